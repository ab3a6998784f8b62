//! The words that descriptors are sorted into: a tree of centres, made by k-means level by level `[vocabulary2006]`.

use crate::landmarks::code::{CODE_BITS, similarity};
use crate::math::Rng;
use crate::math::parallel;

/// Children of a node on each level.
pub(super) const BRANCHES: [usize; 2] = [16, 12];
/// Leaves of the tree.
pub(super) const NUM_WORDS: usize = BRANCHES[0] * BRANCHES[1];
/// All nodes but the root, level after level.
pub(super) const NUM_NODES: usize = BRANCHES[0] + NUM_WORDS;
/// Rounds of k-means on a level.
const ROUNDS: usize = 8;

/// A descriptor as it is compared: centred, folded, of unit length.
pub(super) type Query = [f32; CODE_BITS];

/// The tree.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Words {
    /// Unit vectors; the children of node `i` of a level are `i * branches ..` of the next.
    centres: Vec<Query>,
}

/// The nearest of some centres.
fn nearest(query: &Query, centres: &[Query]) -> usize {
    let mut best = (f32::NEG_INFINITY, 0);
    for (i, centre) in centres.iter().enumerate() {
        let alike = similarity(query, centre);
        if alike > best.0 {
            best = (alike, i);
        }
    }
    best.1
}

impl Words {
    /// Of these descriptors.
    pub(super) fn learn(rows: &[Query]) -> Self {
        let mut rng = Rng::from_seed(0x504C_4143);
        let mut centres = Vec::with_capacity(NUM_NODES);
        let mut groups: Vec<Vec<u32>> = vec![(0..).take(rows.len()).collect()];
        for branches in BRANCHES {
            let seeds: Vec<u64> = groups.iter().map(|_| rng.next_u64()).collect();
            let split = parallel::map(groups.len(), |g| {
                k_means(rows, &groups[g], branches, Rng::from_seed(seeds[g]))
            });
            let mut next = Vec::with_capacity(groups.len() * branches);
            for (own, members) in split {
                centres.extend(own);
                next.extend(members);
            }
            groups = next;
        }
        Self { centres }
    }

    /// From stored centres; `None` for another number of them, and where one is no number.
    pub(super) fn from_centres(centres: &[f32]) -> Option<Self> {
        let (rows, rest) = centres.as_chunks::<CODE_BITS>();
        let is_right = rows.len() == NUM_NODES && rest.is_empty();
        (is_right && centres.iter().all(|v| v.is_finite())).then(|| Self {
            centres: rows.to_vec(),
        })
    }

    /// The centres, row after row.
    pub(super) fn to_numbers(&self) -> Vec<f32> {
        self.centres.as_flattened().to_vec()
    }

    /// The word of a descriptor.
    pub(super) fn of(&self, query: &Query) -> usize {
        let (mut node, mut first, mut level_len) = (0, 0, 1);
        for branches in BRANCHES {
            let start = first + node * branches;
            let children = self.centres.get(start..start + branches).unwrap_or(&[]);
            node = node * branches + nearest(query, children);
            level_len *= branches;
            first += level_len;
        }
        node
    }
}

fn unit(row: &Query) -> Query {
    let norm = row.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
    row.map(|v| v / norm)
}

/// Centres of some rows and the rows of each. Where there are fewer rows than centres, the last centres are copies.
fn k_means(
    rows: &[Query],
    members: &[u32],
    count: usize,
    mut rng: Rng,
) -> (Vec<Query>, Vec<Vec<u32>>) {
    let zero = [0.0; CODE_BITS];
    let row = |m: u32| rows.get(m as usize).unwrap_or(&zero);
    let mut order = members.to_vec();
    // The first centres are distinct rows.
    for i in 0..count.min(order.len()) {
        let other = i + rng.below((order.len() - i) as u32) as usize;
        order.swap(i, other);
    }
    let mut centres: Vec<Query> = (0..count)
        .map(|i| order.get(i % order.len().max(1)).map_or(zero, |m| *row(*m)))
        .collect();
    let mut groups = vec![Vec::new(); count];
    for _ in 0..ROUNDS {
        groups.iter_mut().for_each(Vec::clear);
        for m in members {
            groups[nearest(row(*m), &centres)].push(*m);
        }
        for (centre, group) in centres.iter_mut().zip(&groups) {
            if group.is_empty() {
                continue;
            }
            let mut sum = zero;
            for m in group {
                sum.iter_mut().zip(row(*m)).for_each(|(s, v)| *s += v);
            }
            *centre = unit(&sum);
        }
    }
    (centres, groups)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: usize) -> Vec<Query> {
        let mut rng = Rng::from_seed(3);
        (0..count)
            .map(|_| unit(&core::array::from_fn(|_| rng.normal() as f32)))
            .collect()
    }

    #[test]
    fn a_row_and_its_neighbourhood_are_one_word() {
        let rows = rows(500);
        let words = Words::learn(&rows);
        let mut rng = Rng::from_seed(4);
        let mut same = 0;
        for row in &rows {
            let near = unit(&row.map(|v| v + 0.02 * rng.normal() as f32));
            same += usize::from(words.of(row) == words.of(&near));
        }
        assert!(same > 450, "{same} of 500");
        let used: std::collections::BTreeSet<usize> =
            rows.iter().map(|row| words.of(row)).collect();
        assert!(used.len() > 150, "{} words for 500 rows", used.len());
        assert!(used.iter().all(|word| *word < NUM_WORDS));
    }

    #[test]
    fn stored_centres_give_the_same_words_and_others_are_refused() {
        let rows = rows(300);
        let words = Words::learn(&rows);
        let numbers = words.to_numbers();
        let again = Words::from_centres(&numbers).expect("all of them");
        assert!(rows.iter().all(|row| words.of(row) == again.of(row)));
        for wrong in [f32::INFINITY, f32::NAN] {
            let mut numbers = numbers.clone();
            numbers[0] = wrong;
            assert_eq!(Words::from_centres(&numbers), None);
        }
        assert_eq!(Words::from_centres(&numbers[1..]), None);
        assert_eq!(Words::from_centres(&numbers[CODE_BITS..]), None);
    }

    #[test]
    fn hardly_any_rows_make_a_tree_too() {
        for count in [0, 1, 5] {
            let rows = rows(count);
            let words = Words::learn(&rows);
            assert_eq!(words.centres.len(), NUM_NODES);
            assert!(rows.iter().all(|row| words.of(row) < NUM_WORDS));
        }
    }
}
