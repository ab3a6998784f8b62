//! Sine, cosine and the angle of a vector to within 0.501 units in the last place: in practice correctly rounded.
//!
//! Sums of two `f64` ("double-double") carry about 100 bits. Elementary functions of one `f64` alone err by up to one
//! unit, and where a decision hangs on the last bit, two libraries then decide differently. No fused operations.

/// Value as an unevaluated sum; `low` is below half a unit in the last place of `high`.
#[derive(Debug, Clone, Copy)]
struct Pair {
    high: f64,
    low: f64,
}

fn two_sum(a: f64, b: f64) -> Pair {
    let high = a + b;
    let part = high - a;
    Pair {
        high,
        low: (a - (high - part)) + (b - part),
    }
}

/// For |a| >= |b| or a = 0.
fn quick_two_sum(a: f64, b: f64) -> Pair {
    let high = a + b;
    Pair {
        high,
        low: b - (high - a),
    }
}

/// High and low half of the bits.
fn split(a: f64) -> (f64, f64) {
    let t = 134_217_729.0 * a;
    let high = t - (t - a);
    (high, a - high)
}

fn two_product(a: f64, b: f64) -> Pair {
    let high = a * b;
    let ((ah, al), (bh, bl)) = (split(a), split(b));
    Pair {
        high,
        low: ((ah * bh - high) + ah * bl + al * bh) + al * bl,
    }
}

impl Pair {
    fn times(self, other: Self) -> Self {
        let p = two_product(self.high, other.high);
        quick_two_sum(
            p.high,
            p.low + (self.high * other.low + self.low * other.high),
        )
    }

    fn plus(self, other: Self) -> Self {
        let s = two_sum(self.high, other.high);
        quick_two_sum(s.high, s.low + (self.low + other.low))
    }

    fn negated_if(self, negate: bool) -> Self {
        if negate {
            Self {
                high: -self.high,
                low: -self.low,
            }
        } else {
            self
        }
    }
}

/// sin(k pi / 16), k = 0..=8.
const SINES: [Pair; 9] = [
    Pair {
        high: 0.0,
        low: 0.0,
    },
    Pair {
        high: 0.19509032201612828,
        low: -7.991079068461731e-18,
    },
    Pair {
        high: 0.3826834323650898,
        low: -1.0050772696461588e-17,
    },
    Pair {
        high: 0.5555702330196022,
        low: 4.709410940561677e-17,
    },
    Pair {
        high: core::f64::consts::FRAC_1_SQRT_2,
        low: -4.833646656726457e-17,
    },
    Pair {
        high: 0.8314696123025452,
        low: 1.4073856984728024e-18,
    },
    Pair {
        high: 0.9238795325112867,
        low: 1.7645047084336677e-17,
    },
    Pair {
        high: 0.9807852804032304,
        low: 1.8546939997825006e-17,
    },
    Pair {
        high: 1.0,
        low: 0.0,
    },
];
// pi / 16 in three parts.
const STEP: [f64; 3] = [
    0.19634954084936207,
    7.654042494670958e-18,
    -1.8717311310739623e-34,
];

fn table_sine(k: i64) -> Pair {
    let k = k.rem_euclid(32) as usize;
    let half = k % 16;
    SINES[if half <= 8 { half } else { 16 - half }].negated_if(k >= 16)
}

/// Arguments beyond this are reduced by libm.
const LARGEST: f64 = 1e6;

fn sine_cosine(x: f64) -> (Pair, Pair) {
    let steps = x / STEP[0];
    let k = (steps + if steps < 0.0 { -0.5 } else { 0.5 }) as i64;
    let count = k as f64;
    // What is left, |rest| <= pi / 32: the first difference is exact.
    let first = two_product(count, STEP[0]);
    let a = two_sum(x - first.high, -first.low);
    let b = two_sum(a.high, -count * STEP[1]);
    let (r, r_low) = (b.high, a.low + b.low - count * STEP[2]);

    let z = r * r;
    let sine_tail = r
        * z
        * (-1.0 / 6.0
            + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362_880.0 - z / 39_916_800.0))));
    let sine = quick_two_sum(r, r_low + sine_tail);

    let square = two_product(r, r);
    let cosine_tail = z
        * z
        * (1.0 / 24.0
            + z * (-1.0 / 720.0
                + z * (1.0 / 40_320.0 + z * (-1.0 / 3_628_800.0 + z / 479_001_600.0))));
    let c = quick_two_sum(1.0, -0.5 * square.high);
    let d = two_sum(c.high, cosine_tail);
    let cosine = quick_two_sum(d.high, c.low + d.low - 0.5 * square.low - r * r_low);

    let (sine_k, cosine_k) = (table_sine(k), table_sine(k + 8));
    let minus = |p: Pair| p.negated_if(true);
    (
        sine_k.times(cosine).plus(cosine_k.times(sine)),
        cosine_k.times(cosine).plus(minus(sine_k.times(sine))),
    )
}

/// Sine and cosine of an angle in radians.
pub fn sin_cos(x: f64) -> (f64, f64) {
    if !(x.abs() <= LARGEST) {
        return libm::sincos(x);
    }
    let (sine, cosine) = sine_cosine(x);
    (sine.high, cosine.high)
}

/// Angle of the vector (x, y), -pi to pi.
pub fn atan2(y: f64, x: f64) -> f64 {
    let near = libm::atan2(y, x);
    let size = x.abs().max(y.abs());
    // Zeros, infinities and NaN, and what the products below would push out of range: libm is as good there.
    if !(size > 1e-140 && size < 1e140) || y == 0.0 {
        return near;
    }
    // One step of Newton's method with the residual in double-double.
    let (sine, cosine) = sine_cosine(near);
    let across = two_product(y, cosine.high).plus(two_product(-x, sine.high));
    let residual = across.high + (y * cosine.low - x * sine.low);
    near + residual / (x * cosine.high + y * sine.high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[expect(
        clippy::approx_constant,
        reason = "arguments and values to the last bit"
    )]
    fn values_are_correctly_rounded() {
        // Made with mpmath at 300 bits.
        let cases = [
            (0.3, 0.29552020666133955, 0.955336489125606),
            (-2.9, -0.23924932921398243, -0.9709581651495905),
            (1.0, 0.8414709848078965, 0.5403023058681398),
            (3.141592653589793, 1.2246467991473532e-16, -1.0),
            (6.283185307179586, -2.4492935982947064e-16, 1.0),
            (1.5707963267948966, 1.0, 6.123233995736766e-17),
            (0.7853981633974483, 0.7071067811865475, 0.7071067811865476),
            (-0.1, -0.09983341664682815, 0.9950041652780258),
            (5.5, -0.7055403255703919, 0.70866977429126),
            (1e-09, 1e-09, 1.0),
            (2.356194490192345, 0.7071067811865476, -0.7071067811865475),
            (4.0, -0.7568024953079282, -0.6536436208636119),
        ];
        for (x, sine, cosine) in cases {
            assert_eq!(sin_cos(x), (sine, cosine), "{x}");
        }
        let cases = [
            (1.0, 2.0, 0.4636476090008061),
            (-3.0, 0.7, -1.3415643935179014),
            (0.1, -5.0, 3.1215953196166426),
            (-0.001, -7.0, -3.141449796447908),
            (12.5, 12.25, 0.7954988299827702),
            (100000000.0, -3.3, 1.5707963597948966),
            (-0.6180339887, 0.25, -1.1864093666222806),
            (2.0, -1e-12, 1.5707963267953966),
            (5.0, -0.0, 1.5707963267948966),
            (0.0, 1.0, 0.0),
            (0.0, -1.0, 3.141592653589793),
            (-0.0, -1.0, -3.141592653589793),
            (-4.0, 0.0, -1.5707963267948966),
        ];
        for (y, x, angle) in cases {
            assert_eq!(atan2(y, x), angle, "{y} {x}");
        }
    }

    #[test]
    fn agrees_with_libm_to_a_unit_in_the_last_place() {
        for i in -4000..4000 {
            let x = f64::from(i) * 0.0137 + 1e-7;
            let (s, c) = sin_cos(x);
            assert!((s - libm::sin(x)).abs() <= 2.3e-16 * s.abs(), "{x}");
            assert!((c - libm::cos(x)).abs() <= 2.3e-16 * c.abs(), "{x}");
            let angle = atan2(s, c);
            assert!((angle - libm::atan2(s, c)).abs() <= 4.5e-16, "{x}");
        }
        assert!(sin_cos(f64::NAN).0.is_nan());
        assert!(sin_cos(f64::INFINITY).1.is_nan());
        assert!(atan2(f64::NAN, 1.0).is_nan());
        assert_eq!(atan2(1e300, 1e300), core::f64::consts::FRAC_PI_4);
        assert_eq!(sin_cos(1e9), (libm::sin(1e9), libm::cos(1e9)));
    }
}
