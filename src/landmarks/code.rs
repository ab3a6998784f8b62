//! Descriptors in 64 bits: the signs of the centred descriptor.
//!
//! The landmark keeps signs, the keypoint its numbers: the product of both (asymmetric distance, as in Gordo et al., *Asymmetric
//! distances for binary embeddings*, CVPR 2011) loses less than a comparison of signs with signs.
//! A descriptor of more than 64 numbers is folded: numbers 64 apart are added with fixed signs.

use super::LandmarkError;

/// Bits of a code.
pub const CODE_BITS: usize = 64;

/// What codes are counted from.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SignCode {
    /// Mean of the landmarks' descriptors; as many numbers as a descriptor has.
    pub mean: Vec<f32>,
}

impl SignCode {
    /// From the descriptors that will be stored, rows of `channels` numbers.
    pub fn of<'a>(channels: usize, descriptors: impl Iterator<Item = &'a [f32]>) -> Self {
        let mut sum = vec![0.0_f64; channels];
        let mut num = 0_u32;
        for descriptor in descriptors {
            num += 1;
            for (s, d) in sum.iter_mut().zip(descriptor) {
                *s += f64::from(*d);
            }
        }
        let factor = 1.0 / f64::from(num.max(1));
        Self {
            mean: sum.iter().map(|s| (s * factor) as f32).collect(),
        }
    }

    /// Checks the numbers of a file.
    ///
    /// # Errors
    /// [`LandmarkError::NotFinite`], [`LandmarkError::Channels`].
    pub fn check(&self, what: &'static str, channels: usize) -> Result<(), LandmarkError> {
        if self.mean.len() != channels {
            return Err(LandmarkError::Channels {
                what,
                found: self.mean.len(),
                expected: channels,
            });
        }
        match self.mean.iter().position(|m| !m.is_finite()) {
            None => Ok(()),
            Some(index) => Err(LandmarkError::NotFinite { what, index }),
        }
    }

    /// The centred descriptor of unit length, folded to [`CODE_BITS`] numbers: what is compared with codes.
    pub fn query(&self, descriptor: &[f32], out: &mut [f32; CODE_BITS]) {
        out.fill(0.0);
        for (i, (d, m)) in descriptor.iter().zip(&self.mean).enumerate() {
            // Blocks of 64 numbers alternate in a pattern of their own, so that neighbouring channels do not cancel.
            let is_negative = (i / CODE_BITS) & (i % CODE_BITS) & 1 == 1;
            let v = d - m;
            out[i % CODE_BITS] += if is_negative { -v } else { v };
        }
        let norm = out.iter().map(|v| v * v).sum::<f32>().sqrt();
        if norm > 0.0 {
            for v in out {
                *v /= norm;
            }
        }
    }

    /// The code of a descriptor; bit `i` is set where number `i` of the query is not negative.
    pub fn encode(&self, descriptor: &[f32]) -> u64 {
        signs(&self.query_of(descriptor))
    }

    /// As [`Self::query`].
    pub fn query_of(&self, descriptor: &[f32]) -> [f32; CODE_BITS] {
        let mut query = [0.0; CODE_BITS];
        self.query(descriptor, &mut query);
        query
    }
}

/// The code of a centred descriptor.
pub fn signs(query: &[f32; CODE_BITS]) -> u64 {
    let bits = query.iter().enumerate();
    bits.fold(0, |code, (i, v)| code | (u64::from(*v >= 0.0) << i))
}

/// The unit vector that a code stands for.
pub fn decode(code: u64) -> [f32; CODE_BITS] {
    core::array::from_fn(|i| if code >> i & 1 == 1 { 0.125 } else { -0.125 })
}

/// Cosine of a query and a decoded code. Eight sums in a fixed order: the same bits everywhere.
#[inline]
pub fn similarity(query: &[f32; CODE_BITS], landmark: &[f32; CODE_BITS]) -> f32 {
    let mut sums = [0.0_f32; 8];
    for (q, l) in query
        .as_chunks::<8>()
        .0
        .iter()
        .zip(landmark.as_chunks::<8>().0)
    {
        for (s, (a, b)) in sums.iter_mut().zip(q.iter().zip(l)) {
            *s += a * b;
        }
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rng;

    #[test]
    fn a_code_is_nearest_to_its_own_descriptor() {
        let mut rng = Rng::from_seed(5);
        for channels in [64, 256] {
            let rows: Vec<Vec<f32>> = (0..200)
                .map(|_| (0..channels).map(|_| rng.normal() as f32 + 0.5).collect())
                .collect();
            let code = SignCode::of(channels, rows.iter().map(Vec::as_slice));
            let codes: Vec<_> = rows.iter().map(|r| decode(code.encode(r))).collect();
            let mut query = [0.0; CODE_BITS];
            for (i, row) in rows.iter().enumerate() {
                code.query(row, &mut query);
                let own = similarity(&query, &codes[i]);
                // The mean of |x| for a normal x is 0.8 of its deviation.
                assert!((0.7..0.9).contains(&own), "{own}");
                let others = codes.iter().enumerate().filter(|(j, _)| *j != i);
                let best = others
                    .map(|(_, c)| similarity(&query, c))
                    .fold(-1.0, f32::max);
                assert!(best < own - 0.1, "{best} beside {own}");
            }
        }
    }

    #[test]
    fn eight_sums_are_the_dot_product() {
        let query: [f32; CODE_BITS] = core::array::from_fn(|i| i as f32);
        let other = core::array::from_fn(|i| if i % 3 == 0 { 1.0 } else { 0.0 });
        // 0 + 3 + ... + 63
        assert_eq!(similarity(&query, &other), 693.0);
    }
}
