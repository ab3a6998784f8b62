//! Dropping rows by their logit.

use super::View;

pub(super) fn keep(x: View<'_>, logit: View<'_>, min_logit: f32) -> [Vec<f32>; 2] {
    let survivors: Vec<usize> = (0..x.rows)
        .filter(|&row| logit.row(row)[0] > min_logit)
        .collect();
    let kept = survivors
        .iter()
        .flat_map(|&row| x.row(row).iter().copied())
        .collect();
    let index = survivors.iter().map(|&row| row as f32).collect();
    [kept, index]
}
