//! Changes of zoom in a film, and lenses of the phone that were changed.
//!
//! Pictures with another focal length bend a model until it fits nearly as well. So the model is asked: in one more adjustment
//! every stretch of its pictures has a focal length of its own. Where those differ, every focal length that lasts becomes a
//! camera, pictures between two of them are left out, and everything is grown anew. A picture whose own focal length differs
//! very much from its camera's is not even registered ([`super::grow`]); that leaves pieces, which are compared likewise.

use super::adjust::Effort;
use super::grow::{Attempt, Ground, ZOOM_SIGMAS};
use super::start::close_loops;
use super::{CameraGroup, Picture};
use crate::geometry::{CamFromWorld, Similarity, vector_from_rotation};
use crate::math::elementary::{exp, ln};
use nalgebra::Vector3;

/// Fewer pictures do not know their focal length well enough.
const MIN_PICTURES: usize = 8;
/// Pictures of a stretch where the change is looked for.
const FINE_PICTURES: usize = 4;
/// Focal lengths of pieces whose logarithms are nearer are of one zoom: along a corridor a small piece is off by seven per cent
/// and more, and more cameras than there were bend the model.
pub const MIN_APART_LN: f64 = 0.12;
/// Stretches of one model know better, though what bends a model moves them too: without a zoom they were within 1.4 per cent of
/// each other in a kitchen, 4 in a headset's room and 4.5 along a corridor.
const MIN_CHANGE_LN: f64 = 0.05;

/// Pictures, and what is believed of their cameras.
#[derive(Clone)]
pub(super) struct Film<'a> {
    pub(super) pictures: Vec<Picture<'a>>,
    pub(super) groups: Vec<CameraGroup>,
    /// Focal lengths in pixels to try for each group.
    pub(super) hypotheses: Vec<Vec<f64>>,
    /// Pictures while the zoom moved, which no camera of several pictures fits: they get no pose.
    pub(super) is_between: Vec<bool>,
}

/// The film with a camera group for each focal length that lasts, and whether each piece has only one, so that it is not bent;
/// `None` when all is as it was believed. `pieces` go from the largest to the smallest.
pub(super) fn told_apart<'a>(
    ground: &Ground<'a>,
    pieces: &[Attempt],
    before: &Film<'a>,
) -> Option<(Film<'a>, Vec<bool>)> {
    let mut film = before.clone();
    let mut is_straight = vec![true; pieces.len()];
    let mut group_of = vec![None; film.pictures.len()];
    for (g, asked) in before.groups.iter().enumerate() {
        // Group and focal length of every zoom so far; the first is the group itself.
        let mut zooms: Vec<(usize, Stretch)> = Vec::new();
        if !asked.refines {
            zooms.push((g, Stretch::given(asked.camera.focal_px().0)));
        }
        for (piece, is_straight) in pieces.iter().zip(&mut is_straight) {
            let Some((parts, between)) = parts(ground, piece, g) else {
                continue;
            };
            *is_straight &= parts.len() == 1 && between.is_empty();
            for i in between {
                film.is_between[i] = true;
            }
            // Two parts of one piece are never of one zoom.
            let mut known: Vec<usize> = (0..zooms.len()).collect();
            for part in parts {
                let fits = known
                    .iter()
                    .position(|z| zooms[*z].1.is_same(&part, MIN_APART_LN));
                let group = match fits {
                    Some(k) => zooms[known.swap_remove(k)].0,
                    None if zooms.is_empty() => {
                        film.hypotheses[g] = vec![part.focal_px];
                        g
                    }
                    None => {
                        film.hypotheses.push(vec![part.focal_px]);
                        film.groups.push(CameraGroup {
                            camera: asked.camera,
                            ..CameraGroup::unknown(asked.camera.width, asked.camera.height)
                        });
                        film.groups.len() - 1
                    }
                };
                for i in &part.pictures {
                    group_of[*i] = Some(group);
                }
                if fits.is_none() {
                    zooms.push((group, part));
                }
            }
        }
    }
    // Pictures of no piece go with the next one, before or behind, that is of one.
    for (i, picture) in film.pictures.iter_mut().enumerate() {
        let of = |j: &usize| group_of[*j].filter(|_| before.pictures[*j].camera == picture.camera);
        let next = (0..group_of.len())
            .filter(|j| of(j).is_some())
            .min_by_key(|j| j.abs_diff(i));
        picture.camera = next.and_then(|j| of(&j)).unwrap_or(picture.camera);
    }
    let is_new = film.groups.len() > before.groups.len() || film.is_between != before.is_between;
    is_new.then_some((film, is_straight))
}

/// Pictures, most of them one after the other, and the focal length that they have for themselves.
struct Stretch {
    pictures: Vec<usize>,
    focal_px: f64,
    sigma_ln: f64,
}

impl Stretch {
    /// A focal length that is known.
    fn given(focal_px: f64) -> Self {
        Self {
            pictures: Vec::new(),
            focal_px,
            sigma_ln: 0.0,
        }
    }

    /// Whether both may have one focal length.
    fn is_same(&self, other: &Self, most_ln: f64) -> bool {
        let together = (self.sigma_ln * self.sigma_ln + other.sigma_ln * other.sigma_ln).sqrt();
        off_ln(self.focal_px, other.focal_px) <= most_ln.max(ZOOM_SIGMAS * together)
    }

    /// Both as one, each weighted by what it knows.
    fn join(mut self, other: Self) -> Self {
        let [own, its] = [&self, &other].map(|s| 1.0 / (s.sigma_ln * s.sigma_ln));
        let sum = own + its;
        self.focal_px *= exp(its / sum * ln(other.focal_px / self.focal_px));
        self.sigma_ln = 1.0 / sum.sqrt();
        self.pictures.extend(other.pictures);
        self
    }
}

/// A piece's pictures of a camera group by their focal lengths that last, that of most pictures first, and those between; `None`
/// where they are too few or nothing is determined.
fn parts(ground: &Ground<'_>, piece: &Attempt, g: usize) -> Option<(Vec<Stretch>, Vec<usize>)> {
    let coarse = stretches(ground, piece, g, MIN_PICTURES)?;
    let is_one = |a: &Stretch| coarse.iter().all(|b| a.is_same(b, MIN_CHANGE_LN));
    if coarse.iter().all(is_one) {
        let all = coarse.into_iter().reduce(Stretch::join)?;
        return Some((vec![all], Vec::new()));
    }
    let mut left = stretches(ground, piece, g, FINE_PICTURES)?;
    let mut parts: Vec<Stretch> = Vec::new();
    while let Some(middle) = most_agreed(&left) {
        let (own, rest): (Vec<_>, Vec<_>) = left
            .into_iter()
            .partition(|s| off_ln(s.focal_px, middle) <= 0.5 * MIN_CHANGE_LN);
        left = rest;
        let part = own.into_iter().reduce(Stretch::join)?;
        let known = parts.iter().position(|p| p.is_same(&part, MIN_CHANGE_LN));
        let part = match known {
            Some(known) => parts.swap_remove(known).join(part),
            None => part,
        };
        parts.push(part);
    }
    let mut between = Vec::new();
    for stretch in left {
        let off = |p: &&mut Stretch| off_ln(p.focal_px, stretch.focal_px);
        let nearest = parts.iter_mut().min_by(|a, b| off(a).total_cmp(&off(b)));
        match nearest.filter(|p| p.is_same(&stretch, MIN_CHANGE_LN)) {
            Some(part) => part.pictures.extend(stretch.pictures),
            None => between.extend(stretch.pictures),
        }
    }
    Some((parts, between))
}

/// Focal lengths of stretches of a group's pictures, `size` of them each and more, in their order; `None` where they are fewer, or
/// nothing is determined. The piece is adjusted anew with a camera for each, and tracks that came apart are joined as after a loop.
fn stretches(ground: &Ground<'_>, piece: &Attempt, g: usize, size: usize) -> Option<Vec<Stretch>> {
    let mut pictures = ground.pictures.to_vec();
    let mut groups = ground.groups.to_vec();
    let mut free = piece.clone();
    let is_own = |i: &usize| piece.poses[*i].is_some() && pictures[*i].camera == g;
    let own: Vec<usize> = (0..pictures.len()).filter(is_own).collect();
    let (num, first) = (own.len() / size, groups.len());
    if num == 0 {
        return None;
    }
    let camera = piece.cameras[g];
    let stretch = CameraGroup {
        camera,
        ..CameraGroup::unknown(camera.width, camera.height)
    };
    groups.resize(first + num, stretch);
    free.cameras.resize(first + num, camera);
    for (k, i) in own.iter().enumerate() {
        pictures[*i].camera = first + k * num / own.len();
    }
    let ground = ground.with_cameras(&pictures, &groups);
    close_loops(&ground, &mut free);
    ground.adjust(&mut free, &Effort::thorough());
    let sigmas = ground.focal_sigmas(&free);
    let known = (first..first + num).map(|s| {
        let of_stretch = own.iter().filter(|i| pictures[**i].camera == s);
        Some(Stretch {
            pictures: of_stretch.copied().collect(),
            focal_px: free.cameras[s].focal_px().0,
            sigma_ln: sigmas[s]?,
        })
    });
    known.collect()
}

fn off_ln(a_px: f64, b_px: f64) -> f64 {
    ln(a_px / b_px).abs()
}

/// The focal length about which most pictures are, in pixels; `None` when nowhere are enough.
fn most_agreed(stretches: &[Stretch]) -> Option<f64> {
    let num_near = |focal_px: f64| -> usize {
        let near = |s: &&Stretch| off_ln(s.focal_px, focal_px) <= 0.5 * MIN_CHANGE_LN;
        stretches
            .iter()
            .filter(near)
            .map(|s| s.pictures.len())
            .sum()
    };
    let focals = stretches.iter().map(|s| (num_near(s.focal_px), s.focal_px));
    let (num, focal_px) = focals.reduce(|most, next| if next.0 > most.0 { next } else { most })?;
    (num >= MIN_PICTURES).then_some(focal_px)
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
