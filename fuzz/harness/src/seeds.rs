//! Small inputs that every target accepts, made here; what is large is left to a corpus.

use crate::Folder;
use image::ImageFormat;
use landline::features::{FeatureSet, Keypoint};
use landline::geometry::{CamFromWorld, Camera, Pixel, Segment2};
use landline::models::{ExtractorKind, PointBranchConfig, Preset, RegressorConfig};
use landline::nn::{WeightTensor, Weights};
use landline::reconstruction::{LineTrack, Observation, PointTrack, Reconstruction, View};
use landline::scene_file::{Precision, SceneFile, SceneInfo};
use landline_mapper::labels::{LabelledVariant, Labels, Origin};
use nalgebra::Vector3;
use std::io::Cursor;

/// The camera of the picture below, for `--camera`.
pub(super) const CAMERA: &str = "PINHOLE,32,24,30,30,16,12";

/// 32 x 24 pixels.
pub(super) fn picture() -> Vec<Vec<u8>> {
    let mut bytes = Vec::new();
    let picture = image::GrayImage::from_fn(32, 24, |x, y| image::Luma([(8 * x + y) as u8]));
    picture
        .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
        .expect("room in memory");
    vec![bytes]
}

pub(super) fn pose_list() -> Vec<Vec<u8>> {
    vec![
        b"a.png 1 0 0 0 0.5 0 2\n".to_vec(),
        b"a.png 0.6 0.8 0 0 0 -1 2 31.5\n".to_vec(),
        b"a.png 1 0 0 0.5 0 1 0 0 0 0 1 2 0 0 0 1\n".to_vec(),
    ]
}

pub(super) fn transforms() -> Vec<Vec<u8>> {
    vec![br#"{"fl_x":30,"fl_y":30,"cx":16,"cy":12,"w":32,"h":24,"frames":[{"file_path":"a.png","transform_matrix":[[1,0,0,0.5],[0,1,0,0],[0,0,1,2],[0,0,0,1]]}]}"#.to_vec()]
}

pub(super) fn matrix() -> Vec<Vec<u8>> {
    vec![b"1 0 0 0.5\n0 1 0 0\n0 0 1 2\n0 0 0 1\n".to_vec()]
}

pub(super) fn tum() -> Vec<Vec<u8>> {
    vec![b"# t tx ty tz qx qy qz qw\n1.0 0.5 0 2 0 0 0 1\n".to_vec()]
}

/// One pinhole camera.
pub(super) fn colmap_cameras() -> Vec<Vec<u8>> {
    let mut bytes = 1u64.to_le_bytes().to_vec();
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(1i32.to_le_bytes());
    bytes.extend(32u64.to_le_bytes());
    bytes.extend(24u64.to_le_bytes());
    for v in [30.0_f64, 30.0, 16.0, 12.0] {
        bytes.extend(v.to_le_bytes());
    }
    vec![bytes]
}

/// One picture with one observation of nothing.
pub(super) fn colmap_images() -> Vec<Vec<u8>> {
    let mut bytes = 1u64.to_le_bytes().to_vec();
    bytes.extend(1u32.to_le_bytes());
    for v in [1.0_f64, 0.0, 0.0, 0.0, 0.5, 0.0, 2.0] {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(b"a.png\0");
    bytes.extend(1u64.to_le_bytes());
    for v in [3.5_f64, 4.5] {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend((-1i64).to_le_bytes());
    vec![bytes]
}

/// A scene of five landmarks, in each precision.
pub(super) fn scene() -> Vec<Vec<u8>> {
    let mut config = RegressorConfig::preset(Preset::Compact, 64);
    if let RegressorConfig::Branches { point, line } = &mut config {
        *line = None;
        if let PointBranchConfig::Anchored(c) = point {
            c.num_anchors = 5;
            c.reliability_hidden = 3;
        }
    }
    let tensors = config.tensors().into_iter();
    let weights: Weights = tensors
        .map(|t| {
            let numbers = vec![0.25; t.shape.iter().product()];
            let tensor = WeightTensor::f32(&t.shape, numbers).expect("sizes agree");
            (t.name, tensor)
        })
        .collect();
    let scene = SceneFile {
        info: SceneInfo::new(ExtractorKind::Xfeat, "0".repeat(64)),
        config,
        weights,
        landmarks: None,
    };
    [Precision::F32, Precision::F16, Precision::Int8]
        .into_iter()
        .map(|precision| scene.to_bytes(precision).expect("right"))
        .collect()
}

/// As an extractor file up to its tensors, which are too few: whole ones take megabytes. A scene has the form of one too.
pub(super) fn extractor() -> Vec<Vec<u8>> {
    let sha256 = "0".repeat(64);
    let header = format!(
        r#"{{"__metadata__":{{"landline":"extractor","format":"1","extractor":"xfeat","source_sha256":"{sha256}","source":"a","licence":"b"}},"a.weight":{{"dtype":"F32","shape":[2,1],"data_offsets":[0,8]}},"a.bias":{{"dtype":"F16","shape":[2],"data_offsets":[8,12]}}}}"#
    );
    let mut tensors = safetensors(&header);
    tensors.extend([0; 12]);
    let mut seeds = scene();
    seeds.truncate(1);
    seeds.push(tensors);
    seeds
}

fn safetensors(header: &str) -> Vec<u8> {
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.bytes());
    bytes
}

/// safetensors, and what an archive begins with.
pub(super) fn checkpoint() -> Vec<Vec<u8>> {
    let mut tensors = safetensors(r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#);
    tensors.extend([0; 8]);
    let mut seeds = pickle();
    seeds.extend([tensors, b"PK\x03\x04".to_vec()]);
    seeds
}

/// A state dict of one tensor as PyTorch writes it, and plain containers.
pub(super) fn pickle() -> Vec<Vec<u8>> {
    let state: &[u8] = b"\x80\x02ccollections\x0aOrderedDict\x0aq\x00)Rq\x01(X\x08\x00\x00\x00a.weightq\x02ctorch._utils\x0a_rebuild_tensor_v2\x0aq\x03((X\x07\x00\x00\x00storageq\x04ctorch\x0aFloatStorage\x0aq\x05X\x01\x00\x00\x000q\x06X\x03\x00\x00\x00cpuq\x07K\x06tq\x08QK\x00K\x02K\x03\x86q\x09K\x03K\x01\x86q\x0a\x89h\x00)Rq\x0btq\x0cRq\x0dX\x01\x00\x00\x00nq\x0eK\x03u.";
    let plain: &[u8] = b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01]q\x02(K\x01J\xfe\xff\xff\xffeX\x01\x00\x00\x00bq\x03h\x01N\x88\x87q\x04X\x01\x00\x00\x00cq\x05G?\xf8\x00\x00\x00\x00\x00\x00X\x01\x00\x00\x00dq\x06\x8a\x09\x00\x00\x00\x00\x00\x00\x00\x00@u.";
    vec![state.to_vec(), plain.to_vec()]
}

/// Two pictures that see a point and a line.
pub(super) fn labels() -> Vec<Vec<u8>> {
    let keypoint = |x| Keypoint {
        pixel: Pixel::new(x, 4.5),
        score: 0.5,
    };
    let segment = Segment2 {
        start: Pixel::new(1.0, 2.0),
        end: Pixel::new(30.0, 4.0),
        width_px: 2.0,
        precision: 0.125,
        neg_log10_nfa: 7.5,
    };
    let view = |name: &str| View {
        name: name.to_owned(),
        camera: Camera::centered(32, 24, 30.0),
        cam_from_world: Some(CamFromWorld::identity()),
        features: FeatureSet {
            keypoints: vec![keypoint(3.5), keypoint(9.0)],
            descriptors_nd: vec![1.0, 0.0, 0.0, 1.0],
            segments: vec![segment],
            segment_descriptors_nsd: vec![1.0; 6],
            descriptor_channels: 2,
            tokens: 3,
        },
    };
    let labels = Labels {
        origin: Origin {
            extractor_sha256: "ab".repeat(32),
            source: "two pictures".to_owned(),
            ..Origin::default()
        },
        map: Reconstruction {
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
            views: vec![view("a.png"), view("b.png")],
            ..Reconstruction::default()
        },
        variants: vec![LabelledVariant {
            of_view: 1,
            features: view("").features,
        }],
    };
    let folder = Folder::new();
    let path = folder.0.join("labels");
    labels.write(&path).expect("a writable folder");
    vec![std::fs::read(&path).expect("just written")]
}

/// A point that is seen once.
pub(super) fn colmap_points() -> Vec<Vec<u8>> {
    let mut bytes = 1u64.to_le_bytes().to_vec();
    bytes.extend(7u64.to_le_bytes());
    for v in [0.5_f64, 0.25, 3.0] {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend([200, 100, 50]);
    bytes.extend(0.5_f64.to_le_bytes());
    bytes.extend(1u64.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    vec![bytes]
}
