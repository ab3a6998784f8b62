//! Pieces of a film that were taken with another zoom, or by another lens of the phone.
//!
//! A picture whose own focal length differs clearly from its camera's is not registered ([`super::grow`]), so a change of zoom
//! leaves pieces, each with a focal length of its own. As cameras of their own they can be one model.

use super::grow::{Attempt, Ground, ZOOM_SIGMAS};
use super::{CameraGroup, Picture};
use crate::geometry::{CamFromWorld, vector_from_rotation};
use crate::math::elementary::ln;
use crate::math::stats::median_in_place;

/// A piece of fewer pictures does not know its focal length well enough.
const MIN_PICTURES: usize = 8;
/// Nearer focal lengths are of one zoom: along a corridor a small piece is off by seven per cent and more, and more cameras than there
/// were bend the model.
const MIN_APART_LN: f64 = 0.12;

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

/// Turns between two pictures may differ by so much,
const MAX_TURN_DEG: f64 = 2.0;
/// and distances, after one scale, by this share,
const MAX_STRETCH_LN: f64 = 0.05;
/// in this share of the cases.
const MAX_CHANGED: f64 = 0.1;

/// Whether a model has a piece in it as it was: what several cameras bend to fit together is worse than pieces.
pub(super) fn keeps(piece: &Attempt, model: &[Option<CamFromWorld>]) -> bool {
    let both: Vec<(&CamFromWorld, &CamFromWorld)> = (piece.poses.iter().zip(model))
        .filter_map(|(own, new)| Some((own.as_ref()?, new.as_ref()?)))
        .collect();
    let num_own = piece.num_registered();
    if num_own < MIN_PICTURES {
        return true;
    }
    if ((num_own - both.len()) as f64) > MAX_CHANGED * num_own as f64 {
        return false;
    }
    // Turn in degrees, and both distances, from three of the pictures to all.
    let mut found: Vec<(f64, f64, f64)> = Vec::new();
    for from in [0, both.len() / 2, both.len() - 1] {
        let (own_from, new_from) = both[from];
        let away = both.iter().enumerate().filter(|(k, _)| *k != from);
        found.extend(away.map(|(_, (own, new))| {
            let turn = (own.rotation * own_from.rotation.transpose()).transpose()
                * (new.rotation * new_from.rotation.transpose());
            let distance = |a: &CamFromWorld, b: &CamFromWorld| {
                (a.center_in_world() - b.center_in_world()).norm()
            };
            (
                vector_from_rotation(&turn).norm().to_degrees(),
                distance(own, own_from),
                distance(new, new_from),
            )
        }));
    }
    let longest = found.iter().map(|f| f.1).fold(0.0, f64::max);
    // Short distances say little of the shape.
    let stretch = |f: &(f64, f64, f64)| (f.1 > 0.2 * longest).then(|| ln(f.2.max(1e-12) / f.1));
    let mut all: Vec<f64> = found.iter().filter_map(stretch).collect();
    let usual = median_in_place(&mut all).unwrap_or(0.0);
    let is_changed = |f: &&(f64, f64, f64)| {
        f.0 > MAX_TURN_DEG || stretch(f).is_some_and(|s| (s - usual).abs() > MAX_STRETCH_LN)
    };
    let num_changed = found.iter().filter(is_changed).count();
    num_changed as f64 <= MAX_CHANGED * found.len() as f64
}
