//! Mutual nearest neighbours in descriptor space, checked against the known epipolar geometry.

use super::View;
use landline::geometry::CamFromWorld;
use nalgebra::{DMatrix, Matrix3, Vector3};
use rayon::prelude::*;

/// What counts as a match.
#[derive(Debug, Clone, PartialEq)]
pub struct MatchParams {
    /// Least cosine of the descriptors. 0.82 keeps nearly all true matches of XFeat (measured on RedKitchen).
    pub min_cosine: f32,
    /// Largest distance of either keypoint from the other's epipolar line.
    pub max_epipolar_px: f64,
}

impl Default for MatchParams {
    fn default() -> Self {
        Self {
            min_cosine: 0.82,
            max_epipolar_px: 3.0,
        }
    }
}

/// Two keypoints, each (view, keypoint), that may show the same thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// In the view with the lower number.
    pub a: (u32, u32),
    /// In the other view.
    pub b: (u32, u32),
    /// Cosine of the descriptors.
    pub cosine: f32,
}

/// Matches all pairs in parallel; the result is in the order of the pairs. `done` is called after each pair.
pub fn match_pairs(
    views: &[View],
    pairs: &[(usize, usize)],
    params: &MatchParams,
    done: &(impl Fn() + Sync),
) -> Vec<Match> {
    pairs
        .par_iter()
        .map_init(Scratch::default, |scratch, &(i, j)| {
            let matches = match_pair(views, i, j, params, scratch);
            done();
            matches
        })
        .flatten_iter()
        .collect()
}

struct Scratch {
    similarity: DMatrix<f32>,
    best_a: Vec<(f32, u32)>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            similarity: DMatrix::zeros(0, 0),
            best_a: Vec::new(),
        }
    }
}

/// Mutual nearest neighbours without any geometry.
pub(super) fn mutual_neighbours(
    a_dn: &DMatrix<f32>,
    b_dn: &DMatrix<f32>,
    min_cosine: f32,
) -> Vec<(u32, u32, f32)> {
    mutual(a_dn, b_dn, min_cosine, &mut Scratch::default())
}

fn mutual(
    a_dn: &DMatrix<f32>,
    b_dn: &DMatrix<f32>,
    min_cosine: f32,
    scratch: &mut Scratch,
) -> Vec<(u32, u32, f32)> {
    let (n_a, n_b) = (a_dn.ncols(), b_dn.ncols());
    if n_a == 0 || n_b == 0 || a_dn.nrows() != b_dn.nrows() {
        return Vec::new();
    }
    if scratch.similarity.shape() != (n_a, n_b) {
        scratch.similarity = DMatrix::zeros(n_a, n_b);
    }
    // The product goes through nalgebra's blocked GEMM only with the left side laid out as a matrix of its own.
    let a_nd = a_dn.transpose();
    scratch.similarity.gemm(1.0, &a_nd, b_dn, 0.0);
    scratch.best_a.clear();
    scratch.best_a.resize(n_a, (f32::MIN, u32::MAX));
    let mut best_b = Vec::with_capacity(n_b);
    let columns = scratch.similarity.as_slice().chunks_exact(n_a);
    for (j, column) in columns.enumerate() {
        let mut best = (f32::MIN, u32::MAX);
        for (i, (value, row)) in column.iter().zip(&mut scratch.best_a).enumerate() {
            if *value > best.0 {
                best = (*value, i as u32);
            }
            if *value > row.0 {
                *row = (*value, j as u32);
            }
        }
        best_b.push(best);
    }
    best_b
        .iter()
        .enumerate()
        .filter(|(j, (cosine, i))| {
            *cosine >= min_cosine
                && scratch
                    .best_a
                    .get(*i as usize)
                    .is_some_and(|(_, back)| *back as usize == *j)
        })
        .map(|(j, (cosine, i))| (*i, j as u32, *cosine))
        .collect()
}

/// Maps a place on the plane of `a` to its epipolar line on the plane of `b`.
pub(super) fn essential(a_from_world: &CamFromWorld, b_from_world: &CamFromWorld) -> Matrix3<f64> {
    let b_from_a = *b_from_world * a_from_world.inverse();
    b_from_a.translation.cross_matrix() * b_from_a.rotation
}

/// The larger of the distances of two places from each other's epipolar lines, in the planes' units.
pub(super) fn epipolar_distance(e: &Matrix3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let in_b = e * a;
    let in_a = e.transpose() * b;
    let product = b.dot(&in_b).abs();
    let least = in_b.xy().norm().min(in_a.xy().norm());
    if least > 0.0 {
        product / least
    } else {
        f64::INFINITY
    }
}

fn match_pair(
    views: &[View],
    i: usize,
    j: usize,
    params: &MatchParams,
    scratch: &mut Scratch,
) -> Vec<Match> {
    let (a, b) = (&views[i], &views[j]);
    let e = essential(&a.cam_from_world, &b.cam_from_world);
    let limit = params.max_epipolar_px / (0.5 * (a.focal_px + b.focal_px));
    let place = |view: &View, k: u32| view.planar.get(k as usize).map(|p| p.push(1.0));
    mutual(
        &a.descriptors_dn,
        &b.descriptors_dn,
        params.min_cosine,
        scratch,
    )
    .into_iter()
    .filter(|(k, l, _)| match (place(a, *k), place(b, *l)) {
        (Some(p), Some(q)) => epipolar_distance(&e, &p, &q) <= limit,
        _ => false,
    })
    .map(|(k, l, cosine)| Match {
        a: (i as u32, k),
        b: (j as u32, l),
        cosine,
    })
    .collect()
}
