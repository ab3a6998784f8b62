//! The correspondences as the search wants them: checked, undistorted, centred, scaled and sorted.
//!
//! World coordinates are shifted by the weighted median and divided by the median distance from it, so that neither map
//! coordinates of 1e6 m nor a scene in millimetres cost accuracy. Pixels are undistorted and counted from the principal point.

use super::budget_cap::{room, scattered};
use super::options::PoseOptions;
use super::types::{LineCorrespondence, PointCorrespondence};
use crate::geometry::{CamFromWorld, Camera, Pixel};
use crate::math::elementary::{exp, ln, logistic, logit};
use crate::math::order::{Best, sort_by_in, sort_indices};
use crate::math::stats::{median_in_place, weighted_median_in_place};
use core::cmp::Ordering;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Depth below which something counts as behind the camera, in units of the scene scale.
pub(super) const MIN_DEPTH: f64 = 0.01;

/// Cosine of the largest angle from the optical axis at which the image plane z = 1 still serves (80 degrees).
const MIN_BEARING_Z: f64 = 0.1736;

/// Inlier probabilities are kept away from certainty.
const PROBABILITY_RANGE: (f64, f64) = (0.02, 0.98);

/// What the network's confidence says about a correspondence.
#[derive(Debug, Clone, Copy)]
pub(super) struct Belief {
    /// Odds of being right, were it the only correspondence of its pixel.
    pub(super) odds: f64,
    /// Inlier probability beside its alternatives, and its logit.
    pub(super) prior: f64,
    pub(super) logit: f64,
    /// Number of the set of correspondences with the same pixel, of which at most one is right; 0 when there is no other.
    pub(super) alternatives: u32,
}

impl Belief {
    pub(super) fn from_logit(logit: f64) -> Self {
        Self {
            odds: exp(logit),
            prior: logistic(logit),
            logit,
            alternatives: 0,
        }
    }

    /// Odds of being right, beside its alternatives.
    pub(super) fn odds_beside_others(&self) -> f64 {
        if self.alternatives == 0 {
            self.odds
        } else {
            self.prior / (1.0 - self.prior)
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct PointItem {
    /// Undistorted, from the principal point, in pixels of the given focal length.
    pub(super) uv: Vector2<f64>,
    /// Normalised world point.
    pub(super) x: Vector3<f64>,
    pub(super) belief: Belief,
    /// Standard deviation of the world point in normalised units; 0 when unknown.
    pub(super) sigma: f64,
    /// Standard deviation of the pixel.
    pub(super) sigma_px: f64,
    /// Index in the caller's list.
    pub(super) source: u32,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct LineItem {
    pub(super) a: Vector2<f64>,
    pub(super) b: Vector2<f64>,
    pub(super) x1: Vector3<f64>,
    pub(super) x2: Vector3<f64>,
    /// Unit direction from `x1` to `x2`.
    pub(super) direction: Vector3<f64>,
    pub(super) length_px: f64,
    pub(super) belief: Belief,
    pub(super) sigma: f64,
    pub(super) sigma_px: f64,
    pub(super) source: u32,
}

/// A pose in normalised units and a factor on the given focal lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
    pub(super) focal: f64,
}

impl Model {
    pub(super) fn is_finite(&self) -> bool {
        (self.rotation.sum() + self.translation.sum() + self.focal).is_finite()
    }

    pub(super) fn center(&self) -> Vector3<f64> {
        -(self.rotation.transpose() * self.translation)
    }

    /// Whether two models are clearly different places: more than 3 degrees or 5 % of the scene scale apart.
    pub(super) fn is_distinct_from(&self, other: &Self) -> bool {
        let trace = (self.rotation.component_mul(&other.rotation)).sum();
        // cos 3 degrees
        0.5 * (trace - 1.0) < 0.998_63
            || (self.center() - other.center()).norm_squared() > 0.05 * 0.05
    }
}

/// Checked and normalised input. Buffers are reused from call to call.
#[derive(Debug, Default)]
pub(super) struct Problem {
    pub(super) points: Vec<PointItem>,
    pub(super) lines: Vec<LineItem>,
    /// Focal lengths in pixels that belong to `Model::focal == 1`.
    pub(super) fx: f64,
    pub(super) fy: f64,
    /// Normalised = (world - center) / scale.
    pub(super) center: Vector3<f64>,
    pub(super) scale: f64,
    /// ln of the density (per square pixel) of the residual of an outlier.
    pub(super) ln_null_point: f64,
    pub(super) ln_null_line: f64,
    /// The densities themselves.
    pub(super) null_point: f64,
    pub(super) null_line: f64,
    pub(super) num_invalid: u32,
    pub(super) num_outside_view: u32,
    pub(super) num_left_out: u32,
    /// How many sets of alternatives there are among points and lines.
    pub(super) num_alternatives: u32,
    /// Share of the correspondences that have alternatives.
    pub(super) alternative_share: f64,
    pairs: Vec<(f64, f64)>,
    distances: Vec<f64>,
    order: Vec<u32>,
    cap: Best,
}

/// Correspondences with the same pixels are alternatives: a keypoint shows one thing. Given that, the prior of each is its share
/// of the odds beside those of the others and of "none".
fn find_alternatives<T, const N: usize>(
    items: &mut [T],
    order: &mut Vec<u32>,
    num: &mut u32,
    key: impl Fn(&T) -> [f64; N],
    belief: impl Fn(&mut T) -> &mut Belief,
) {
    order.clear();
    order.extend(0..items.len() as u32);
    let compare = |a: &T, b: &T| {
        let pairs = key(a).into_iter().zip(key(b));
        pairs.fold(Ordering::Equal, |o, (x, y)| o.then(x.total_cmp(&y)))
    };
    sort_indices(order, &mut |a, b| {
        compare(&items[a as usize], &items[b as usize])
    });
    let mut rest = order.as_slice();
    while let Some(first) = rest.first() {
        let is_same = |i: &&u32| compare(&items[**i as usize], &items[*first as usize]).is_eq();
        let (set, others) = rest.split_at(rest.iter().take_while(is_same).count().max(1));
        rest = others;
        if set.len() == 1 {
            continue;
        }
        *num += 1;
        let mut total = 0.0;
        for i in set {
            total += belief(&mut items[*i as usize]).odds;
        }
        for i in set {
            let b = belief(&mut items[*i as usize]);
            b.alternatives = *num;
            b.prior = b.odds / (1.0 + total);
            b.logit = ln(b.odds / (1.0 + total - b.odds));
        }
    }
}

fn is_confidence(c: f32) -> bool {
    (0.0..=1.0).contains(&c)
}

fn is_sigma(s: f32) -> bool {
    s >= 0.0 && s.is_finite()
}

fn is_finite(v: &Vector3<f64>) -> bool {
    // Larger numbers overflow when squared; no scene is 1e100 m wide.
    v.amax() < 1e100
}

fn is_usable_point(p: &PointCorrespondence) -> bool {
    p.pixel.x.is_finite()
        && p.pixel.y.is_finite()
        && is_finite(&p.point_in_world)
        && is_confidence(p.confidence)
        && is_sigma(p.sigma_m)
        && is_sigma(p.sigma_px)
}

fn is_usable_line(l: &LineCorrespondence) -> bool {
    l.start.x.is_finite()
        && l.start.y.is_finite()
        && l.end.x.is_finite()
        && l.end.y.is_finite()
        && is_finite(&l.start_in_world)
        && is_finite(&l.end_in_world)
        && is_confidence(l.confidence)
        && is_sigma(l.sigma_m)
        && is_sigma(l.sigma_px)
        && (l.end_in_world - l.start_in_world).norm() > 0.0
}

/// Index and confidence of what can be used and counts: a confidence of exactly zero takes a correspondence out.
fn weighed<'a, T>(
    items: &'a [T],
    is_usable: fn(&T) -> bool,
    confidence: fn(&T) -> f32,
) -> impl Iterator<Item = (u32, f32)> + 'a {
    let counts = move |(_, item): &(usize, &T)| is_usable(item) && confidence(item) > 0.0;
    let all = items.iter().enumerate().filter(counts);
    all.map(move |(i, item)| (scattered(i as u32), confidence(item)))
}

impl Problem {
    /// Takes over what is usable of the input.
    pub(super) fn load(
        &mut self,
        points: &[PointCorrespondence],
        lines: &[LineCorrespondence],
        camera: &Camera,
        options: &PoseOptions,
    ) {
        self.points.clear();
        self.lines.clear();
        self.num_invalid = 0;
        self.num_outside_view = 0;
        self.num_left_out = 0;
        let room = room(options.time_budget_ms);
        (self.fx, self.fy) = camera.focal_px();
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        self.ln_null_point = -ln(w * h);
        self.ln_null_line = -ln(w * w + h * h);
        self.null_point = 1.0 / (w * h);
        self.null_line = 1.0 / (w * w + h * h);
        let (fx, fy) = (self.fx, self.fy);
        let centered = |p: Pixel| -> Option<Vector2<f64>> {
            let b = camera.bearing_from_pixel(p)?;
            (b.z > MIN_BEARING_Z).then(|| Vector2::new(fx * b.x / b.z, fy * b.y / b.z))
        };
        let prior_logit = |confidence: f32| {
            let (slope, offset) = options.calibration;
            let c = f64::from(confidence).clamp(1e-6, 1.0 - 1e-6);
            let (low, high) = PROBABILITY_RANGE;
            (slope * logit(c) + offset).clamp(logit(low), logit(high))
        };
        let sigma_px = |given: f32| {
            if given > 0.0 {
                f64::from(given)
            } else {
                options.sigma_px
            }
        };
        if points.len() > room {
            let usable = weighed(points, is_usable_point, |p| p.confidence);
            self.num_left_out += self.cap.choose(room, usable) as u32;
        }
        let are_all_points_kept = points.len() <= room;
        for (i, p) in points.iter().enumerate() {
            if !is_usable_point(p) {
                self.num_invalid += 1;
                continue;
            }
            // A confidence of exactly zero takes the correspondence out.
            if p.confidence == 0.0
                || !(are_all_points_kept || self.cap.keeps(scattered(i as u32), p.confidence))
            {
                continue;
            }
            let Some(uv) = centered(p.pixel) else {
                self.num_outside_view += 1;
                continue;
            };
            self.points.push(PointItem {
                uv,
                x: p.point_in_world,
                belief: Belief::from_logit(prior_logit(p.confidence)),
                sigma: f64::from(p.sigma_m),
                sigma_px: sigma_px(p.sigma_px),
                source: i as u32,
            });
        }
        if lines.len() > room {
            let usable = weighed(lines, is_usable_line, |l| l.confidence);
            self.num_left_out += self.cap.choose(room, usable) as u32;
        }
        let are_all_lines_kept = lines.len() <= room;
        for (i, l) in lines.iter().enumerate() {
            if !is_usable_line(l) {
                self.num_invalid += 1;
                continue;
            }
            if l.confidence == 0.0
                || !(are_all_lines_kept || self.cap.keeps(scattered(i as u32), l.confidence))
            {
                continue;
            }
            let (Some(a), Some(b)) = (centered(l.start), centered(l.end)) else {
                self.num_outside_view += 1;
                continue;
            };
            let length = (l.end_in_world - l.start_in_world).norm();
            let length_px = (b - a).norm();
            if !(length_px > 0.5) {
                self.num_invalid += 1;
                continue;
            }
            self.lines.push(LineItem {
                a,
                b,
                x1: l.start_in_world,
                x2: l.end_in_world,
                direction: (l.end_in_world - l.start_in_world) / length,
                length_px,
                belief: Belief::from_logit(prior_logit(l.confidence)),
                sigma: f64::from(l.sigma_m),
                sigma_px: sigma_px(l.sigma_px),
                source: i as u32,
            });
        }
        self.num_alternatives = 0;
        let ends = |l: &LineItem| [l.a.x, l.a.y, l.b.x, l.b.y];
        let num = &mut self.num_alternatives;
        find_alternatives(
            &mut self.points,
            &mut self.order,
            num,
            |p| [p.uv.x, p.uv.y],
            |p| &mut p.belief,
        );
        find_alternatives(&mut self.lines, &mut self.order, num, ends, |l| {
            &mut l.belief
        });
        let points = self.points.iter().map(|p| &p.belief);
        let with_others = points
            .chain(self.lines.iter().map(|l| &l.belief))
            .filter(|b| b.alternatives > 0)
            .count();
        self.alternative_share = with_others as f64 / self.len().max(1) as f64;
        self.normalize();
        // Equal beliefs are scattered, because what stands first is looked at first and should not be one structure of the scene.
        let by_belief = |a: (&Belief, u32), b: (&Belief, u32)| {
            let by_belief = b.0.logit.total_cmp(&a.0.logit);
            by_belief.then(scattered(a.1).cmp(&scattered(b.1)))
        };
        sort_by_in(&mut self.points, &mut self.order, |a, b| {
            by_belief((&a.belief, a.source), (&b.belief, b.source))
        });
        sort_by_in(&mut self.lines, &mut self.order, |a, b| {
            by_belief((&a.belief, a.source), (&b.belief, b.source))
        });
    }

    /// The same correspondences in a world that is reflected at its centre.
    pub(super) fn reflect(&mut self, other: &Self) {
        self.points.clear();
        self.points
            .extend(other.points.iter().map(|p| PointItem { x: -p.x, ..*p }));
        self.lines.clear();
        self.lines.extend(other.lines.iter().map(|l| LineItem {
            x1: -l.x1,
            x2: -l.x2,
            direction: -l.direction,
            ..*l
        }));
        (self.fx, self.fy) = (other.fx, other.fy);
        (self.center, self.scale) = (-other.center, other.scale);
        (self.ln_null_point, self.ln_null_line) = (other.ln_null_point, other.ln_null_line);
        (self.null_point, self.null_line) = (other.null_point, other.null_line);
        self.num_alternatives = other.num_alternatives;
        self.alternative_share = other.alternative_share;
    }

    fn normalize(&mut self) {
        let pairs = &mut self.pairs;
        for axis in 0..3 {
            pairs.clear();
            pairs.extend(self.points.iter().map(|p| (p.x[axis], p.belief.prior)));
            pairs.extend(self.lines.iter().map(|l| (l.x1[axis], l.belief.prior)));
            pairs.extend(self.lines.iter().map(|l| (l.x2[axis], l.belief.prior)));
            self.center[axis] = weighted_median_in_place(pairs).unwrap_or(0.0);
        }
        let center = self.center;
        self.distances.clear();
        self.distances
            .extend(self.points.iter().map(|p| (p.x - center).norm()));
        self.distances
            .extend(self.lines.iter().map(|l| (l.x1 - center).norm()));
        let scale = median_in_place(&mut self.distances).unwrap_or(1.0);
        self.scale = if scale > 0.0 && scale.is_finite() {
            scale
        } else {
            1.0
        };
        let inverse = 1.0 / self.scale;
        for p in &mut self.points {
            p.x = (p.x - center) * inverse;
            p.sigma *= inverse;
        }
        for l in &mut self.lines {
            l.x1 = (l.x1 - center) * inverse;
            l.x2 = (l.x2 - center) * inverse;
            l.sigma *= inverse;
        }
    }

    pub(super) fn len(&self) -> usize {
        self.points.len() + self.lines.len()
    }

    /// Unit bearing of an undistorted centred pixel under a focal factor.
    pub(super) fn bearing(&self, uv: &Vector2<f64>, focal: f64) -> Vector3<f64> {
        Vector3::new(uv.x / (self.fx * focal), uv.y / (self.fy * focal), 1.0).normalize()
    }

    /// Unit normal of the viewing plane of an observed segment.
    pub(super) fn plane_normal(&self, line: &LineItem, focal: f64) -> Vector3<f64> {
        self.bearing(&line.a, focal)
            .cross(&self.bearing(&line.b, focal))
            .normalize()
    }

    pub(super) fn model_from_pose(&self, pose: &CamFromWorld, focal: f64) -> Model {
        Model {
            rotation: pose.rotation,
            translation: (pose.translation + pose.rotation * self.center) / self.scale,
            focal,
        }
    }

    pub(super) fn pose_from_model(&self, model: &Model) -> CamFromWorld {
        CamFromWorld::new(
            model.rotation,
            model.translation * self.scale - model.rotation * self.center,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalization_is_undone_exactly_enough_for_map_coordinates() {
        let offset = Vector3::new(4.5e5, 5.4e6, 120.0);
        let points: Vec<_> = (0..20)
            .map(|i| PointCorrespondence {
                pixel: Pixel::new(30.0 * f64::from(i), 17.0 * f64::from(i % 7)),
                point_in_world: offset + Vector3::new(f64::from(i), f64::from(i * i % 5), 1.0),
                confidence: 0.5,
                sigma_m: 0.0,
                sigma_px: 0.0,
            })
            .collect();
        let mut problem = Problem::default();
        let camera = Camera::centered(640, 480, 500.0);
        problem.load(&points, &[], &camera, &PoseOptions::default());
        let pose = CamFromWorld::new(
            crate::geometry::rotation_from_vector(&Vector3::new(0.1, -0.4, 0.2)),
            Vector3::new(1.0, 2.0, 3.0),
        );
        let model = problem.model_from_pose(&pose, 1.0);
        let back = problem.pose_from_model(&model);
        assert!((back.translation - pose.translation).norm() < 1e-8);
        assert!(problem.points.iter().all(|p| p.x.norm() < 5.0));
    }

    #[test]
    fn drops_and_counts_what_is_not_usable() {
        let good = PointCorrespondence {
            pixel: Pixel::new(10.0, 10.0),
            point_in_world: Vector3::new(1.0, 2.0, 3.0),
            confidence: 0.5,
            sigma_m: 0.0,
            sigma_px: 0.0,
        };
        let line = LineCorrespondence {
            start: Pixel::new(10.0, 10.0),
            end: Pixel::new(90.0, 10.0),
            start_in_world: Vector3::zeros(),
            end_in_world: Vector3::x(),
            confidence: 0.5,
            sigma_m: 0.0,
            sigma_px: 0.0,
        };
        let nan = f64::NAN;
        let points = [
            good,
            PointCorrespondence {
                pixel: Pixel::new(nan, 0.0),
                ..good
            },
            PointCorrespondence {
                point_in_world: Vector3::new(0.0, f64::INFINITY, 0.0),
                ..good
            },
            PointCorrespondence {
                confidence: 1.5,
                ..good
            },
            PointCorrespondence {
                confidence: f32::NAN,
                ..good
            },
            PointCorrespondence {
                sigma_m: -1.0,
                ..good
            },
            PointCorrespondence {
                sigma_px: f32::NAN,
                ..good
            },
        ];
        let lines = [
            line,
            LineCorrespondence {
                end: line.start,
                ..line
            },
            LineCorrespondence {
                end_in_world: line.start_in_world,
                ..line
            },
        ];
        let mut problem = Problem::default();
        let camera = Camera::centered(640, 480, 500.0);
        problem.load(&points, &lines, &camera, &PoseOptions::default());
        assert_eq!((problem.points.len(), problem.lines.len()), (1, 1));
        assert_eq!(problem.num_invalid, 8);
    }
}
