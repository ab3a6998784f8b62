//! Where the time of a frame went.

/// Milliseconds per stage, read from the caller's clock: the core has none of its own.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTimings {
    /// Grey image and resize.
    pub preprocess_ms: f64,
    /// Extractor network, keypoints and their descriptors.
    pub features_ms: f64,
    /// Line segments.
    pub lines_ms: f64,
    /// The scene's two branches.
    pub regress_ms: f64,
    /// Correspondences and pose.
    pub solve_ms: f64,
    /// The second look, where the scene has landmarks.
    pub look_ms: f64,
    /// From the first stage to the last.
    pub total_ms: f64,
}
