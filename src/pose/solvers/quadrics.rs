//! Common roots of three quadrics in three unknowns.
//!
//! One unknown, x, is hidden in the coefficients. The quadrics give y^2, z^2 and yz as linear forms in (y, z, 1) over
//! polynomials in x; the identities y(yz) = z(y^2), y(z^2) = z(yz), (yz)^2 = (y^2)(z^2), reduced by the same substitutions,
//! are three more linear forms whose determinant has degree eight in x (idea of Kukelova et al., CVPR 2016).

use crate::math::poly::{eval, real_root_ratios};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Coefficients of three quadrics, columns x^2 xy xz y^2 yz z^2 x y z 1.
pub(super) type Quadrics = SMatrix<f64, 3, 10>;

/// Column of a monomial with exponents of the unknowns given by two variable indices (3 stands for the constant 1).
const COLUMN: [[usize; 4]; 4] = [[0, 1, 2, 6], [1, 3, 4, 7], [2, 4, 5, 8], [6, 7, 8, 9]];

/// Polynomial in x, constant term first, degree at most eight.
#[derive(Clone, Copy)]
struct Poly([f64; 9]);

impl Poly {
    const ZERO: Self = Self([0.0; 9]);

    fn new(c: &[f64]) -> Self {
        let mut p = Self::ZERO;
        for (to, from) in p.0.iter_mut().zip(c) {
            *to = *from;
        }
        p
    }

    fn plus(self, other: Self) -> Self {
        Self(core::array::from_fn(|i| self.0[i] + other.0[i]))
    }

    fn minus(self, other: Self) -> Self {
        Self(core::array::from_fn(|i| self.0[i] - other.0[i]))
    }

    fn times(self, other: Self) -> Self {
        let mut out = [0.0; 9];
        for (i, a) in self.0.iter().enumerate() {
            if *a != 0.0 {
                for (j, b) in other.0.iter().take(9 - i).enumerate() {
                    out[i + j] += a * b;
                }
            }
        }
        Self(out)
    }
}

/// Up to eight real solutions, polished on the quadrics; calls `found` for each.
pub(super) fn solve(quadrics: &Quadrics, mut found: impl FnMut(Vector3<f64>)) {
    // Hide the unknown whose elimination block is best conditioned.
    let mut hidden = 0;
    let mut best = 0.0;
    for h in 0..3 {
        let (y, z) = ((h + 1) % 3, (h + 2) % 3);
        let det = block(quadrics, y, z).determinant().abs();
        if det > best {
            (best, hidden) = (det, h);
        }
    }
    let (y, z) = ((hidden + 1) % 3, (hidden + 2) % 3);
    let Some(inverse) = block(quadrics, y, z).try_inverse() else {
        return;
    };
    let column = |a: usize, b: usize| -(inverse * quadrics.column(COLUMN[a][b]));
    let (xx, xy, xz) = (column(hidden, hidden), column(hidden, y), column(hidden, z));
    let (x1, y1, z1, one) = (column(hidden, 3), column(y, 3), column(z, 3), column(3, 3));
    // Row r: a y + b z + c equals y^2, z^2, yz.
    let a: [Poly; 3] = core::array::from_fn(|r| Poly::new(&[y1[r], xy[r]]));
    let b: [Poly; 3] = core::array::from_fn(|r| Poly::new(&[z1[r], xz[r]]));
    let c: [Poly; 3] = core::array::from_fn(|r| Poly::new(&[one[r], x1[r], xx[r]]));
    // Coefficients of (y^2, z^2, yz) and of (y, z, 1), reduced to a linear form in (y, z, 1).
    let reduce = |quadratic: [Poly; 3], linear: [Poly; 3]| -> [Poly; 3] {
        let mut out = linear;
        for r in 0..3 {
            out[0] = out[0].plus(quadratic[r].times(a[r]));
            out[1] = out[1].plus(quadratic[r].times(b[r]));
            out[2] = out[2].plus(quadratic[r].times(c[r]));
        }
        out
    };
    let zero = Poly::ZERO;
    let twice = |p: Poly| p.plus(p);
    let rows = [
        reduce(
            [a[2], zero.minus(b[0]), b[2].minus(a[0])],
            [c[2], zero.minus(c[0]), zero],
        ),
        reduce(
            [a[1], zero.minus(b[2]), b[1].minus(a[2])],
            [c[1], zero.minus(c[2]), zero],
        ),
        reduce(
            [
                a[2].times(a[2]).minus(a[0].times(a[1])),
                b[2].times(b[2]).minus(b[0].times(b[1])),
                twice(a[2].times(b[2])).minus(a[0].times(b[1]).plus(b[0].times(a[1]))),
            ],
            [
                twice(a[2].times(c[2])).minus(a[0].times(c[1]).plus(c[0].times(a[1]))),
                twice(b[2].times(c[2])).minus(b[0].times(c[1]).plus(c[0].times(b[1]))),
                c[2].times(c[2]).minus(c[0].times(c[1])),
            ],
        ),
    ];
    let minor = |i: usize, j: usize| {
        rows[1][i]
            .times(rows[2][j])
            .minus(rows[1][j].times(rows[2][i]))
    };
    let det = rows[0][0]
        .times(minor(1, 2))
        .minus(rows[0][1].times(minor(0, 2)))
        .plus(rows[0][2].times(minor(0, 1)));
    for &(num, den) in real_root_ratios(&det.0).as_slice() {
        let x = num / den;
        if !x.is_finite() {
            continue;
        }
        let m = Matrix3::from_fn(|i, j| eval(&rows[i][j].0, x));
        let row = |i: usize| {
            let r: Vector3<f64> = m.row(i).transpose();
            r / r.amax().max(f64::MIN_POSITIVE)
        };
        let (r0, r1, r2) = (row(0), row(1), row(2));
        let null = [r0.cross(&r1), r0.cross(&r2), r1.cross(&r2)]
            .into_iter()
            .fold(Vector3::zeros(), |best: Vector3<f64>, n| {
                if n.norm_squared() > best.norm_squared() {
                    n
                } else {
                    best
                }
            });
        let mut v = Vector3::zeros();
        v[hidden] = x;
        v[y] = null.x / null.z;
        v[z] = null.y / null.z;
        if v.sum().is_finite() {
            found(polish(quadrics, v));
        }
    }
}

/// Coefficients of y^2, z^2, yz.
fn block(q: &Quadrics, y: usize, z: usize) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        q.column(COLUMN[y][y]),
        q.column(COLUMN[z][z]),
        q.column(COLUMN[y][z]),
    ])
}

/// Newton on the quadrics themselves.
fn polish(q: &Quadrics, mut v: Vector3<f64>) -> Vector3<f64> {
    for _ in 0..4 {
        let mut residual = Vector3::zeros();
        let mut jacobian = Matrix3::zeros();
        for r in 0..3 {
            let k = q.row(r);
            let gradient = Vector3::new(
                2.0 * k[0] * v.x + k[1] * v.y + k[2] * v.z + k[6],
                k[1] * v.x + 2.0 * k[3] * v.y + k[4] * v.z + k[7],
                k[2] * v.x + k[4] * v.y + 2.0 * k[5] * v.z + k[8],
            );
            let linear = k[6] * v.x + k[7] * v.y + k[8] * v.z;
            residual[r] = 0.5 * (gradient.dot(&v) + linear) + k[9];
            jacobian.set_row(r, &gradient.transpose());
        }
        let Some(inverse) = jacobian.try_inverse() else {
            break;
        };
        let step = inverse * residual;
        if !(step.norm_squared() < 0.25 * (1e-12 + v.norm_squared())) {
            break;
        }
        v -= step;
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn finds_the_planted_root_of_random_quadrics() {
        let mut rng = Rng::from_seed(5);
        let mut missed = 0;
        for _ in 0..2_000 {
            let truth = Vector3::from_fn(|_, _| rng.normal());
            let monomials = [
                truth.x * truth.x,
                truth.x * truth.y,
                truth.x * truth.z,
                truth.y * truth.y,
                truth.y * truth.z,
                truth.z * truth.z,
                truth.x,
                truth.y,
                truth.z,
            ];
            let q = Quadrics::from_fn(|_, _| rng.normal());
            let mut q = q;
            for r in 0..3 {
                q[(r, 9)] = -(0..9).map(|i| q[(r, i)] * monomials[i]).sum::<f64>();
            }
            let mut nearest = f64::INFINITY;
            let mut count = 0;
            solve(&q, |v| {
                nearest = nearest.min((v - truth).norm());
                count += 1;
            });
            assert!(count <= 8, "{count} solutions");
            missed += usize::from(nearest > 1e-6);
        }
        assert!(missed <= 2, "{missed} of 2000 missed");
    }
}
