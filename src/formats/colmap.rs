//! Files of COLMAP's sparse models, binary and text, of versions with and without rigs and frames.
//!
//! Every version writes the full pose of each picture into `images`, rigs or not. Pixels are corner-based and poses camera from
//! world, as ours.

use super::FormatError;
use super::camera::colmap_model;
use super::text::TextFile;
use crate::geometry::{CameraRecord, Pixel};
use std::collections::HashMap;

/// A picture as `images` has it.
#[derive(Debug, Clone, PartialEq)]
pub struct RawImage {
    /// By which points name it.
    pub id: u32,
    /// With its folders.
    pub name: String,
    /// Its numbers in the file's order.
    pub quaternion: [f64; 4],
    /// Of camera from world.
    pub translation: [f64; 3],
    /// Id of its camera.
    pub camera: u32,
    /// Pixel and id of its 3D point.
    pub keypoints: Vec<(Pixel, Option<u64>)>,
}

/// A point as `points3D` has it.
#[derive(Debug, Clone, PartialEq)]
pub struct RawPoint {
    /// By which pictures name it.
    pub id: u64,
    /// In the model's world.
    pub position: [f64; 3],
    /// Picture id and keypoint.
    pub track: Vec<(u32, u32)>,
}

/// Cameras of `cameras.bin`, by id.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn cameras_of_bytes(
    file: &str,
    bytes: &[u8],
) -> Result<HashMap<u32, CameraRecord>, FormatError> {
    let mut r = Reader::new(file, bytes);
    let mut cameras = HashMap::new();
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
    Ok(cameras)
}

/// Cameras of `cameras.txt`, by id.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn cameras_of_text(file: &TextFile) -> Result<HashMap<u32, CameraRecord>, FormatError> {
    let mut cameras = HashMap::new();
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
    Ok(cameras)
}

/// Pictures of `images.bin`.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn images_of_bytes(file: &str, bytes: &[u8]) -> Result<Vec<RawImage>, FormatError> {
    let mut r = Reader::new(file, bytes);
    let mut images = Vec::new();
    for _ in 0..r.count(73)? {
        let id = r.u32()?;
        let quaternion = [r.f64()?, r.f64()?, r.f64()?, r.f64()?];
        let translation = [r.f64()?, r.f64()?, r.f64()?];
        let camera = r.u32()?;
        let name = r.name()?;
        let mut keypoints = Vec::new();
        for _ in 0..r.count(24)? {
            let pixel = Pixel::new(r.finite()?, r.finite()?);
            let point = r.u64()?;
            keypoints.push((pixel, (point != u64::MAX).then_some(point)));
        }
        images.push(RawImage {
            id,
            name,
            quaternion,
            translation,
            camera,
            keypoints,
        });
    }
    Ok(images)
}

/// Pictures of `images.txt`: two lines each, the second of which may be empty.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn images_of_text(file: &TextFile) -> Result<Vec<RawImage>, FormatError> {
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
                let pixel = second.finite(&triple[..2])?;
                keypoints.push((Pixel::new(pixel[0], pixel[1]), u64::try_from(id).ok()));
            }
        }
        images.push(RawImage {
            id: line.number(numbers[0])?,
            name: line.split_at(9).1.to_owned(),
            quaternion: [pose[0], pose[1], pose[2], pose[3]],
            translation: [pose[4], pose[5], pose[6]],
            camera: line.number(numbers[8])?,
            keypoints,
        });
    }
    Ok(images)
}

/// Points of `points3D.bin`.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn points_of_bytes(file: &str, bytes: &[u8]) -> Result<Vec<RawPoint>, FormatError> {
    let mut r = Reader::new(file, bytes);
    let mut points = Vec::new();
    for _ in 0..r.count(51)? {
        let id = r.u64()?;
        let position = [r.finite()?, r.finite()?, r.finite()?];
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
    Ok(points)
}

/// Points of `points3D.txt`.
///
/// # Errors
/// When the file is damaged; with its name and the place.
pub fn points_of_text(file: &TextFile) -> Result<Vec<RawPoint>, FormatError> {
    let mut points = Vec::new();
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
                .collect::<Result<_, FormatError>>()?,
        });
    }
    Ok(points)
}

/// Little-endian numbers of a file, front to back.
struct Reader<'a> {
    file: &'a str,
    bytes: &'a [u8],
    next: usize,
}

impl<'a> Reader<'a> {
    fn new(file: &'a str, bytes: &'a [u8]) -> Self {
        Self {
            file,
            bytes,
            next: 0,
        }
    }

    fn error(&self, what: impl ToString) -> FormatError {
        FormatError::at(self.file, format!("byte {}", self.next), what)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
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

    fn u8(&mut self) -> Result<u8, FormatError> {
        self.take().map(|[b]: [u8; 1]| b)
    }
    fn u32(&mut self) -> Result<u32, FormatError> {
        self.take().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Result<u64, FormatError> {
        self.take().map(u64::from_le_bytes)
    }
    fn f64(&mut self) -> Result<f64, FormatError> {
        self.take().map(f64::from_le_bytes)
    }

    /// A number of which nothing later asks whether it is one.
    fn finite(&mut self) -> Result<f64, FormatError> {
        let value = self.f64()?;
        if value.is_finite() {
            return Ok(value);
        }
        let at = format!("byte {}", self.next - size_of::<f64>());
        Err(FormatError::at(
            self.file,
            at,
            format!("{value} is no number to compute with"),
        ))
    }

    /// A count of records that take at least `size` bytes each.
    fn count(&mut self, size: usize) -> Result<usize, FormatError> {
        let count = self.u64()?;
        let rest = self.bytes.len().saturating_sub(self.next) / size;
        match usize::try_from(count) {
            Ok(n) if n <= rest => Ok(n),
            _ => Err(self.error(format!("{count} records are announced, at most {rest} fit"))),
        }
    }

    fn side(&mut self) -> Result<u32, FormatError> {
        let value = self.u64()?;
        u32::try_from(value).map_err(|_| self.error(format!("a picture side of {value} pixels")))
    }

    fn name(&mut self) -> Result<String, FormatError> {
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
