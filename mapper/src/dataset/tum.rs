//! TUM RGB-D folders: `rgb.txt` (`timestamp path`) and `groundtruth.txt` (`t tx ty tz qx qy qz qw`, world from camera),
//! joined by the nearest time.

use super::cameras::CameraSource;
use super::pictures::{FoundPicture, Pictures};
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use landline::formats::rigid_from_quaternion;
use landline::geometry::{Camera, CameraModel, WorldFromCam};
use landline::scene_file::Units;
use nalgebra::Vector3;
use std::path::Path;

/// Poses come at 100 Hz; further apart than this they belong to another moment.
const MAX_TIME_DIFFERENCE_S: f64 = 0.02;

/// fx, fy, cx, cy of the three sensors (the set's own table; principal points count pixel centres as integers).
const SENSORS: [(&str, [f64; 4]); 3] = [
    ("freiburg1", [517.3, 516.5, 318.6, 255.3]),
    ("freiburg2", [520.9, 521.0, 325.1, 249.7]),
    ("freiburg3", [535.4, 539.2, 320.1, 247.6]),
];

/// Whether a folder has this layout.
pub(super) fn is_tum(root: &Path) -> bool {
    root.join("rgb.txt").is_file() && root.join("groundtruth.txt").is_file()
}

/// Reads the folder.
pub(super) fn read(
    root: &Path,
    pictures: &Pictures,
    cameras: &CameraSource,
) -> Result<Dataset, DatasetError> {
    let mut dataset = Dataset::empty("TUM RGB-D");
    dataset.units = Units::Metres;
    dataset.sources.push(root.to_owned());
    let truth_path = root.join("groundtruth.txt");
    let truth = read_text(&truth_path)?;
    let mut poses: Vec<(f64, [f64; 7])> = Vec::new();
    for line in truth.lines() {
        let v = line.numbers(&line.fields())?;
        let &[t, tx, ty, tz, qx, qy, qz, qw] = v.as_slice() else {
            return Err(line
                .error(format!(
                    "expected `t tx ty tz qx qy qz qw`, found {} numbers",
                    v.len()
                ))
                .into());
        };
        poses.push((t, [tx, ty, tz, qw, qx, qy, qz]));
    }
    poses.sort_by(|a, b| a.0.total_cmp(&b.0));
    let folder_name = root
        .canonicalize()
        .unwrap_or_else(|_| root.to_owned())
        .to_string_lossy()
        .to_lowercase();
    let sensor = SENSORS.iter().find(|(name, _)| folder_name.contains(name));
    if let Some((name, _)) = sensor {
        dataset.notes.push(format!(
            "camera of {name} from the set's table, without lens distortion (--camera to change)"
        ));
    }
    let list = read_text(&root.join("rgb.txt"))?;
    for line in list.lines() {
        let fields = line.fields();
        let Some(time) = fields.first() else {
            continue;
        };
        let name = line.split_at(1).1.to_owned();
        let time: f64 = line.number(time)?;
        let at = poses.partition_point(|(t, _)| *t < time);
        let nearest = [at.checked_sub(1), Some(at)]
            .into_iter()
            .flatten()
            .filter_map(|i| poses.get(i))
            .min_by(|a, b| (a.0 - time).abs().total_cmp(&(b.0 - time).abs()))
            .filter(|(t, _)| (t - time).abs() <= MAX_TIME_DIFFERENCE_S);
        let Some((_, [tx, ty, tz, qw, qx, qy, qz])) = nearest else {
            dataset.drop_image(name, "no pose within 0.02 s");
            continue;
        };
        let world_from_cam: WorldFromCam =
            match rigid_from_quaternion([*qw, *qx, *qy, *qz], Vector3::new(*tx, *ty, *tz)) {
                Ok(t) => t,
                Err(problem) => {
                    dataset.drop_image(name, format!("pose: {problem}"));
                    continue;
                }
            };
        let Some(FoundPicture {
            name, path, size, ..
        }) = pictures.find(&name, &mut dataset)
        else {
            continue;
        };
        let camera = match (cameras.camera(&name, size, None), sensor) {
            (Some(camera), _) => camera.map_err(|e| line.error(e))?,
            (None, Some((_, [fx, fy, cx, cy]))) => {
                let scale = f64::from(size.0) / 640.0;
                Camera {
                    width: size.0,
                    height: size.1,
                    model: CameraModel::Pinhole {
                        fx: fx * scale,
                        fy: fy * scale,
                        cx: (cx + 0.5) * scale,
                        cy: (cy + 0.5) * scale,
                    },
                }
            }
            (None, None) => {
                return Err(DatasetError::missing(
                    root,
                    "the folder's name does not say which sensor (freiburg1, 2 or 3); give --camera MODEL,w,h,params",
                ));
            }
        };
        dataset.images.push(DatasetImage {
            name,
            path,
            camera,
            cam_from_world: Some(world_from_cam.inverse()),
            split: Split::Train,
        });
    }
    Ok(dataset)
}
