//! Light map: irradiance on every quad from the emitting quads directly and by one bounce.

use super::color::{Rgb, srgb};
use super::noise::{Dice, hash};
use super::texture::Texture;
use super::trace::{Bvh, Hit, Quad};
use crate::parallel::map_range;
use nalgebra::Vector3;

const TEXEL_M: f64 = 0.06;
const MAX_TEXELS: usize = 96;
const SAMPLES_A_LAMP: u32 = 12;
const BOUNCE_RAYS: u32 = 48;
/// Light that has bounced more than once.
const AMBIENT: Rgb = [0.14, 0.138, 0.135];

/// Irradiance divided by pi on a grid over every quad: times the reflectance it is the radiance that leaves.
#[derive(Debug)]
pub(super) struct LightMap {
    grids: Vec<Grid>,
}

#[derive(Debug, Clone)]
struct Grid {
    columns: usize,
    rows: usize,
    light: Vec<Rgb>,
}

impl Grid {
    fn sample(&self, s: f64, t: f64) -> Rgb {
        let x = (s * self.columns as f64 - 0.5).clamp(0.0, self.columns as f64 - 1.0);
        let y = (t * self.rows as f64 - 0.5).clamp(0.0, self.rows as f64 - 1.0);
        let (i, j) = (x as usize, y as usize);
        let (i1, j1) = ((i + 1).min(self.columns - 1), (j + 1).min(self.rows - 1));
        let (fx, fy) = (x - i as f64, y - j as f64);
        let at = |a: usize, b: usize| self.light[b * self.columns + a];
        let (a, b, c, d) = (at(i, j), at(i1, j), at(i, j1), at(i1, j1));
        core::array::from_fn(|k| {
            (1.0 - fy) * ((1.0 - fx) * a[k] + fx * b[k]) + fy * ((1.0 - fx) * c[k] + fx * d[k])
        })
    }

    /// Box blur over 3 x 3 texels, which removes the sampling noise.
    fn blurred(&self) -> Self {
        let mut light = Vec::with_capacity(self.light.len());
        for j in 0..self.rows {
            for i in 0..self.columns {
                let (mut sum, mut count) = ([0.0; 3], 0.0);
                for b in j.saturating_sub(1)..=(j + 1).min(self.rows - 1) {
                    for a in i.saturating_sub(1)..=(i + 1).min(self.columns - 1) {
                        let c = self.light[b * self.columns + a];
                        sum = core::array::from_fn(|k| sum[k] + c[k]);
                        count += 1.0;
                    }
                }
                light.push(sum.map(|v| v / count));
            }
        }
        Self {
            light,
            ..self.clone()
        }
    }
}

/// A quad that lights the room, with its colour times its brightness.
struct Emitter {
    quad: usize,
    power: Rgb,
}

impl LightMap {
    pub(super) fn bake(quads: &[Quad], textures: &[Texture], bvh: &Bvh, seed: u64) -> Self {
        let emitters: Vec<Emitter> = quads
            .iter()
            .enumerate()
            .filter_map(|(quad, q)| {
                let texture = textures[q.texture];
                let color = match texture {
                    Texture::Outside => srgb(0xDCE9F7),
                    Texture::Lamp if q.normal.z < -0.9 => srgb(0xFFE3B8),
                    _ => return None,
                };
                let power = color.map(|c| c * texture.emission());
                Some(Emitter { quad, power })
            })
            .collect();
        let albedo: Vec<Rgb> = quads.iter().map(|q| mean_color(q, textures)).collect();
        let direct = Self {
            grids: map_range(quads.len(), |i| {
                grid_over(i, &quads[i], seed, |point, dice| {
                    lamps(quads, bvh, &emitters, &quads[i], point, dice)
                })
                .blurred()
            }),
        };
        let grids = map_range(quads.len(), |i| {
            let bounced = grid_over(i, &quads[i], seed ^ 1, |point, dice| {
                gather(quads, bvh, &albedo, &direct, &quads[i], point, dice)
            })
            .blurred()
            .blurred();
            let mut grid = direct.grids[i].clone();
            for (a, b) in grid.light.iter_mut().zip(&bounced.light) {
                *a = core::array::from_fn(|k| a[k] + b[k]);
            }
            grid
        });
        Self { grids }
    }

    pub(super) fn at(&self, hit: &Hit) -> Rgb {
        self.grids[hit.quad].sample(hit.s, hit.t)
    }
}

fn mean_color(q: &Quad, textures: &[Texture]) -> Rgb {
    let (w, h) = q.size();
    let mut sum = [0.0; 3];
    for k in 0..25 {
        let (s, t) = (
            (f64::from(k % 5) + 0.5) / 5.0,
            (f64::from(k / 5) + 0.5) / 5.0,
        );
        let c = textures[q.texture].color(s * w, t * h, w, h, q.seed);
        sum = core::array::from_fn(|i| sum[i] + c[i] / 25.0);
    }
    sum
}

fn grid_over(
    index: usize,
    quad: &Quad,
    seed: u64,
    light_at: impl Fn(&Vector3<f64>, &mut Dice) -> Rgb,
) -> Grid {
    let (w, h) = quad.size();
    let texels = |length: f64| ((length / TEXEL_M).ceil() as usize).clamp(2, MAX_TEXELS);
    let (columns, rows) = (texels(w), texels(h));
    let mut light = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        for i in 0..columns {
            let s = (i as f64 + 0.5) / columns as f64;
            let t = (j as f64 + 0.5) / rows as f64;
            let point = quad.origin + s * quad.u + t * quad.v + 2e-4 * quad.normal;
            let mut dice = Dice::new(hash(index as i64, (j * columns + i) as i64, seed));
            light.push(light_at(&point, &mut dice));
        }
    }
    Grid {
        columns,
        rows,
        light,
    }
}

fn lamps(
    quads: &[Quad],
    bvh: &Bvh,
    emitters: &[Emitter],
    quad: &Quad,
    point: &Vector3<f64>,
    dice: &mut Dice,
) -> Rgb {
    let mut sum = [0.0; 3];
    for emitter in emitters {
        let lamp = &quads[emitter.quad];
        let (w, h) = lamp.size();
        let weight = w * h / (core::f64::consts::PI * f64::from(SAMPLES_A_LAMP));
        for k in 0..SAMPLES_A_LAMP {
            let s = (f64::from(k % 4) + dice.unit()) / 4.0;
            let t = (f64::from(k / 4) + dice.unit()) / f64::from(SAMPLES_A_LAMP / 4);
            let to_lamp = lamp.origin + s * lamp.u + t * lamp.v + 1e-3 * lamp.normal - point;
            let distance_sq = to_lamp.norm_squared();
            let distance = distance_sq.sqrt();
            let direction = to_lamp / distance;
            let (cos_here, cos_there) = (quad.normal.dot(&direction), -lamp.normal.dot(&direction));
            if cos_here <= 0.0 || cos_there <= 0.0 {
                continue;
            }
            if bvh
                .nearest(quads, point, &direction, distance - 2e-3)
                .is_none()
            {
                let f = weight * cos_here * cos_there / distance_sq.max(0.01);
                sum = core::array::from_fn(|i| sum[i] + f * emitter.power[i]);
            }
        }
    }
    sum
}

fn gather(
    quads: &[Quad],
    bvh: &Bvh,
    albedo: &[Rgb],
    direct: &LightMap,
    quad: &Quad,
    point: &Vector3<f64>,
    dice: &mut Dice,
) -> Rgb {
    let (x, y) = (quad.u.normalize(), quad.v.normalize());
    let mut sum = [0.0; 3];
    for k in 0..BOUNCE_RAYS {
        // Cosine-weighted, stratified over the angle.
        let turn = (f64::from(k) + dice.unit()) / f64::from(BOUNCE_RAYS);
        let (sin, cos) = (turn * core::f64::consts::TAU * 5.0).sin_cos();
        let r_sq = dice.unit();
        let r = r_sq.sqrt();
        let direction = r * cos * x + r * sin * y + (1.0 - r_sq).sqrt() * quad.normal;
        if let Some(hit) = bvh.nearest(quads, point, &direction, f64::INFINITY) {
            let light = direct.at(&hit);
            // Close corners receive less of what has bounced more than once.
            let open = (hit.distance / 0.8).min(1.0);
            sum = core::array::from_fn(|i| {
                sum[i] + albedo[hit.quad][i] * light[i] + AMBIENT[i] * (0.25 + 0.75 * open)
            });
        }
    }
    sum.map(|v| v / f64::from(BOUNCE_RAYS))
}
