//! The whole pipeline on one frame, to see how much memory it takes.

use std::cell::RefCell;

use landline::{
    geometry::Camera,
    image::{FrameView, PixelFormat},
    models::{
        ExtractorKind, LineBranchConfig, PointBranchConfig, Preset, RegressorConfig, TensorSpec,
    },
    nn::{WeightTensor, Weights},
    relocalizer::{Query, Relocalizer},
    scene_file::{ExtractorFile, Precision, SceneFile, SceneInfo},
};

thread_local! {
    static FILES: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) };
    static PIPELINE: RefCell<Option<Relocalizer>> = const { RefCell::new(None) };
}

const SHA256: &str = "0000000000000000000000000000000000000000000000000000000000000000";

fn weights_of(specs: Vec<TensorSpec>) -> Weights {
    let mut weights = Weights::new();
    for spec in specs {
        let len = spec.shape.iter().product();
        let scale = 1.7 / (len as f32 / spec.shape[0] as f32).sqrt();
        let numbers = super::pattern(len).into_iter().map(|x| x * scale).collect();
        weights.insert(
            spec.name,
            WeightTensor::f32(&spec.shape, numbers).expect("sizes agree"),
        );
    }
    weights
}

/// The paper's network with thresholds that drop nothing.
pub(crate) fn keeping_all(mut config: RegressorConfig) -> RegressorConfig {
    if let RegressorConfig::Branches { point, line } = &mut config {
        if let PointBranchConfig::Attention(point) = point {
            point.min_confidence = 0.0;
        }
        if let Some(LineBranchConfig::Attention(line)) = line {
            line.min_confidence = 0.0;
        }
    }
    config
}

/// Makes the paper's network for XFeat (every keypoint kept) and an extractor, with made-up weights, as the files that a page
/// would load. Read them with [`example_file`].
#[unsafe(no_mangle)]
pub extern "C" fn make_example_files() {
    let kind = ExtractorKind::Xfeat;
    let config = keeping_all(RegressorConfig::preset(
        Preset::Paper,
        kind.descriptor_channels(),
    ));
    let weights = weights_of(config.tensors());
    let scene = SceneFile {
        info: SceneInfo::new(kind, SHA256),
        config,
        weights,
        landmarks: None,
    };
    let extractor = ExtractorFile {
        kind,
        source_sha256: SHA256.to_owned(),
        source: String::new(),
        licence: String::new(),
        weights: weights_of(kind.tensors()),
    };
    FILES.set(vec![
        scene.to_bytes(Precision::F16).expect("a valid scene"),
        extractor
            .to_bytes(Precision::F16)
            .expect("a valid extractor"),
    ]);
}

/// Start of a file (0 scene, 1 extractor).
#[unsafe(no_mangle)]
pub extern "C" fn example_file(which: usize) -> *const u8 {
    FILES.with_borrow(|files| files[which].as_ptr())
}

/// Bytes of a file.
#[unsafe(no_mangle)]
pub extern "C" fn example_file_len(which: usize) -> usize {
    FILES.with_borrow(|files| files[which].len())
}

/// Makes the pipeline from the two files, which it frees.
///
/// # Safety
/// Both pointers come from `reserve` with these lengths.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pipeline_new(
    scene: *mut u8,
    scene_len: usize,
    extractor: *mut u8,
    extractor_len: usize,
) {
    // SAFETY: the caller's promise; `reserve` rounds lengths up to whole `f32`.
    let [scene, extractor] =
        [(scene, scene_len), (extractor, extractor_len)].map(|(at, len)| unsafe {
            (
                Box::from_raw(std::ptr::slice_from_raw_parts_mut(
                    at.cast::<f32>(),
                    len.div_ceil(4),
                )),
                len,
            )
        });
    let bytes = |(file, len): &(Box<[f32]>, usize)| -> &'static [u8] {
        // SAFETY: the boxes live until the end of this function, and the pipeline keeps no reference.
        unsafe { std::slice::from_raw_parts(file.as_ptr().cast(), *len) }
    };
    let made = Relocalizer::from_bytes(bytes(&scene), bytes(&extractor), |_| {});
    PIPELINE.set(Some(made.expect("files of make_example_files")));
}

/// Locates a grey frame; returns keypoints in the lower and segments in the upper half of the result.
///
/// # Safety
/// `gray` points to `width * height` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn pipeline_locate(gray: *const u8, width: usize, height: usize) -> usize {
    // SAFETY: the caller's promise.
    let bytes = unsafe { std::slice::from_raw_parts(gray, width * height) };
    let frame = FrameView::tight(bytes, width as u32, height as u32, PixelFormat::Luma8);
    let query = Query::with_camera(Camera::centered(width as u32, height as u32, width as f64));
    PIPELINE.with_borrow_mut(|pipeline| {
        let pipeline = pipeline.as_mut().expect("pipeline_new comes first");
        let report = pipeline
            .locate(&frame, &query, &mut || 0.0)
            .expect("a valid frame");
        report.counts.num_keypoints + (report.counts.num_segments << 16)
    })
}
