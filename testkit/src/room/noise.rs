//! Hashes and value noise for the textures. All of it is a pure function of integers or positions.

/// Mixes three integers into 64 well-spread bits.
pub(super) fn hash(a: i64, b: i64, seed: u64) -> u64 {
    let mut h = seed
        ^ (a as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (b as u64)
            .wrapping_mul(0xC2B2_AE3D_27D4_EB4F)
            .rotate_left(29);
    h ^= h >> 32;
    h = h.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    h ^= h >> 32;
    h = h.wrapping_mul(0xD6E8_FEB8_6659_FD93);
    h ^ (h >> 32)
}

/// Uniform in 0..1 from two cell numbers.
pub(super) fn cell(a: i64, b: i64, seed: u64) -> f64 {
    (hash(a, b, seed) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Value noise in 0..1 with one cell per unit.
pub(super) fn value(x: f64, y: f64, seed: u64) -> f64 {
    let (xi, yi) = (x.floor(), y.floor());
    let (fx, fy) = (smooth(x - xi), smooth(y - yi));
    let (a, b) = (xi as i64, yi as i64);
    let top = mix(cell(a, b, seed), cell(a + 1, b, seed), fx);
    let bottom = mix(cell(a, b + 1, seed), cell(a + 1, b + 1, seed), fx);
    mix(top, bottom, fy)
}

/// Sum of `octaves` value noises of doubling frequency, in 0..1.
pub(super) fn fbm(x: f64, y: f64, octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut gain, mut total, mut scale) = (0.0, 1.0, 0.0, 1.0);
    for octave in 0..octaves {
        sum += gain * value(x * scale, y * scale, seed.wrapping_add(u64::from(octave)));
        total += gain;
        gain *= 0.5;
        scale *= 2.03;
    }
    sum / total
}

/// Linear blend.
pub(super) fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// Zero slope at both ends.
pub(super) fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

/// A counter turned into random numbers: the generator of everything that is placed at random.
#[derive(Debug, Clone)]
pub(super) struct Dice {
    seed: u64,
    count: i64,
}

impl Dice {
    pub(super) fn new(seed: u64) -> Self {
        Self { seed, count: 0 }
    }

    /// Uniform in 0..1.
    pub(super) fn unit(&mut self) -> f64 {
        self.count += 1;
        cell(self.count, 77, self.seed)
    }

    pub(super) fn range(&mut self, low: f64, high: f64) -> f64 {
        mix(low, high, self.unit())
    }

    pub(super) fn index(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    pub(super) fn bits(&mut self) -> u64 {
        self.count += 1;
        hash(self.count, 78, self.seed)
    }
}
