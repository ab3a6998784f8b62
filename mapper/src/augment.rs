//! Image-space variants of training pictures: turned in the plane, scaled, lit differently, blurred.
//!
//! Positions in a variant go back to the unchanged picture exactly ([`Variant::source_from_variant`]), so camera and pose stay
//! those of the picture. Outside the picture the nearest border pixel is repeated, so that the border is no edge.

use landline::features::{FeatureSet, Keypoint};
use landline::geometry::Pixel;
use landline::image::GrayImage;
use landline::math::Rng;

/// Largest turn in degrees.
const MAX_TURN_DEG: f64 = 30.0;
/// Scales are drawn between one over this and this, evenly in their logarithm.
const MAX_SCALE: f64 = 1.5;
/// Largest change of contrast, relative.
const MAX_CONTRAST: f64 = 0.10;
/// Largest change of brightness in grey levels.
const MAX_BRIGHTNESS: f64 = 38.0;
/// Largest exponent of the tone curve, and one over the smallest.
const MAX_GAMMA: f64 = 1.2;
/// Half of the variants are blurred, by up to this standard deviation.
const MAX_BLUR_PX: f64 = 1.2;
/// Features nearer to the border of the unchanged picture are dropped: their surroundings are made up.
const BORDER_PX: f64 = 8.0;

/// One way to change a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Variant {
    /// Counter-clockwise turn about the middle of the picture, as seen on the screen.
    pub turn_rad: f64,
    /// Pixels of the variant for one of the picture.
    pub scale: f64,
    /// Factor on the distance from middle grey.
    pub contrast: f64,
    /// Grey levels added.
    pub brightness: f64,
    /// Exponent on the grey value in 0..1.
    pub gamma: f64,
    /// Standard deviation of the blur in pixels of the variant; 0 for none.
    pub blur_px: f64,
}

impl Variant {
    /// The picture itself.
    pub const IDENTITY: Self = Self {
        turn_rad: 0.0,
        scale: 1.0,
        contrast: 1.0,
        brightness: 0.0,
        gamma: 1.0,
        blur_px: 0.0,
    };

    /// The `index`-th variant of a picture; the same for the same name.
    pub fn draw(name: &str, index: usize) -> Self {
        let seed = name
            .bytes()
            .chain(index.to_le_bytes())
            .fold(0xCBF2_9CE4_8422_2325u64, |h, b| {
                (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01B3)
            });
        let mut rng = Rng::from_seed(seed);
        let mut around = |limit: f64| rng.range(-limit, limit);
        Self {
            turn_rad: around(MAX_TURN_DEG).to_radians(),
            scale: around(MAX_SCALE.ln()).exp(),
            contrast: 1.0 + around(MAX_CONTRAST),
            brightness: around(MAX_BRIGHTNESS),
            gamma: around(MAX_GAMMA.ln()).exp(),
            blur_px: around(MAX_BLUR_PX).max(0.0),
        }
    }

    /// Where a position of the variant lies in the picture of this size.
    pub fn source_from_variant(&self, p: Pixel, width: usize, height: usize) -> Pixel {
        let middle = (0.5 * width as f64, 0.5 * height as f64);
        let (x, y) = ((p.x - middle.0) / self.scale, (p.y - middle.1) / self.scale);
        let (sin, cos) = self.turn_rad.sin_cos();
        Pixel::new(middle.0 + cos * x - sin * y, middle.1 + sin * x + cos * y)
    }

    /// The changed picture, of the same size.
    pub fn apply(&self, picture: &GrayImage) -> GrayImage {
        let (w, h) = (picture.width, picture.height);
        let mut source: Vec<f32> = picture.data.iter().map(|v| f32::from(*v)).collect();
        if self.scale < 1.0 {
            // What the smaller grid cannot carry must go first.
            let sigma = 0.5 * (1.0 / (self.scale * self.scale) - 1.0).sqrt();
            blur(&mut source, w, h, sigma);
        }
        let mut out = vec![0.0f32; w * h];
        for (i, v) in out.iter_mut().enumerate() {
            let at = Pixel::new((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
            *v = bilinear(&source, w, h, self.source_from_variant(at, w, h));
        }
        if self.blur_px > 0.0 {
            blur(&mut out, w, h, self.blur_px);
        }
        let tone = |v: f32| {
            let v = (f64::from(v) - 128.0) * self.contrast + 128.0 + self.brightness;
            let v = (v / 255.0).clamp(0.0, 1.0).powf(self.gamma) * 255.0;
            v.round() as u8
        };
        GrayImage {
            data: out.into_iter().map(tone).collect(),
            width: w,
            height: h,
        }
    }

    /// Features of the variant as features of the unchanged picture. What lies outside it or near its border is dropped.
    pub fn to_source(&self, features: &FeatureSet, width: usize, height: usize) -> FeatureSet {
        let map = |p: Pixel| self.source_from_variant(p, width, height);
        let inside = |p: Pixel| {
            p.x >= BORDER_PX
                && p.y >= BORDER_PX
                && p.x <= width as f64 - BORDER_PX
                && p.y <= height as f64 - BORDER_PX
        };
        let mut out = FeatureSet {
            descriptor_channels: features.descriptor_channels,
            tokens: features.tokens,
            ..FeatureSet::default()
        };
        for (i, keypoint) in features.keypoints.iter().enumerate() {
            let pixel = map(keypoint.pixel);
            if let Some(descriptor) = features.descriptor(i).filter(|_| inside(pixel)) {
                out.keypoints.push(Keypoint { pixel, ..*keypoint });
                out.descriptors_nd.extend_from_slice(descriptor);
            }
        }
        for (i, segment) in features.segments.iter().enumerate() {
            let mut segment = *segment;
            segment.start = map(segment.start);
            segment.end = map(segment.end);
            segment.width_px /= self.scale;
            let is_inside = inside(segment.start) && inside(segment.end);
            if let Some(rows) = features.segment_descriptors(i).filter(|_| is_inside) {
                out.segments.push(segment);
                out.segment_descriptors_nsd.extend_from_slice(rows);
            }
        }
        out
    }
}

/// Bilinear value at a corner-based position, the border repeated outside.
fn bilinear(picture: &[f32], width: usize, height: usize, p: Pixel) -> f32 {
    let x = (p.x - 0.5).clamp(0.0, (width - 1) as f64);
    let y = (p.y - 0.5).clamp(0.0, (height - 1) as f64);
    let (left, top) = (x as usize, y as usize);
    let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
    let (fx, fy) = ((x - left as f64) as f32, (y - top as f64) as f32);
    let row = |y: usize| picture[y * width + left] * (1.0 - fx) + picture[y * width + right] * fx;
    row(top) * (1.0 - fy) + row(bottom) * fy
}

/// Gaussian blur in place, the border repeated outside.
fn blur(picture: &mut [f32], width: usize, height: usize, sigma: f64) {
    let radius = (3.0 * sigma).ceil() as usize;
    if radius == 0 {
        return;
    }
    let mut kernel: Vec<f32> = (0..=2 * radius)
        .map(|i| {
            let x = (i as f64 - radius as f64) / sigma;
            (-0.5 * x * x).exp() as f32
        })
        .collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let along = |picture: &mut [f32], len: usize, step: usize, lines: usize, line_step: usize| {
        let mut line = vec![0.0f32; len];
        for l in 0..lines {
            for (i, v) in line.iter_mut().enumerate() {
                *v = kernel
                    .iter()
                    .enumerate()
                    .map(|(k, weight)| {
                        let at = (i + k).saturating_sub(radius).min(len - 1);
                        weight * picture[l * line_step + at * step]
                    })
                    .sum();
            }
            for (i, v) in line.iter().enumerate() {
                picture[l * line_step + i * step] = *v;
            }
        }
    };
    along(picture, width, 1, height, width);
    along(picture, height, width, width, 1);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(width: usize, height: usize, x: usize, y: usize) -> GrayImage {
        let mut data = vec![20u8; width * height];
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            data[(y + dy) * width + x + dx] = 220;
        }
        GrayImage {
            data,
            width,
            height,
        }
    }

    /// Centre of what is brighter than the ground.
    fn centre(picture: &GrayImage, ground: f64) -> Pixel {
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        for (i, v) in picture.data.iter().enumerate() {
            let weight = (f64::from(*v) - ground).max(0.0);
            sum += weight;
            x += weight * ((i % picture.width) as f64 + 0.5);
            y += weight * ((i / picture.width) as f64 + 0.5);
        }
        Pixel::new(x / sum, y / sum)
    }

    #[test]
    fn a_dot_is_found_where_the_map_says() {
        let picture = dot(80, 60, 50, 20);
        for (turn_deg, scale, blur_px) in [
            (0.0, 1.0, 0.0),
            (25.0, 1.3, 0.0),
            (-30.0, 0.7, 0.0),
            (10.0, 1.0, 1.0),
        ] {
            let variant = Variant {
                turn_rad: f64::to_radians(turn_deg),
                scale,
                blur_px,
                ..Variant::IDENTITY
            };
            let found = centre(&variant.apply(&picture), 22.0);
            let back = variant.source_from_variant(found, 80, 60);
            let off = back.distance(Pixel::new(51.0, 21.0));
            assert!(off < 0.15, "{turn_deg} deg, scale {scale}: {off} px off");
        }
    }

    #[test]
    fn light_changes_grey_values_only() {
        let picture = dot(40, 30, 10, 10);
        assert_eq!(Variant::IDENTITY.apply(&picture).data, picture.data);
        let brighter = Variant {
            brightness: 10.0,
            ..Variant::IDENTITY
        };
        assert_eq!(brighter.apply(&picture).data[0], 30);
        let drawn: Vec<_> = (0..50).map(|i| Variant::draw("a.jpg", i)).collect();
        assert_eq!(drawn[7], Variant::draw("a.jpg", 7));
        assert!(drawn.iter().all(|v| v.scale > 0.66 && v.scale < 1.51));
        assert!(drawn.iter().any(|v| v.turn_rad > 0.3) && drawn.iter().any(|v| v.turn_rad < -0.3));
    }

    #[test]
    fn features_outside_the_picture_are_dropped_with_their_rows() {
        let keypoint = |x: f64, score: f32| Keypoint {
            pixel: Pixel::new(x, 30.0),
            score,
        };
        let features = FeatureSet {
            keypoints: vec![keypoint(2.0, 1.0), keypoint(40.0, 2.0)],
            descriptor_channels: 2,
            descriptors_nd: vec![1.0, 0.0, 0.0, 1.0],
            ..FeatureSet::default()
        };
        let back = Variant::IDENTITY.to_source(&features, 80, 60);
        assert_eq!(back.keypoints, [keypoint(40.0, 2.0)]);
        assert_eq!(back.descriptors_nd, [0.0, 1.0]);
    }
}
