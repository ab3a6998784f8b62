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

/// A correspondence's number in the choice by confidence: of equal ones those that are kept lie all over the list, because what
/// stands together is often one part of the picture.
pub(super) fn scattered(index: u32) -> u32 {
    index.wrapping_mul(0x9e37_79b9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::order::Best;

    #[test]
    fn keeps_the_most_confident_and_scatters_equal_ones() {
        let mut cap = Best::default();
        let confidence = |i: u32| if i < 10 { 0.9 } else { 0.5 };
        let usable = (0..1000).map(|i| (scattered(i), confidence(i)));
        assert_eq!(cap.choose(110, usable.clone()), 890);
        let kept: Vec<u32> = (0..1000)
            .filter(|i| cap.keeps(scattered(*i), confidence(*i)))
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
