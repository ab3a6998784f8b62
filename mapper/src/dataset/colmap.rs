//! COLMAP sparse models, binary or text, of versions with and without rigs and frames.
//!
//! Every version writes the full pose of each picture into `images`, rigs or not, so `rigs` and `frames` need no reading.
//! Pixels are corner-based and poses camera from world, as ours.

use super::args::QuaternionOrder;
use super::camera::{colmap_model, expressed};
use super::pictures::Pictures;
use super::pose_check::rigid_from_quaternion;
use super::text::TextFile;
use super::{Dataset, DatasetError, DatasetImage, ModelPoint, Split};
use landline::geometry::{Camera, CameraRecord, Pixel};
use nalgebra::Vector3;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

struct RawImage {
    name: String,
    quaternion: [f64; 4],
    translation: [f64; 3],
    camera: u32,
    /// Pixel and id of its 3D point.
    keypoints: Vec<(Pixel, Option<u64>)>,
}

struct RawPoint {
    id: u64,
    position: [f64; 3],
    /// Picture id and keypoint.
    track: Vec<(u32, u32)>,
}

struct RawModel {
    cameras: HashMap<u32, CameraRecord>,
    images: Vec<(u32, RawImage)>,
    points: Vec<RawPoint>,
}

/// The model of a workspace, and others that were not chosen.
pub(super) struct FoundModel {
    /// Its folder.
    pub(super) folder: PathBuf,
    /// For the table, when there was a choice.
    pub(super) note: Option<String>,
}

/// Number of pictures of the model in a folder; `None` when there is none.
fn num_pictures(folder: &Path) -> Option<u64> {
    use std::io::Read;
    if let Ok(mut file) = std::fs::File::open(folder.join("images.bin")) {
        let mut count = [0; 8];
        // A file too short to hold a count is one that its reader refuses with the reason.
        return Some(
            file.read_exact(&mut count)
                .map_or(0, |()| u64::from_le_bytes(count)),
        );
    }
    let path = folder.join("images.txt");
    path.is_file().then(|| {
        TextFile::read(&path).map_or(0, |file| {
            let lines = file.all_lines().filter(|l| !l.text.starts_with('#'));
            lines.count() as u64 / 2
        })
    })
}

/// The model folder in a workspace: the folder itself, or the one under `sparse` with the most pictures.
pub(super) fn find_model(root: &Path) -> Option<FoundModel> {
    if num_pictures(root).is_some() {
        return Some(FoundModel {
            folder: root.to_owned(),
            note: None,
        });
    }
    let mut candidates = Vec::new();
    for base in [
        root.to_owned(),
        root.join("sparse"),
        root.join("colmap/sparse"),
    ] {
        candidates.push(base.clone());
        if let Ok(entries) = std::fs::read_dir(&base) {
            candidates.extend(entries.flatten().map(|e| e.path()));
        }
    }
    // `sparse` is both a base and a folder of the root.
    candidates.sort();
    candidates.dedup();
    let mut models: Vec<(u64, PathBuf)> = candidates
        .into_iter()
        .filter_map(|folder| num_pictures(&folder).map(|n| (n, folder)))
        .collect();
    // The most pictures; of equals the first by name.
    models.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    let mut models = models.into_iter();
    let (count, folder) = models.next()?;
    let others: Vec<String> = models
        .map(|(n, other)| format!("{} ({n} pictures)", other.display()))
        .collect();
    let note = (!others.is_empty()).then(|| {
        format!(
            "several models: {} with {count} pictures is read, not {}; give a model's folder to choose (with --pictures DIR)",
            folder.display(),
            others.join(", ")
        )
    });
    Some(FoundModel { folder, note })
}

/// Reads a model.
pub(super) fn read(
    folder: &Path,
    pictures: &Pictures,
    quaternions: QuaternionOrder,
) -> Result<Dataset, DatasetError> {
    let is_binary = folder.join("images.bin").is_file();
    let raw = if is_binary {
        read_binary(folder)?
    } else {
        read_text(folder)?
    };
    let mut dataset = Dataset::empty(if is_binary {
        "COLMAP model (binary)"
    } else {
        "COLMAP model (text)"
    });
    dataset.sources.push(folder.to_owned());
    if ["rigs.bin", "rigs.txt"]
        .iter()
        .any(|f| folder.join(f).is_file())
    {
        dataset
            .notes
            .push("model with rigs: each picture's own pose is used".to_owned());
    }
    if raw.points.is_empty() {
        dataset.notes.push(
            "the model has no points (no points3D file, or an empty one): points are triangulated"
                .to_owned(),
        );
    }
    let mut cameras: HashMap<u32, Result<Camera, String>> = HashMap::new();
    for (id, record) in &raw.cameras {
        cameras.insert(*id, expressed(record).map_err(|e| e.to_string()));
    }
    let mut position_of: HashMap<u32, usize> = HashMap::new();
    for (id, image) in &raw.images {
        let camera = match cameras.get(&image.camera) {
            Some(Ok(camera)) => *camera,
            Some(Err(reason)) => {
                dataset.drop_image(&image.name, reason.clone());
                continue;
            }
            None => {
                return Err(DatasetError::missing(
                    folder,
                    format!(
                        "picture {} names camera {}, which the model lacks",
                        image.name, image.camera
                    ),
                ));
            }
        };
        let cam_from_world = match rigid_from_quaternion(
            quaternions.wxyz(image.quaternion),
            image.translation.into(),
        ) {
            Ok(transform) => transform,
            Err(problem) => {
                dataset.drop_image(&image.name, format!("pose: {problem}"));
                continue;
            }
        };
        let Some(found) = pictures.find(&image.name, &mut dataset) else {
            continue;
        };
        position_of.insert(*id, dataset.images.len());
        dataset.images.push(DatasetImage {
            name: found.name,
            path: found.path,
            camera,
            cam_from_world: Some(cam_from_world),
            split: Split::Train,
        });
    }
    let by_id: HashMap<u32, &RawImage> =
        raw.images.iter().map(|(id, image)| (*id, image)).collect();
    let mut num_broken = 0;
    for point in &raw.points {
        let mut observations = Vec::with_capacity(point.track.len());
        for (image, keypoint) in &point.track {
            let seen = by_id
                .get(image)
                .and_then(|i| i.keypoints.get(*keypoint as usize));
            match (seen, position_of.get(image)) {
                (Some((pixel, owner)), Some(position)) => {
                    num_broken += usize::from(*owner != Some(point.id));
                    observations.push((*position, *pixel));
                }
                (None, _) => num_broken += 1,
                // The picture was dropped.
                (Some(_), None) => {}
            }
        }
        if observations.len() >= 2 {
            dataset.points.push(ModelPoint {
                point_in_world: Vector3::from(point.position),
                observations,
            });
        }
    }
    if num_broken > 0 {
        dataset.notes.push(format!(
            "{num_broken} observations of points do not agree with the pictures' keypoints"
        ));
    }
    Ok(dataset)
}

/// Little-endian numbers of a file, front to back.
struct Reader<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    next: usize,
}

impl Reader<'_> {
    fn error(&self, what: impl ToString) -> DatasetError {
        DatasetError::parse(self.path, format!("byte {}", self.next), what)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], DatasetError> {
        let taken = self
            .bytes
            .get(self.next..)
            .and_then(|rest| rest.first_chunk::<N>())
            .copied()
            .ok_or_else(|| {
                self.error(format!(
                    "the file ends here, at least {N} more bytes were expected"
                ))
            })?;
        self.next += N;
        Ok(taken)
    }

    fn u8(&mut self) -> Result<u8, DatasetError> {
        self.take().map(|[b]: [u8; 1]| b)
    }
    fn u32(&mut self) -> Result<u32, DatasetError> {
        self.take().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Result<u64, DatasetError> {
        self.take().map(u64::from_le_bytes)
    }
    fn f64(&mut self) -> Result<f64, DatasetError> {
        self.take().map(f64::from_le_bytes)
    }

    /// A count of records that take at least `size` bytes each.
    fn count(&mut self, size: usize) -> Result<usize, DatasetError> {
        let count = self.u64()?;
        let rest = self.bytes.len().saturating_sub(self.next) / size;
        match usize::try_from(count) {
            Ok(n) if n <= rest => Ok(n),
            _ => Err(self.error(format!("{count} records are announced, at most {rest} fit"))),
        }
    }

    fn side(&mut self) -> Result<u32, DatasetError> {
        let value = self.u64()?;
        u32::try_from(value).map_err(|_| self.error(format!("a picture side of {value} pixels")))
    }

    fn name(&mut self) -> Result<String, DatasetError> {
        let rest = self.bytes.get(self.next..).unwrap_or_default();
        let len = rest
            .iter()
            .position(|b| *b == 0)
            .ok_or_else(|| self.error("a picture name does not end"))?;
        let name = std::str::from_utf8(&rest[..len])
            .map_err(|e| self.error(format!("a picture name is not UTF-8: {e}")))?
            .to_owned();
        self.next += len + 1;
        Ok(name)
    }
}

fn read_binary(folder: &Path) -> Result<RawModel, DatasetError> {
    let load = |name: &str| {
        let path = folder.join(name);
        std::fs::read(&path)
            .map(|bytes| (path.clone(), bytes))
            .map_err(DatasetError::io(&path))
    };
    let mut cameras = HashMap::new();
    let (path, bytes) = load("cameras.bin")?;
    let mut r = Reader {
        path: &path,
        bytes: &bytes,
        next: 0,
    };
    for _ in 0..r.count(24)? {
        let id = r.u32()?;
        let model = r.u32()?;
        let (width, height) = (r.side()?, r.side()?);
        let model = colmap_model(model).ok_or_else(|| {
            r.error(format!(
                "camera model {model} is unknown, and the file does not say how many parameters it has"
            ))
        })?;
        let params = (0..model.num_params)
            .map(|_| r.f64())
            .collect::<Result<_, _>>()?;
        cameras.insert(
            id,
            CameraRecord {
                model: model.name.to_owned(),
                width,
                height,
                params,
            },
        );
    }

    let (path, bytes) = load("images.bin")?;
    let mut r = Reader {
        path: &path,
        bytes: &bytes,
        next: 0,
    };
    let mut images = Vec::new();
    for _ in 0..r.count(73)? {
        let id = r.u32()?;
        let quaternion = [r.f64()?, r.f64()?, r.f64()?, r.f64()?];
        let translation = [r.f64()?, r.f64()?, r.f64()?];
        let camera = r.u32()?;
        let name = r.name()?;
        let mut keypoints = Vec::new();
        for _ in 0..r.count(24)? {
            let pixel = Pixel::new(r.f64()?, r.f64()?);
            let point = r.u64()?;
            keypoints.push((pixel, (point != u64::MAX).then_some(point)));
        }
        images.push((
            id,
            RawImage {
                name,
                quaternion,
                translation,
                camera,
                keypoints,
            },
        ));
    }

    let mut points = Vec::new();
    // Poses do not need points: a model of known poses has none.
    if !folder.join("points3D.bin").exists() {
        return Ok(RawModel {
            cameras,
            images,
            points,
        });
    }
    let (path, bytes) = load("points3D.bin")?;
    let mut r = Reader {
        path: &path,
        bytes: &bytes,
        next: 0,
    };
    for _ in 0..r.count(51)? {
        let id = r.u64()?;
        let position = [r.f64()?, r.f64()?, r.f64()?];
        let _colour = [r.u8()?, r.u8()?, r.u8()?];
        let _error = r.f64()?;
        let mut track = Vec::new();
        for _ in 0..r.count(8)? {
            track.push((r.u32()?, r.u32()?));
        }
        points.push(RawPoint {
            id,
            position,
            track,
        });
    }
    Ok(RawModel {
        cameras,
        images,
        points,
    })
}

fn read_text(folder: &Path) -> Result<RawModel, DatasetError> {
    let mut cameras = HashMap::new();
    let file = TextFile::read(&folder.join("cameras.txt"))?;
    for line in file.lines() {
        let fields = line.fields();
        let (&[id, model, width, height], params) = fields
            .split_first_chunk::<4>()
            .ok_or_else(|| line.error("expected `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`"))?;
        cameras.insert(
            line.number(id)?,
            CameraRecord {
                model: model.to_owned(),
                width: line.number(width)?,
                height: line.number(height)?,
                params: line.finite(params)?,
            },
        );
    }

    let file = TextFile::read(&folder.join("images.txt"))?;
    let mut images = Vec::new();
    let mut lines = file.all_lines();
    while let Some(line) = lines.next() {
        if line.text.is_empty() || line.text.starts_with('#') {
            continue;
        }
        let fields = line.fields();
        let Some((numbers, _)) = fields
            .split_first_chunk::<9>()
            .filter(|(_, name)| !name.is_empty())
        else {
            return Err(line.error(
                "expected `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, and keypoints on every second line",
            ));
        };
        let pose = line.numbers(&numbers[1..8])?;
        // The second line, which may be empty, is x, y, point id, repeatedly.
        let mut keypoints = Vec::new();
        if let Some(second) = lines.next() {
            let fields = second.fields();
            if fields.len() % 3 != 0 {
                return Err(second.error(format!(
                    "expected triples X Y POINT3D_ID, found {} fields",
                    fields.len()
                )));
            }
            for triple in fields.chunks_exact(3) {
                let id: i64 = second.number(triple[2])?;
                keypoints.push((
                    Pixel::new(second.number(triple[0])?, second.number(triple[1])?),
                    u64::try_from(id).ok(),
                ));
            }
        }
        images.push((
            line.number(numbers[0])?,
            RawImage {
                name: line.split_at(9).1.to_owned(),
                quaternion: [pose[0], pose[1], pose[2], pose[3]],
                translation: [pose[4], pose[5], pose[6]],
                camera: line.number(numbers[8])?,
                keypoints,
            },
        ));
    }

    let mut points = Vec::new();
    let path = folder.join("points3D.txt");
    // Poses do not need points: a model of known poses has none.
    if !path.exists() {
        return Ok(RawModel {
            cameras,
            images,
            points,
        });
    }
    let file = TextFile::read(&path)?;
    for line in file.lines() {
        let fields = line.fields();
        let Some((head, track)) = fields
            .split_first_chunk::<8>()
            .filter(|(_, t)| t.len() % 2 == 0)
        else {
            return Err(line
                .error("expected `POINT3D_ID X Y Z R G B ERROR` and pairs IMAGE_ID POINT2D_IDX"));
        };
        let position = line.finite(&head[1..4])?;
        points.push(RawPoint {
            id: line.number(head[0])?,
            position: [position[0], position[1], position[2]],
            track: track
                .chunks_exact(2)
                .map(|pair| Ok((line.number(pair[0])?, line.number(pair[1])?)))
                .collect::<Result<_, DatasetError>>()?,
        });
    }
    Ok(RawModel {
        cameras,
        images,
        points,
    })
}
