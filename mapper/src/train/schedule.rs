//! What changes over a training run: learning rates and the clamp of the reprojection loss.

/// One-cycle rate at progress `t` in 0..1: linear warm-up to `peak`, then half a cosine down to `peak * floor`.
pub fn one_cycle(t: f64, peak: f64, warm_up: f64, floor: f64) -> f64 {
    if t < warm_up {
        return peak * (0.04 + 0.96 * t / warm_up);
    }
    let u = ((t - warm_up) / (1.0 - warm_up)).min(1.0);
    peak * (floor + (1.0 - floor) * 0.5 * (1.0 + (core::f64::consts::PI * u).cos()))
}

/// The reference's rate: halved seven times at equal distances; a change takes effect one epoch after its boundary.
pub fn halving(epoch: usize, num_epochs: usize, base: f64) -> f64 {
    let step = num_epochs / 7;
    if step == 0 {
        return base;
    }
    base * 0.5f64.powi((epoch.saturating_sub(1) / step) as i32)
}

/// Clamp of the reprojection loss in pixels at progress `t`: `sqrt(1 - t^2) * max + min` (paper, text after equation 5;
/// the same as ACE's circular schedule).
pub fn clamp_px(t: f64, max: f64, min: f64) -> f64 {
    (1.0 - t * t).max(0.0).sqrt() * max + min
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clamp_follows_the_published_table() {
        for (t, expected) in [
            (0.0, 51.0),
            (0.25, 49.4),
            (0.5, 44.3),
            (0.75, 34.1),
            (0.9, 22.8),
            (0.99, 8.05),
            (1.0, 1.0),
        ] {
            assert!((clamp_px(t, 50.0, 1.0) - expected).abs() < 0.05, "t = {t}");
        }
    }

    #[test]
    fn one_cycle_rises_and_falls() {
        let rate = |t| one_cycle(t, 1.0, 0.05, 1e-3);
        assert!(rate(0.0) < 0.05 && (rate(0.05) - 1.0).abs() < 1e-9);
        assert!(rate(0.3) > rate(0.6) && (rate(1.0) - 1e-3).abs() < 1e-9);
    }

    #[test]
    fn halving_starts_one_epoch_late_and_never_with_few_epochs() {
        let rate = |epoch| halving(epoch, 70, 8.0);
        assert_eq!((rate(0), rate(10), rate(11)), (8.0, 8.0, 4.0));
        assert_eq!(rate(69), 8.0 / 64.0);
        assert_eq!(halving(5, 6, 8.0), 8.0);
    }
}
