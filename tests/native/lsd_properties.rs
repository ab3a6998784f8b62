//! What must hold for the line segment detector on any picture: placement on synthetic edges, symmetries, false alarms.

use landline::geometry::{Pixel, Segment2};
use landline::image::GrayView;
use landline::lsd::{LsdParams, LsdScratch, RealView, detect, detect_real};
use landline::math::Rng;
use landline_testkit::shared_data;

pub(crate) fn segments(data: &[u8], width: usize, params: &LsdParams) -> Vec<Segment2> {
    let view = GrayView::tight(data, width, data.len() / width);
    detect(&view, params, &mut LsdScratch::default())
        .expect("a good picture")
        .to_vec()
}

pub(crate) fn real_segments(data: &[f64], width: usize, params: &LsdParams) -> Vec<Segment2> {
    let view = RealView {
        data,
        width,
        height: data.len() / width,
        stride: width,
    };
    detect_real(&view, params, &mut LsdScratch::default())
        .expect("a good picture")
        .to_vec()
}

pub(crate) fn at_scale(scale: f64) -> LsdParams {
    LsdParams {
        scale,
        ..LsdParams::default()
    }
}

/// Half plane, each pixel the mean of 8x8 samples: `bright` where (x, y).n > offset, in corner-based pixels.
fn half_plane(size: usize, angle: f64, offset: f64) -> Vec<f64> {
    let (sin, cos) = angle.sin_cos();
    let mut data = Vec::with_capacity(size * size);
    for y in 0..size {
        for x in 0..size {
            let inside = (0..64)
                .filter(|i| {
                    let (sx, sy) = (f64::from(i % 8), f64::from(i / 8));
                    let (px, py) = (x as f64 + (sx + 0.5) / 8.0, y as f64 + (sy + 0.5) / 8.0);
                    px * cos + py * sin > offset
                })
                .count();
            data.push(60.0 + 120.0 * inside as f64 / 64.0);
        }
    }
    data
}

#[test]
fn synthetic_edges_are_placed_without_bias() {
    let mut rng = Rng::from_seed(7);
    for (scale, max_rms) in [(1.0, 0.02), (0.8, 0.02), (0.5, 0.03)] {
        let (mut sum, mut square_sum, mut count, mut angles) = (0.0, 0.0, 0.0, Vec::new());
        for i in 0..36 {
            let angle = 2.0 * std::f64::consts::PI * (f64::from(i) + rng.uniform()) / 36.0;
            let (sin, cos) = angle.sin_cos();
            let offset = 100.0 * (cos + sin) + 3.0 * (rng.uniform() - 0.5);
            let data: Vec<f64> = half_plane(200, angle, offset)
                .iter()
                .map(|v| v + 2.0 * rng.normal())
                .collect();
            let found = real_segments(&data, 200, &at_scale(scale));
            // Without smoothing, noise may break the edge; its longest piece is as good for the purpose.
            let longest = found
                .iter()
                .max_by(|a, b| a.length_px().total_cmp(&b.length_px()));
            let s = longest.expect("a segment");
            let num_long = found.iter().filter(|s| s.length_px() >= 100.0).count();
            assert!(
                num_long == 1 || scale == 1.0,
                "scale {scale}, angle {angle}: {num_long}"
            );
            assert!(s.length_px() > 60.0, "scale {scale}, angle {angle}");
            for p in [s.start, s.end] {
                let off = p.x * cos + p.y * sin - offset;
                sum += off;
                square_sum += off * off;
                count += 1.0;
            }
            // Walking along the segment, the dark side is at the right hand: the bright normal is at the left,
            // which with y down is (dy, -dx).
            let (dx, dy) = (s.end.x - s.start.x, s.end.y - s.start.y);
            let length = s.length_px();
            let sine = (dx * cos + dy * sin) / length;
            assert!(
                (dy * cos - dx * sin) / length > 0.99,
                "direction at {angle}"
            );
            angles.push(sine.asin().to_degrees().abs());
        }
        angles.sort_by(f64::total_cmp);
        let (bias, rms, angle) = (sum / count, (square_sum / count).sqrt(), angles[18]);
        println!(
            "scale {scale}: bias {bias:+.4} px, rms {rms:.4} px, median angle error {angle:.4} deg"
        );
        assert!(bias.abs() < 0.01, "scale {scale}: bias {bias}");
        assert!(rms < max_rms, "scale {scale}: rms {rms}");
        assert!(angle < 0.03, "scale {scale}: angle {angle}");
    }
}

pub(crate) fn step(transposed: bool) -> Vec<u8> {
    (0..200 * 200)
        .map(|i| {
            if if transposed { i / 200 } else { i % 200 } < 100 {
                0
            } else {
                255
            }
        })
        .collect()
}

#[test]
fn axis_aligned_steps_have_the_values_of_the_published_program() {
    // In the published coordinates, 0.5 less than ours.
    let cases = [
        (1.0, false, [99.5, 0.5, 99.5, 198.5], 1.0, 167.168),
        (0.8, false, [99.490, 0.625, 99.490, 198.125], 2.5, 274.218),
        (0.8, true, [198.125, 99.490, 0.625, 99.490], 2.5, 274.218),
    ];
    for (scale, transposed, ends, width, nfa) in cases {
        let found = segments(&step(transposed), 200, &at_scale(scale));
        assert_eq!(found.len(), 1, "{scale} {transposed}");
        let s = found[0];
        let got = [s.start.x, s.start.y, s.end.x, s.end.y].map(|v| v - 0.5);
        for (g, w) in got.iter().zip(ends) {
            assert!((g - w).abs() < 1e-3, "{scale} {transposed}: {got:?}");
        }
        assert!((s.width_px - width).abs() < 1e-3, "{}", s.width_px);
        assert!((s.neg_log10_nfa - nfa).abs() < 1e-3, "{}", s.neg_log10_nfa);
        assert_eq!(s.precision, 0.125);
    }
}

fn painted(size: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<u8> {
    (0..size * size)
        .map(|i| {
            let (x, y) = ((i % size) as f64 + 0.5, (i / size) as f64 + 0.5);
            if inside(x, y) { 200 } else { 50 }
        })
        .collect()
}

#[test]
fn shapes_give_their_sides() {
    let near = |s: &Segment2, p: Pixel| s.start.distance(p).min(s.end.distance(p)) < 3.5;
    let rectangle = painted(120, |x, y| {
        (30.0..90.0).contains(&x) && (40.0..80.0).contains(&y)
    });
    let found = segments(&rectangle, 120, &LsdParams::default());
    assert_eq!(found.len(), 4);
    for corner in [(30.0, 40.0), (90.0, 40.0), (30.0, 80.0), (90.0, 80.0)] {
        let corner = Pixel::new(corner.0, corner.1);
        assert_eq!(
            found.iter().filter(|s| near(s, corner)).count(),
            2,
            "{corner:?}"
        );
    }

    let triangle = painted(160, |x, y| {
        y > 30.0 && y < 120.0 && (x - 80.0).abs() < 0.7 * (y - 30.0)
    });
    let long = |v: Vec<Segment2>| v.into_iter().filter(|s| s.length_px() > 40.0).count();
    assert_eq!(long(segments(&triangle, 160, &LsdParams::default())), 3);

    let bar = painted(120, |x, _| (60.0..63.0).contains(&x));
    let found = segments(&bar, 120, &LsdParams::default());
    assert_eq!(found.len(), 2);
    let down = |s: &Segment2| s.end.y > s.start.y;
    assert_ne!(
        down(&found[0]),
        down(&found[1]),
        "the two sides run in opposite directions"
    );

    let ramp: Vec<u8> = (0..120 * 120).map(|i| (i % 120) as u8 * 2).collect();
    assert!(segments(&ramp, 120, &LsdParams::default()).is_empty());

    let disc = painted(200, |x, y| (x - 100.0).hypot(y - 100.0) < 70.0);
    let found = segments(&disc, 200, &LsdParams::default());
    assert!(found.len() >= 12, "{}", found.len());
    for s in &found {
        for p in [s.start, s.end] {
            let off = p.distance(Pixel::new(100.0, 100.0)) - 70.0;
            assert!(off.abs() < 4.0, "{off}");
        }
    }
}

/// Share of `a` (by count) with both ends within `px` of a segment of `b`, in the same order of ends.
fn same_share(a: &[Segment2], b: &[Segment2], px: f64) -> f64 {
    let same = |s: &&Segment2| {
        b.iter()
            .any(|t| s.start.distance(t.start) < px && s.end.distance(t.end) < px)
    };
    a.iter().filter(same).count() as f64 / a.len() as f64
}

/// Share of the length of `a` that some segment of `b` repeats: angle below 3 degrees, ends within 1 px of its line,
/// more than half covered.
fn matched_share(a: &[Segment2], b: &[Segment2]) -> f64 {
    let repeats = |s: &Segment2, t: &Segment2| {
        let (ls, lt) = (s.length_px(), t.length_px());
        let d = [(t.end.x - t.start.x) / lt, (t.end.y - t.start.y) / lt];
        let e = [(s.end.x - s.start.x) / ls, (s.end.y - s.start.y) / ls];
        let off = |p: Pixel| (d[0] * (p.y - t.start.y) - d[1] * (p.x - t.start.x)).abs();
        let along = |p: Pixel| e[0] * (p.x - s.start.x) + e[1] * (p.y - s.start.y);
        let (u, v) = (along(t.start), along(t.end));
        d[0] * e[0] + d[1] * e[1] > 3f64.to_radians().cos()
            && off(s.start) < 1.0
            && off(s.end) < 1.0
            && u.max(v).min(ls) - u.min(v).max(0.0) > 0.5 * ls
    };
    let total: f64 = a.iter().map(Segment2::length_px).sum();
    let matched: f64 = a
        .iter()
        .filter(|s| b.iter().any(|t| repeats(s, t)))
        .map(Segment2::length_px)
        .sum();
    matched / total
}

struct Picture {
    data: Vec<u8>,
    width: usize,
    height: usize,
}

impl Picture {
    /// Pixel (x, y) of the result is the one that `from` names in this picture.
    fn moved(
        &self,
        width: usize,
        height: usize,
        from: impl Fn(usize, usize) -> (usize, usize),
    ) -> Self {
        let data = (0..width * height)
            .map(|i| {
                let (x, y) = from(i % width, i / width);
                self.data[y * self.width + x]
            })
            .collect();
        Self {
            data,
            width,
            height,
        }
    }

    fn segments(&self, params: &LsdParams) -> Vec<Segment2> {
        segments(&self.data, self.width, params)
    }

    fn real(&self, f: impl Fn(f64) -> f64) -> Vec<f64> {
        self.data.iter().map(|&v| f(f64::from(v))).collect()
    }
}

fn room() -> Option<Picture> {
    let dir = shared_data("data/golden/lsd")?;
    let picture = image::open(dir.join("redkitchen_000300.png"))
        .expect("a picture")
        .into_luma8();
    Some(Picture {
        width: picture.width() as usize,
        height: picture.height() as usize,
        data: picture.into_raw(),
    })
}

fn mapped(list: &[Segment2], swap: bool, map: impl Fn(Pixel) -> Pixel) -> Vec<Segment2> {
    list.iter()
        .map(|s| {
            let (start, end) = (map(s.start), map(s.end));
            let (start, end) = if swap { (end, start) } else { (start, end) };
            Segment2 { start, end, ..*s }
        })
        .collect()
}

#[test]
fn turns_and_flips_move_segments_along() {
    let Some(p) = room() else { return };
    let (w, h) = (p.width, p.height);
    let (fw, fh) = (w as f64, h as f64);
    // At scale 1 only the order inside a bin breaks the symmetry, at 0.8 the sampling grid as well.
    for (scale, least) in [(1.0, 0.92), (0.8, 0.86)] {
        let params = at_scale(scale);
        let base = p.segments(&params);
        let cases = [
            (
                "quarter turn",
                p.moved(h, w, |x, y| (y, h - 1 - x)),
                mapped(&base, false, |q| Pixel::new(fh - q.y, q.x)),
            ),
            (
                "half turn",
                p.moved(w, h, |x, y| (w - 1 - x, h - 1 - y)),
                mapped(&base, false, |q| Pixel::new(fw - q.x, fh - q.y)),
            ),
            (
                "left-right flip",
                p.moved(w, h, |x, y| (w - 1 - x, y)),
                // A mirror image keeps the dark side but turns left into right: the ends change places.
                mapped(&base, true, |q| Pixel::new(fw - q.x, q.y)),
            ),
            (
                "upside-down flip",
                p.moved(w, h, |x, y| (x, h - 1 - y)),
                mapped(&base, true, |q| Pixel::new(q.x, fh - q.y)),
            ),
            (
                "transpose",
                p.moved(h, w, |x, y| (y, x)),
                mapped(&base, true, |q| Pixel::new(q.y, q.x)),
            ),
        ];
        for (name, moved, want) in cases {
            let got = moved.segments(&params);
            let share = matched_share(&want, &got).min(matched_share(&got, &want));
            println!("{name} at scale {scale}: {:.1} %", 100.0 * share);
            assert!(share >= least, "{name} at scale {scale}: {share}");
        }
    }
}

#[test]
fn contrast_and_brightness() {
    let Some(p) = room() else { return };
    let params = LsdParams::default();
    let base = p.segments(&params);

    let doubled = LsdParams {
        quantization_bound: 2.0 * params.quantization_bound,
        ..params
    };
    assert_eq!(
        real_segments(&p.real(|v| 2.0 * v), p.width, &doubled),
        base,
        "exact"
    );
    let full = at_scale(1.0);
    let brighter = real_segments(&p.real(|v| v + 40.0), p.width, &full);
    assert_eq!(brighter, p.segments(&full), "exact");
    let brighter = real_segments(&p.real(|v| v + 40.0), p.width, &params);
    assert!(same_share(&base, &brighter, 0.05) > 0.98);

    let negative = real_segments(&p.real(|v| 255.0 - v), p.width, &params);
    let swapped = mapped(&negative, true, |q| q);
    let share = same_share(&base, &swapped, 0.05);
    assert!(share >= 0.99, "negated: {share}");

    let mut rng = Rng::from_seed(3);
    let noisy: Vec<f64> = p
        .data
        .iter()
        .map(|&v| f64::from(v) + 1e-9 * rng.normal())
        .collect();
    let share = same_share(&base, &real_segments(&noisy, p.width, &params), 0.05);
    assert!(share >= 0.96, "noise of 1e-9: {share}");
}

#[test]
fn a_window_gives_what_its_copy_gives() {
    let Some(p) = room() else { return };
    let (x0, y0, w, h) = (101, 67, 333, 251);
    let copy = p.moved(w, h, |x, y| (x + x0, y + y0));
    let window = GrayView {
        data: &p.data[y0 * p.width + x0..],
        width: w,
        height: h,
        stride: p.width,
    };
    let mut scratch = LsdScratch::default();
    let params = LsdParams::default();
    // The scratch has seen another picture before.
    detect(
        &GrayView::tight(&p.data, p.width, p.height),
        &params,
        &mut scratch,
    )
    .expect("good");
    let got = detect(&window, &params, &mut scratch)
        .expect("good")
        .to_vec();
    assert_eq!(got, copy.segments(&params));
    assert!(got.len() > 50);
}

#[test]
fn white_noise_has_no_segments() {
    let params = LsdParams::default();
    for (name, scale) in [
        ("uniform", 0.8),
        ("gaussian", 0.8),
        ("uniform", 1.0),
        ("gaussian", 1.0),
    ] {
        let mut rng = Rng::from_seed(11);
        let mut scratch = LsdScratch::default();
        let (mut total, mut most) = (0, 0);
        for _ in 0..100 {
            let data: Vec<f64> = (0..256 * 256)
                .map(|_| match name {
                    "uniform" => 255.0 * rng.uniform(),
                    _ => (128.0 + 40.0 * rng.normal()).clamp(0.0, 255.0),
                })
                .collect();
            let view = RealView {
                data: &data,
                width: 256,
                height: 256,
                stride: 256,
            };
            let params = LsdParams { scale, ..params };
            let count = detect_real(&view, &params, &mut scratch)
                .expect("good")
                .len();
            total += count;
            most = most.max(count);
        }
        println!(
            "{name} noise at scale {scale}: {total} segments in 100 pictures, at most {most} in one"
        );
        assert!(
            total <= 20 && most <= 2,
            "{name} at {scale}: {total}, {most}"
        );
    }
}
