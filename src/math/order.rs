//! Sorting and choosing by one compiled copy of the library's sort.
//!
//! The library's sort is compiled anew for every type and every comparison, 3 to 14 kB each: they were a tenth of a page's engine
//! and more of its mapper. Here indices are sorted, by a comparison that is called through a pointer, and the items are moved
//! afterwards. The order is that of the library's stable sort. Where sorting itself takes time the library is called directly.

use core::cmp::Ordering;

/// Sorts as `slice::sort_by` does; allocates four bytes an item. At most 2^32 items.
pub fn sort_by<T>(items: &mut [T], compare: impl FnMut(&T, &T) -> Ordering) {
    sort_by_in(items, &mut Vec::new(), compare);
}

/// Sorts as `slice::sort_by_key` does; allocates four bytes an item.
pub fn sort_by_key<T, K: Ord>(items: &mut [T], mut key: impl FnMut(&T) -> K) {
    sort_by(items, |a, b| key(a).cmp(&key(b)));
}

/// [`sort_by`] in a buffer that the caller keeps, so that nothing allocates once it has grown.
pub fn sort_by_in<T>(
    items: &mut [T],
    order: &mut Vec<u32>,
    mut compare: impl FnMut(&T, &T) -> Ordering,
) {
    order.clear();
    order.extend(0..items.len() as u32);
    sort_indices(order, &mut |a, b| {
        compare(&items[a as usize], &items[b as usize])
    });
    // Along each cycle of the permutation; what is done points at itself.
    for start in 0..order.len() {
        let mut at = start;
        loop {
            let from = core::mem::replace(&mut order[at], at as u32) as usize;
            if from == start {
                break;
            }
            items.swap(at, from);
            at = from;
        }
    }
}

/// Sorts indices by what they stand for; of equal ones the smaller comes first.
#[inline(never)]
pub fn sort_indices(order: &mut [u32], compare: &mut dyn FnMut(u32, u32) -> Ordering) {
    order.sort_unstable_by(|a, b| compare(*a, *b).then(a.cmp(b)));
}

/// The best of a list by score, in time proportional to its length. Each has a number of its own; of equal scores the smaller
/// number is better. NaN is above infinity, as in `f32::total_cmp`. Buffers are reused from call to call.
#[derive(Debug, Default)]
pub struct Best {
    keys: Vec<u64>,
    /// The best key that is left out; `None` where there is room for all.
    bound: Option<u64>,
}

impl Best {
    /// Makes the choice; returns how many are left out.
    pub fn choose(&mut self, most: usize, scores: impl Iterator<Item = (u32, f32)>) -> usize {
        self.keys.clear();
        self.keys.extend(scores.map(|(number, s)| key(number, s)));
        let is_full = self.keys.len() > most;
        self.bound = is_full.then(|| *self.keys.select_nth_unstable(most).1);
        self.keys.len().saturating_sub(most)
    }

    /// Whether one of those that were given is among the best.
    pub fn keeps(&self, number: u32, score: f32) -> bool {
        self.bound.is_none_or(|bound| key(number, score) < bound)
    }
}

/// Smaller for better ones.
fn key(number: u32, score: f32) -> u64 {
    let bits = score.to_bits();
    let falling = if score.is_sign_negative() {
        bits
    } else {
        !(bits | 1 << 31)
    };
    u64::from(falling) << 32 | u64::from(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn sorts_as_the_library_does_and_keeps_equal_ones_in_their_order() {
        let mut rng = Rng::from_seed(3);
        for num in [0, 1, 2, 3, 20, 21, 500] {
            let mut items: Vec<(u32, String)> =
                (0..num).map(|i| (rng.below(9), i.to_string())).collect();
            let mut expected = items.clone();
            expected.sort_by_key(|i| core::cmp::Reverse(i.0));
            let mut by_key = items.clone();
            sort_by(&mut items, |a, b| b.0.cmp(&a.0));
            assert_eq!(items, expected);
            sort_by_key(&mut by_key, |i| core::cmp::Reverse(i.0));
            assert_eq!(by_key, expected);
        }
    }

    #[test]
    fn the_best_are_those_that_a_sort_puts_first() {
        let mut rng = Rng::from_seed(4);
        let special = [f32::NAN, f32::INFINITY, -f32::INFINITY, 0.0, -0.0, -1.5];
        let mut best = Best::default();
        for most in [0, 1, 7, 40, 60, 80] {
            let random = (0..54).map(|_| rng.below(8) as f32 / 4.0 - 1.0);
            let scores: Vec<f32> = random.chain(special).collect();
            let mut sorted: Vec<u32> = (0..60).collect();
            sorted.sort_by(|a, b| scores[*b as usize].total_cmp(&scores[*a as usize]));
            sorted.truncate(most);
            sorted.sort_unstable();
            let given = (0..).zip(scores.iter().copied());
            assert_eq!(best.choose(most, given), 60_usize.saturating_sub(most));
            let kept = (0..60).filter(|i| best.keeps(*i, scores[*i as usize]));
            assert_eq!(kept.collect::<Vec<u32>>(), sorted, "{most} of 60");
        }
    }
}
