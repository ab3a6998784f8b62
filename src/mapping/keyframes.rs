//! Which frames of a film a map is made of.
//!
//! * **In and out**: the grey working image and the features of each frame; a [`Verdict`]: kept, or why not, and what would help.
//! * **Spaces and units**: displacements are shares of the picture's longer side, grey values 0 to 255.
//! * **Method**: a frame is too dark by its mean, blurred by its sharpness beside that of the frames before (mean squared
//!   Laplacian; `[autofocus2000]` takes its variance), too similar by the median displacement of the features that it
//!   shares with the last keyframe.
//! * **Invariants**: the same frames give the same choice.
//! * **Cost**: one or two matches of descriptors a frame.

use crate::features::FeatureSet;
use crate::geometry::Camera;
use crate::image::GrayView;
use crate::math::stats::median_in_place;
use crate::reconstruction::{
    FOCAL_PRIOR, MutualMatcher, TwoViewKind, TwoViewParams, planar_from_pixel, two_view,
};
use std::collections::VecDeque;

/// What a keyframe must have.
#[derive(Debug, Clone, PartialEq)]
pub struct KeyframeParams {
    /// Most keyframes of a film.
    pub max_keyframes: usize,
    /// So many usually do for a room.
    pub enough_keyframes: usize,
    /// Least mean grey value.
    pub min_brightness: f64,
    /// Least sharpness as a share of the median of the frames before.
    pub min_sharpness_share: f64,
    /// Least number of keypoints.
    pub min_keypoints: usize,
    /// Least median displacement since the last keyframe, as a share of the longer side.
    pub min_displacement: f64,
    /// Least cosine of matched descriptors.
    pub min_cosine: f32,
    /// With fewer matches two frames show different things.
    pub min_matches: usize,
}

impl Default for KeyframeParams {
    fn default() -> Self {
        Self {
            max_keyframes: 300,
            enough_keyframes: 120,
            min_brightness: 18.0,
            min_sharpness_share: 0.3,
            min_keypoints: 100,
            min_displacement: 0.025,
            min_cosine: 0.82,
            min_matches: 20,
        }
    }
}

/// Why a frame is no keyframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum NotKept {
    /// It shows what the last keyframe shows, from the same place.
    TooSimilar,
    /// Hardly any light.
    TooDark,
    /// Less sharp than the frames before.
    Blurred,
    /// A wall, fog, a lens that is covered.
    TooFewFeatures,
    /// Another size than the first frame.
    SizeChanged,
    /// There are as many keyframes as there may be.
    Full,
}

/// What whoever films should do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Advice {
    /// The camera only turns: that shows no depth.
    MoveSideways,
    /// Frames are blurred, or share too little with each other.
    Slower,
    /// It is dark.
    MoreLight,
    /// There is enough for a map.
    Enough,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Verdict {
    /// `None` when it was kept.
    pub not_kept: Option<NotKept>,
    /// What would help.
    pub advice: Option<Advice>,
}

impl Verdict {
    fn refused(reason: NotKept, advice: Option<Advice>) -> Self {
        Self {
            not_kept: Some(reason),
            advice,
        }
    }
}

/// Light and sharpness of a grey image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Mean grey value.
    pub brightness: f64,
    /// Mean squared Laplacian.
    pub sharpness: f64,
}

impl Exposure {
    /// Of an image of three by three pixels at least.
    pub fn of(image: &GrayView<'_>) -> Self {
        let row = |y: usize| image.row(y);
        let (mut sum, mut squared, mut count) = (0u64, 0u64, 0u64);
        for y in 0..image.height {
            sum += row(y).iter().map(|v| u64::from(*v)).sum::<u64>();
            if y == 0 || y + 1 >= image.height {
                continue;
            }
            let (above, here, below) = (row(y - 1), row(y), row(y + 1));
            for x in 1..image.width.saturating_sub(1) {
                let around = [here[x - 1], here[x + 1], above[x], below[x]];
                let around: i64 = around.iter().map(|v| i64::from(*v)).sum();
                let laplacian = around - 4 * i64::from(here[x]);
                squared += laplacian.unsigned_abs().pow(2);
                count += 1;
            }
        }
        let pixels = (image.width * image.height).max(1);
        Self {
            brightness: sum as f64 / pixels as f64,
            sharpness: squared as f64 / count.max(1) as f64,
        }
    }
}

/// Frames before that sharpness is compared with.
const NUM_RECENT: usize = 15;
/// Keyframes between two that are asked whether the camera only turned.
const TURN_GAP: usize = 3;
/// Keyframes in a row that only turned, after which it is said.
const TURNED_IN_A_ROW: usize = 3;

/// Chooses the keyframes of one film. The keyframes themselves are the caller's.
#[derive(Debug, Clone, Default)]
pub struct KeyframeChoice {
    params: KeyframeParams,
    size: Option<(u32, u32)>,
    recent: VecDeque<f64>,
    matcher: MutualMatcher,
    turned_in_a_row: usize,
    num_asked: usize,
    num_turned: usize,
}

impl KeyframeChoice {
    /// Before the first frame.
    pub fn new(params: KeyframeParams) -> Self {
        Self {
            params,
            ..Self::default()
        }
    }

    /// How it chooses.
    pub fn params(&self) -> &KeyframeParams {
        &self.params
    }

    /// Whether a turn on the spot explains nearly all keyframes so far. Structure from motion does not always see that: with an
    /// unknown focal length a turn can look like a movement.
    pub fn only_turns(&self) -> bool {
        self.num_asked > 0 && 5 * self.num_turned >= 4 * self.num_asked
    }

    /// What can be said of a frame before its features are made: reasons against it, if there are any. A frame that is chosen
    /// already, because it was a keyframe before, is not asked for its sharpness.
    pub fn look(
        &mut self,
        size: (u32, u32),
        exposure: Exposure,
        kept: usize,
        is_chosen: bool,
    ) -> Option<Verdict> {
        if kept >= self.params.max_keyframes {
            return Some(Verdict::refused(NotKept::Full, Some(Advice::Enough)));
        }
        if kept > 0 && self.size.is_some_and(|first| first != size) {
            return Some(Verdict::refused(NotKept::SizeChanged, None));
        }
        self.size = Some(size);
        if exposure.brightness < self.params.min_brightness {
            return Some(Verdict::refused(NotKept::TooDark, Some(Advice::MoreLight)));
        }
        let usual = median_in_place(&mut self.recent.iter().copied().collect::<Vec<f64>>());
        self.recent.push_back(exposure.sharpness);
        if self.recent.len() > NUM_RECENT {
            self.recent.pop_front();
        }
        let is_blurred =
            usual.is_some_and(|usual| exposure.sharpness < self.params.min_sharpness_share * usual);
        (is_blurred && !is_chosen)
            .then_some(Verdict::refused(NotKept::Blurred, Some(Advice::Slower)))
    }

    /// What becomes of a frame that [`Self::look`] had nothing against; `kept` are the keyframes so far. Features are in pixels
    /// of the frame. One that is chosen already may be similar.
    pub fn choose(
        &mut self,
        features: &FeatureSet,
        kept: &[&FeatureSet],
        is_chosen: bool,
    ) -> Verdict {
        if features.keypoints.len() < self.params.min_keypoints {
            return Verdict::refused(NotKept::TooFewFeatures, None);
        }
        let (width, height) = self.size.unwrap_or((1, 1));
        let side = f64::from(width.max(height));
        let mut advice = None;
        if let Some(last) = kept.last() {
            self.matcher.set_first(last);
            let mut moved: Vec<f64> = self
                .matcher
                .matches(features, self.params.min_cosine)
                .map(|(a, b, _)| {
                    let (from, to) = (&last.keypoints[a as usize], &features.keypoints[b as usize]);
                    let (dx, dy) = (to.pixel.x - from.pixel.x, to.pixel.y - from.pixel.y);
                    (dx * dx + dy * dy).sqrt()
                })
                .collect();
            if moved.len() < self.params.min_matches {
                advice = Some(Advice::Slower);
            } else if !is_chosen
                && median_in_place(&mut moved)
                    .is_some_and(|m| m < self.params.min_displacement * side)
            {
                return Verdict::refused(NotKept::TooSimilar, None);
            }
        }
        if let Some(earlier) = kept.len().checked_sub(TURN_GAP).and_then(|i| kept.get(i)) {
            let only_turned = self.only_turned(earlier, features, (width, height));
            self.num_asked += 1;
            self.num_turned += usize::from(only_turned);
            self.turned_in_a_row = if only_turned {
                self.turned_in_a_row + 1
            } else {
                0
            };
        }
        if advice.is_none() && self.turned_in_a_row >= TURNED_IN_A_ROW {
            advice = Some(Advice::MoveSideways);
        }
        if advice.is_none() && kept.len() + 1 >= self.params.enough_keyframes {
            advice = Some(Advice::Enough);
        }
        Verdict {
            not_kept: None,
            advice,
        }
    }

    /// Whether a turn on the spot explains what two frames share.
    fn only_turned(&mut self, a: &FeatureSet, b: &FeatureSet, (width, height): (u32, u32)) -> bool {
        let focal_px = FOCAL_PRIOR * f64::from(width.max(height));
        let camera = Camera::centered(width, height, focal_px);
        self.matcher.set_first(a);
        let matches: Vec<(u32, u32)> = self
            .matcher
            .matches(b, self.params.min_cosine)
            .map(|(k, l, _)| (k, l))
            .collect();
        let places = |of: &FeatureSet| -> Vec<_> {
            let pixels = of.keypoints.iter().map(|k| k.pixel);
            pixels.map(|p| planar_from_pixel(&camera, p)).collect()
        };
        let params = TwoViewParams {
            max_iterations: 100,
            ..TwoViewParams::default()
        };
        two_view(&places(a), &places(b), &matches, focal_px, &params, 0)
            .is_some_and(|pair| pair.kind == TwoViewKind::RotationOnly)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Keypoint;
    use crate::geometry::Pixel;
    use crate::math::{Rng, elementary};

    /// Keypoints with descriptors of their own, all moved.
    fn features(moved_px: f64) -> FeatureSet {
        placed(|x, y| Pixel::new(x + moved_px, y))
    }

    /// The same as a camera sees them that is turned to the side.
    fn turned(yaw_rad: f64) -> FeatureSet {
        let focal_px = FOCAL_PRIOR * 640.0;
        let (sin, cos) = (elementary::sin(yaw_rad), elementary::cos(yaw_rad));
        placed(|x, y| {
            let (u, v) = ((x - 320.0) / focal_px, (y - 240.0) / focal_px);
            let z = cos - sin * u;
            let place = |w: f64| focal_px * w / z;
            Pixel::new(320.0 + place(cos * u + sin), 240.0 + place(v))
        })
    }

    fn placed(place: impl Fn(f64, f64) -> Pixel) -> FeatureSet {
        let mut rng = Rng::from_seed(1);
        let mut set = FeatureSet {
            descriptor_channels: 16,
            ..FeatureSet::default()
        };
        for _ in 0..200 {
            let (x, y) = (rng.range(0.0, 500.0), rng.range(0.0, 400.0));
            set.keypoints.push(Keypoint {
                pixel: place(x, y),
                score: 1.0,
            });
            let row: Vec<f64> = (0..16).map(|_| rng.range(-1.0, 1.0)).collect();
            let norm = row.iter().map(|v| v * v).sum::<f64>().sqrt();
            set.descriptors_nd
                .extend(row.iter().map(|v| (v / norm) as f32));
        }
        set
    }

    fn exposure(brightness: f64, sharpness: f64) -> Exposure {
        Exposure {
            brightness,
            sharpness,
        }
    }

    #[test]
    fn a_checkerboard_is_sharp_and_a_plane_is_not() {
        let levels: Vec<u8> = (0..64 * 64)
            .map(|i| if (i % 64 + i / 64) % 2 == 0 { 0 } else { 200 })
            .collect();
        let board = Exposure::of(&GrayView::tight(&levels, 64, 64));
        assert_eq!(board, exposure(100.0, 640_000.0), "(4 x 200)^2");
        let slope: Vec<u8> = (0..64 * 64).map(|i| (i % 64) as u8).collect();
        assert_eq!(
            Exposure::of(&GrayView::tight(&slope, 64, 64)).sharpness,
            0.0
        );
    }

    #[test]
    fn dark_blurred_and_resized_frames_are_refused_with_their_reason() {
        let mut choice = KeyframeChoice::default();
        let why = |v: Option<Verdict>| v.and_then(|v| v.not_kept);
        let size = (640, 480);
        for _ in 0..5 {
            assert_eq!(choice.look(size, exposure(100.0, 50.0), 0, false), None);
        }
        let dark = choice.look(size, exposure(5.0, 50.0), 0, false);
        assert_eq!(why(dark), Some(NotKept::TooDark));
        assert_eq!(dark.and_then(|v| v.advice), Some(Advice::MoreLight));
        let blurred = choice.look(size, exposure(100.0, 5.0), 1, false);
        assert_eq!(why(blurred), Some(NotKept::Blurred));
        let turned = choice.look((480, 640), exposure(100.0, 50.0), 1, false);
        assert_eq!(why(turned), Some(NotKept::SizeChanged));
        let full = choice.look(size, exposure(100.0, 50.0), 300, false);
        assert_eq!(why(full), Some(NotKept::Full));
    }

    #[test]
    fn what_moved_is_kept_and_what_did_not_is_not() {
        let mut choice = KeyframeChoice::default();
        choice.look((640, 480), exposure(100.0, 50.0), 0, false);
        let first = features(0.0);
        assert_eq!(choice.choose(&first, &[], false).not_kept, None);
        let near = choice.choose(&features(10.0), &[&first], false);
        assert_eq!(near.not_kept, Some(NotKept::TooSimilar));
        assert_eq!(
            choice.choose(&features(40.0), &[&first], false).not_kept,
            None
        );
        let again = choice.choose(&features(10.0), &[&first], true);
        assert_eq!(again.not_kept, None, "a keyframe of before");
        let empty = choice.choose(&FeatureSet::default(), &[&first], false);
        assert_eq!(empty.not_kept, Some(NotKept::TooFewFeatures));
    }

    #[test]
    fn turning_on_the_spot_is_told() {
        let mut choice = KeyframeChoice::default();
        choice.look((640, 480), exposure(100.0, 50.0), 0, false);
        let film: Vec<FeatureSet> = (0..8).map(|i| turned(0.04 * f64::from(i))).collect();
        let mut advice = None;
        for i in 0..film.len() {
            let kept: Vec<&FeatureSet> = film[..i].iter().collect();
            advice = choice.choose(&film[i], &kept, false).advice;
        }
        assert_eq!(advice, Some(Advice::MoveSideways));
        assert!(choice.only_turns());
    }
}
