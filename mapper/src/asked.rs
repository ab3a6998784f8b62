//! A place asked with pictures: of which room, and where in it.

use crate::picture;
use crate::place::PlaceFiles;
use anyhow::{Context, Result, bail};
use landline::geometry::Camera;
use landline::image::{FrameView, PixelFormat};
use landline::place::{Place, PlaceOptions, PlaceReport};
use landline::relocalizer::{Outcome, Relocalizer};
use landline::scene_file::ExtractorFile;
use landline::session::SessionQuery;
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Pictures of known rooms.
#[derive(Debug, Clone, Default)]
pub struct RoomPictures {
    /// Name of the room and its pictures.
    pub rooms: Vec<(String, Vec<PathBuf>)>,
}

impl RoomPictures {
    /// The folders of a folder; each is called as its room.
    ///
    /// # Errors
    /// When a folder cannot be listed, or there is no picture.
    pub fn of_folder(folder: &Path) -> Result<Self> {
        let list = |folder: &Path| -> Result<Vec<PathBuf>> {
            let entries = std::fs::read_dir(folder)
                .with_context(|| format!("cannot list {}", folder.display()))?;
            let mut paths: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
            paths.sort();
            Ok(paths)
        };
        let mut rooms = Vec::new();
        for room in list(folder)?.into_iter().filter(|p| p.is_dir()) {
            let mut pictures = list(&room)?;
            pictures.retain(|p| picture::has_known_ending(p));
            let name = room.file_name().unwrap_or_default().to_string_lossy();
            rooms.push((name.into_owned(), pictures));
        }
        if rooms.iter().all(|(_, pictures)| pictures.is_empty()) {
            bail!("no folder of {} holds a picture", folder.display());
        }
        Ok(Self { rooms })
    }
}

/// A place of which scenes are read when they are wanted.
#[derive(Debug)]
pub struct Asking {
    files: PlaceFiles,
    place: Place,
    extractor: ExtractorFile,
    started: Instant,
}

impl Asking {
    /// Starts without any scene.
    ///
    /// # Errors
    /// When place and extractor do not belong together.
    pub fn new(files: PlaceFiles, extractor: ExtractorFile) -> Result<Self> {
        let (manifest, index) = (files.manifest.clone(), files.index.clone());
        let options = PlaceOptions::default();
        let place = Place::new(manifest, index, extractor.clone(), options, |_| ())?;
        Ok(Self {
            files,
            place,
            extractor,
            started: Instant::now(),
        })
    }

    fn id(&self, room: usize) -> &str {
        let room = self.files.manifest.rooms.get(room);
        room.map_or("", |r| r.id.as_str())
    }

    /// Locates a picture, with all the scenes that it wants. A room whose scene is not as it should be is told and left out.
    fn locate(&mut self, rgb: &image::RgbImage, camera: Option<Camera>) -> Result<PlaceReport> {
        let frame = FrameView::tight(rgb.as_raw(), rgb.width(), rgb.height(), PixelFormat::Rgb8);
        let query = SessionQuery {
            camera: camera.and_then(|c| c.for_size(rgb.width(), rgb.height())),
            ..SessionQuery::default()
        };
        let started = self.started;
        let mut clock = move || started.elapsed().as_secs_f64() * 1e3;
        let mut report = self.place.locate(&frame, &query, &mut clock)?;
        loop {
            let mut has_come = false;
            for room in self.place.wanted().to_vec() {
                let scene = self.files.scene(room);
                match scene.and_then(|scene| Ok(self.place.put_room(room, scene)?)) {
                    Ok(()) => has_come = true,
                    Err(error) => eprintln!("left out: {}", crate::shown::told(&error)),
                }
            }
            if !has_come {
                break;
            }
            if let Some(again) = self.place.resume(&query, &mut clock)? {
                report = again;
            }
        }
        Ok(report)
    }

    /// Room and position of a picture, as a line. `camera` is that of the picture, where it is known.
    ///
    /// # Errors
    /// When the picture cannot be read.
    pub fn told(&mut self, path: &Path, camera: Option<Camera>) -> Result<String> {
        let rgb = picture::read(path)?.into_rgb8();
        self.place.leave();
        let report = self.locate(&rgb, camera)?;
        Ok(match (&report.session.frame.outcome, report.room) {
            (Outcome::Located(l), Some(room)) => {
                let c = l.cam_from_world.center_in_world();
                let mut line = format!(
                    "in {:?} at {:.3} {:.3} {:.3}, confidence {:.3}",
                    self.id(room),
                    c.x,
                    c.y,
                    c.z,
                    l.confidence
                );
                if let Some(cam_from_place) = report.cam_from_place {
                    let c = cam_from_place.center_in_world();
                    write!(line, "; in the place at {:.3} {:.3} {:.3}", c.x, c.y, c.z)?;
                }
                line
            }
            _ => match report.rival {
                Some([a, b]) => format!(
                    "not located: {:?} and {:?} look alike from there",
                    self.id(a),
                    self.id(b)
                ),
                None => match report.session.frame.outcome {
                    Outcome::NotLocated(reason) => format!("not located: {}", reason.message()),
                    Outcome::Located(_) => "not located".to_owned(),
                },
            },
        })
    }

    /// Asks with pictures of known rooms, each for itself, and writes how often the room was right, a line when a room is done.
    /// `twins` are pairs `ROOM=ROOM` that may be taken for each other in the ranking.
    ///
    /// # Errors
    /// When a picture cannot be read, a room does not exist, or nothing can be written.
    pub fn evaluate(
        &mut self,
        asked: &RoomPictures,
        twins: &[String],
        out: &mut dyn Write,
    ) -> Result<()> {
        let mut all = Tally::default();
        for (name, pictures) in &asked.rooms {
            let truth = self.files.manifest.position(name);
            let truth = truth.with_context(|| format!("there is no room {name:?}"))?;
            let twin = twins.iter().filter_map(|pair| pair.split_once('='));
            let twin = twin.filter_map(|(a, b)| {
                let other = [(a, b), (b, a)]
                    .into_iter()
                    .find(|(own, _)| *own == name.as_str())?;
                self.files.manifest.position(other.1)
            });
            let own: Vec<usize> = std::iter::once(truth).chain(twin).collect();
            let tally = self.evaluate_room(truth, &own, pictures)?;
            writeln!(out, "{name}: {tally}")?;
            out.flush()?;
            all.add(&tally);
        }
        writeln!(out, "all: {all}")?;
        writeln!(
            out,
            "index {} bytes; scenes at hand {} bytes; times in ms, median: ranking {:.3}, first frame in a room {:.1}, next \
             frame there {:.1}, the same with its scene alone {:.1}",
            self.files.manifest.index.bytes,
            self.place.num_bytes(),
            median(&mut all.rank_ms),
            median(&mut all.first_ms),
            median(&mut all.next_ms),
            median(&mut all.alone_ms),
        )?;
        Ok(())
    }

    /// `own` are the rooms that count as right in the ranking: the true one, and its twins.
    fn evaluate_room(
        &mut self,
        truth: usize,
        own: &[usize],
        pictures: &[PathBuf],
    ) -> Result<Tally> {
        let scene = self.files.scene(truth)?;
        let camera = scene.info.camera;
        let mut alone = Relocalizer::new(scene, self.extractor.clone(), |_| ())?;
        let mut tally = Tally::default();
        let mut ranking = Vec::new();
        for path in pictures {
            let rgb = picture::read(path)?.into_rgb8();
            self.place.leave();
            let start = Instant::now();
            let report = self.locate(&rgb, camera)?;
            tally.first_ms.push(start.elapsed().as_secs_f64() * 1e3);
            let start = Instant::now();
            let features = self.place.session().relocalizer().features();
            self.files.index.rank(features, &mut ranking);
            tally.rank_ms.push(start.elapsed().as_secs_f64() * 1e3);
            tally.num_asked += 1;
            let at = ranking.iter().position(|r| own.contains(&r.room));
            tally.num_first += usize::from(at == Some(0));
            tally.num_in_three += usize::from(at.is_some_and(|at| at < 3));
            tally.num_ambiguous += usize::from(report.rival.is_some());
            match report.room {
                Some(room) if room == truth => tally.num_right += 1,
                Some(_) => tally.num_wrong += 1,
                None => {}
            }
            if report.room != Some(truth) {
                continue;
            }
            let start = Instant::now();
            self.locate(&rgb, camera)?;
            tally.next_ms.push(start.elapsed().as_secs_f64() * 1e3);
            let frame =
                FrameView::tight(rgb.as_raw(), rgb.width(), rgb.height(), PixelFormat::Rgb8);
            let query = landline::relocalizer::Query {
                camera: camera.and_then(|c| c.for_size(rgb.width(), rgb.height())),
                ..Default::default()
            };
            let start = Instant::now();
            alone.locate(&frame, &query, &mut || 0.0)?;
            tally.alone_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(tally)
    }
}

/// How often what happened.
#[derive(Debug, Clone, Default)]
struct Tally {
    num_asked: usize,
    num_first: usize,
    num_in_three: usize,
    num_right: usize,
    num_wrong: usize,
    num_ambiguous: usize,
    rank_ms: Vec<f64>,
    first_ms: Vec<f64>,
    next_ms: Vec<f64>,
    alone_ms: Vec<f64>,
}

impl Tally {
    fn add(&mut self, other: &Self) {
        self.num_asked += other.num_asked;
        self.num_first += other.num_first;
        self.num_in_three += other.num_in_three;
        self.num_right += other.num_right;
        self.num_wrong += other.num_wrong;
        self.num_ambiguous += other.num_ambiguous;
        for (own, others) in [
            (&mut self.rank_ms, &other.rank_ms),
            (&mut self.first_ms, &other.first_ms),
            (&mut self.next_ms, &other.next_ms),
            (&mut self.alone_ms, &other.alone_ms),
        ] {
            own.extend_from_slice(others);
        }
    }
}

impl core::fmt::Display for Tally {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "{} asked; right room first {}, among three {}; located in the right room {}, in a wrong one {}, ambiguous {}",
            self.num_asked,
            self.num_first,
            self.num_in_three,
            self.num_right,
            self.num_wrong,
            self.num_ambiguous
        )
    }
}

fn median(values: &mut [f64]) -> f64 {
    landline::math::stats::median_in_place(values).unwrap_or(0.0)
}
