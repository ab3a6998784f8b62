//! Labels on disk: one safetensors file, all pictures' rows concatenated, descriptors as f16.
//!
//! Counts per picture and track say where rows belong; names and cameras are JSON in the header. Version 1 had targets too,
//! which are the observations the other way round; it is still read.

mod read;
mod write;

use landline::geometry::CameraRecord;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::PathBuf;

const FORMAT: &str = "landline labels 2";
const FORMAT_1: &str = "landline labels 1";

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
    use super::super::{LabelledVariant, Labels};
    use super::*;
    use landline::features::{FeatureSet, Keypoint};
    use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
    use landline::reconstruction::{LineTrack, Observation, PointTrack, Reconstruction, View};
    use nalgebra::Vector3;

    fn keypoint(x: f64, y: f64, score: f32) -> Keypoint {
        Keypoint {
            pixel: Pixel::new(x, y),
            score,
        }
    }

    fn sample() -> Labels {
        let segment = Segment2 {
            start: Pixel::new(1.0, 2.0),
            end: Pixel::new(30.0, 4.0),
            width_px: 2.0,
            precision: 0.125,
            neg_log10_nfa: 7.5,
        };
        let map = Reconstruction {
            points: vec![PointTrack {
                point_in_world: Vector3::new(1.0, 2.0, 3.0),
                observations: vec![Observation::new(0, 1), Observation::new(1, 0)],
                descriptor: vec![0.5, -0.25],
                mean_error_px: 0.75,
            }],
            lines: vec![LineTrack {
                start_in_world: Vector3::new(0.0, 0.5, 1.0),
                end_in_world: Vector3::new(0.0, 1.5, 1.0),
                observations: vec![Observation::new(0, 0)],
                descriptor: vec![1.0, 0.0],
                mean_error_px: 0.5,
            }],
            views: vec![
                View {
                    name: "a b.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: Some(CamFromWorld::from_quaternion_wxyz(
                        [1.0, 0.1, 0.0, 0.0],
                        Vector3::new(0.1, 0.2, 0.3),
                    )),
                    features: FeatureSet {
                        keypoints: vec![keypoint(0.5, 1.5, 1.0), keypoint(3.25, 9.0, 0.5)],
                        descriptors_nd: vec![1.0, 0.0, 0.0, 1.0],
                        segments: vec![segment],
                        segment_descriptors_nsd: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
                        descriptor_channels: 2,
                        tokens: 3,
                    },
                },
                View {
                    name: "c.jpg".to_owned(),
                    camera: Camera::centered(64, 48, 50.0),
                    cam_from_world: Some(CamFromWorld::identity()),
                    features: FeatureSet {
                        keypoints: vec![keypoint(7.5, 7.5, 0.25)],
                        descriptors_nd: vec![0.5, 0.5],
                        descriptor_channels: 2,
                        tokens: 3,
                        ..FeatureSet::default()
                    },
                },
            ],
        };
        let variants = vec![LabelledVariant {
            of_view: 1,
            features: map.views[0].features.clone(),
        }];
        Labels {
            extractor: "test".to_owned(),
            map,
            variants,
        }
    }

    #[test]
    fn labels_survive_the_file() {
        let path = std::env::temp_dir().join(format!("labels-{}.safetensors", std::process::id()));
        let labels = sample();
        labels
            .write(&path)
            .expect("the temporary folder is writable");
        assert_eq!(Labels::read(&path).expect("just written"), labels);
        let targets = labels.targets();
        assert_eq!(targets.views[0].points, [None, Some(0)]);
        assert_eq!(targets.views[1].points, [Some(0)]);

        let bytes = std::fs::read(&path).expect("exists");
        std::fs::write(&path, &bytes[..bytes.len() - 3]).expect("writable");
        assert!(matches!(
            Labels::read(&path),
            Err(LabelFileError::Container { .. })
        ));
        std::fs::remove_file(&path).expect("exists");
    }

    #[test]
    fn refuses_observations_of_what_is_not_there_and_pictures_without_pose() {
        let path = std::env::temp_dir().join(format!("labels-bad-{}.st", std::process::id()));
        let refused = |change: fn(&mut Labels), what: &str| {
            let mut labels = sample();
            change(&mut labels);
            let outcome = labels.write(&path).and_then(|()| Labels::read(&path));
            let message = outcome.expect_err("must be refused").to_string();
            assert!(message.contains(what), "{message}");
        };
        refused(
            |l| l.map.points[0].observations[1].feature = 9,
            "feature 9 of 1",
        );
        refused(
            |l| l.map.lines[0].observations[0].view = 2,
            "picture 2 of 2",
        );
        refused(
            |l| l.map.views[1].cam_from_world = None,
            "c.jpg has no pose",
        );
        refused(|l| l.variants[0].of_view = 5, "a variant of picture 5");
        std::fs::remove_file(&path).expect("written by the first two");
    }

    /// A file of another version says which, and what to do.
    #[test]
    fn names_the_format_that_it_does_not_read() {
        let path = std::env::temp_dir().join(format!("labels-3-{}.st", std::process::id()));
        sample().write(&path).expect("writable");
        let bytes = std::fs::read(&path).expect("exists");
        let text = String::from_utf8_lossy(&bytes);
        let at = text.find("landline labels 2").expect("the format");
        for (digit, is_read) in [(b'1', true), (b'3', false)] {
            let mut other = bytes.clone();
            other[at + "landline labels ".len()] = digit;
            std::fs::write(&path, &other).expect("writable");
            match Labels::read(&path) {
                Ok(labels) => assert!(is_read && labels == sample()),
                Err(e) => {
                    let message = e.to_string();
                    let what = ["landline labels 3", "`landline labels`"];
                    assert!(
                        !is_read && what.iter().all(|w| message.contains(w)),
                        "{message}"
                    );
                }
            }
        }
        std::fs::remove_file(&path).expect("exists");
    }
}
