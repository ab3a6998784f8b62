//! Dense symmetric positive definite systems of some thousand unknowns: blocked Cholesky without fused operations.
//!
//! Column blocks go left to right; the trailing update is a product of blocks that stay in the cache. The order of all sums is
//! fixed, so every target returns the same bits, on several threads too (rows of the trailing part are independent).

use super::parallel;

/// Columns of one block. 48 rows of 48 numbers are 18 kB, half of a first-level cache.
const BLOCK: usize = 48;

/// Rows that one piece of work of the trailing update has.
const STRIP: usize = 96;

/// Solves `A x = b` in place for the lower half of a row-major `A` with `n` rows, which is overwritten by its factor.
/// False when `A` is not positive definite; `b` is then unchanged.
#[must_use]
pub fn solve_in_place(a: &mut [f64], b: &mut [f64]) -> bool {
    let n = b.len();
    if a.len() != n * n || !factor(a, n) {
        return false;
    }
    for i in 0..n {
        let row = &a[i * n..i * n + i];
        let sum: f64 = row.iter().zip(b.iter()).map(|(l, x)| l * x).sum();
        b[i] = (b[i] - sum) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let x = b[i] / a[i * n + i];
        b[i] = x;
        for (y, l) in b[..i].iter_mut().zip(&a[i * n..i * n + i]) {
            *y -= l * x;
        }
    }
    true
}

/// Overwrites the lower half with L of `A = L L'`.
fn factor(a: &mut [f64], n: usize) -> bool {
    let mut panel = Vec::new();
    let mut start = 0;
    while start < n {
        let end = (start + BLOCK).min(n);
        let width = end - start;
        // The diagonal block, then the rows below it.
        for i in start..n {
            let (above, below) = a.split_at_mut(i * n);
            let row = &mut below[..n];
            for j in start..end.min(i + 1) {
                let other = if j == i {
                    None
                } else {
                    Some(&above[j * n..j * n + end])
                };
                let mut sum = row[j];
                match other {
                    Some(other) => {
                        for k in start..j {
                            sum -= row[k] * other[k];
                        }
                        row[j] = sum / other[j];
                    }
                    None => {
                        for v in &row[start..j] {
                            sum -= v * v;
                        }
                        if !(sum > 0.0 && sum.is_finite()) {
                            return false;
                        }
                        row[j] = sum.sqrt();
                    }
                }
            }
        }
        // Trailing rows less the product of their panels. The panel is copied out once, transposed in groups of four rows,
        // so that the inner loop runs over contiguous numbers.
        let rows = n - end;
        panel.clear();
        panel.reserve(rows.div_ceil(4) * 4 * width);
        for group in (end..n).step_by(4) {
            for k in start..end {
                for i in group..group + 4 {
                    panel.push(if i < n { a[i * n + k] } else { 0.0 });
                }
            }
        }
        parallel::map_chunks(&mut a[end * n..], STRIP * n, |strip, rows_of_strip| {
            for (g, rows) in rows_of_strip.chunks_mut(4 * n).enumerate() {
                update_rows(rows, n, end, &panel, width, strip * (STRIP / 4) + g);
            }
        });
        start = end;
    }
    true
}

/// Up to four rows, number `group` of four after column `end`, less their panels times those of the groups before and their own.
fn update_rows(rows: &mut [f64], n: usize, end: usize, panel: &[f64], width: usize, group: usize) {
    let own = &panel[group * 4 * width..(group + 1) * 4 * width];
    for (g, other) in panel.chunks_exact(4 * width).take(group + 1).enumerate() {
        let mut sums = [[0.0; 4]; 4];
        for (o, p) in own.chunks_exact(4).zip(other.chunks_exact(4)) {
            for (sum, factor) in sums.iter_mut().zip(o) {
                for (s, v) in sum.iter_mut().zip(p) {
                    *s += factor * v;
                }
            }
        }
        let first = end + 4 * g;
        let last = (first + 4).min(n);
        for (row, sum) in rows.chunks_exact_mut(n).zip(&sums) {
            for (c, s) in row[first..last].iter_mut().zip(sum) {
                *c -= s;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn solves_systems_of_all_sizes_about_the_blocks() {
        let mut rng = Rng::from_seed(1);
        for n in [1, 2, 5, 47, 48, 49, 97, 150, 251] {
            let g: Vec<f64> = (0..n * n).map(|_| rng.normal()).collect();
            let mut a = vec![0.0; n * n];
            for i in 0..n {
                for j in 0..=i {
                    let dot: f64 = (0..n).map(|k| g[i * n + k] * g[j * n + k]).sum();
                    a[i * n + j] = dot + if i == j { 0.1 } else { 0.0 };
                }
            }
            let x: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
            let entry = |i: usize, j: usize| a[i.max(j) * n + i.min(j)];
            let mut b: Vec<f64> = (0..n)
                .map(|i| (0..n).map(|j| entry(i, j) * x[j]).sum())
                .collect();
            let mut matrix = a.clone();
            assert!(solve_in_place(&mut matrix, &mut b));
            let error = x
                .iter()
                .zip(&b)
                .map(|(p, q)| (p - q).abs())
                .fold(0.0, f64::max);
            assert!(error < 1e-7, "{n}: {error}");
        }
    }

    #[test]
    fn refuses_what_is_not_positive_definite() {
        let mut b = [1.0, 2.0];
        assert!(!solve_in_place(&mut [1.0, 0.0, 2.0, 1.0], &mut b));
        assert!(!solve_in_place(&mut [f64::NAN, 0.0, 0.0, 1.0], &mut b));
        assert!(!solve_in_place(&mut [1.0], &mut b));
        assert_eq!(b, [1.0, 2.0]);
    }
}
