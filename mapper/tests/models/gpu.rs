//! Poses with the networks on a GPU against those of the CPU, with the real extractor on real pictures of a scene.

use crate::extractors::extractor;
use landline::image::{FrameView, PixelFormat};
use landline::nn::gpu::{AdapterChoice, GpuDevice};
use landline::relocalizer::{GpuNetworks, Query, Relocalizer};
use landline::scene_file::{Precision, SceneFile};
use landline_mapper::eval::PoseError;
use landline_mapper::picture;
use landline_testkit::gpu_or_skip;
use std::path::Path;

/// What the backends may differ by: a millimetre, and a fiftieth of a degree.
const MAX_APART: (f64, f64) = (1e-3, 0.02);
/// One picture of the sample: a software device takes seconds for it. For all of them, and for those of any scene:
/// `landline locate --device gpu --against-cpu`.
const PICTURES: [&str; 1] = ["query-17.jpg"];

#[test]
fn poses_of_the_sample_are_those_of_the_cpu() {
    let Some(extractor) = extractor("LANDLINE_XFEAT_CHECKPOINT", Precision::F16) else {
        return;
    };
    let Some(gpu) = gpu_or_skip(GpuDevice::request(AdapterChoice::Any)) else {
        return;
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../www/scenes/sample");
    let bytes = std::fs::read(folder.join("sample.landline")).expect("the sample is there");
    let scene = SceneFile::from_bytes(&bytes).expect("the sample is whole");
    let camera = scene.info.camera.expect("the sample says its camera");
    let mut on_cpu =
        Relocalizer::new(scene.clone(), extractor.clone(), |_| {}).expect("they belong together");
    let mut on_gpu =
        Relocalizer::new(scene.clone(), extractor.clone(), |_| {}).expect("they belong together");
    let options = on_gpu.options().front_end;
    let networks = GpuNetworks::new(gpu.clone(), &scene, &extractor, &options, None);
    let networks = pollster::block_on(networks).expect("fits");
    on_gpu.use_gpu(networks).expect("made for it");
    for name in PICTURES {
        let rgb = picture::read(&folder.join(name))
            .expect("decodes")
            .into_rgb8();
        let frame = FrameView::tight(rgb.as_raw(), rgb.width(), rgb.height(), PixelFormat::Rgb8);
        let query = Query::with_camera(camera);
        let mut clock = || 0.0;
        let expected = on_cpu.locate(&frame, &query, &mut clock).expect("valid");
        let found = on_gpu.locate_with_gpu(&frame, &query, &mut clock);
        let found = pollster::block_on(found).expect("valid");
        assert!(found.on_gpu, "{:?}", on_gpu.gpu_failure());
        let pose = |report: &landline::relocalizer::Report| {
            report.outcome.located().expect("located").cam_from_world
        };
        let apart = PoseError::between(&pose(&found), &pose(&expected));
        println!(
            "{name}: {:.6} m, {:.5} deg",
            apart.position, apart.rotation_deg
        );
        assert!(
            apart.position < MAX_APART.0 && apart.rotation_deg < MAX_APART.1,
            "{name}: {apart:?}"
        );
    }
    assert_eq!(gpu.check(), Ok(()), "the driver refused something");
}
