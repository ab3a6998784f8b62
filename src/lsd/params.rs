//! Parameters, what is wrong with them, and the tolerances derived from them.

use crate::image::ImageError;
use core::f64::consts::PI;
use thiserror::Error;

/// Largest side of the working image: coordinates are packed into 16 bits.
pub(super) const MAX_WORKING_SIDE: usize = 65_534;
/// Times a precision is halved at most: five times in the first and five in the last stage of the improvement.
pub(super) const MAX_HALVINGS: usize = 10;

/// Which published version of LSD is reproduced; they differ in two constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LsdVersion {
    /// Of November 2011, the one of the published article: the number of tests counts 11 precisions and the
    /// gradient bins end at the largest gradient.
    #[default]
    V1_6,
    /// Of December 2010: one precision, bins end at a gradient of 255. Detects a few more segments. For comparisons.
    V1_5,
}

/// Parameters of the detector. The defaults are the published ones and need no tuning for 8-bit pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LsdParams {
    /// Size of the working image divided by the size of the picture, above 0 and at most 8. 1 means no smoothing.
    pub scale: f64,
    /// The blur before sampling has sigma = `sigma_scale / scale` input pixels (`sigma_scale` when enlarging);
    /// above 0 and at most 64.
    pub sigma_scale: f64,
    /// Bound on the gradient error due to quantised grey levels, 0 to 1e6. Gradients below it divided by the sine of
    /// the angle tolerance are ignored.
    pub quantization_bound: f64,
    /// Angle tolerance in degrees, above 0 and below 180.
    pub angle_tolerance_deg: f64,
    /// A segment is kept when its -log10 of the number of false alarms is greater than this, -1e6 to 1e6.
    pub min_neg_log10_nfa: f64,
    /// Least share of a rectangle's area that its pixels must cover, 0 to 1. 0 turns the refinement off.
    pub min_density: f64,
    /// Number of bins of the ordering by gradient, 1 to 65536.
    pub num_bins: usize,
    /// Published version to reproduce.
    pub version: LsdVersion,
}

impl Default for LsdParams {
    fn default() -> Self {
        Self {
            scale: 0.8,
            sigma_scale: 0.6,
            quantization_bound: 2.0,
            angle_tolerance_deg: 22.5,
            min_neg_log10_nfa: 0.0,
            min_density: 0.7,
            num_bins: 1024,
            version: LsdVersion::V1_6,
        }
    }
}

/// Why the detector refuses its input.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum LsdError {
    /// Something is wrong with the picture.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A parameter is outside its range.
    #[error("LSD parameter {name} is {value}; it must be {range}")]
    Param {
        /// Name of the field of [`LsdParams`].
        name: &'static str,
        /// What was given.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// The working image would be too large.
    #[error(
        "the working image would be {width}x{height} pixels at scale {scale}; at most {MAX_WORKING_SIDE} a side and {max} in all are accepted: use a smaller scale",
        max = crate::image::MAX_PIXELS
    )]
    WorkingImageTooLarge {
        /// In pixels.
        width: usize,
        /// In pixels.
        height: usize,
        /// The parameter that leads to it.
        scale: f64,
    },
}

impl LsdParams {
    /// Checks every parameter against its range.
    ///
    /// # Errors
    /// `Param` for the first one that is outside, NaN included.
    pub fn check(&self) -> Result<(), LsdError> {
        let checks = [
            (
                self.scale > 0.0 && self.scale <= 8.0,
                "scale",
                self.scale,
                "above 0 and at most 8",
            ),
            (
                self.sigma_scale > 0.0 && self.sigma_scale <= 64.0,
                "sigma_scale",
                self.sigma_scale,
                "above 0 and at most 64",
            ),
            (
                (0.0..=1e6).contains(&self.quantization_bound),
                "quantization_bound",
                self.quantization_bound,
                "0 to 1e6",
            ),
            (
                self.angle_tolerance_deg > 0.0 && self.angle_tolerance_deg < 180.0,
                "angle_tolerance_deg",
                self.angle_tolerance_deg,
                "above 0 and below 180",
            ),
            (
                (-1e6..=1e6).contains(&self.min_neg_log10_nfa),
                "min_neg_log10_nfa",
                self.min_neg_log10_nfa,
                "-1e6 to 1e6",
            ),
            (
                (0.0..=1.0).contains(&self.min_density),
                "min_density",
                self.min_density,
                "0 to 1",
            ),
            (
                (1..=65_536).contains(&self.num_bins),
                "num_bins",
                self.num_bins as f64,
                "1 to 65536",
            ),
        ];
        match checks.into_iter().find(|check| !check.0) {
            None => Ok(()),
            Some((_, name, value, range)) => Err(LsdError::Param { name, value, range }),
        }
    }

    /// Size of the working image.
    pub(super) fn working_size(
        &self,
        width: usize,
        height: usize,
    ) -> Result<(usize, usize), LsdError> {
        if self.scale == 1.0 {
            return Ok((width, height));
        }
        let (n, m) = (
            libm::ceil(width as f64 * self.scale) as usize,
            libm::ceil(height as f64 * self.scale) as usize,
        );
        if n > MAX_WORKING_SIDE || m > MAX_WORKING_SIDE || n * m > crate::image::MAX_PIXELS {
            return Err(LsdError::WorkingImageTooLarge {
                width: n,
                height: m,
                scale: self.scale,
            });
        }
        Ok((n, m))
    }
}

/// Half width of the band around a threshold, relative to the squared cosine, inside which the comparison of
/// products gives way to the comparison of angles. Rounding moves the products by less than 1e-13.
const BAND: f64 = 1e-11;
/// Below this cosine (89.9 degrees) the relative band is no longer safe and every comparison uses the angles.
const LEAST_COS: f64 = 1e-3;

/// An angle tolerance prepared for comparing directions without computing angles: with `a` the signed square of the
/// dot product of a unit vector and a vector `s`, the angle between them is within the tolerance when
/// `a > above * |s|^2`, outside when `a < below * |s|^2`, and needs the exact comparison in between.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerance {
    pub(super) rad: f64,
    pub(super) above: f64,
    pub(super) below: f64,
}

impl Tolerance {
    pub(super) fn new(rad: f64) -> Self {
        let cos = libm::cos(rad);
        let (above, below) = if rad < PI && cos > LEAST_COS {
            let sq = cos * cos;
            (sq * (1.0 + BAND), sq * (1.0 - BAND))
        } else {
            (f64::INFINITY, f64::NEG_INFINITY)
        };
        Self { rad, above, below }
    }
}

/// Difference of two angles on the circle, for angles in -pi..2pi, 0 to pi (`[lsd2012]`: one wrap is enough).
pub(super) fn angle_distance(a: f64, b: f64) -> f64 {
    let d = (a - b).abs();
    if d > PI { (d - 2.0 * PI).abs() } else { d }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_out_of_range_is_named() {
        let ok = LsdParams::default();
        assert_eq!(ok.check(), Ok(()));
        let cases: [(&str, LsdParams); 10] = [
            ("scale", LsdParams { scale: 0.0, ..ok }),
            (
                "scale",
                LsdParams {
                    scale: f64::NAN,
                    ..ok
                },
            ),
            (
                "scale",
                LsdParams {
                    scale: f64::INFINITY,
                    ..ok
                },
            ),
            (
                "sigma_scale",
                LsdParams {
                    sigma_scale: -1.0,
                    ..ok
                },
            ),
            (
                "quantization_bound",
                LsdParams {
                    quantization_bound: -0.1,
                    ..ok
                },
            ),
            (
                "angle_tolerance_deg",
                LsdParams {
                    angle_tolerance_deg: 180.0,
                    ..ok
                },
            ),
            (
                "min_neg_log10_nfa",
                LsdParams {
                    min_neg_log10_nfa: f64::NAN,
                    ..ok
                },
            ),
            (
                "min_density",
                LsdParams {
                    min_density: 1.1,
                    ..ok
                },
            ),
            ("num_bins", LsdParams { num_bins: 0, ..ok }),
            (
                "num_bins",
                LsdParams {
                    num_bins: 70_000,
                    ..ok
                },
            ),
        ];
        for (want, params) in cases {
            match params.check() {
                Err(LsdError::Param { name, .. }) => assert_eq!(name, want),
                other => panic!("{want}: {other:?}"),
            }
        }
        let message = cases[0].1.check().unwrap_err().to_string();
        assert_eq!(
            message,
            "LSD parameter scale is 0; it must be above 0 and at most 8"
        );
    }

    #[test]
    fn working_size_rounds_up_and_is_limited() {
        let p = LsdParams::default();
        assert_eq!(p.working_size(640, 480), Ok((512, 384)));
        assert_eq!(p.working_size(641, 1), Ok((513, 1)));
        let p = LsdParams { scale: 8.0, ..p };
        assert!(matches!(
            p.working_size(16_384, 1),
            Err(LsdError::WorkingImageTooLarge { width: 131_072, .. })
        ));
    }

    #[test]
    fn distance_on_the_circle() {
        assert!((angle_distance(3.0, -3.0) - (2.0 * PI - 6.0)).abs() < 1e-15);
        assert!((angle_distance(-1.0, 0.5) - 1.5).abs() < 1e-15);
        assert!((angle_distance(1.5 * PI, -0.5 * PI)).abs() < 1e-15);
    }
}
