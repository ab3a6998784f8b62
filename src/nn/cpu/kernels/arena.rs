//! One block of numbers, lent out in parts.

use std::ops::Range;

/// The activations of a graph.
#[derive(Debug, Clone)]
pub(in crate::nn::cpu) struct Arena {
    numbers: Vec<f32>,
}

impl Arena {
    /// Room for `len` numbers.
    pub(in crate::nn::cpu) fn new(len: usize) -> Self {
        Self {
            numbers: vec![0.0; len],
        }
    }

    /// A part to read.
    pub(in crate::nn::cpu) fn part(&self, range: Range<usize>) -> &[f32] {
        &self.numbers[range]
    }

    /// A part to write.
    pub(in crate::nn::cpu) fn part_mut(&mut self, range: Range<usize>) -> &mut [f32] {
        &mut self.numbers[range]
    }

    /// Parts to read beside parts to write. Empty parts are fine.
    ///
    /// # Panics
    /// If a part to write overlaps another part or leaves the arena: a mistake of the plan.
    pub(in crate::nn::cpu) fn split<const R: usize, const W: usize>(
        &mut self,
        reads: [Range<usize>; R],
        writes: [Range<usize>; W],
    ) -> ([&[f32]; R], [&mut [f32]; W]) {
        let overlap = |a: &Range<usize>, b: &Range<usize>| a.start < b.end && b.start < a.end;
        for (index, write) in writes.iter().enumerate() {
            assert!(
                write.start <= write.end && write.end <= self.numbers.len(),
                "part {write:?} of the arena"
            );
            for other in reads.iter().chain(&writes[..index]) {
                assert!(
                    !overlap(write, other),
                    "parts {write:?} and {other:?} of the arena overlap"
                );
            }
        }
        for read in &reads {
            assert!(
                read.start <= read.end && read.end <= self.numbers.len(),
                "part {read:?} of the arena"
            );
        }
        let base = self.numbers.as_mut_ptr();
        // SAFETY: all parts lie in the arena, and those to write overlap no other part; checked above.
        unsafe {
            (
                reads.map(|part| std::slice::from_raw_parts(base.add(part.start), part.len())),
                writes.map(|part| std::slice::from_raw_parts_mut(base.add(part.start), part.len())),
            )
        }
    }
}
