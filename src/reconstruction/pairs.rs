//! Which pictures to match: those that look at the same things from different places.
//!
//! Overlap is measured with poses and a typical depth alone: points of a grid over the picture, put at three depths, are
//! projected into the other picture. The depth comes from a few neighbouring pairs that are matched first.

use super::matching::{MatchParams, match_pairs};
use super::{PosedView, planar_from_pixel};
use crate::geometry::Pixel;
use crate::math::elementary;
use crate::math::order::sort_by;
use crate::math::stats::median_in_place;
use nalgebra::Vector3;

/// How pairs are chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct PairParams {
    /// Least share of grid points that both pictures see.
    pub min_overlap: f64,
    /// Largest angle between the optical axes; descriptors do not match across larger ones.
    pub max_axis_angle_deg: f64,
    /// Least distance of the cameras as a share of the depth.
    pub min_baseline_ratio: f64,
    /// Largest distance of the cameras as a share of the depth.
    pub max_baseline_ratio: f64,
    /// Partners wanted for each picture.
    pub partners: usize,
}

impl Default for PairParams {
    fn default() -> Self {
        Self {
            min_overlap: 0.4,
            max_axis_angle_deg: 30.0,
            min_baseline_ratio: 0.01,
            max_baseline_ratio: 0.5,
            partners: 20,
        }
    }
}

const DEPTHS: [f64; 3] = [0.6, 1.0, 1.7];

fn grid(view: &PosedView<'_>, depth: f64) -> Vec<Vector3<f64>> {
    let (w, h) = (f64::from(view.camera.width), f64::from(view.camera.height));
    let world_from_cam = view.cam_from_world.inverse();
    let places = (0..12).flat_map(|i| {
        let pixel = Pixel::new(
            w * (0.125 + 0.25 * f64::from(i % 4)),
            h * (1.0 / 6.0 + f64::from(i / 4) / 3.0),
        );
        let planar = planar_from_pixel(&view.camera, pixel);
        DEPTHS.map(|share| {
            let z = depth * share;
            world_from_cam.transform_point(&Vector3::new(planar.x * z, planar.y * z, z))
        })
    });
    places.collect()
}

/// Share of what one view sees at typical depths that the other sees too; the less of both directions.
fn overlaps(views: &[PosedView<'_>], depth: f64, candidates: &[(usize, usize)]) -> Vec<f64> {
    let grids: Vec<Vec<Vector3<f64>>> = views.iter().map(|v| grid(v, depth)).collect();
    let share = |from: usize, to: usize| {
        let seen = grids[from].iter().filter(|p| views[to].sees(p)).count();
        seen as f64 / grids[from].len().max(1) as f64
    };
    candidates
        .iter()
        .map(|&(i, j)| share(i, j).min(share(j, i)))
        .collect()
}

/// All pairs whose axes are close enough, with their distance.
fn pairs_by_axis(views: &[PosedView<'_>], max_angle_deg: f64) -> Vec<(usize, usize, f64)> {
    let cos_limit = elementary::cos(max_angle_deg.to_radians());
    let axes: Vec<Vector3<f64>> = views
        .iter()
        .map(|v| v.cam_from_world.rotation.row(2).transpose())
        .collect();
    let mut pairs = Vec::new();
    for i in 0..views.len() {
        for j in i + 1..views.len() {
            if axes[i].dot(&axes[j]) >= cos_limit {
                let distance = (views[i].center_in_world - views[j].center_in_world).norm();
                pairs.push((i, j, distance));
            }
        }
    }
    pairs
}

/// Typical distance of what the pictures see, from matches of up to `num_pairs` pairs spread over the set.
/// `None` when nothing can be triangulated.
pub fn probe_depth(views: &[PosedView<'_>], num_pairs: usize, params: &MatchParams) -> Option<f64> {
    // For each of some pictures: the nearest one in angle that has moved a little. Moved enough is not known before
    // the depth is; the median of the nearest eight distances is a start that works for walks and for turntables.
    let step = views.len().div_ceil(num_pairs).max(1);
    let mut chosen = Vec::new();
    for i in (0..views.len()).step_by(step) {
        let mut near: Vec<(f64, usize)> = (0..views.len())
            .filter(|j| *j != i)
            .map(|j| {
                let distance = (views[i].center_in_world - views[j].center_in_world).norm();
                let cos = views[i]
                    .cam_from_world
                    .rotation
                    .row(2)
                    .dot(&views[j].cam_from_world.rotation.row(2));
                (distance, j, cos)
            })
            .filter(|(_, _, cos)| *cos > 0.94)
            .map(|(distance, j, _)| (distance, j))
            .collect();
        sort_by(&mut near, |a, b| a.0.total_cmp(&b.0));
        near.truncate(24);
        if let Some((_, j)) = near.last() {
            chosen.push((i.min(*j), i.max(*j)));
        }
        if let Some((_, j)) = near.get(near.len() / 2) {
            chosen.push((i.min(*j), i.max(*j)));
        }
    }
    chosen.sort_unstable();
    chosen.dedup();
    let matches = match_pairs(views, &chosen, params);
    let mut depths = Vec::new();
    for m in matches {
        let (a, b) = (&views[m.a.view as usize], &views[m.b.view as usize]);
        let (ray_a, ray_b) = (a.ray(m.a.feature as usize), b.ray(m.b.feature as usize));
        if ray_a.angle_to(&ray_b) < 1f64.to_radians() {
            continue;
        }
        if let Some(point) = ray_a.midpoint(&ray_b) {
            depths.push(a.cam_from_world.transform_point(&point).z);
        }
    }
    if depths.len() < 20 {
        return None;
    }
    median_in_place(&mut depths)
}

/// The pairs to match, each once with the lower position first, sorted.
///
/// Of a picture's candidates a third are its nearest, which link tracks; the others are spread evenly over the
/// baselines, which give depth.
pub fn choose_pairs(
    views: &[PosedView<'_>],
    depth: f64,
    params: &PairParams,
) -> Vec<(usize, usize)> {
    let candidates: Vec<(usize, usize, f64)> = pairs_by_axis(views, params.max_axis_angle_deg)
        .into_iter()
        .filter(|(_, _, distance)| {
            let ratio = distance / depth;
            ratio >= params.min_baseline_ratio && ratio <= params.max_baseline_ratio
        })
        .collect();
    let plain: Vec<(usize, usize)> = candidates.iter().map(|(i, j, _)| (*i, *j)).collect();
    let shares = overlaps(views, depth, &plain);
    let mut partners: Vec<Vec<(f64, usize)>> = vec![Vec::new(); views.len()];
    for ((i, j, distance), share) in candidates.into_iter().zip(shares) {
        if share >= params.min_overlap {
            partners[i].push((distance, j));
            partners[j].push((distance, i));
        }
    }
    let mut pairs = Vec::new();
    for (i, list) in partners.iter_mut().enumerate() {
        sort_by(list, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let nearest = params.partners / 3;
        let mut chosen: Vec<usize> = list.iter().take(nearest).map(|(_, j)| *j).collect();
        let rest = list.get(nearest..).unwrap_or_default();
        let wanted = (params.partners - nearest).min(rest.len());
        chosen.extend((0..wanted).map(|k| rest[k * rest.len() / wanted].1));
        pairs.extend(chosen.into_iter().map(|j| (i.min(j), i.max(j))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}
