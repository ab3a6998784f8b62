//! Labels on disk; what the file is made of is in the core.

mod read;
mod write;

use landline::mapping::LABEL_VERSION;
use std::io;
use std::path::PathBuf;

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
    /// Labels of another version of this tool.
    #[error(
        "label file {path}: `format` is version {found}, this tool reads version {LABEL_VERSION}; make it again with `landline labels`"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: String,
    },
    /// The features are not of the extractor that they are to be used with.
    #[error(
        "label file {path}: `extractor` is {labels}, the loaded weights are {loaded}; load the matching weights, or make \
         the labels again with these"
    )]
    WrongExtractor {
        /// The file.
        path: PathBuf,
        /// Name and checkpoint of the extractor of the labels.
        labels: String,
        /// Of the one that is loaded.
        loaded: String,
    },
    /// A value of the header that cannot be understood.
    #[error("label file {path}: `{field}` is {found}: {expected}")]
    Value {
        /// The file.
        path: PathBuf,
        /// Key in the header.
        field: &'static str,
        /// Its value.
        found: String,
        /// What it should be.
        expected: &'static str,
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

#[cfg(test)]
mod tests {
    use super::super::{LabelledVariant, Labels, Origin};
    use super::*;
    use landline::features::{FeatureSet, Keypoint};
    use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
    use landline::models::ExtractorKind;
    use landline::reconstruction::{LineTrack, Observation, PointTrack, Reconstruction, View};
    use landline::scene_file::Units;
    use nalgebra::Vector3;
    use safetensors::SafeTensors;

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
            units: Units::Metres,
            gravity: Some(Vector3::new(0.0, -1.0, 0.0)),
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
            origin: Origin {
                extractor: ExtractorKind::Xfeat,
                extractor_sha256: "ab".repeat(32),
                working_max_side: 640,
                source: "two pictures".to_owned(),
            },
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

    /// A label file whose header entries were changed by `change`.
    fn changed(name: &str, change: impl Fn(&mut serde_json::Value, &mut String)) -> PathBuf {
        let path = std::env::temp_dir().join(format!("labels-{name}-{}.st", std::process::id()));
        sample().write(&path).expect("writable");
        let bytes = std::fs::read(&path).expect("exists");
        let (_, metadata) = SafeTensors::read_metadata(&bytes).expect("just written");
        let mut entries = metadata.metadata().clone().expect("has entries");
        let mut header = serde_json::from_str(&entries["labels"]).expect("JSON");
        let mut format = entries["format"].clone();
        change(&mut header, &mut format);
        entries.insert("labels".to_owned(), header.to_string());
        entries.insert("format".to_owned(), format);
        let file = SafeTensors::deserialize(&bytes).expect("just written");
        let bytes = safetensors::serialize(file.tensors(), Some(entries)).expect("as before");
        std::fs::write(&path, bytes).expect("writable");
        path
    }

    #[test]
    fn values_that_are_none_are_refused_by_file_field_and_value() {
        for (field, value, shown) in [
            ("units", serde_json::json!("feet"), "feet"),
            (
                "gravity",
                serde_json::json!([0.0, 0.0, 0.0]),
                "[0.0, 0.0, 0.0]",
            ),
            (
                "gravity",
                serde_json::json!([0.0, 1e300, 0.0]),
                "[0.0, 1e300, 0.0]",
            ),
            ("extractor", serde_json::json!("sift"), "sift"),
            ("extractor_sha256", serde_json::json!("zz"), "zz"),
            ("working_max_side", serde_json::json!(0), "0"),
        ] {
            let path = changed(field, |header, _| header[field] = value.clone());
            let error = Labels::read(&path).expect_err("must refuse");
            let LabelFileError::Value {
                field: f, found, ..
            } = &error
            else {
                panic!("{field}: {error}");
            };
            assert_eq!((*f, found.as_str()), (field, shown));
            assert!(error.to_string().contains(&path.display().to_string()));
            std::fs::remove_file(&path).expect("exists");
        }
    }

    #[test]
    fn numbers_that_the_file_cannot_hold_are_refused_before_they_are_allocated() {
        type Change = fn(&mut serde_json::Value);
        let cases: [(&str, Change, &str); 4] = [
            (
                "keypoints",
                |h| h["images"][0]["num_keypoints"] = 100_000_000_000_u64.into(),
                "rows of",
            ),
            (
                "samples",
                |h| h["samples_per_segment"] = (1_u64 << 62).into(),
                "samples",
            ),
            (
                "rotation",
                |h| h["images"][0]["rotation_row_major"] = vec![0.0; 9].into(),
                "pose of",
            ),
            (
                "translation",
                |h| h["images"][0]["translation"] = vec![1e308; 3].into(),
                "pose of",
            ),
        ];
        for (name, change, what) in cases {
            let path = changed(name, |header, _| change(header));
            let message = Labels::read(&path).expect_err(name).to_string();
            std::fs::remove_file(&path).expect("exists");
            assert!(message.contains(what), "{name}: {message}");
        }
    }

    #[test]
    fn labels_of_an_older_version_are_refused_by_it() {
        for version in ["1", "2", "4"] {
            let path = changed("old", |_, format| {
                *format = format!("landline labels {version}");
            });
            let error = Labels::read(&path).expect_err("must refuse");
            assert!(
                matches!(&error, LabelFileError::Version { found, .. } if found == version),
                "{error}"
            );
            assert!(error.to_string().contains("`landline labels`"), "{error}");
            std::fs::remove_file(&path).expect("exists");
        }
        let path = changed("other", |_, format| *format = "pictures".to_owned());
        let error = Labels::read(&path).expect_err("must refuse");
        assert!(matches!(error, LabelFileError::Content { .. }), "{error}");
        std::fs::remove_file(&path).expect("exists");
    }

    #[test]
    fn labels_of_another_extractor_are_refused() {
        let path = changed("extractor", |_, _| {});
        let read = |kind, sha: &str| Labels::read_for(&path, kind, &sha.repeat(32));
        assert_eq!(
            read(ExtractorKind::Xfeat, "ab").expect("the same"),
            sample()
        );
        for (kind, sha) in [
            (ExtractorKind::Xfeat, "cd"),
            (ExtractorKind::SuperPointOpen, "ab"),
        ] {
            let error = read(kind, sha).expect_err("must refuse");
            assert!(matches!(error, LabelFileError::WrongExtractor { .. }));
            let text = error.to_string();
            for part in ["xfeat", kind.name(), &path.display().to_string()] {
                assert!(text.contains(part), "{text}");
            }
        }
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
}
