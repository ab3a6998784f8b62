//! Robust statistics on slices that may be reordered; nothing allocates.

/// The `fraction` quantile (0 = smallest, 1 = largest) by selection; reorders the slice. `None` when it is empty.
/// NaN sorts last.
pub fn quantile_in_place(values: &mut [f64], fraction: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let last = values.len() - 1;
    let k = (fraction.clamp(0.0, 1.0) * last as f64 + 0.5) as usize;
    let (_, value, _) = values.select_nth_unstable_by(k.min(last), f64::total_cmp);
    Some(*value)
}

/// Upper median by selection; reorders the slice. `None` when it is empty.
pub fn median_in_place(values: &mut [f64]) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let k = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(k, f64::total_cmp);
    Some(*value)
}

/// Value at which half of the weight lies below; sorts the slice of (value, weight). `None` when it is empty.
pub fn weighted_median_in_place(pairs: &mut [(f64, f64)]) -> Option<f64> {
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * pairs.iter().map(|p| p.1).sum::<f64>();
    let mut seen = 0.0;
    for &(value, weight) in pairs.iter() {
        seen += weight;
        if seen >= half {
            return Some(value);
        }
    }
    pairs.last().map(|p| p.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median_in_place(&mut []), None);
        assert_eq!(median_in_place(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(quantile_in_place(&mut [3.0, 1.0, 2.0], 1.0), Some(3.0));
        assert_eq!(quantile_in_place(&mut [3.0, 1.0, 2.0], 0.0), Some(1.0));
        let mut pairs = [(10.0, 0.1), (1.0, 0.2), (2.0, 0.9)];
        assert_eq!(weighted_median_in_place(&mut pairs), Some(2.0));
    }
}
