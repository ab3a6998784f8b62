//! Pieces of a film that were taken with another zoom, or by another lens of the phone.
//!
//! A picture whose own focal length differs clearly from its camera's is not registered ([`super::grow`]), so a change of zoom
//! leaves pieces, each with a focal length of its own. As cameras of their own they can be one model.

use super::grow::{Attempt, Ground, ZOOM_SIGMAS};
use super::{CameraGroup, Picture};
use crate::geometry::{CamFromWorld, Similarity, vector_from_rotation};
use crate::math::elementary::ln;
use nalgebra::Vector3;

/// A piece of fewer pictures does not know its focal length well enough.
const MIN_PICTURES: usize = 8;
/// Focal lengths whose logarithms are nearer are of one zoom: along a corridor a small piece is off by seven per cent and more, and more cameras than there
/// were bend the model.
pub const MIN_APART_LN: f64 = 0.12;

/// The pictures anew, with a camera group for each zoom.
pub(super) struct Zoomed<'a> {
    pub(super) pictures: Vec<Picture<'a>>,
    pub(super) groups: Vec<CameraGroup>,
    /// Focal lengths in pixels to try for each group.
    pub(super) hypotheses: Vec<Vec<f64>>,
}

/// Pictures of pieces whose focal length differs from the larger pieces' get a group of their own; `None` when none does.
/// `pieces` go from the largest to the smallest.
pub(super) fn told_apart<'a>(
    ground: &Ground<'a>,
    pieces: &[Attempt],
    hypotheses: &[Vec<f64>],
) -> Option<Zoomed<'a>> {
    // One piece has one focal length.
    if pieces.len() < 2 {
        return None;
    }
    let mut pictures = ground.pictures.to_vec();
    let mut groups = ground.groups.to_vec();
    let mut hypotheses = hypotheses.to_vec();
    for (g, group) in ground.groups.iter().enumerate().filter(|(_, g)| g.refines) {
        // Group, focal length and its deviation of every zoom so far; the first is the group itself.
        let mut zooms: Vec<(usize, f64, f64)> = Vec::new();
        for piece in pieces {
            let own = |i: &usize| piece.poses[*i].is_some() && ground.pictures[*i].camera == g;
            let own: Vec<usize> = (0..pictures.len()).filter(own).collect();
            let (true, Some(sigma)) = (own.len() >= MIN_PICTURES, ground.focal_sigmas(piece)[g])
            else {
                continue;
            };
            let focal_px = piece.cameras[g].focal_px().0;
            let is_same = |other: &&(usize, f64, f64)| {
                let off_ln = ln(focal_px / other.1).abs();
                let together = (sigma * sigma + other.2 * other.2).sqrt();
                off_ln <= MIN_APART_LN || off_ln <= ZOOM_SIGMAS * together
            };
            let found = match zooms.iter().find(is_same) {
                Some((found, ..)) => *found,
                None if zooms.is_empty() => {
                    zooms.push((g, focal_px, sigma));
                    hypotheses[g] = vec![focal_px];
                    g
                }
                None => {
                    zooms.push((groups.len(), focal_px, sigma));
                    groups.push(group.clone());
                    hypotheses.push(vec![focal_px]);
                    groups.len() - 1
                }
            };
            for i in own {
                pictures[i].camera = found;
            }
        }
    }
    (groups.len() > ground.groups.len()).then_some(Zoomed {
        pictures,
        groups,
        hypotheses,
    })
}

/// After one similarity a picture may be turned by so much,
const MAX_TURN_DEG: f64 = 2.0;
/// and moved by this share of the piece's extent,
const MAX_MOVED: f64 = 0.02;
/// in this share of the pictures more.
const MAX_CHANGED: f64 = 0.1;

/// Whether a model has a piece in it as it was: what several cameras bend to fit together is worse than pieces.
pub(super) fn keeps(piece: &Attempt, model: &[Option<CamFromWorld>]) -> bool {
    if piece.num_registered() < MIN_PICTURES {
        return true;
    }
    let both: Vec<(&CamFromWorld, &CamFromWorld)> = (piece.poses.iter().zip(model))
        .filter_map(|(own, new)| Some((own.as_ref()?, new.as_ref()?)))
        .collect();
    let centers = both
        .iter()
        .map(|(own, new)| (new.center_in_world(), own.center_in_world()));
    let centers: Vec<_> = centers.collect();
    let Some(moved) = Similarity::fit(&centers) else {
        return false;
    };
    let middle = centers.iter().map(|c| c.0).sum::<Vector3<f64>>() / centers.len() as f64;
    let from_middle = centers.iter().map(|c| (c.0 - middle).norm());
    let extent = from_middle.fold(0.0, f64::max);
    let is_kept = |(own, new): &&(&CamFromWorld, &CamFromWorld)| {
        let own = moved.transform_pose(own);
        let turn = vector_from_rotation(&(own.rotation.transpose() * new.rotation)).norm();
        let off = (own.center_in_world() - new.center_in_world()).norm();
        turn.to_degrees() <= MAX_TURN_DEG && off <= MAX_MOVED * extent
    };
    let num_kept = both.iter().filter(is_kept).count();
    num_kept as f64 >= (1.0 - MAX_CHANGED) * piece.num_registered() as f64
}
