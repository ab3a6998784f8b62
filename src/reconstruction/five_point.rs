//! Essential matrices from five points, after Nistér (2004).
//!
//! The null space of the five epipolar equations has four dimensions; the ten cubic constraints of an essential matrix are
//! eliminated in the monomial order of the paper, which leaves a polynomial of degree ten in one unknown. Its real roots
//! are isolated without sampling ([`crate::math::poly`]), so no solution is missed.

use super::relative;
use crate::math::poly::{eval, real_root_ratios};
use nalgebra::{Matrix3, Vector3};

/// Monomials of degree two at most: x2, xy, xz, y2, yz, z2, x, y, z, 1.
const NUM_QUADRATIC: usize = 10;
/// Monomials of degree three at most, in the order of the paper:
/// x3 y3 x2y xy2 x2z x2 y2z y2 xyz xy | xz2 xz x | yz2 yz y | z3 z2 z 1.
const NUM_CUBIC: usize = 20;

/// Exponents (x, y, z).
type Exponents = [u8; 3];

const LINEAR: [Exponents; 4] = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]];
const QUADRATIC: [Exponents; NUM_QUADRATIC] = [
    [2, 0, 0],
    [1, 1, 0],
    [1, 0, 1],
    [0, 2, 0],
    [0, 1, 1],
    [0, 0, 2],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
];
const CUBIC: [Exponents; NUM_CUBIC] = [
    [3, 0, 0],
    [0, 3, 0],
    [2, 1, 0],
    [1, 2, 0],
    [2, 0, 1],
    [2, 0, 0],
    [0, 2, 1],
    [0, 2, 0],
    [1, 1, 1],
    [1, 1, 0],
    [1, 0, 2],
    [1, 0, 1],
    [1, 0, 0],
    [0, 1, 2],
    [0, 1, 1],
    [0, 1, 0],
    [0, 0, 3],
    [0, 0, 2],
    [0, 0, 1],
    [0, 0, 0],
];

const fn products<const A: usize, const N: usize>(
    a: &[Exponents; A],
    into: &[Exponents; N],
) -> [[usize; 4]; A] {
    let mut table = [[0; 4]; A];
    let mut i = 0;
    while i < A {
        let mut j = 0;
        while j < 4 {
            let mut k = 0;
            while k < N {
                let same = a[i][0] + LINEAR[j][0] == into[k][0]
                    && a[i][1] + LINEAR[j][1] == into[k][1]
                    && a[i][2] + LINEAR[j][2] == into[k][2];
                if same {
                    table[i][j] = k;
                }
                k += 1;
            }
            j += 1;
        }
        i += 1;
    }
    table
}

const LINEAR_BY_LINEAR: [[usize; 4]; 4] = products(&LINEAR, &QUADRATIC);
const QUADRATIC_BY_LINEAR: [[usize; 4]; NUM_QUADRATIC] = products(&QUADRATIC, &CUBIC);

type Linear = [f64; 4];
type Quadratic = [f64; NUM_QUADRATIC];
type Cubic = [f64; NUM_CUBIC];

fn add_product(a: &Linear, b: &Linear, factor: f64, out: &mut Quadratic) {
    for i in 0..4 {
        for j in 0..4 {
            out[LINEAR_BY_LINEAR[i][j]] += factor * a[i] * b[j];
        }
    }
}

fn add_cubic(a: &Quadratic, b: &Linear, out: &mut Cubic) {
    for i in 0..NUM_QUADRATIC {
        for j in 0..4 {
            out[QUADRATIC_BY_LINEAR[i][j]] += a[i] * b[j];
        }
    }
}

/// A basis of what is orthogonal to all rows, by elimination with complete pivoting; `None` when the rows are dependent.
pub(super) fn null_space<const R: usize, const N: usize>(
    mut rows: [[f64; 9]; R],
) -> Option<[[f64; 9]; N]> {
    const { assert!(R + N == 9, "rows and null space fill nine dimensions") };
    let mut columns: [usize; 9] = core::array::from_fn(|i| i);
    for k in 0..R {
        let (mut r, mut c, mut largest) = (k, k, 0.0);
        for (i, row) in rows.iter().enumerate().skip(k) {
            for (j, v) in row.iter().enumerate().skip(k) {
                if v.abs() > largest {
                    (r, c, largest) = (i, j, v.abs());
                }
            }
        }
        if !(largest > 1e-12) {
            return None;
        }
        rows.swap(k, r);
        columns.swap(k, c);
        for row in &mut rows {
            row.swap(k, c);
        }
        let inverse = 1.0 / rows[k][k];
        for v in &mut rows[k][k..] {
            *v *= inverse;
        }
        let pivot = rows[k];
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            if i != k && factor != 0.0 {
                for j in k..9 {
                    row[j] -= factor * pivot[j];
                }
            }
        }
    }
    let mut basis = [[0.0; 9]; N];
    for n in 0..N {
        let mut v = [0.0; 9];
        for (i, row) in rows.iter().enumerate() {
            v[columns[i]] = -row[R + n];
        }
        v[columns[R + n]] = 1.0;
        // Orthonormal, so that no direction of the null space is favoured.
        for earlier in &basis[..n] {
            let dot: f64 = v.iter().zip(earlier).map(|(a, b)| a * b).sum();
            for (a, b) in v.iter_mut().zip(earlier) {
                *a -= dot * b;
            }
        }
        let norm = v.iter().map(|a| a * a).sum::<f64>().sqrt();
        for (slot, a) in basis[n].iter_mut().zip(v) {
            *slot = a / norm;
        }
    }
    Some(basis)
}

/// Row of the epipolar equation `b' E a = 0` for row-major `E`.
pub(super) fn epipolar_row(a: &Vector3<f64>, b: &Vector3<f64>) -> [f64; 9] {
    [
        b.x * a.x,
        b.x * a.y,
        b.x * a.z,
        b.y * a.x,
        b.y * a.y,
        b.y * a.z,
        b.z * a.x,
        b.z * a.y,
        b.z * a.z,
    ]
}

/// Appends the essential matrices, ten at most, with `b' E a = 0` for all five pairs of bearings.
pub(super) fn five_point(
    a: &[Vector3<f64>; 5],
    b: &[Vector3<f64>; 5],
    out: &mut Vec<Matrix3<f64>>,
) {
    let rows: [[f64; 9]; 5] = core::array::from_fn(|i| epipolar_row(&a[i], &b[i]));
    let Some(basis) = null_space::<5, 4>(rows) else {
        return;
    };
    // Entry (r, c) of E is x X + y Y + z Z + W.
    let e = |r: usize, c: usize| -> Linear { core::array::from_fn(|k| basis[k][3 * r + c]) };
    let Some(reduced) = eliminate(constraints(&e)) else {
        return;
    };
    // k = <x2z> - z <x2>, l = <y2z> - z <y2>, m = <xyz> - z <xy>: three rows that are linear in x and y.
    let mut b_rows = [([0.0; 4], [0.0; 4], [0.0; 5]); 3];
    for (row, slot) in b_rows.iter_mut().enumerate() {
        let (upper, lower) = (&reduced[2 * row], &reduced[2 * row + 1]);
        let three = |at: usize| {
            [
                upper[at + 2],
                upper[at + 1] - lower[at + 2],
                upper[at] - lower[at + 1],
                -lower[at],
            ]
        };
        slot.0 = three(0);
        slot.1 = three(3);
        slot.2 = [
            upper[9],
            upper[8] - lower[9],
            upper[7] - lower[8],
            upper[6] - lower[7],
            -lower[6],
        ];
    }
    let [(x0, y0, c0), (x1, y1, c1), (x2, y2, c2)] = &b_rows;
    let minor = |p: &[f64; 4], q: &[f64; 5], r: &[f64; 4], s: &[f64; 5]| -> [f64; 8] {
        let mut m = [0.0; 8];
        for i in 0..4 {
            for j in 0..5 {
                m[i + j] += p[i] * s[j] - r[i] * q[j];
            }
        }
        m
    };
    // Cofactors of the third row.
    let first = minor(y0, c0, y1, c1);
    let second = minor(x0, c0, x1, c1).map(|v| -v);
    let mut third = [0.0; 7];
    for i in 0..4 {
        for j in 0..4 {
            third[i + j] += x0[i] * y1[j] - x1[i] * y0[j];
        }
    }
    let mut determinant = [0.0; 11];
    for i in 0..8 {
        for j in 0..4 {
            determinant[i + j] += first[i] * x2[j] + second[i] * y2[j];
        }
    }
    for i in 0..7 {
        for j in 0..5 {
            determinant[i + j] += third[i] * c2[j];
        }
    }
    for &(num, den) in real_root_ratios(&determinant).as_slice() {
        if den == 0.0 {
            continue;
        }
        let z = num / den;
        let values: [Vector3<f64>; 3] = core::array::from_fn(|i| {
            let (x, y, c) = &b_rows[i];
            Vector3::new(eval(x, z), eval(y, z), eval(c, z))
        });
        // (x, y, 1) is orthogonal to all three rows; the longest cross product is the safest.
        let [p, q, r] = values.map(|v| v / v.norm().max(f64::MIN_POSITIVE));
        let cross = [p.cross(&q), p.cross(&r), q.cross(&r)];
        let longest = cross.iter().fold(cross[0], |best, c| {
            if c.norm_squared() > best.norm_squared() {
                *c
            } else {
                best
            }
        });
        if longest.z == 0.0 {
            continue;
        }
        let (x, y) = (longest.x / longest.z, longest.y / longest.z);
        let essential = Matrix3::from_fn(|r, c| {
            let l = e(r, c);
            x * l[0] + y * l[1] + z * l[2] + l[3]
        });
        let norm = essential.norm();
        if norm > 0.0 && norm.is_finite() {
            out.push(polished(essential / norm, a, b));
        }
    }
}

/// Ill-conditioned samples and near-double roots lose digits; Newton on the five equations brings them back.
fn polished(e: Matrix3<f64>, a: &[Vector3<f64>; 5], b: &[Vector3<f64>; 5]) -> Matrix3<f64> {
    let gram = e * e.transpose();
    let violation = gram * e * 2.0 - e * gram.trace();
    if violation.norm() < 1e-11 {
        return e;
    }
    let pairs = || a.iter().copied().zip(b.iter().copied());
    let start = relative::poses_from_essential(&e);
    match start
        .first()
        .and_then(|s| relative::refine_pose(s, pairs(), 1.0, 25))
    {
        Some(pose) => {
            let better = pose.essential() / core::f64::consts::SQRT_2;
            let worst = |m: &Matrix3<f64>| {
                pairs()
                    .map(|(a, b)| b.dot(&(m * a)).abs())
                    .fold(0.0, f64::max)
            };
            // The matrix itself fulfils the five equations and not the constraints: compare what both should fulfil.
            if worst(&better) < 1e-10 { better } else { e }
        }
        None => e,
    }
}

/// det E = 0 and 2 E E' E - trace(E E') E = 0.
fn constraints(e: &impl Fn(usize, usize) -> Linear) -> [Cubic; 10] {
    let mut rows = [[0.0; NUM_CUBIC]; 10];
    for c in 0..3 {
        let (d, f) = ((c + 1) % 3, (c + 2) % 3);
        let mut minor = [0.0; NUM_QUADRATIC];
        add_product(&e(1, d), &e(2, f), 1.0, &mut minor);
        add_product(&e(1, f), &e(2, d), -1.0, &mut minor);
        add_cubic(&minor, &e(0, c), &mut rows[0]);
    }
    let mut gram = [[[0.0; NUM_QUADRATIC]; 3]; 3];
    for (i, row) in gram.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            for k in 0..3 {
                add_product(&e(i, k), &e(j, k), 1.0, entry);
            }
        }
    }
    let half_trace: Quadratic =
        core::array::from_fn(|k| 0.5 * (gram[0][0][k] + gram[1][1][k] + gram[2][2][k]));
    for (i, row) in gram.iter_mut().enumerate() {
        for (v, t) in row[i].iter_mut().zip(&half_trace) {
            *v -= t;
        }
    }
    for i in 0..3 {
        for j in 0..3 {
            for (k, of_k) in gram[i].iter().enumerate() {
                add_cubic(of_k, &e(k, j), &mut rows[1 + 3 * i + j]);
            }
        }
    }
    rows
}

/// Gauss and Jordan on the first ten columns; the last ten columns of the rows of x2z, x2, y2z, y2, xyz and xy.
fn eliminate(mut rows: [Cubic; 10]) -> Option<[[f64; 10]; 6]> {
    for k in 0..10 {
        let mut r = k;
        for i in k + 1..10 {
            if rows[i][k].abs() > rows[r][k].abs() {
                r = i;
            }
        }
        if rows[r][k].abs() < 1e-14 {
            return None;
        }
        rows.swap(k, r);
        let inverse = 1.0 / rows[k][k];
        for v in &mut rows[k][k..] {
            *v *= inverse;
        }
        let pivot = rows[k];
        for (i, row) in rows.iter_mut().enumerate() {
            let factor = row[k];
            // The rows of x3, y3, x2y and xy2 are not needed, so they need no elimination upwards.
            if i != k && factor != 0.0 && (i > k || i >= 4) {
                for j in k..NUM_CUBIC {
                    row[j] -= factor * pivot[j];
                }
            }
        }
    }
    Some(core::array::from_fn(|i| {
        core::array::from_fn(|j| rows[4 + i][10 + j])
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_vector;
    use crate::math::Rng;

    #[test]
    fn solves_ten_thousand_of_ten_thousand_random_problems() {
        let mut rng = Rng::from_seed(5);
        let mut num_solutions = 0;
        for problem in 0..10_000 {
            let axis = Vector3::from_fn(|_, _| rng.normal());
            let rotation = rotation_from_vector(&(axis * 0.4));
            let translation = Vector3::from_fn(|_, _| rng.normal()).normalize();
            let mut a = [Vector3::zeros(); 5];
            let mut b = [Vector3::zeros(); 5];
            for i in 0..5 {
                let p = Vector3::new(rng.range(-0.7, 0.7), rng.range(-0.5, 0.5), 1.0)
                    * rng.range(1.0, 8.0);
                a[i] = p.normalize();
                b[i] = (rotation * p + translation).normalize();
            }
            let truth = relative::essential(&rotation, &translation).normalize();
            let mut found = Vec::new();
            five_point(&a, &b, &mut found);
            num_solutions += found.len();
            let error = found
                .iter()
                .map(|e| (e - truth).norm().min((e + truth).norm()))
                .fold(f64::INFINITY, f64::min);
            // Ill-conditioned samples lose digits; 1e-4 of a unit matrix is a tenth of a pixel at f = 1,000.
            assert!(error < 1e-4, "problem {problem}: {error}");
            for e in &found {
                assert!((e.norm() - 1.0).abs() < 1e-12);
            }
        }
        // Nistér's experiments find 4.55 real solutions on average for random problems; these are of that kind.
        let mean = f64::from(num_solutions as u32) / 10_000.0;
        assert!((3.0..6.0).contains(&mean), "{mean} solutions on average");
    }

    #[test]
    fn dependent_points_give_nothing() {
        let a = [Vector3::z(); 5];
        let mut found = Vec::new();
        five_point(&a, &a, &mut found);
        assert!(found.is_empty());
        five_point(&[Vector3::repeat(f64::NAN); 5], &a, &mut found);
        assert!(found.is_empty());
    }
}
