//! Cameras that come beside the poses: one for all, a list by name, or a `K.txt`.

use super::DatasetError;
use super::pictures::FoundPicture;
use super::text::read_text;
use landline::formats::list::query_line;
use landline::formats::{CameraRecordError, Names, expressed};
use landline::geometry::{Camera, CameraModel, CameraRecord, PixelMap};
use std::path::Path;

/// Where cameras come from when a list has none.
#[derive(Default)]
pub(super) struct CameraSource {
    /// For all pictures.
    pub(super) given: Option<CameraRecord>,
    /// By picture name: the names and a camera for each.
    by_name: Option<(Names, Vec<CameraRecord>)>,
    /// fx, fy, cx, cy of a `K.txt`, its principal point already corner-based.
    pub(super) k: Option<[f64; 4]>,
}

impl CameraSource {
    /// One camera for all pictures, or none yet.
    pub(super) fn new(given: Option<CameraRecord>) -> Self {
        Self {
            given,
            ..Self::default()
        }
    }

    /// Reads a query list for its cameras.
    pub(super) fn read_cameras(&mut self, path: &Path) -> Result<(), DatasetError> {
        let file = read_text(path)?;
        let (names, records): (Vec<String>, Vec<CameraRecord>) = file
            .lines()
            .map(|line| query_line(&line))
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .unzip();
        self.by_name = Some((Names::new(names.iter().map(String::as_str)), records));
        Ok(())
    }

    /// Reads a 3x3 matrix. Such files count pixel centres as integers (OpenCV), so half a pixel is added.
    pub(super) fn read_k(&mut self, path: &Path) -> Result<(), DatasetError> {
        let file = read_text(path)?;
        let mut v = Vec::new();
        for line in file.lines() {
            v.extend(line.finite(&line.fields())?);
        }
        let &[fx, skew, cx, _, fy, cy, _, _, one] = v.as_slice() else {
            return Err(DatasetError::missing(
                path,
                format!("expected a 3x3 matrix, found {} numbers", v.len()),
            ));
        };
        if one != 1.0 || skew != 0.0 {
            return Err(DatasetError::missing(
                path,
                "this is no camera matrix of the form [fx 0 cx; 0 fy cy; 0 0 1]",
            ));
        }
        self.k = Some([fx, fy, cx + 0.5, cy + 0.5]);
        Ok(())
    }

    /// The camera that was given for a picture with the size that it is of.
    fn stated(&self, name: &str) -> Option<&CameraRecord> {
        let listed = self
            .by_name
            .as_ref()
            .and_then(|(names, records)| records.get(names.find(name).one()?));
        listed.or(self.given.as_ref())
    }

    /// For a picture that EXIF turns, where no size says whether its pose is of the stored pixels: the camera of those.
    pub(super) fn camera_of_stored(
        &self,
        found: &FoundPicture,
        focal: Option<f64>,
    ) -> Option<Camera> {
        let stored = found
            .stored
            .filter(|_| self.stated(&found.name).is_none())?;
        self.camera(&found.name, stored, focal)?.ok()
    }

    /// The camera of a picture of a given size; `None` when nothing is known.
    pub(super) fn camera(
        &self,
        name: &str,
        (width, height): (u32, u32),
        focal: Option<f64>,
    ) -> Option<Result<Camera, CameraRecordError>> {
        if let Some(record) = self.stated(name) {
            return Some(expressed(record));
        }
        let camera = match (focal, self.k) {
            (Some(f), _) => Camera::centered(width, height, f),
            (None, Some([fx, fy, cx, cy])) => Camera {
                width,
                height,
                model: CameraModel::Pinhole { fx, fy, cx, cy },
            },
            (None, None) => return None,
        };
        let (camera, _) = of_this_size(camera);
        Some(
            camera
                .validate()
                .map(|()| camera)
                .map_err(CameraRecordError::from),
        )
    }

    /// What was done to a `K.txt` for a picture of a given size, for the table.
    pub(super) fn k_note(&self, (width, height): (u32, u32)) -> Option<String> {
        let [fx, fy, cx, cy] = self.k?;
        let model = CameraModel::Pinhole { fx, fy, cx, cy };
        of_this_size(Camera {
            width,
            height,
            model,
        })
        .1
    }
}

/// Sizes by which pictures are shrunk or enlarged.
const USUAL_SCALES: [f64; 10] = [
    0.25,
    1.0 / 3.0,
    0.5,
    2.0 / 3.0,
    0.75,
    4.0 / 3.0,
    1.5,
    2.0,
    3.0,
    4.0,
];

/// Intrinsics that state no size, made those of the picture at hand, with a remark.
///
/// A lens looks through the middle of its picture. A principal point that lies as far from it along both sides as that of a
/// picture of another usual size would, says that the numbers are of that size.
pub(super) fn of_this_size(camera: Camera) -> (Camera, Option<String>) {
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let center = camera.principal_point();
    let (rx, ry) = (2.0 * center.x / w, 2.0 * center.y / h);
    let ratio = (rx * ry).abs().sqrt();
    let is_centered = |r: f64| (0.7..=1.3).contains(&r);
    if is_centered(rx) && is_centered(ry) {
        return (camera, None);
    }
    let usual = USUAL_SCALES
        .into_iter()
        .find(|scale| [rx, ry].iter().all(|r| (r / scale - 1.0).abs() < 0.08));
    let Some(scale) = usual else {
        return (
            camera,
            Some(format!(
                "the principal point {:.1} {:.1} is far from the middle of pictures of {w}x{h} (ratio {ratio:.2}): are the \
                 intrinsics of another size? --camera MODEL,w,h,params states one",
                center.x, center.y
            )),
        );
    };
    let map: PixelMap<Here, There> = PixelMap::from_scale(1.0 / scale, 1.0 / scale);
    let scaled = Camera {
        width: camera.width,
        height: camera.height,
        ..camera.resized(&map)
    };
    let note = format!(
        "intrinsics are of pictures of {:.0}x{:.0}, as their principal point says, and were scaled to {w}x{h}",
        w * scale,
        h * scale
    );
    (scaled, Some(note))
}

/// The picture at hand, and the one that intrinsics are of.
enum Here {}
enum There {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_of_a_picture_of_another_size_are_told_by_their_principal_point() {
        let camera = |fx: f64, cx: f64, cy: f64| Camera {
            width: 640,
            height: 480,
            model: CameraModel::Pinhole { fx, fy: fx, cx, cy },
        };
        // Of 1280x960, its principal point off the middle by some pixels.
        let (scaled, note) = of_this_size(camera(1051.01, 652.0, 471.0));
        assert_eq!(scaled, camera(525.505, 326.0, 235.5));
        assert!(note.is_some_and(|n| n.contains("1280x960")));
        for kept in [camera(525.0, 320.0, 240.0), camera(525.0, 400.0, 200.0)] {
            assert_eq!(of_this_size(kept), (kept, None));
        }
        // A corner of a picture: nothing to go by, but worth a word.
        let odd = camera(525.0, 640.0, 240.0);
        let (kept, note) = of_this_size(odd);
        assert!(kept == odd && note.is_some_and(|n| n.contains("--camera")));
    }
}
