//! Which correspondences a time budget has room for.
//!
//! Loading, ranking and refining a problem takes time in proportion to its size before any clock can end it, so a budget bounds
//! the size too: of more correspondences than it has room for, those with the greatest confidence are used.

/// Correspondences of a kind that a millisecond of the budget has room for: the slowest step without a look at the clock
/// (preparing the search, or one refinement) then stays within a fraction of it.
const PER_MS: f64 = 400.0;

/// As many are used however small the budget is: fewer would cost more in accuracy than they save in time.
const AT_LEAST: usize = 2000;

/// How many correspondences of a kind (points, or lines) a budget has room for.
pub(super) fn room(budget_ms: Option<f64>) -> usize {
    budget_ms.map_or(usize::MAX, |ms| ((PER_MS * ms) as usize).max(AT_LEAST))
}

/// Chooses by confidence. Buffers are reused from call to call.
#[derive(Debug, Default)]
pub(super) struct Cap {
    keys: Vec<u64>,
    /// The largest key that is kept; `None` where there is room for all.
    last: Option<u64>,
}

/// Greater confidences first; equal ones scattered, because what stands together in the list is often one part of the picture.
/// No two indices have the same key.
fn key(confidence: f32, index: u32) -> u64 {
    let weight = u64::from(!confidence.to_bits()) << 32;
    weight | u64::from(index.wrapping_mul(0x9e37_79b9))
}

impl Cap {
    /// Makes the choice among the correspondences that can be used, given as index and confidence (0..1); returns how many are
    /// left out. Linear in their number.
    pub(super) fn choose(&mut self, room: usize, usable: impl Iterator<Item = (u32, f32)>) -> u32 {
        self.keys.clear();
        self.last = None;
        self.keys.extend(usable.map(|(i, c)| key(c, i)));
        let Some(left_out) = self.keys.len().checked_sub(room).filter(|n| *n > 0) else {
            return 0;
        };
        let (_, last, _) = self.keys.select_nth_unstable(room - 1);
        self.last = Some(*last);
        left_out as u32
    }

    /// Whether one of them is kept.
    pub(super) fn keeps(&self, index: u32, confidence: f32) -> bool {
        self.last.is_none_or(|last| key(confidence, index) <= last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_most_confident_and_scatters_equal_ones() {
        let mut cap = Cap::default();
        let confidence = |i: u32| if i < 10 { 0.9 } else { 0.5 };
        let usable = (0..1000).map(|i| (i, confidence(i)));
        assert_eq!(cap.choose(110, usable.clone()), 890);
        let kept: Vec<u32> = usable
            .clone()
            .filter(|(i, c)| cap.keeps(*i, *c))
            .map(|(i, _)| i)
            .collect();
        assert_eq!(kept.len(), 110);
        assert!((0..10).all(|i| kept.contains(&i)));
        // The other hundred lie all over the list.
        let in_first_half = kept.iter().filter(|i| (10..505).contains(*i)).count();
        assert!((40..=60).contains(&in_first_half), "{in_first_half}");

        assert_eq!(cap.choose(1000, usable.clone()), 0);
        assert!(usable.clone().all(|(i, c)| cap.keeps(i, c)));
        assert_eq!(cap.choose(room(None), usable), 0);
    }
}
