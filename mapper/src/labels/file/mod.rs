//! Labels on disk: one safetensors file, all pictures' rows concatenated, descriptors as f16.
//!
//! Counts per picture and track say where rows belong; names and cameras are JSON in the header.

mod read;
mod write;

use landline::geometry::CameraRecord;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::PathBuf;

const FORMAT: &str = "landline labels 1";
/// In `point_targets` and `segment_targets`: no target.
const NO_TARGET: i64 = -1;

/// Why a label file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum LabelFileError {
    /// The operating system refused.
    #[error("label file {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not a safetensors file, or cut short.
    #[error("label file {path} is damaged or no label file: {source}")]
    Container {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        source: safetensors::SafeTensorError,
    },
    /// The container is sound, its content is not what this version writes.
    #[error("label file {path}: {what}; make it again with `landline labels`")]
    Content {
        /// The file.
        path: PathBuf,
        /// What disagrees.
        what: String,
    },
}

#[derive(Serialize, Deserialize)]
struct Header {
    extractor: String,
    samples_per_segment: usize,
    images: Vec<ImageHeader>,
}

#[derive(Serialize, Deserialize)]
struct ImageHeader {
    name: String,
    camera: CameraRecord,
    rotation_row_major: [f64; 9],
    translation: [f64; 3],
    num_keypoints: usize,
    num_segments: usize,
    /// Index of the picture that this one is a variant of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    variant_of: Option<u32>,
}

#[cfg(test)]
mod tests {
    use super::super::{
        LabelledImage, LabelledVariant, Labels, LineTrack, Observation, PointTrack, SegmentTarget,
    };
    use super::*;
    use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
    use nalgebra::Vector3;

    fn sample() -> Labels {
        let segment = Segment2 {
            start: Pixel::new(1.0, 2.0),
            end: Pixel::new(30.0, 4.0),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa: 7.5,
        };
        Labels {
            descriptor_len: 2,
            samples_per_segment: 3,
            extractor: "test".to_owned(),
            points: vec![PointTrack {
                point_in_world: Vector3::new(1.0, 2.0, 3.0),
                observations: vec![
                    Observation {
                        image: 0,
                        feature: 1,
                    },
                    Observation {
                        image: 1,
                        feature: 0,
                    },
                ],
                descriptor: vec![0.5, -0.25],
                mean_error_px: 0.75,
            }],
            lines: vec![LineTrack {
                start_in_world: Vector3::new(0.0, 0.5, 1.0),
                end_in_world: Vector3::new(0.0, 1.5, 1.0),
                observations: vec![Observation {
                    image: 0,
                    feature: 0,
                }],
                descriptor: vec![1.0, 0.0],
                mean_error_px: 0.5,
            }],
            images: vec![
                LabelledImage {
                    name: "a b.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: CamFromWorld::from_quaternion_wxyz(
                        [1.0, 0.1, 0.0, 0.0],
                        Vector3::new(0.1, 0.2, 0.3),
                    ),
                    pixels: vec![Pixel::new(0.5, 1.5), Pixel::new(3.25, 9.0)],
                    scores: vec![1.0, 0.5],
                    descriptors_nd: vec![1.0, 0.0, 0.0, 1.0],
                    point_targets: vec![None, Some(0)],
                    segments: vec![segment],
                    segment_descriptors_nsd: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
                    segment_targets: vec![Some(SegmentTarget {
                        track: 0,
                        reversed: true,
                    })],
                },
                LabelledImage {
                    name: "c.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: CamFromWorld::identity(),
                    pixels: vec![Pixel::new(7.5, 7.5)],
                    scores: vec![0.25],
                    descriptors_nd: vec![0.5, 0.5],
                    point_targets: vec![Some(0)],
                    segments: vec![],
                    segment_descriptors_nsd: vec![],
                    segment_targets: vec![],
                },
            ],
            variants: Vec::new(),
        }
    }

    #[test]
    fn labels_survive_the_file() {
        let path = std::env::temp_dir().join(format!("labels-{}.safetensors", std::process::id()));
        let mut labels = sample();
        labels.variants.push(LabelledVariant {
            of_image: 1,
            image: labels.images[0].clone(),
        });
        labels
            .write(&path)
            .expect("the temporary folder is writable");
        assert_eq!(Labels::read(&path).expect("just written"), labels);
        let target = labels.images[0].segment_targets[0].expect("has one");
        let ends = labels.segment_target_ends(target).expect("track exists");
        assert_eq!(ends[0], labels.lines[0].end_in_world);

        let bytes = std::fs::read(&path).expect("exists");
        std::fs::write(&path, &bytes[..bytes.len() - 3]).expect("writable");
        assert!(matches!(
            Labels::read(&path),
            Err(LabelFileError::Container { .. })
        ));
        std::fs::remove_file(&path).expect("exists");
    }

    #[test]
    fn refuses_a_target_beyond_the_tracks() {
        let path = std::env::temp_dir().join(format!("labels-bad-{}.st", std::process::id()));
        let mut labels = sample();
        labels.images[0].point_targets[0] = Some(9);
        labels.write(&path).expect("writable");
        let message = Labels::read(&path)
            .expect_err("track 9 does not exist")
            .to_string();
        assert!(message.contains("track 9 of 1"), "{message}");
        std::fs::remove_file(&path).expect("exists");
    }
}
