//! Mutual nearest neighbours of two sets of descriptors, by the matrix kernels.

use super::{
    Level,
    kernels::{
        gemm::{Packed, Rows},
        nearest::{Nearest, nearest, padded, scratch_len},
    },
};

/// Two rows, each the other's most similar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MutualPair {
    /// Row of the keys.
    pub key: u32,
    /// Row of what was compared with them.
    pub row: u32,
    /// Their dot product.
    pub product: f32,
}

/// Compares sets of rows with a set of keys. Keeps its memory from one set to the next.
///
/// Products are those of a network's linear layer on this level: f32, rounded as [`Level`] says.
#[derive(Debug, Clone)]
pub struct MutualNearest {
    keys: Packed,
    best_of_row: Vec<f32>,
    best_of_key: Vec<f32>,
    row_of_key: Vec<u32>,
    is_taken: Vec<bool>,
    scratch: Vec<f32>,
}

impl Default for MutualNearest {
    fn default() -> Self {
        Self::with_level(Level::best())
    }
}

impl MutualNearest {
    /// On one of [`Level::available`].
    pub fn with_level(level: Level) -> Self {
        Self {
            keys: Packed::new(level, 0, 0, None, |_, _| 0.0),
            best_of_row: Vec::new(),
            best_of_key: Vec::new(),
            row_of_key: Vec::new(),
            is_taken: Vec::new(),
            scratch: Vec::new(),
        }
    }

    /// Sets the keys, rows of `channels` numbers. Incomplete rows are left out.
    pub fn set_keys(&mut self, keys_nd: &[f32], channels: usize) {
        let num_keys = keys_nd.len().checked_div(channels).unwrap_or(0);
        self.keys
            .refill(channels, num_keys, |k, n| keys_nd[n * channels + k]);
        self.best_of_key.resize(padded(num_keys), 0.0);
        self.row_of_key.resize(padded(num_keys), 0);
        self.scratch.resize(scratch_len(num_keys), 0.0);
    }

    /// Pairs of key and row, each the other's best, whose product is at least `least`, in the order of the keys; each row at
    /// most once. `rows_nd` has as many numbers a row as the keys.
    pub fn find<'s>(
        &'s mut self,
        rows_nd: &[f32],
        least: f32,
    ) -> impl Iterator<Item = MutualPair> + use<'s> {
        let channels = self.keys.depth();
        let num_keys = self.keys.columns();
        let rows = rows_nd.len().checked_div(channels).unwrap_or(0);
        self.best_of_row.resize(rows, 0.0);
        self.is_taken.clear();
        self.is_taken.resize(rows, false);
        let searched = if rows == 0 { 0 } else { num_keys };
        if searched > 0 {
            nearest(Nearest {
                x: Rows {
                    data: rows_nd,
                    rows,
                    channels,
                    stride: channels,
                },
                keys: &self.keys,
                best_of_row: &mut self.best_of_row,
                best_of_key: &mut self.best_of_key,
                row_of_key: &mut self.row_of_key,
                scratch: &mut self.scratch,
            });
        }
        let (best_of_row, is_taken) = (&self.best_of_row, &mut self.is_taken);
        self.best_of_key[..searched]
            .iter()
            .zip(&self.row_of_key)
            .zip(0..)
            .filter_map(move |((product, row), key)| {
                let at = *row as usize;
                let is_mutual = *product >= least && best_of_row[at] == *product;
                // Equal descriptors have equal products with a row: the first of them gets it.
                (is_mutual && !std::mem::replace(&mut is_taken[at], true)).then_some(MutualPair {
                    key,
                    row: *row,
                    product: *product,
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    /// The same by its definition, in f64.
    fn reference(keys: &[f32], rows: &[f32], d: usize, least: f64) -> Vec<(u32, u32)> {
        let dot = |a: &[f32], b: &[f32]| -> f64 {
            a.iter()
                .zip(b)
                .map(|(x, y)| f64::from(*x) * f64::from(*y))
                .sum()
        };
        let best = |of: &[f32], among: &[f32]| -> usize {
            let products: Vec<f64> = among.chunks_exact(d).map(|x| dot(of, x)).collect();
            (0..products.len()).fold(0, |b, i| if products[i] > products[b] { i } else { b })
        };
        keys.chunks_exact(d)
            .enumerate()
            .filter_map(|(k, key)| {
                let r = best(key, rows);
                let row = &rows[r * d..][..d];
                (best(row, keys) == k && dot(key, row) >= least).then_some((k as u32, r as u32))
            })
            .collect()
    }

    #[test]
    fn pairs_are_each_others_best_on_every_level() {
        let mut rng = Rng::from_seed(4);
        for (num_keys, num_rows, d) in [(1, 1, 1), (37, 50, 5), (130, 61, 64), (16, 200, 64)] {
            let mut unit = |n: usize| -> Vec<f32> {
                (0..n)
                    .flat_map(|_| {
                        let v: Vec<f64> = (0..d).map(|_| rng.normal()).collect();
                        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
                        v.into_iter().map(move |x| (x / norm) as f32)
                    })
                    .collect()
            };
            let (keys, rows) = (unit(num_keys), unit(num_rows));
            let expected = reference(&keys, &rows, d, 0.2);
            for level in Level::available() {
                let mut search = MutualNearest::with_level(level);
                // What an earlier, larger set left behind has no say.
                search.set_keys(&unit_like(300, d), d);
                assert!(search.find(&rows, -2.0).count() > 0);
                search.set_keys(&keys, d);
                let found: Vec<(u32, u32)> =
                    search.find(&rows, 0.2).map(|p| (p.key, p.row)).collect();
                assert_eq!(found, expected, "{num_keys} x {num_rows}, {}", level.name());
                assert_eq!(search.find(&[], 0.2).count(), 0);
            }
        }
    }

    fn unit_like(n: usize, d: usize) -> Vec<f32> {
        vec![1.0 / (d as f32).sqrt(); n * d]
    }

    #[test]
    fn equal_descriptors_do_not_share_a_partner() {
        let mut search = MutualNearest::default();
        search.set_keys(&[1.0, 0.0, 1.0, 0.0, 0.0, 1.0], 2);
        let found: Vec<_> = search
            .find(&[0.0, 1.0, 1.0, 0.0, 1.0, 0.0], 0.5)
            .map(|p| (p.key, p.row))
            .collect();
        assert_eq!(found, [(0, 1), (2, 0)]);
        search.set_keys(&[], 0);
        assert_eq!(search.find(&[1.0], 0.5).count(), 0);
        search.set_keys(&[f32::NAN, 1.0], 1);
        assert_eq!(search.find(&[1.0], 0.5).count(), 1);
    }
}
