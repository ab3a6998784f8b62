//! Pictures without poses: found in a folder or taken from a video, and posed by structure from motion.

use crate::dataset::{DatasetImage, Split, WrittenImage, WrittenModel, WrittenPoint};
use crate::picture::{self, counted};
use landline::features::FeatureSet;
use landline::geometry::Camera;
use landline::reconstruction::motion::{CameraGroup, Component};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Why there are no pictures to pose.
#[derive(Debug, thiserror::Error)]
pub enum UnposedError {
    /// The operating system refused.
    #[error("cannot read {path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder without pictures, or with one.
    #[error(
        "{path} has {}: poses need three at least that overlap, better thirty to three hundred{}",
        counted(*found, "readable picture"),
        because(unread)
    )]
    TooFew {
        /// The folder.
        path: PathBuf,
        /// Pictures in it.
        found: usize,
        /// What is there and not read, for people.
        unread: Vec<String>,
    },
    /// A picture in place of a folder of them.
    #[error(
        "{0} is a picture: give the folder that holds the pictures, three at least, or a video"
    )]
    OnePicture(PathBuf),
    /// A video, and nothing that reads it.
    #[error(
        "{path} is a video, and the program `ffmpeg` that reads videos is not there: install it (https://ffmpeg.org), or \
         give a folder of pictures"
    )]
    NoFfmpeg {
        /// The video.
        path: PathBuf,
    },
    /// `ffmpeg` could not read the video.
    #[error("{path} cannot be read as a video: {what}")]
    Video {
        /// The video.
        path: PathBuf,
        /// The last line that the program said.
        what: String,
    },
}

fn because(unread: &[String]) -> String {
    match unread {
        [] => String::new(),
        all => format!("; not read: {}", all.join("; ")),
    }
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> UnposedError + '_ {
    move |source| UnposedError::Io {
        path: path.to_owned(),
        source,
    }
}

/// Pictures of a folder in the order of their names, and those that cannot be read with the reason.
pub struct Found {
    /// Without poses; cameras know only the size.
    pub images: Vec<DatasetImage>,
    /// Name and reason.
    pub unreadable: Vec<(String, String)>,
}

impl Found {
    /// What could not be read, one text for each reason: how many, the first of them, and why.
    pub fn unread(&self) -> Vec<String> {
        let mut reasons: Vec<(&str, &str, usize)> = Vec::new();
        for (name, reason) in &self.unreadable {
            match reasons.iter_mut().find(|(_, known, _)| known == reason) {
                Some((_, _, num)) => *num += 1,
                None => reasons.push((name, reason, 1)),
            }
        }
        let text = |(name, reason, num): (&str, &str, usize)| match num {
            1 => format!("{name}: {reason}"),
            _ => format!("{} ({name} ...): {reason}", counted(num, "picture")),
        };
        reasons.into_iter().map(text).collect()
    }
}

/// Looks for pictures in a folder, not below it.
///
/// # Errors
/// When the folder cannot be read or has fewer than three.
pub fn find_pictures(folder: &Path) -> Result<Found, UnposedError> {
    let mut found = Found {
        images: Vec::new(),
        unreadable: Vec::new(),
    };
    let listed = picture::listed(folder).map_err(io(folder))?;
    let instead = listed.is_empty().then(|| listed.instead());
    // Those of other formats are asked too, for the reason.
    let undecoded = listed.undecoded.into_iter().map(|(path, _)| path);
    for path in listed.pictures.into_iter().chain(undecoded) {
        let Some(name) = path.file_name() else {
            continue;
        };
        let name = name.to_string_lossy().into_owned();
        match picture::size(&path) {
            Ok(size) if !size.is_mirrored => {
                let (w, h) = size.upright;
                found.images.push(DatasetImage {
                    name,
                    path,
                    camera: CameraGroup::unknown(w, h).camera,
                    cam_from_world: None,
                    split: Split::Train,
                });
            }
            Ok(_) => found
                .unreadable
                .push((name, "EXIF says that the picture is mirrored".to_owned())),
            Err(e) => found.unreadable.push((name, e.short())),
        }
    }
    found.images.sort_by(|a, b| a.name.cmp(&b.name));
    found.unreadable.sort();
    if found.images.len() < 3 {
        return Err(UnposedError::TooFew {
            path: folder.to_owned(),
            found: found.images.len(),
            unread: instead.into_iter().chain(found.unread()).collect(),
        });
    }
    Ok(found)
}

/// Frames of a video at a steady rate into a folder, by the program `ffmpeg`. The folder appears whole or not at all.
///
/// # Errors
/// When the program is missing or refuses the video.
pub fn extract_frames(video: &Path, folder: &Path, per_second: f64) -> Result<(), UnposedError> {
    if picture::is_called_picture(video) {
        return Err(UnposedError::OnePicture(video.to_owned()));
    }
    let mut partial = folder.as_os_str().to_owned();
    partial.push(".partial");
    let partial = PathBuf::from(partial);
    if partial.exists() {
        std::fs::remove_dir_all(&partial).map_err(io(&partial))?;
    }
    std::fs::create_dir_all(&partial).map_err(io(&partial))?;
    let outcome = Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-xerror", "-i"])
        .arg(video)
        .args(["-vf", &format!("fps={per_second}"), "-q:v", "2"])
        .arg(partial.join("%05d.jpg"))
        .output();
    let result = match outcome {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Err(UnposedError::NoFfmpeg {
            path: video.to_owned(),
        }),
        Err(source) => Err(io(video)(source)),
        Ok(output) if !output.status.success() => {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(UnposedError::Video {
                path: video.to_owned(),
                what: said.lines().last().unwrap_or("no reason given").to_owned(),
            })
        }
        Ok(_) => std::fs::rename(&partial, folder).map_err(io(folder)),
    };
    if result.is_err() {
        // The first error is the one to report.
        drop(std::fs::remove_dir_all(&partial));
    }
    result
}

/// One group for each size of picture, and the group of each picture. `given` is asked for what is known of a size.
pub fn group_cameras(
    images: &[DatasetImage],
    given: impl Fn(u32, u32) -> Option<CameraGroup>,
) -> (Vec<CameraGroup>, Vec<usize>) {
    let mut groups: Vec<CameraGroup> = Vec::new();
    let of_image = images
        .iter()
        .map(|image| {
            let (w, h) = (image.camera.width, image.camera.height);
            let is_same = |g: &CameraGroup| (g.camera.width, g.camera.height) == (w, h);
            groups.iter().position(is_same).unwrap_or_else(|| {
                groups.push(given(w, h).unwrap_or_else(|| CameraGroup::unknown(w, h)));
                groups.len() - 1
            })
        })
        .collect();
    (groups, of_image)
}

/// A camera of which only the focal length is known.
pub fn with_focal(width: u32, height: u32, focal_px: f64) -> CameraGroup {
    CameraGroup::given(Camera::centered(width, height, focal_px))
}

/// A component as a COLMAP model: its pictures with all their keypoints.
pub fn written(
    component: &Component,
    images: &[DatasetImage],
    features: &[FeatureSet],
    group_of: &[usize],
) -> WrittenModel {
    let mut index_of = vec![usize::MAX; images.len()];
    let mut model = WrittenModel {
        cameras: component.cameras.clone(),
        images: Vec::new(),
        points: Vec::new(),
    };
    for (i, pose) in component.cam_from_world.iter().enumerate() {
        let Some(cam_from_world) = *pose else {
            continue;
        };
        index_of[i] = model.images.len();
        let keypoints = features[i].keypoints.iter().map(|k| (k.pixel, None));
        model.images.push(WrittenImage {
            name: images[i].name.clone(),
            camera: group_of[i],
            cam_from_world,
            keypoints: keypoints.collect(),
        });
    }
    for (p, point) in component.points.iter().enumerate() {
        let observations: Vec<(usize, usize)> = point
            .observations
            .iter()
            .map(|o| (index_of[o.view as usize], o.feature as usize))
            .collect();
        for (image, keypoint) in &observations {
            model.images[*image].keypoints[*keypoint].1 = Some(p);
        }
        model.points.push(WrittenPoint {
            point_in_world: point.point_in_world,
            error_px: f64::from(point.mean_error_px),
            observations,
        });
    }
    model
}
