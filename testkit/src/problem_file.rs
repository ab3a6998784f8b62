//! Pose problems with ground truth as bytes: the `.plb` format of benchmarks.
//!
//! Little endian: `PLB1`, u32 number of problems, then for each: f64 width, height, fx, fy, cx, cy; f64 rotation (9, row
//! major) and translation (3) of the true `cam_from_world`; u32 number of points, u32 number of lines; per point f64
//! u, v, X, Y, Z, confidence, is_inlier; per line f64 u1, v1, u2, v2, X1, Y1, Z1, X2, Y2, Z2, confidence, is_inlier.
//! Reading only; the bytes come from the caller.

use landline::geometry::{CamFromWorld, Camera, CameraModel, Pixel};
use landline::pose::{LineCorrespondence, PointCorrespondence};
use nalgebra::{Matrix3, Vector3};

/// One problem of the file.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedProblem {
    /// Pinhole.
    pub camera: Camera,
    /// The truth.
    pub cam_from_world: CamFromWorld,
    /// The points.
    pub points: Vec<PointCorrespondence>,
    /// Whether each point was drawn as an inlier.
    pub is_point_inlier: Vec<bool>,
    /// The lines.
    pub lines: Vec<LineCorrespondence>,
    /// Whether each line was drawn as an inlier.
    pub is_line_inlier: Vec<bool>,
}

/// Why the bytes are not a problem file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ProblemFileError {
    /// The first four bytes differ.
    #[error("not a pose problem file: it starts with {found:?}, expected \"PLB1\"")]
    Magic {
        /// The first bytes.
        found: Vec<u8>,
    },
    /// The bytes end too early.
    #[error("pose problem file ends at byte {length}; problem {problem} needs {wanted} more")]
    Truncated {
        /// Bytes in the file.
        length: usize,
        /// Index of the problem being read.
        problem: usize,
        /// Bytes missing.
        wanted: usize,
    },
    /// Bytes are left over.
    #[error("pose problem file has {extra} bytes after its last problem")]
    Trailing {
        /// How many.
        extra: usize,
    },
    /// An image size that is not a whole number of pixels.
    #[error("problem {problem} has an image of {width}x{height} pixels")]
    ImageSize {
        /// Index of the problem.
        problem: usize,
        /// As stored.
        width: String,
        /// As stored.
        height: String,
    },
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    problem: usize,
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], ProblemFileError> {
        match self.bytes[self.at..].first_chunk::<N>() {
            Some(chunk) => {
                self.at += N;
                Ok(*chunk)
            }
            None => Err(ProblemFileError::Truncated {
                length: self.bytes.len(),
                problem: self.problem,
                wanted: N - (self.bytes.len() - self.at),
            }),
        }
    }

    fn count(&mut self) -> Result<usize, ProblemFileError> {
        Ok(u32::from_le_bytes(self.take()?) as usize)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], ProblemFileError> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = f64::from_le_bytes(self.take()?);
        }
        Ok(out)
    }
}

/// Reads all problems of a file.
///
/// # Errors
/// When the bytes are not of this format.
pub fn parse(bytes: &[u8]) -> Result<Vec<RecordedProblem>, ProblemFileError> {
    let found = bytes.get(..4).unwrap_or(bytes);
    if found != b"PLB1" {
        return Err(ProblemFileError::Magic {
            found: found.to_vec(),
        });
    }
    let mut reader = Reader {
        bytes,
        at: 4,
        problem: 0,
    };
    let count = reader.count()?;
    let mut problems = Vec::new();
    for problem in 0..count {
        reader.problem = problem;
        problems.push(read_problem(&mut reader)?);
    }
    match bytes.len() - reader.at {
        0 => Ok(problems),
        extra => Err(ProblemFileError::Trailing { extra }),
    }
}

fn read_problem(reader: &mut Reader<'_>) -> Result<RecordedProblem, ProblemFileError> {
    let [width, height, fx, fy, cx, cy] = reader.numbers()?;
    let is_size = |v: f64| v >= 1.0 && v <= f64::from(u32::MAX) && v.fract() == 0.0;
    if !(is_size(width) && is_size(height)) {
        return Err(ProblemFileError::ImageSize {
            problem: reader.problem,
            width: width.to_string(),
            height: height.to_string(),
        });
    }
    let rotation = Matrix3::from_row_slice(&reader.numbers::<9>()?);
    let translation = Vector3::from(reader.numbers::<3>()?);
    let (num_points, num_lines) = (reader.count()?, reader.count()?);
    let mut out = RecordedProblem {
        camera: Camera {
            width: width as u32,
            height: height as u32,
            model: CameraModel::Pinhole { fx, fy, cx, cy },
        },
        cam_from_world: CamFromWorld::new(rotation, translation),
        points: Vec::new(),
        is_point_inlier: Vec::new(),
        lines: Vec::new(),
        is_line_inlier: Vec::new(),
    };
    for _ in 0..num_points {
        let [u, v, x, y, z, confidence, is_inlier] = reader.numbers()?;
        out.points.push(PointCorrespondence {
            pixel: Pixel::new(u, v),
            point_in_world: Vector3::new(x, y, z),
            confidence: confidence as f32,
            sigma_m: 0.0,
            sigma_px: 0.0,
        });
        out.is_point_inlier.push(is_inlier > 0.5);
    }
    for _ in 0..num_lines {
        let n: [f64; 12] = reader.numbers()?;
        out.lines.push(LineCorrespondence {
            start: Pixel::new(n[0], n[1]),
            end: Pixel::new(n[2], n[3]),
            start_in_world: Vector3::new(n[4], n[5], n[6]),
            end_in_world: Vector3::new(n[7], n[8], n[9]),
            confidence: n[10] as f32,
            sigma_m: 0.0,
            sigma_px: 0.0,
        });
        out.is_line_inlier.push(n[11] > 0.5);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> Vec<u8> {
        let mut bytes = b"PLB1".to_vec();
        bytes.extend(1u32.to_le_bytes());
        let numbers = |values: &[f64]| {
            values
                .iter()
                .flat_map(|v| v.to_le_bytes())
                .collect::<Vec<_>>()
        };
        let head = numbers(&[640.0, 480.0, 525.0, 525.0, 320.0, 240.0]);
        let pose = numbers(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3]);
        let point = numbers(&[1.0, 2.0, 3.0, 4.0, 5.0, 0.5, 1.0]);
        bytes.extend(head);
        bytes.extend(pose);
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        bytes.extend(point);
        bytes
    }

    #[test]
    fn reads_what_was_written_and_refuses_the_rest() {
        let bytes = file();
        let problems = parse(&bytes).expect("valid");
        assert_eq!(problems[0].points[0].pixel, Pixel::new(1.0, 2.0));
        assert_eq!(problems[0].is_point_inlier, [true]);
        assert_eq!(problems[0].camera.focal_px(), (525.0, 525.0));
        assert!(matches!(
            parse(&bytes[..bytes.len() - 3]),
            Err(ProblemFileError::Truncated {
                problem: 0,
                wanted: 3,
                ..
            })
        ));
        assert!(matches!(parse(b"PL"), Err(ProblemFileError::Magic { .. })));
        let mut long = bytes;
        long.push(0);
        assert_eq!(parse(&long), Err(ProblemFileError::Trailing { extra: 1 }));
    }
}
