//! Runs a scene's network on the features of a picture and turns its output into scene points and segments.
//!
//! * **In and out**: a [`crate::features::FeatureSet`]; [`Predictions`]: scene points and segments, and which keypoint or segment each
//!   belongs to.
//! * **Spaces and units**: network coordinates become world coordinates here, once, in f64 ([`crate::geometry::SceneScale`]).
//! * **Method**: the networks of [`crate::models`]. Confidence is the sigmoid of the pruning logit (`proposed`), of the
//!   reliability logit (anchored), or `1 / (1 + 100 |x|)` (`v1`). What a network drops by its threshold is not returned;
//!   anchored networks drop nothing, because a fixed threshold starves the solver on new viewpoints: take the most confident.
//! * **Invariants**: rows keep the order of the features; every coordinate is finite.
//! * **Cost**: one run of each network; nothing is allocated once buffers have grown.

mod decode;
mod regressor;

pub use decode::{Predictions, decode};
pub use regressor::{RegressError, Regressor, network_parts};
