//! Real roots of polynomials: what the minimal pose solvers need, nothing more.
//!
//! Coefficients are stored constant term first.
//! The solver of degree up to ten isolates roots by the sign changes of Bernstein coefficients on the four charts x, -x, 1/x, -1/x in
//! (0, 1], so that no root is missed by sampling and no large power is formed.
//! Cost: no allocation, well below a microsecond for most polynomials.

use super::elementary::cbrt;

/// Roots of a x^2 + b x + c as ratios (numerator, denominator), which stay finite when a is 0.
/// A slightly negative discriminant (relative to b^2, from rounding at a double root) counts as zero.
pub fn quadratic_ratios(a: f64, b: f64, c: f64) -> Option<[(f64, f64); 2]> {
    let mut d = b * b - 4.0 * a * c;
    if d < 0.0 {
        if d < -1e-9 * b * b {
            return None;
        }
        d = 0.0;
    }
    let q = -0.5 * (b + d.sqrt().copysign(b));
    Some([(q, a), (c, q)])
}

/// One real root of the monic cubic x^3 + c2 x^2 + c1 x + c0.
///
/// Shifted to its inflection point the cubic is t^3 - 3 h t = |f|; Newton from a proven upper bound on the convex side
/// is monotone, so there is no trigonometry and no case that fails to converge.
pub fn cubic_root(c2: f64, c1: f64, c0: f64) -> f64 {
    let inflection = -c2 / 3.0;
    let f0 = ((inflection + c2) * inflection + c1) * inflection + c0;
    let h2 = (c2 * c2 - 3.0 * c1) / 9.0;
    let sign = if f0 <= 0.0 { 1.0 } else { -1.0 };
    let a = f0.abs();
    let mut t = if a == 0.0 {
        if h2 > 0.0 { (3.0 * h2).sqrt() } else { 0.0 }
    } else if h2 >= 0.0 {
        (3.0 * h2).sqrt() + cbrt(a)
    } else {
        cbrt(a).min(a / (-3.0 * h2))
    };
    if a != 0.0 {
        for _ in 0..30 {
            let slope = 3.0 * (t * t - h2);
            if slope <= 0.0 {
                break;
            }
            let next = t - (t * (t * t - 3.0 * h2) - a) / slope;
            if !(next < t) {
                break;
            }
            t = next;
        }
    }
    let mut x = inflection + sign * t;
    for _ in 0..2 {
        let slope = (3.0 * x + 2.0 * c2) * x + c1;
        if slope == 0.0 {
            break;
        }
        x -= (((x + c2) * x + c1) * x + c0) / slope;
    }
    x
}

/// Value of a polynomial.
pub fn eval(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, &c| sum * x + c)
}

/// Value and first derivative.
pub fn eval_with_slope(coefficients: &[f64], x: f64) -> (f64, f64) {
    let (mut value, mut slope) = (0.0, 0.0);
    for &c in coefficients.iter().rev() {
        slope = slope * x + value;
        value = value * x + c;
    }
    (value, slope)
}

/// Largest degree that [`real_root_ratios`] takes.
pub const MAX_DEGREE: usize = 10;

/// Up to ten real roots as ratios (numerator, denominator) with both parts in [-1, 1].
#[derive(Debug, Clone, Copy, Default)]
pub struct Roots {
    ratios: [(f64, f64); 2 * MAX_DEGREE],
    len: usize,
}

impl Roots {
    /// The roots.
    pub fn as_slice(&self) -> &[(f64, f64)] {
        &self.ratios[..self.len]
    }

    fn push(&mut self, ratio: (f64, f64)) {
        if self.len < self.ratios.len() {
            self.ratios[self.len] = ratio;
            self.len += 1;
        }
    }
}

/// Bernstein coefficients of a polynomial of degree N - 1 over an interval.
type Bernstein<const N: usize> = [f64; N];

/// From powers to the Bernstein basis: C(i, j) / C(N - 1, j).
struct Basis<const N: usize>;

impl<const N: usize> Basis<N> {
    const TABLE: [[f64; N]; N] = bernstein_table();
}

const fn bernstein_table<const N: usize>() -> [[f64; N]; N] {
    assert!(N >= 2 && N <= MAX_DEGREE + 1, "degree out of range");
    let mut binomial = [[0.0; N]; N];
    let mut i = 0;
    while i < N {
        binomial[i][0] = 1.0;
        let mut j = 1;
        while j <= i {
            binomial[i][j] = binomial[i - 1][j - 1] + binomial[i - 1][j];
            j += 1;
        }
        i += 1;
    }
    let top = binomial[N - 1];
    let mut i = 0;
    while i < N {
        let mut j = 0;
        while j <= i {
            binomial[i][j] /= top[j];
            j += 1;
        }
        i += 1;
    }
    binomial
}

/// All real roots of a polynomial of degree N - 1 (at most [`MAX_DEGREE`]), near-double ones included once.
pub fn real_root_ratios<const N: usize>(coefficients: &[f64; N]) -> Roots {
    let mut roots = Roots::default();
    let scale = coefficients.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if !(scale > 0.0) || !scale.is_finite() {
        return roots;
    }
    let p = coefficients.map(|c| c / scale);
    let mirrored = |p: &[f64; N]| -> [f64; N] {
        core::array::from_fn(|i| if i % 2 == 1 { -p[i] } else { p[i] })
    };
    let mut reversed = p;
    reversed.reverse();
    // Zero and one belong to one chart each.
    if p[0] == 0.0 {
        roots.push((0.0, 1.0));
    }
    if reversed[0] == 0.0 {
        roots.push((1.0, 0.0));
    }
    roots_in_unit_interval(&p, true, |x| roots.push((x, 1.0)));
    roots_in_unit_interval(&mirrored(&p), true, |x| roots.push((-x, 1.0)));
    roots_in_unit_interval(&reversed, false, |x| roots.push((1.0, x)));
    roots_in_unit_interval(&mirrored(&reversed), false, |x| roots.push((-1.0, x)));
    roots
}

fn sign_changes<const N: usize>(b: &Bernstein<N>) -> u32 {
    let mut changes = 0;
    let mut last = 0.0;
    for &c in b {
        if c != 0.0 {
            if last * c < 0.0 {
                changes += 1;
            }
            last = if c > 0.0 { 1.0 } else { -1.0 };
        }
    }
    changes
}

/// The two halves of an interval, by de Casteljau's scheme.
fn halves<const N: usize>(b: &Bernstein<N>) -> (Bernstein<N>, Bernstein<N>) {
    let (mut left, mut right) = (*b, *b);
    for (level, end) in left.iter_mut().enumerate().skip(1) {
        for i in 0..(N - level) {
            right[i] = 0.5 * (right[i] + right[i + 1]);
        }
        *end = right[0];
    }
    (left, right)
}

/// Calls `found` for the roots in (0, 1), and for one at 1 when `includes_one`.
///
/// The number of sign changes of the Bernstein coefficients bounds the number of roots in an interval and has its parity, so
/// none means no root and one means exactly one; anything else is halved.
fn roots_in_unit_interval<const N: usize>(
    p: &[f64; N],
    includes_one: bool,
    mut found: impl FnMut(f64),
) {
    /// A pair of roots closer than 2^-26 is a double root.
    const MAX_DEPTH: u32 = 26;
    let whole: Bernstein<N> =
        core::array::from_fn(|i| (0..=i).map(|j| Basis::<N>::TABLE[i][j] * p[j]).sum());
    if includes_one && whole[N - 1] == 0.0 {
        found(1.0);
    }
    // Depth-first: at most one pending sibling for each level.
    let mut stack = [(whole, 0.0, 0u32); MAX_DEPTH as usize + 2];
    let mut len = 1;
    while len > 0 {
        len -= 1;
        let (b, start, depth) = stack[len];
        let width = 1.0 / f64::from(1u32 << depth);
        match sign_changes(&b) {
            0 => {}
            1 if b[0] != 0.0 && b[N - 1] != 0.0 => {
                found(bracketed_root(p, start, start + width, b[0]));
            }
            _ if depth == MAX_DEPTH => found(start + 0.5 * width),
            _ => {
                let (left, right) = halves(&b);
                if right[0] == 0.0 {
                    found(start + 0.5 * width);
                }
                stack[len] = (right, start + 0.5 * width, depth + 1);
                stack[len + 1] = (left, start, depth + 1);
                len += 2;
            }
        }
    }
}

/// Newton kept inside a bracket by bisection.
fn bracketed_root(q: &[f64], mut left: f64, mut right: f64, f_left: f64) -> f64 {
    let rising = f_left < 0.0;
    let mut x = 0.5 * (left + right);
    for _ in 0..60 {
        let (f, slope) = eval_with_slope(q, x);
        if f == 0.0 {
            return x;
        }
        if (f < 0.0) == rising {
            left = x;
        } else {
            right = x;
        }
        let mut next = x - f / slope;
        if !(next > left && next < right) {
            next = 0.5 * (left + right);
        }
        if (next - x).abs() <= 4e-16 * (1.0 + x.abs()) {
            return next;
        }
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn cubic_root_solves_random_and_degenerate_cubics() {
        let mut rng = Rng::from_seed(1);
        for i in 0..20_000 {
            let [a, b, c] = if i % 10 == 0 {
                let (r, s) = (rng.range(-3.0, 3.0), rng.range(-3.0, 3.0)); // double root r
                [-(2.0 * r + s), r * r + 2.0 * r * s, -r * r * s]
            } else {
                [rng.normal() * 3.0, rng.normal() * 3.0, rng.normal() * 3.0]
            };
            let x = cubic_root(a, b, c);
            let size = x.abs().powi(3) + (a * x * x).abs() + (b * x).abs() + c.abs();
            let value = ((x + a) * x + b) * x + c;
            assert!(value.abs() <= 1e-14 * size + 1e-300, "{a} {b} {c}: {value}");
        }
    }

    #[test]
    fn octic_finds_every_planted_root() {
        let mut rng = Rng::from_seed(2);
        for _ in 0..2_000 {
            let roots: [f64; 4] = core::array::from_fn(|_| rng.normal() * 2.0);
            let mut p = [0.0; 9];
            p[0] = 1.0;
            let mut degree = 0;
            let mut multiply = |factor: &[f64]| {
                let mut q = [0.0; 9];
                for i in 0..=degree {
                    for (j, f) in factor.iter().enumerate() {
                        q[i + j] += p[i] * f;
                    }
                }
                degree += factor.len() - 1;
                p = q;
            };
            for r in roots {
                multiply(&[-r, 1.0]);
            }
            for _ in 0..2 {
                let (re, im) = (rng.normal(), 0.5 + rng.uniform());
                multiply(&[re * re + im * im, -2.0 * re, 1.0]);
            }
            let found = real_root_ratios(&p);
            let gap = (0..4)
                .flat_map(|i| (0..i).map(move |j| (i, j)))
                .map(|(i, j)| (roots[i] - roots[j]).abs())
                .fold(1.0, f64::min);
            if gap < 1e-3 {
                continue;
            }
            assert_eq!(found.as_slice().len(), 4, "{roots:?}");
            for r in roots {
                assert!(
                    found
                        .as_slice()
                        .iter()
                        .any(|(a, b)| (a / b - r).abs() < 1e-7 * (1.0 + r.abs())),
                    "{r} missing"
                );
            }
        }
    }

    #[test]
    fn quadratic_keeps_the_root_at_infinity() {
        let roots = quadratic_ratios(0.0, 2.0, -4.0).expect("real");
        assert_eq!(roots[0].1, 0.0);
        assert_eq!(roots[1].0 / roots[1].1, 2.0);
        assert!(quadratic_ratios(1.0, 0.0, 1.0).is_none());
        assert!(real_root_ratios(&[f64::NAN; 9]).as_slice().is_empty());
        assert!(real_root_ratios(&[0.0; 9]).as_slice().is_empty());
    }
}
