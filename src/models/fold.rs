//! Small dense algebra for folding weights, in f64 so that folding costs no accuracy.

/// Row-major matrix.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matrix {
    pub(super) rows: usize,
    pub(super) cols: usize,
    pub(super) data: Vec<f64>,
}

impl Matrix {
    pub(super) fn from_f32(rows: usize, cols: usize, data: &[f32]) -> Self {
        assert_eq!(rows * cols, data.len(), "shape and data disagree");
        Self {
            rows,
            cols,
            data: data.iter().map(|x| f64::from(*x)).collect(),
        }
    }

    pub(super) fn zeros(rows: usize, cols: usize) -> Self {
        Self {
            rows,
            cols,
            data: vec![0.0; rows * cols],
        }
    }

    pub(super) fn row(&self, r: usize) -> &[f64] {
        &self.data[r * self.cols..(r + 1) * self.cols]
    }

    /// `self * right`
    pub(super) fn mul(&self, right: &Self) -> Self {
        assert_eq!(self.cols, right.rows, "inner sizes differ");
        let mut out = Self::zeros(self.rows, right.cols);
        for r in 0..self.rows {
            let target = &mut out.data[r * right.cols..(r + 1) * right.cols];
            for (a, b_row) in self.row(r).iter().zip(right.data.chunks_exact(right.cols)) {
                for (t, b) in target.iter_mut().zip(b_row) {
                    *t += a * b;
                }
            }
        }
        out
    }

    /// `self * v`
    pub(super) fn mul_vec(&self, v: &[f64]) -> Vec<f64> {
        assert_eq!(self.cols, v.len(), "inner sizes differ");
        (0..self.rows)
            .map(|r| self.row(r).iter().zip(v).map(|(a, b)| a * b).sum())
            .collect()
    }

    /// Columns `from..to`.
    pub(super) fn columns(&self, from: usize, to: usize) -> Self {
        Self {
            rows: self.rows,
            cols: to - from,
            data: (0..self.rows)
                .flat_map(|r| self.row(r)[from..to].iter().copied())
                .collect(),
        }
    }

    /// Rows `from..to`.
    pub(super) fn row_range(&self, from: usize, to: usize) -> Self {
        Self {
            rows: to - from,
            cols: self.cols,
            data: self.data[from * self.cols..to * self.cols].to_vec(),
        }
    }

    pub(super) fn transposed(&self) -> Self {
        let mut out = Self::zeros(self.cols, self.rows);
        for r in 0..self.rows {
            for c in 0..self.cols {
                out.data[c * self.rows + r] = self.data[r * self.cols + c];
            }
        }
        out
    }

    /// `self` above `below`.
    pub(super) fn stacked(mut self, below: &Self) -> Self {
        assert_eq!(self.cols, below.cols, "widths differ");
        self.rows += below.rows;
        self.data.extend_from_slice(&below.data);
        self
    }
}

pub(super) fn to_f64(v: &[f32]) -> Vec<f64> {
    v.iter().map(|x| f64::from(*x)).collect()
}

pub(super) fn to_f32(v: &[f64]) -> Vec<f32> {
    v.iter().map(|x| *x as f32).collect()
}

pub(super) fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| x + y).collect()
}
