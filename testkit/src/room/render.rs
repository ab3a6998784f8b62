//! Ray caster: one ray through every sub-pixel, then exposure, sensor noise and 8 bit.

use super::Room;
use super::color::Rgb;
use super::noise::hash;
use crate::parallel::map_range;
use landline::geometry::{CamFromWorld, Camera, Pixel};
use nalgebra::Vector3;

/// How a picture is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// Rays a pixel along x and along y.
    pub supersampling: u32,
    /// Factor on the light that reaches the sensor.
    pub exposure: f64,
    /// Standard deviation of the sensor noise in 8-bit levels.
    pub noise_levels: f64,
    /// Of the noise.
    pub seed: u64,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            supersampling: 3,
            exposure: 1.2,
            noise_levels: 1.2,
            seed: 0,
        }
    }
}

/// A rendered picture: sRGB, 3 bytes a pixel, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// `3 * width * height` bytes.
    pub rgb: Vec<u8>,
}

impl Room {
    /// Takes a picture.
    pub fn render(
        &self,
        camera: &Camera,
        cam_from_world: &CamFromWorld,
        options: &RenderOptions,
    ) -> Picture {
        let world_from_cam = cam_from_world.inverse();
        let origin = world_from_cam.translation;
        let (width, height) = (camera.width, camera.height);
        let grid = options.supersampling.max(1);
        let rows = map_range(height as usize, |row| {
            let mut bytes = Vec::with_capacity(3 * width as usize);
            for column in 0..width {
                let mut sum = [0.0; 3];
                for k in 0..grid * grid {
                    let pixel = Pixel::new(
                        f64::from(column) + (f64::from(k % grid) + 0.5) / f64::from(grid),
                        row as f64 + (f64::from(k / grid) + 0.5) / f64::from(grid),
                    );
                    let Some(bearing) = camera.bearing_from_pixel(pixel) else {
                        continue; // beyond the field of view of a fisheye: stays black
                    };
                    let c = self.radiance(&origin, &(world_from_cam.rotation * bearing));
                    // Highlights are cut per ray, so that the window does not bleed over its frame.
                    sum = core::array::from_fn(|i| sum[i] + tone(c[i] * options.exposure));
                }
                let mean = sum.map(|v| v / f64::from(grid * grid));
                for (channel, value) in mean.into_iter().enumerate() {
                    let noise = gaussian(
                        i64::from(column) * 3 + channel as i64,
                        row as i64,
                        options.seed,
                    );
                    let level = 255.0 * encode(value) + options.noise_levels * noise;
                    bytes.push(level.round().clamp(0.0, 255.0) as u8);
                }
            }
            bytes
        });
        Picture {
            width,
            height,
            rgb: rows.concat(),
        }
    }

    fn radiance(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Rgb {
        let Some(hit) = self
            .bvh
            .nearest(&self.quads, origin, direction, f64::INFINITY)
        else {
            return [0.0; 3];
        };
        let quad = &self.quads[hit.quad];
        let (w, h) = quad.size();
        let texture = self.textures[quad.texture];
        let color = texture.color(hit.s * w, hit.t * h, w, h, quad.seed);
        let emission = texture.emission();
        let light = self.light_map.at(&hit);
        if emission > 0.0 {
            // The eye's view of a lamp is far dimmer than its light would be: keep its colours.
            return color.map(|c| c * emission.min(1.05));
        }
        core::array::from_fn(|i| color[i] * light[i])
    }
}

/// Straight for the dark half, then a shoulder that ends at one.
fn tone(x: f64) -> f64 {
    const KNEE: f64 = 0.55;
    if x < KNEE {
        x
    } else {
        KNEE + (1.0 - KNEE) * (1.0 - (-(x - KNEE) / (1.0 - KNEE)).exp())
    }
}

/// sRGB transfer function.
fn encode(x: f64) -> f64 {
    if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    }
}

/// Nearly normal: the sum of four uniform numbers taken from one hash.
fn gaussian(a: i64, b: i64, seed: u64) -> f64 {
    let h = hash(a, b, seed ^ 0x5EED);
    let sum: f64 = (0..4)
        .map(|k| ((h >> (16 * k)) & 0xFFFF) as f64 / 65536.0)
        .sum();
    (sum - 2.0) * 3f64.sqrt()
}
