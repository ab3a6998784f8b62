//! Where each value lies in one arena: values that are never alive together share room.
//!
//! Liveness over the list of operations, then largest value first into the smallest gap that fits.

use super::graph::Graph;
use crate::math::order::sort_by_key;

/// Values start at multiples of this many numbers (one cache line).
pub const ALIGNMENT: usize = 16;

/// Places in one arena of `f32`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Plan {
    /// First number of each value.
    pub offsets: Vec<usize>,
    /// Numbers in the arena.
    pub arena_len: usize,
}

/// First and last operation (inclusive) during which a value has to be kept. Inputs are alive from before the first
/// operation, outputs until after the last.
fn lifetimes(graph: &Graph) -> Vec<(usize, usize)> {
    let last = graph.last_uses();
    let mut first = vec![0; last.len()];
    for (step, node) in graph.nodes().iter().enumerate() {
        for tensor in &node.outputs {
            first[tensor.value.0] = step;
        }
    }
    first.into_iter().zip(last).collect()
}

impl Plan {
    /// Plans a graph at full capacity.
    pub fn new(graph: &Graph) -> Self {
        let sizes: Vec<usize> = graph
            .value_sizes()
            .iter()
            .map(|size| size.next_multiple_of(ALIGNMENT))
            .collect();
        let lives = lifetimes(graph);
        let mut order: Vec<usize> = (0..sizes.len()).collect();
        sort_by_key(&mut order, |&value| std::cmp::Reverse(sizes[value]));
        let mut offsets = vec![0; sizes.len()];
        let mut placed: Vec<usize> = Vec::new();
        let mut arena_len = 0;
        for &value in &order {
            let mut taken: Vec<(usize, usize)> = placed
                .iter()
                .filter(|&&other| {
                    lives[other].0 <= lives[value].1 && lives[value].0 <= lives[other].1
                })
                .map(|&other| (offsets[other], offsets[other] + sizes[other]))
                .collect();
            taken.sort_unstable();
            let mut best: Option<(usize, usize)> = None;
            let mut end = 0;
            for (start, stop) in taken {
                let gap = start.saturating_sub(end);
                if gap >= sizes[value] && best.is_none_or(|(smallest, _)| gap < smallest) {
                    best = Some((gap, end));
                }
                end = end.max(stop);
            }
            offsets[value] = best.map_or(end, |(_, start)| start);
            arena_len = arena_len.max(offsets[value] + sizes[value]);
            placed.push(value);
        }
        Self { offsets, arena_len }
    }

    /// Bytes of the arena.
    pub fn arena_bytes(&self) -> usize {
        self.arena_len * size_of::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Dense, GraphBuilder, Rows};

    #[test]
    fn a_chain_needs_two_buffers_and_nothing_alive_overlaps() {
        let mut g = GraphBuilder::new("chain");
        let mut x = g.input("x", Rows::Fixed(10), 32, None);
        let skip = x;
        for layer in 0..6 {
            x = g.linear(x, Dense::new(&format!("l{layer}"), 32));
        }
        let y = g.add(x, skip, Activation::None);
        g.output("y", y);
        let graph = g.finish().expect("a valid graph");
        let plan = Plan::new(&graph);
        assert_eq!(plan.arena_len, 3 * 320);
        let lives = lifetimes(&graph);
        for a in 0..lives.len() {
            for b in 0..a {
                let together = lives[a].0 <= lives[b].1 && lives[b].0 <= lives[a].1;
                let apart = plan.offsets[a] + graph.value_sizes()[a] <= plan.offsets[b]
                    || plan.offsets[b] + graph.value_sizes()[b] <= plan.offsets[a];
                assert!(!together || apart, "values {a} and {b} overlap");
            }
        }
    }
}
