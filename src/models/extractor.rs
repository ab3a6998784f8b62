//! The frozen feature extractors: which there are, what they take, and the graph that samples their descriptors.

use super::config::{TensorSpec, check_exactly};
use super::error::{ModelError, check_size};
use super::{CELL, ports, superpoint, xfeat};
use crate::nn::{AxisMap, Filter, Graph, GraphBuilder, Weights};

/// A feature extractor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExtractorKind {
    /// XFeat [xfeat2024].
    Xfeat,
    /// SuperPoint with the layers of the first release.
    SuperPointV1,
    /// The open re-training of SuperPoint, with a batch norm after each activation.
    SuperPointOpen,
}

/// Where a position reads the descriptor map, and how.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sampler {
    /// XFeat's own: bicubic.
    Xfeat,
    /// SuperPoint's first release: bilinear, positions compressed towards the origin by up to 3.5 pixels. What imported
    /// checkpoints were trained with.
    Legacy,
    /// Bilinear at the geometrically right place.
    Exact,
}

impl Sampler {
    /// All samplers.
    pub const ALL: [Self; 3] = [Self::Xfeat, Self::Legacy, Self::Exact];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Xfeat => "xfeat",
            Self::Legacy => "legacy",
            Self::Exact => "exact",
        }
    }

    /// The sampler of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}

/// How keypoints are read from an extractor's maps, as its reference does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Selection {
    /// Output with the keypoint map.
    pub heat: &'static str,
    /// What else multiplies the scores, and how neighbours are suppressed.
    pub rule: SelectionRule,
    /// Published half side of the suppression window, without its centre, pixels of the keypoint map.
    pub nms_radius: usize,
    /// Published value of the keypoint map that a keypoint is above.
    pub min_heat: f32,
    /// Published width of the border without keypoints, pixels of the keypoint map.
    pub border: usize,
    /// Published most keypoints.
    pub max_keypoints: usize,
    /// True when the picture is resized to the keypoint map, false when what does not fill a cell is left out.
    pub resizes: bool,
}

/// Which local maxima are keypoints, and with what score.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SelectionRule {
    /// Window maxima, ties stay, scored by heat times this output with a value for each cell, read bilinearly with this
    /// sampler. The reference reads the heat at the nearest pixel with half-pixel centres, which falls outside for the last
    /// column and row, so those never become keypoints.
    Reliable {
        /// Output with the reliability of each cell.
        reliability: &'static str,
        /// Where a pixel of the keypoint map reads it.
        sampler: Sampler,
    },
    /// The released three-pass suppression of SuperPoint, scored by heat.
    ThreePass,
}

impl Selection {
    /// Pixels of the picture for a pixel of the keypoint map of size `inner`, horizontally and vertically.
    pub fn picture_per_map(&self, picture: (usize, usize), inner: (usize, usize)) -> (f64, f64) {
        if !self.resizes {
            return (1.0, 1.0);
        }
        let ratio = |whole: usize, map: usize| whole as f64 / map as f64;
        (ratio(picture.0, inner.0), ratio(picture.1, inner.1))
    }
}

impl ExtractorKind {
    /// How keypoints are read from the maps; for SuperPoint with the settings of the paper's experiments.
    pub fn selection(self) -> Selection {
        match self {
            Self::Xfeat => Selection {
                heat: ports::HEAT,
                rule: SelectionRule::Reliable {
                    reliability: ports::RELIABILITY,
                    sampler: Sampler::Xfeat,
                },
                nms_radius: 2,
                min_heat: 0.05,
                border: 0,
                max_keypoints: 1024,
                resizes: true,
            },
            Self::SuperPointV1 | Self::SuperPointOpen => Selection {
                heat: ports::HEAT,
                rule: SelectionRule::ThreePass,
                nms_radius: 3,
                min_heat: 0.005,
                border: 4,
                max_keypoints: 2048,
                resizes: false,
            },
        }
    }

    /// All extractors.
    pub const ALL: [Self; 3] = [Self::Xfeat, Self::SuperPointV1, Self::SuperPointOpen];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Xfeat => "xfeat",
            Self::SuperPointV1 => "superpoint-v1",
            Self::SuperPointOpen => "superpoint-open",
        }
    }

    /// The extractor of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }

    /// Numbers in a descriptor.
    pub fn descriptor_channels(self) -> usize {
        match self {
            Self::Xfeat => 64,
            Self::SuperPointV1 | Self::SuperPointOpen => 256,
        }
    }

    /// Whether this sampler reads this extractor's map.
    pub fn supports(self, sampler: Sampler) -> bool {
        (self == Self::Xfeat) == (sampler == Sampler::Xfeat)
    }

    /// The sampler for networks trained here.
    pub fn default_sampler(self) -> Sampler {
        match self {
            Self::Xfeat => Sampler::Xfeat,
            Self::SuperPointV1 | Self::SuperPointOpen => Sampler::Exact,
        }
    }

    /// Smallest side of a picture.
    pub fn min_side(self) -> usize {
        match self {
            Self::Xfeat => xfeat::MULTIPLE,
            Self::SuperPointV1 | Self::SuperPointOpen => 2 * CELL,
        }
    }

    /// Names and shapes of the tensors.
    pub fn tensors(self) -> Vec<TensorSpec> {
        match self {
            Self::Xfeat => xfeat::tensors(),
            Self::SuperPointV1 => superpoint::tensors(false),
            Self::SuperPointOpen => superpoint::tensors(true),
        }
    }

    /// Checks that the weights are exactly those of this extractor.
    ///
    /// # Errors
    /// [`ModelError::UnexpectedTensor`], [`ModelError::Nn`] for missing and misshapen ones.
    pub fn check_weights(self, weights: &Weights) -> Result<(), ModelError> {
        check_exactly(&self.tensors(), weights)
    }

    /// Size of the picture that the keypoint map covers, for a picture of this size: XFeat resizes to multiples of 32,
    /// SuperPoint leaves out what does not fill a cell.
    pub fn inner_size(self, width: usize, height: usize) -> (usize, usize) {
        match self {
            Self::Xfeat => (
                width / xfeat::MULTIPLE * xfeat::MULTIPLE,
                height / xfeat::MULTIPLE * xfeat::MULTIPLE,
            ),
            Self::SuperPointV1 | Self::SuperPointOpen => {
                (width / CELL * CELL, height / CELL * CELL)
            }
        }
    }

    fn check_picture(self, width: usize, height: usize) -> Result<(), ModelError> {
        check_size("picture width", width, self.min_side(), 8192)?;
        check_size("picture height", height, self.min_side(), 8192)
    }

    /// From a grey picture to unit descriptors for each cell ([`ports::FEATURES`]), a keypoint map ([`ports::HEAT`]) and, for
    /// XFeat, [`ports::RELIABILITY`]. With `diagnostics` also `raw_features` (before normalisation) and `keypoint_logits`.
    /// The weights are used as they are in the file.
    ///
    /// # Errors
    /// [`ModelError`] for a picture that is too small or too large.
    pub fn graph(
        self,
        width: usize,
        height: usize,
        diagnostics: bool,
    ) -> Result<Graph, ModelError> {
        self.check_picture(width, height)?;
        match self {
            Self::Xfeat => xfeat::graph(width, height, diagnostics),
            Self::SuperPointV1 => superpoint::graph(width, height, false, diagnostics),
            Self::SuperPointOpen => superpoint::graph(width, height, true, diagnostics),
        }
    }

    /// From the cells' descriptors ([`ports::CELLS`]) and positions in corner-based pixels of the picture
    /// ([`ports::POSITIONS`], rows of x and y) to unit descriptors ([`ports::DESCRIPTORS`]).
    ///
    /// # Errors
    /// [`ModelError`] for a picture or capacity out of range, or a sampler that is not of this extractor.
    pub fn sampler_graph(
        self,
        width: usize,
        height: usize,
        sampler: Sampler,
        capacity: usize,
    ) -> Result<Graph, ModelError> {
        self.check_picture(width, height)?;
        check_size("samples", capacity, 1, 1 << 20)?;
        if !self.supports(sampler) {
            return Err(ModelError::Mismatch(format!(
                "sampler `{}` does not read the map of `{}`",
                sampler.name(),
                self.name()
            )));
        }
        let (inner_width, inner_height) = self.inner_size(width, height);
        let filter = match sampler {
            Sampler::Xfeat => Filter::Bicubic,
            Sampler::Legacy | Sampler::Exact => Filter::Bilinear,
        };
        let mut g = GraphBuilder::new("descriptor sampler");
        let samples = g.count(ports::SAMPLES, capacity);
        let cells = g.input_grid(
            ports::CELLS,
            inner_height / CELL,
            inner_width / CELL,
            self.descriptor_channels(),
        );
        let positions = g.input_rows(ports::POSITIONS, samples, 2);
        let read = g.sample(
            cells,
            positions,
            filter,
            sampler.axis(width, inner_width),
            sampler.axis(height, inner_height),
        );
        let unit = g.l2_norm(read, 1e-12);
        g.output(ports::DESCRIPTORS, unit);
        Ok(g.finish()?)
    }
}

impl Sampler {
    /// Cell index of a corner-based pixel coordinate, along an axis of `length` pixels of which the extractor saw `inner`
    /// (after a resize for XFeat).
    pub fn axis(self, length: usize, inner: usize) -> AxisMap {
        let (length, inner) = (length as f64, inner as f64);
        let cells = inner / CELL as f64;
        let (scale, offset) = match self {
            // Index coordinate of the resized picture over its largest one, spread over cells with half-pixel centres.
            Self::Xfeat => {
                let per_pixel = cells / (inner - 1.0);
                (inner / length * per_pixel, -0.5 * per_pixel - 0.5)
            }
            // (x - 4) (cells - 1) / (8 cells - 4.5): as released, see `Sampler::Legacy`.
            Self::Legacy => {
                let scale = (cells - 1.0) / (inner - 4.5);
                (scale, -4.0 * scale)
            }
            Self::Exact => (1.0 / CELL as f64, -0.5),
        };
        AxisMap {
            scale: scale as f32,
            offset: offset as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn superpoint_positions_match_the_table_of_the_reference() {
        // Index coordinate, legacy and exact cell position for a picture 640 wide, computed from the released formula.
        for (k, legacy, exact) in [
            (0.0, -0.43509, -0.43750),
            (100.0, 11.99607, 12.0625),
            (320.0, 39.34461, 39.5625),
            (635.0, 78.50275, 78.9375),
            (639.0, 79.0, 79.4375),
        ] {
            for (sampler, expected) in [(Sampler::Legacy, legacy), (Sampler::Exact, exact)] {
                let map = sampler.axis(640, 640);
                let got = map.scale * (k + 0.5) + map.offset;
                assert!((got - expected).abs() < 2e-5, "{sampler:?} {k}: {got}");
            }
        }
    }

    #[test]
    fn xfeat_positions_survive_the_inner_resize() {
        // The reference reads index coordinate k of the resized picture at k / (W - 1) * w - 0.5.
        let map = Sampler::Xfeat.axis(540, 512);
        for k in [0.0_f64, 17.0, 511.0] {
            let pixel = (k + 0.5) * 540.0 / 512.0;
            let got = f64::from(map.scale) * pixel + f64::from(map.offset);
            let expected = k / 511.0 * 64.0 - 0.5;
            assert!((got - expected).abs() < 1e-4, "{k}: {got} {expected}");
        }
    }

    #[test]
    fn parameter_counts() {
        let count = |kind: ExtractorKind| -> usize {
            kind.tensors()
                .iter()
                .map(|t| t.shape.iter().product::<usize>())
                .sum()
        };
        assert_eq!(count(ExtractorKind::SuperPointV1), 1_300_865);
        for kind in ExtractorKind::ALL {
            let graph = kind.graph(640, 480, false).expect("builds");
            assert_eq!(graph.num_parameters(), count(kind), "{}", kind.name());
            assert!(kind.graph(31, 480, false).is_err() || kind != ExtractorKind::Xfeat);
        }
    }

    #[test]
    fn samplers_belong_to_extractors() {
        let got = ExtractorKind::Xfeat.sampler_graph(640, 480, Sampler::Exact, 10);
        assert!(matches!(got, Err(ModelError::Mismatch(_))));
    }
}
