//! Time of the line segment detector by stage size: `cargo bench -p landline --no-default-features --bench lsd`.
//!
//! The pictures are synthetic (tilted bands with noise, about as many segments as a room), so that the bench runs
//! anywhere. `benches/lsd_peers.py` compares with other detectors on photographs.

#![expect(missing_docs, reason = "criterion_group! makes public functions")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use landline::image::{GrayImage, working_from_gray};
use landline::lsd::{LsdParams, LsdScratch, MergeParams, detect, merge_collinear};
use std::hint::black_box;

fn bands(width: usize, height: usize) -> GrayImage {
    let mut noise = 1u32;
    let data = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let band = (x * 3 + y * 5) / 211 + (y * 7 + 7 * width - x) / 389;
            (40 + band * 53 % 150) as u8 + (noise >> 28) as u8
        })
        .collect();
    GrayImage {
        data,
        width,
        height,
    }
}

fn lsd(c: &mut Criterion) {
    let mut group = c.benchmark_group("lsd");
    group.sample_size(20);
    let mut scratch = LsdScratch::default();
    for (width, height) in [(320, 240), (640, 480), (1280, 960)] {
        let picture = bands(width, height);
        group.throughput(Throughput::Elements((width * height) as u64));
        for scale in [0.8, 1.0] {
            let params = LsdParams {
                scale,
                ..LsdParams::default()
            };
            group.bench_function(format!("detect/{width}x{height}/scale {scale}"), |b| {
                b.iter(|| detect(&picture.view(), &params, &mut scratch).map(<[_]>::len));
            });
        }
    }
    let picture = bands(1280, 960);
    let mut working = GrayImage::default();
    group.bench_function("working_from_gray/1280 to 640", |b| {
        b.iter(|| working_from_gray(&picture.view(), 640, &mut working).is_ok());
    });
    let found = detect(&picture.view(), &LsdParams::default(), &mut scratch).map(<[_]>::to_vec);
    if let Ok(segments) = found {
        group.throughput(Throughput::Elements(segments.len() as u64));
        group.bench_function("merge_collinear", |b| {
            b.iter(|| merge_collinear(black_box(&segments), &MergeParams::default()).len());
        });
    }
    group.finish();
}

criterion_group!(benches, lsd);
criterion_main!(benches);
