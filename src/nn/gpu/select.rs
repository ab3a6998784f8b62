//! Keypoint selection on the device: local maxima, compaction in order, the best by score. It runs behind a network whose
//! arena holds the maps, in room added to that arena.

use super::{lower::Dispatch, pipelines::Params};
use crate::nn::{
    AxisMap, Graph, NnError,
    plan::{ALIGNMENT, Plan},
};

/// How keypoints are chosen from a network's outputs. Same meaning as `features::KeypointParams`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpuSelect {
    /// Output with the keypoint map.
    pub heat: &'static str,
    /// Output with a reliability per cell and where a pixel of the map reads it; the scores are multiplied by it. Without
    /// it the three-pass suppression of SuperPoint is used.
    pub reliability: Option<(&'static str, AxisMap, AxisMap)>,
    /// Half the side of the suppression window, without its centre.
    pub radius: usize,
    /// Values that are not above this are no keypoints.
    pub min_heat: f32,
    /// Width of the border without keypoints.
    pub border: usize,
    /// Most keypoints.
    pub capacity: usize,
    /// Pixels of the picture per pixel of the map, horizontally and vertically.
    pub scale: [f32; 2],
}

/// Places of the selection's results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Selected {
    /// First number of `[capacity, 2]` positions in the arena.
    pub(super) positions: usize,
    /// First number of `[capacity]` scores in the arena.
    pub(super) scores: usize,
    /// Entry of the counts buffer with the number of keypoints.
    pub(super) count: usize,
    /// Numbers that the arena needs in all.
    pub(super) arena_len: usize,
    /// Entries that the counts buffer needs in all.
    pub(super) num_counts: usize,
    /// Bytes that the selection reads and writes, each map once per kernel call.
    pub(super) bytes_moved: u64,
}

impl GpuSelect {
    /// The kernel calls and where their results lie, behind a network of this plan.
    ///
    /// # Errors
    /// [`NnError::UnknownName`], or [`NnError::BadGraph`] for a map without a size.
    pub(super) fn lower(
        &self,
        graph: &Graph,
        plan: &Plan,
    ) -> Result<(Vec<Dispatch>, Selected), NnError> {
        let grid_of = |name: &str| {
            let tensor = graph.output(name)?;
            tensor
                .grid
                .map(|grid| (tensor, grid))
                .ok_or_else(|| NnError::BadGraph {
                    graph: graph.name().to_owned(),
                    problem: format!("output `{name}` is not a picture"),
                })
        };
        let (heat, grid) = grid_of(self.heat)?;
        let at = |tensor: crate::nn::Tensor| plan.offsets[tensor.value.0] + tensor.offset;
        let pixels = grid.pixels();
        let blocks = pixels.div_ceil(256);
        let mut end = plan.arena_len;
        let mut room = |numbers: usize| {
            let start = end;
            end += numbers.next_multiple_of(ALIGNMENT);
            start
        };
        let [scores, block_sums, candidates] = [room(pixels), room(blocks), room(2 * pixels)];
        // Marks and hidden values are done with before the candidates are written.
        let (marks, hidden) = (candidates, candidates + pixels);
        let [positions, chosen] = [room(2 * self.capacity), room(self.capacity)];
        let num_counts = graph.counts().len();
        let (candidates_count, kept_count) = (num_counts, num_counts + 1);

        let (reliability, cells, x, y) = match self.reliability {
            Some((name, x, y)) => {
                let (tensor, cells) = grid_of(name)?;
                (Some(tensor), cells, x, y)
            }
            None => (
                None,
                grid,
                AxisMap {
                    scale: 0.0,
                    offset: 0.0,
                },
                AxisMap {
                    scale: 0.0,
                    offset: 0.0,
                },
            ),
        };
        let peaks = |mode: usize| Dispatch {
            kernel: "peaks",
            constants: String::new(),
            params: Params::default()
                .u("mode", mode)
                .u("width", grid.width)
                .u("height", grid.height)
                .u("radius", self.radius)
                .u("border", self.border)
                .u("heat_offset", at(heat))
                .u("marks_offset", marks)
                .u("hidden_offset", hidden)
                .u("scores_offset", scores)
                .u("weighted", usize::from(reliability.is_some()))
                .u("r_offset", reliability.map_or(0, at))
                .u(
                    "r_stride",
                    reliability.map_or(0, |tensor| tensor.row_stride),
                )
                .u("cells_x", cells.width)
                .u("cells_y", cells.height)
                .f("min_heat", self.min_heat)
                .f("scale_x", x.scale)
                .f("offset_x", x.offset)
                .f("scale_y", y.scale)
                .f("offset_y", y.offset),
            groups: [grid.width.div_ceil(8), grid.height.div_ceil(8), 1],
        };
        let compact = |mode: usize, groups: usize| Dispatch {
            kernel: "peaks_compact",
            constants: String::new(),
            params: Params::default()
                .u("mode", mode)
                .u("pixels", pixels)
                .u("blocks", blocks)
                .u("scores_offset", scores)
                .u("blocks_offset", block_sums)
                .u("candidates_offset", candidates)
                .u("candidates_count", candidates_count),
            groups: [groups, 1, 1],
        };
        let modes: &[usize] = if reliability.is_some() {
            &[4]
        } else {
            &[0, 1, 2, 1, 2, 3]
        };
        let mut dispatches: Vec<Dispatch> = modes.iter().map(|&mode| peaks(mode)).collect();
        dispatches.extend([compact(0, blocks), compact(1, 1), compact(2, blocks)]);
        dispatches.push(Dispatch {
            kernel: "top_k",
            constants: String::new(),
            params: Params::default()
                .u("candidates_offset", candidates)
                .u("candidates_count", candidates_count)
                .u("kept_count", kept_count)
                .u("capacity", self.capacity)
                .u("positions_offset", positions)
                .u("chosen_offset", chosen)
                .u("width", grid.width)
                .f("scale_x", self.scale[0])
                .f("scale_y", self.scale[1]),
            groups: [1, 1, 1],
        });
        // Marking and XFeat's one call touch two maps, the others three; compaction reads the scores twice. What is behind it
        // works on candidates, which are few.
        let of_peaks = modes
            .iter()
            .map(|mode| if matches!(mode, 0 | 4) { 2 } else { 3 });
        let maps = of_peaks.sum::<usize>() + 2;
        let cell_numbers = reliability.map_or(0, |tensor| {
            tensor.rows.at(&graph.capacities()) * tensor.channels
        });
        let numbers = maps * pixels + cell_numbers + 4 * blocks + 3 * self.capacity;
        let selected = Selected {
            bytes_moved: 4 * numbers as u64,
            positions,
            scores: chosen,
            count: kept_count,
            arena_len: end,
            num_counts: num_counts + 2,
        };
        Ok((dispatches, selected))
    }
}
