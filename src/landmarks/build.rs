//! From tracks to a table.

use super::code::SignCode;
use super::table::{LandmarkError, LandmarkTable, NO_CLUSTER, PositionGrid};
use super::view::ViewCone;
use crate::math::order::sort_by_key;
use crate::math::stats::quantile_in_place;
use nalgebra::Vector3;

/// Views of a cluster, where the place has fewer than 255 of them.
const CLUSTER_VIEWS: usize = 6;
/// Positions beyond the middle 98 % by more than this many times their range are dropped: they would coarsen the grid.
const BOX_MARGIN: f64 = 1.0;

/// A point as it was reconstructed.
#[derive(Debug, Clone, Copy)]
pub struct PointSource<'a> {
    /// World position.
    pub point_in_world: Vector3<f64>,
    /// Of the extractor's length.
    pub descriptor: &'a [f32],
    /// Standard deviation across the line of sight, world units.
    pub sigma: f64,
    /// The views that see it.
    pub views: &'a [u32],
}

/// A line as it was reconstructed.
#[derive(Debug, Clone, Copy)]
pub struct LineSource<'a> {
    /// World position of the end where most image segments start.
    pub start_in_world: Vector3<f64>,
    /// The other end.
    pub end_in_world: Vector3<f64>,
    /// Unit mean of the descriptors along it.
    pub descriptor: &'a [f32],
    /// Standard deviation across the line, world units.
    pub sigma: f64,
    /// The views that see it.
    pub views: &'a [u32],
}

/// Makes a table. `cameras` are the positions of the views, those that are not finite see nothing; descriptors have `channels` numbers. Sources that no view sees, that
/// lie far outside of the place, or whose numbers are not finite are left out.
///
/// # Errors
/// [`LandmarkError::Empty`] when no point is left, [`LandmarkError::TooMany`].
pub fn build(
    channels: usize,
    cameras: &[Vector3<f64>],
    points: &[PointSource<'_>],
    lines: &[LineSource<'_>],
) -> Result<LandmarkTable, LandmarkError> {
    let centers = |views: &[u32]| -> Vec<Vector3<f64>> {
        let known = views.iter().filter_map(|v| cameras.get(*v as usize));
        known.copied().filter(|c| c.sum().is_finite()).collect()
    };
    let is_sound = |descriptor: &[f32], sigma: f64| {
        descriptor.len() == channels
            && descriptor.iter().all(|d| d.is_finite())
            && sigma > 0.0
            && sigma.is_finite()
    };
    let points: Vec<(&PointSource<'_>, ViewCone)> = points
        .iter()
        .filter(|p| is_sound(p.descriptor, p.sigma))
        .filter_map(|p| {
            let cameras = centers(p.views);
            let cone = ViewCone::of(&p.point_in_world, cameras.iter().copied(), p.sigma)?;
            Some((p, cone))
        })
        .collect();
    let lines: Vec<(&LineSource<'_>, ViewCone)> = lines
        .iter()
        .filter(|l| is_sound(l.descriptor, l.sigma))
        .filter_map(|l| {
            let middle = 0.5 * (l.start_in_world + l.end_in_world);
            let cone = ViewCone::of(&middle, centers(l.views).into_iter(), l.sigma)?;
            Some((l, cone))
        })
        .collect();
    let ends = lines
        .iter()
        .flat_map(|(l, _)| [l.start_in_world, l.end_in_world]);
    let positions: Vec<_> = points
        .iter()
        .map(|(p, _)| p.point_in_world)
        .chain(ends)
        .collect();
    let grid = grid_of(&positions).ok_or(LandmarkError::Empty)?;
    let seen: Vec<&[u32]> = points.iter().map(|(p, _)| p.views).collect();
    let (cluster_of_view, num_clusters) = clusters(cameras.len(), &seen);

    let mut table = LandmarkTable {
        grid,
        point_code: SignCode::of(channels, points.iter().map(|(p, _)| p.descriptor)),
        line_code: SignCode::of(channels, lines.iter().map(|(l, _)| l.descriptor)),
        num_clusters,
        point_positions: Vec::with_capacity(points.len()),
        point_codes: Vec::with_capacity(points.len()),
        point_views: Vec::with_capacity(points.len()),
        point_clusters: Vec::with_capacity(points.len()),
        line_positions: Vec::with_capacity(lines.len()),
        line_codes: Vec::with_capacity(lines.len()),
        line_views: Vec::with_capacity(lines.len()),
    };
    for (p, cone) in &points {
        if let Some(position) = grid.encode(&p.point_in_world) {
            table.point_positions.push(position);
            table
                .point_codes
                .push(table.point_code.encode(p.descriptor));
            table.point_views.push(cone.encode(grid.step));
            table
                .point_clusters
                .push(most_frequent(p.views, &cluster_of_view));
        }
    }
    for (l, cone) in &lines {
        let ends = (grid.encode(&l.start_in_world), grid.encode(&l.end_in_world));
        if let (Some(start), Some(end)) = ends
            && start != end
        {
            table.line_positions.push([start, end]);
            table.line_codes.push(table.line_code.encode(l.descriptor));
            table.line_views.push(cone.encode(grid.step));
        }
    }
    table.check(channels)?;
    Ok(table)
}

/// The grid of a place: around its positions, but for the far ones.
fn grid_of(positions: &[Vector3<f64>]) -> Option<PositionGrid> {
    let (mut low, mut high) = (Vector3::zeros(), Vector3::zeros());
    for axis in 0..3 {
        let values = || -> Vec<f64> {
            let all = positions.iter().map(|p| p[axis]);
            all.filter(|v| v.is_finite()).collect()
        };
        let from = quantile_in_place(&mut values(), 0.01)?;
        let to = quantile_in_place(&mut values(), 0.99)?;
        let margin = BOX_MARGIN * (to - from);
        let kept = values()
            .into_iter()
            .filter(|v| *v >= from - margin && *v <= to + margin);
        (low[axis], high[axis]) = kept.fold((from, to), |(l, h), v| (l.min(v), h.max(v)));
    }
    Some(PositionGrid::around(&low, &high))
}

/// Views that see the same things: the cluster of each, and how many there are. A cluster is the first view that is in none
/// and those others that share most points with it.
fn clusters(num_views: usize, seen: &[&[u32]]) -> (Vec<u8>, usize) {
    let mut points_of_view: Vec<Vec<u32>> = vec![Vec::new(); num_views];
    for (point, views) in seen.iter().enumerate() {
        for view in *views {
            if let Some(list) = points_of_view.get_mut(*view as usize) {
                list.push(point as u32);
            }
        }
    }
    let size = CLUSTER_VIEWS.max(num_views.div_ceil(usize::from(NO_CLUSTER) / 2));
    let mut cluster_of_view = vec![NO_CLUSTER; num_views];
    let mut num = 0_u8;
    let mut shared = vec![0_u32; num_views];
    for first in 0..num_views {
        if cluster_of_view[first] != NO_CLUSTER || num == NO_CLUSTER {
            continue;
        }
        shared.fill(0);
        for point in &points_of_view[first] {
            for view in seen[*point as usize] {
                if let Some(n) = shared.get_mut(*view as usize) {
                    *n += 1;
                }
            }
        }
        let mut others: Vec<usize> = (first + 1..num_views)
            .filter(|v| cluster_of_view[*v] == NO_CLUSTER && shared[*v] > 0)
            .collect();
        sort_by_key(&mut others, |v| core::cmp::Reverse(shared[*v]));
        others.truncate(size - 1);
        cluster_of_view[first] = num;
        for view in others {
            cluster_of_view[view] = num;
        }
        num += 1;
    }
    (cluster_of_view, usize::from(num))
}

/// The two clusters in which most of the views are; of equals the first.
fn most_frequent(views: &[u32], cluster_of_view: &[u8]) -> [u8; 2] {
    let mut counts = [0_u32; 256];
    for view in views {
        if let Some(cluster) = cluster_of_view.get(*view as usize) {
            counts[usize::from(*cluster)] += 1;
        }
    }
    counts[usize::from(NO_CLUSTER)] = 0;
    let mut take = || {
        let best = (0..=u8::MAX)
            .rev()
            .max_by_key(|c| counts[usize::from(*c)])?;
        let count = core::mem::take(&mut counts[usize::from(best)]);
        (count > 0).then_some(best)
    };
    [take(), take()].map(|c| c.unwrap_or(NO_CLUSTER))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clusters_hold_what_is_seen_together() {
        // Two halls of eight views each; one point joins them.
        let seen: Vec<Vec<u32>> = (0..40)
            .map(|i| {
                let hall = 8 * (i % 2);
                (hall..hall + 8).filter(|v| (v + i) % 3 != 0).collect()
            })
            .chain([vec![7, 8]])
            .collect();
        let lists: Vec<&[u32]> = seen.iter().map(Vec::as_slice).collect();
        let (of_view, num) = clusters(16, &lists);
        assert_eq!(
            num,
            of_view.iter().copied().max().map_or(0, usize::from) + 1
        );
        for a in 0..7 {
            for b in 9..16 {
                assert_ne!(of_view[a], of_view[b]);
            }
        }
        assert_eq!(
            most_frequent(&[0, 1, 9], &[4, 4, 9, 9, 9, 9, 9, 9, 9, 2]),
            [4, 2]
        );
        assert_eq!(most_frequent(&[], &of_view), [NO_CLUSTER; 2]);
    }

    #[test]
    fn unsound_sources_are_left_out_and_nothing_left_is_an_error() {
        let descriptor = vec![0.5_f32; 64];
        let cameras = [Vector3::zeros(), Vector3::new(0.5, 0.0, 0.0)];
        let good = |i: usize| PointSource {
            point_in_world: Vector3::new(i as f64 % 7.0, i as f64 % 5.0, 2.0 + i as f64 % 3.0),
            descriptor: &descriptor,
            sigma: 1e-3,
            views: &[0, 1],
        };
        let mut points: Vec<_> = (0..200).map(good).collect();
        points[3].views = &[];
        points[4].sigma = f64::NAN;
        points[5].descriptor = &descriptor[..32];
        points[6].point_in_world = Vector3::new(1e6, 0.0, 0.0);
        let table = build(64, &cameras, &points, &[]).expect("points are left");
        assert_eq!(table.point_positions.len(), 196);
        let back = table.grid.decode(table.point_positions[0]);
        assert!((back - points[0].point_in_world).norm() < 2.0 * table.grid.step);
        assert_eq!(
            build(64, &cameras, &points[3..4], &[]),
            Err(LandmarkError::Empty)
        );
    }
}
