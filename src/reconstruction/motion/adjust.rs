//! Bundle adjustment of a reconstruction while it grows: what is handed to [`bundle`], and how thoroughly.

use super::CameraGroup;
use super::grow::{Attempt, Ground, NO_TRACK};
use crate::geometry::{Camera, CameraModel, Pixel};
use crate::math::order::sort_by_key;
use crate::reconstruction::bundle::{
    self, BundleCamera, BundleObservation, BundleOptions, BundleProblem, BundleSummary, Intrinsics,
    IntrinsicsPrior, Loss,
};
use crate::reconstruction::planar_from_pixel;
use nalgebra::Vector2;

/// An attempt as the adjustment wants it.
struct Posed {
    problem: BundleProblem,
    options: BundleOptions,
    /// Picture of each camera.
    registered: Vec<usize>,
    /// Track of each point.
    chosen: Vec<usize>,
}

impl Ground<'_> {
    /// A pixel as the adjustment wants it: relative to the principal point, without distortion other than one radial term.
    /// Where the camera is not refined its distortion is taken out instead.
    fn place_px(camera: &Camera, refines: bool, pixel: Pixel) -> Option<Vector2<f64>> {
        match camera.model {
            CameraModel::SimplePinhole { cx, cy, .. } => {
                Some(Vector2::new(pixel.x - cx, pixel.y - cy))
            }
            CameraModel::SimpleRadial { cx, cy, .. } if refines => {
                Some(Vector2::new(pixel.x - cx, pixel.y - cy))
            }
            _ => {
                let (fx, fy) = camera.focal_px();
                let planar = planar_from_pixel(camera, pixel);
                (!planar.x.is_nan()).then(|| planar * (0.5 * (fx + fy)))
            }
        }
    }

    fn intrinsics(camera: &Camera, group: &CameraGroup, refines_radial: bool) -> Intrinsics {
        let (fx, fy) = camera.focal_px();
        let focal_px = 0.5 * (fx + fy);
        let k = match camera.model {
            CameraModel::SimpleRadial { k, .. } => k,
            _ => 0.0,
        };
        let moves = group.refines;
        let prior = if moves {
            IntrinsicsPrior {
                focal_px: group.prior_focal_px(),
                sigma_ln: group.sigma_ln,
                sigma_k: if refines_radial { 0.1 } else { 1e-6 },
            }
        } else {
            // Held by a prior that nothing moves, so that other groups may be refined beside it.
            IntrinsicsPrior {
                focal_px,
                sigma_ln: 1e-7,
                sigma_k: 1e-7,
            }
        };
        Intrinsics {
            focal_px,
            k: if moves { k } else { 0.0 },
            prior: Some(prior),
        }
    }

    /// Bundle adjustment of everything registered on the tracks that cover the pictures best.
    pub(super) fn adjust(&self, attempt: &mut Attempt, effort: &Effort) {
        self.adjust_with(self.groups, attempt, effort);
    }

    /// The same with other beliefs about the cameras; `None` when there is nothing to adjust.
    pub(super) fn adjust_with(
        &self,
        groups: &[CameraGroup],
        attempt: &mut Attempt,
        effort: &Effort,
    ) -> Option<BundleSummary> {
        let Posed {
            mut problem,
            options,
            registered,
            chosen,
        } = self.problem(groups, attempt, effort)?;
        let summary = bundle::adjust(&mut problem, &options).ok()?;
        for (i, camera) in registered.iter().zip(&problem.cameras) {
            attempt.poses[*i] = Some(camera.cam_from_world);
        }
        for (t, position) in chosen.iter().zip(&problem.points) {
            if let Some(point) = &mut attempt.points[*t] {
                point.position = *position;
            }
        }
        for (g, intrinsics) in problem.intrinsics.iter().enumerate() {
            if groups[g].refines {
                let camera = &mut attempt.cameras[g];
                let c = camera.principal_point();
                camera.model = CameraModel::SimpleRadial {
                    f: intrinsics.focal_px,
                    cx: c.x,
                    cy: c.y,
                    k: intrinsics.k,
                };
            }
        }
        Some(summary)
    }

    /// Standard deviation of ln f of each group, from the points of an attempt; `None` where it is not adjusted.
    pub(super) fn focal_sigmas(&self, attempt: &Attempt) -> Vec<Option<f64>> {
        let sigmas = self
            .problem(self.groups, attempt, &Effort::thorough())
            .and_then(|posed| bundle::focal_sigmas(&posed.problem, &posed.options));
        self.groups
            .iter()
            .enumerate()
            .map(|(g, group)| group.refines.then(|| sigmas.as_ref()?.get(g).copied())?)
            .collect()
    }

    /// Everything registered on the tracks that cover the pictures best; `None` without points.
    fn problem(&self, groups: &[CameraGroup], attempt: &Attempt, effort: &Effort) -> Option<Posed> {
        let registered: Vec<usize> = (0..attempt.poses.len())
            .filter(|i| attempt.poses[*i].is_some())
            .collect();
        let num_registered = registered.len();
        let mut problem = BundleProblem::default();
        let mut camera_of = vec![NO_TRACK; attempt.poses.len()];
        for i in &registered {
            let Some(cam_from_world) = attempt.poses[*i] else {
                continue;
            };
            camera_of[*i] = problem.cameras.len() as u32;
            problem.cameras.push(BundleCamera {
                cam_from_world,
                intrinsics: self.pictures[*i].camera,
                is_fixed: false,
            });
        }
        let refines = groups.iter().any(|g| g.refines);
        let options = BundleOptions {
            loss: Loss::Cauchy(effort.loss_px),
            refines_focal: refines && num_registered >= self.params.refine_focal_from,
            refines_radial: refines && num_registered >= self.params.refine_radial_from,
            max_iterations: effort.iterations,
            tolerance: effort.tolerance,
        };
        problem.intrinsics = (groups.iter().zip(&attempt.cameras))
            .map(|(group, camera)| Self::intrinsics(camera, group, options.refines_radial))
            .collect();
        let chosen = self.cover(attempt, effort.points_per_picture);
        for (p, t) in chosen.iter().enumerate() {
            let Some(point) = &attempt.points[*t] else {
                continue;
            };
            problem.points.push(point.position);
            for o in &point.observations {
                let picture = &self.pictures[o.view as usize];
                let pixel = picture.features.keypoints[o.feature as usize].pixel;
                let refines = groups[picture.camera].refines;
                let camera = &attempt.cameras[picture.camera];
                if let Some(place_px) = Self::place_px(camera, refines, pixel) {
                    problem.observations.push(BundleObservation {
                        camera: camera_of[o.view as usize],
                        point: p as u32,
                        place_px,
                    });
                }
            }
        }
        if let Some(given) = &self.given {
            given.hold(&registered, &mut problem);
        }
        if problem.points.is_empty() {
            return None;
        }
        Some(Posed {
            problem,
            options,
            registered,
            chosen,
        })
    }

    /// Tracks with points, longest first, until every picture has its share.
    fn cover(&self, attempt: &Attempt, per_picture: usize) -> Vec<usize> {
        let mut with_points: Vec<(usize, usize)> = attempt
            .points
            .iter()
            .enumerate()
            .filter_map(|(t, p)| Some((p.as_ref()?.observations.len(), t)))
            .collect();
        sort_by_key(&mut with_points, |(len, _)| core::cmp::Reverse(*len));
        let mut have = vec![0usize; attempt.poses.len()];
        let mut chosen = Vec::new();
        for (_, t) in with_points {
            let Some(point) = &attempt.points[t] else {
                continue;
            };
            if point
                .observations
                .iter()
                .any(|o| have[o.view as usize] < per_picture)
            {
                for o in &point.observations {
                    have[o.view as usize] += 1;
                }
                chosen.push(t);
            }
        }
        chosen.sort_unstable();
        chosen
    }
}

/// How thoroughly to adjust.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    pub(super) points_per_picture: usize,
    pub(super) iterations: usize,
    pub(super) tolerance: f64,
    pub(super) loss_px: f64,
}

impl Effort {
    /// While it grows.
    pub(super) fn quick() -> Self {
        Self {
            points_per_picture: 120,
            iterations: 12,
            tolerance: 1e-3,
            loss_px: 2.0,
        }
    }

    /// Where far ends of a walk that came apart are drawn together.
    pub(super) fn wide(factor: f64) -> Self {
        Self {
            points_per_picture: 200,
            iterations: 15,
            tolerance: 1e-3,
            loss_px: 2.0 * factor,
        }
    }

    /// In the end.
    pub(super) fn thorough() -> Self {
        Self {
            points_per_picture: 600,
            iterations: 25,
            tolerance: 1e-5,
            loss_px: 1.5,
        }
    }
}
