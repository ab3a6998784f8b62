//! Vectors of `f32` for each instruction set, behind one trait.
//!
//! The methods are safe to call only where the instruction set exists. That holds because the types are used only inside
//! functions made by [`entry`], which are reached only through a [`Level`] that [`Level::best`] found on this machine.
#![expect(unsafe_code, reason = "vector instructions")]

#[cfg(target_arch = "aarch64")]
pub(crate) mod neon;
// Where there are vectors of four, plain Rust is what they are compared with.
#[cfg(any(
    test,
    not(any(
        target_arch = "x86_64",
        target_arch = "aarch64",
        all(target_arch = "wasm32", target_feature = "simd128")
    ))
))]
pub(crate) mod plain;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub(crate) mod simd128;
#[cfg(target_arch = "x86_64")]
pub(crate) mod x86;

#[cfg(target_arch = "aarch64")]
pub(crate) use neon::Separate as Portable;
#[cfg(not(any(
    target_arch = "x86_64",
    target_arch = "aarch64",
    all(target_arch = "wasm32", target_feature = "simd128")
)))]
pub(crate) use plain::Plain as Portable;
#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub(crate) use simd128::Simd128 as Portable;
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Sse2 as Portable;

/// How the kernels compute: an instruction set, and with it the order and rounding of sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// 4 lanes, products rounded before they are added: the same bits on every target, natively and in wasm. By SSE2, NEON or
    /// simd128; plain Rust where there is none of them.
    Portable,
    /// 8 lanes with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 16 lanes with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 4 lanes with fused multiply-add.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// 4 lanes with the multiply-add of relaxed SIMD: fused where the processor can. Only in builds with the feature
    /// `relaxed-simd`, which do not load elsewhere.
    #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
    Relaxed,
}

impl Default for Level {
    fn default() -> Self {
        Self::best()
    }
}

impl Level {
    /// The best level of this machine.
    pub fn best() -> Self {
        Self::available().last().copied().unwrap_or(Self::Portable)
    }

    /// All levels that this machine can run, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "some targets have only the portable level")]
        let mut levels = vec![Self::Portable];
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
        {
            levels.push(Self::Avx2);
            if std::arch::is_x86_feature_detected!("avx512f") {
                levels.push(Self::Avx512);
            }
        }
        #[cfg(target_arch = "aarch64")]
        levels.push(Self::Neon);
        #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
        levels.push(Self::Relaxed);
        levels
    }

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "avx512",
            #[cfg(target_arch = "aarch64")]
            Self::Neon => "neon",
            #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
            Self::Relaxed => "relaxed",
        }
    }

    /// The vector instructions behind it: `none`, `sse2`, `avx2`, `avx512f`, `neon`, `simd128` or
    /// `relaxed-simd`.
    pub fn instructions(self) -> &'static str {
        match self {
            Self::Portable => Portable::INSTRUCTIONS,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::Avx2::INSTRUCTIONS,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::Avx512::INSTRUCTIONS,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::Neon::INSTRUCTIONS,
            #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
            Self::Relaxed => simd128::Relaxed::INSTRUCTIONS,
        }
    }

    /// Numbers per vector.
    pub fn lanes(self) -> usize {
        match self {
            Self::Portable => Portable::LANES,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::Avx2::LANES,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::Avx512::LANES,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::Neon::LANES,
            #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
            Self::Relaxed => simd128::Relaxed::LANES,
        }
    }
}

/// Compiles a generic kernel for every level and makes the function that chooses.
macro_rules! entry {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) => $generic:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::simd::kernels::Level, $($arg: $type),*) {
            use $crate::simd::kernels::{Level, Portable};
            #[cfg(target_arch = "x86_64")]
            use $crate::simd::kernels::x86::{Avx2, Avx512};
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($arg: $type),*) {
                $generic::<Avx2>($($arg),*);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512($($arg: $type),*) {
                $generic::<Avx512>($($arg),*);
            }
            #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
            #[target_feature(enable = "relaxed-simd")]
            fn relaxed($($arg: $type),*) {
                $generic::<$crate::simd::kernels::simd128::Relaxed>($($arg),*);
            }
            match level {
                Level::Portable => $generic::<Portable>($($arg),*),
                #[cfg(target_arch = "x86_64")]
                // SAFETY: a level exists only where `Level::available` found its instructions.
                Level::Avx2 => unsafe { avx2($($arg),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                Level::Avx512 => unsafe { avx512($($arg),*) },
                #[cfg(target_arch = "aarch64")]
                Level::Neon => $generic::<$crate::simd::kernels::neon::Neon>($($arg),*),
                #[cfg(all(target_arch = "wasm32", feature = "relaxed-simd"))]
                Level::Relaxed => relaxed($($arg),*),
            }
        }
    };
}
pub(crate) use entry;

/// Adding this rounds a small number to an integer, which then stands in the low bits of the sum.
const ROUNDER: f32 = 12_582_912.0;

/// A vector of `f32`.
pub(crate) trait Lanes: Copy {
    /// The vector instructions.
    const INSTRUCTIONS: &'static str;
    /// Numbers in the vector.
    const LANES: usize;
    /// Rows of a matrix product's tile that is two vectors wide.
    const TILE_ROWS: usize;
    /// Rows of a tile that is one vector wide.
    const NARROW_TILE_ROWS: usize;
    /// Whether the inner loop of products takes four steps at a time.
    const UNROLL: bool;

    fn splat(x: f32) -> Self;
    /// # Safety
    /// `LANES` numbers can be read.
    unsafe fn load(from: *const f32) -> Self;
    /// # Safety
    /// `LANES` numbers can be written.
    unsafe fn store(self, to: *mut f32);
    /// # Safety
    /// `LANES` bytes can be read.
    unsafe fn load_bytes(from: *const u8) -> Self;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    /// `self + a * b`, rounded once or twice.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// The larger one; `self` where they are equal or one is not a number. On the portable level this includes the sign of zero.
    fn max(self, other: Self) -> Self;
    /// The smaller one, as [`Self::max`].
    fn min(self, other: Self) -> Self;
    /// `self` in the lanes where `a` is larger than `b`, zero in the others; nothing is larger than a NaN, nor a NaN.
    fn where_greater(self, a: Self, b: Self) -> Self;
    /// Two to the power of `n`, given `ROUNDER + n` for integers from -126 to 127.
    fn power_of_rounded(self) -> Self;
    /// Sum of the lanes; on the portable level the upper half added to the lower one until one is left.
    fn sum(self) -> f32;
    /// Largest lane.
    fn largest(self) -> f32;

    /// Reads `count` < `LANES` numbers; the other lanes are `fill`.
    ///
    /// # Safety
    /// `count` numbers can be read.
    #[inline(always)]
    unsafe fn load_part(from: *const f32, count: usize, fill: f32) -> Self {
        let mut buffer = [fill; 16];
        // SAFETY: the caller allows `count` numbers, and the buffer has room for any vector.
        unsafe {
            std::ptr::copy_nonoverlapping(from, buffer.as_mut_ptr(), count.min(Self::LANES));
            Self::load(buffer.as_ptr())
        }
    }

    /// Writes the first `count` < `LANES` numbers.
    ///
    /// # Safety
    /// `count` numbers can be written.
    #[inline(always)]
    unsafe fn store_part(self, to: *mut f32, count: usize) {
        let mut buffer = [0.0_f32; 16];
        // SAFETY: as for `load_part`.
        unsafe {
            self.store(buffer.as_mut_ptr());
            std::ptr::copy_nonoverlapping(buffer.as_ptr(), to, count.min(Self::LANES));
        }
    }

    /// `exp(self)`, relative error about 1e-7; below -87 the result of -87 (1.6e-38).
    #[inline(always)]
    fn exp(self) -> Self {
        // Range reduction to |r| <= ln 2 / 2, then the polynomial of the Cephes library's single-precision exponential.
        let x = self.max(Self::splat(-87.0)).min(Self::splat(88.0));
        let rounded = Self::splat(ROUNDER).mul_add(x, Self::splat(std::f32::consts::LOG2_E));
        let n = rounded.sub(Self::splat(ROUNDER));
        let r = x
            .mul_add(n, Self::splat(-0.693_359_4))
            .mul_add(n, Self::splat(2.121_944_4e-4));
        let mut p = Self::splat(1.987_569_1e-4);
        for coefficient in [
            1.398_2e-3,
            8.333_452e-3,
            4.166_579_6e-2,
            1.666_666_5e-1,
            0.5,
        ] {
            p = Self::splat(coefficient).mul_add(p, r);
        }
        let e = Self::splat(1.0).add(r).mul_add(p, r.mul(r));
        e.mul(rounded.power_of_rounded())
    }

    /// `2^self`, relative error about 2e-7, for numbers up to 126; below -60 the result of -60 (9e-19), so that products with
    /// it are not denormal, which would be slow.
    #[inline(always)]
    #[expect(
        clippy::approx_constant,
        reason = "a fitted coefficient that comes close to ln 2, not ln 2"
    )]
    fn exp2_of_score(self) -> Self {
        let x = self.max(Self::splat(-60.0));
        let rounded = x.add(Self::splat(ROUNDER));
        let f = x.sub(rounded.sub(Self::splat(ROUNDER)));
        // Least relative error on [-1/2, 1/2] with the constant term 1 (fitted for this file): 9.1e-8.
        let mut p = Self::splat(1.326_472_6e-3);
        for coefficient in [
            9.671_513e-3,
            5.550_733_6e-2,
            2.402_224_2e-1,
            6.931_47e-1,
            1.0,
        ] {
            p = Self::splat(coefficient).mul_add(p, f);
        }
        p.mul(rounded.power_of_rounded())
    }

    /// `erf(self)`, absolute error below 3e-7 (Abramowitz and Stegun 7.1.26).
    #[inline(always)]
    fn erf(self) -> Self {
        let magnitude = self.max(Self::splat(0.0).sub(self));
        let one = Self::splat(1.0);
        let t = one.div(one.mul_add(magnitude, Self::splat(0.327_591_1)));
        let mut p = Self::splat(1.061_405_4);
        for coefficient in [-1.453_152, 1.421_413_7, -0.284_496_74, 0.254_829_6] {
            p = Self::splat(coefficient).mul_add(p, t);
        }
        let tail = p
            .mul(t)
            .mul(Self::splat(0.0).sub(magnitude.mul(magnitude)).exp());
        // The sign of the argument, zero for zero.
        let large = Self::splat(f32::MAX);
        let sign = self.mul(large).max(Self::splat(-1.0)).min(one);
        one.sub(tail).mul(sign)
    }

    /// `1 / (1 + exp(-self))`
    #[inline(always)]
    fn sigmoid(self) -> Self {
        let one = Self::splat(1.0);
        one.div(one.add(Self::splat(0.0).sub(self).exp()))
    }

    /// `self * (1 + erf(self / sqrt 2)) / 2`
    #[inline(always)]
    fn gelu(self) -> Self {
        let half = self.mul(Self::splat(0.5));
        half.mul_add(
            half,
            self.mul(Self::splat(std::f32::consts::FRAC_1_SQRT_2)).erf(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::plain::Plain;
    use super::*;

    /// Numbers of all sizes and signs, zeros of both signs among them.
    fn numbers(seed: u32) -> Vec<f32> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 8
        };
        let mut numbers = vec![0.0, -0.0, 1.0, -1.0, 87.9, -87.9, 1e-39, -60.5];
        numbers.resize_with(4000, || {
            let mantissa = next() as f32 / 8_388_608.0 - 1.0;
            mantissa * 2_f32.powi((next() % 40) as i32 - 30)
        });
        numbers
    }

    /// Every operation of the trait on four numbers.
    fn results<L: Lanes>(a: &[f32], b: &[f32]) -> Vec<f32> {
        let mut out = Vec::new();
        // SAFETY: the caller gives four numbers each, and the vector has four lanes.
        let (x, y) = unsafe { (L::load(a.as_ptr()), L::load(b.as_ptr())) };
        let rounded = L::splat(ROUNDER).add(x.max(L::splat(-60.0)).min(L::splat(60.0)));
        for vector in [
            x.add(y),
            x.sub(y),
            x.mul(y),
            x.div(y),
            x.mul_add(y, x),
            x.max(y),
            x.min(y),
            x.where_greater(x, y),
            rounded.power_of_rounded(),
            x.exp(),
            x.exp2_of_score(),
            x.erf(),
            x.sigmoid(),
            x.gelu(),
        ] {
            let mut lanes = [0.0; 4];
            // SAFETY: four numbers fit.
            unsafe { vector.store(lanes.as_mut_ptr()) };
            out.extend(lanes);
        }
        let mut bytes = [0.0; 4];
        let from: [u8; 4] = std::array::from_fn(|lane| a[lane].to_bits() as u8);
        // SAFETY: four bytes there, four numbers here.
        unsafe { L::load_bytes(from.as_ptr()).store(bytes.as_mut_ptr()) };
        assert_eq!(bytes, from.map(f32::from));
        out.extend([x.sum(), x.largest()]);
        out
    }

    #[test]
    fn the_portable_level_computes_as_plain_rust() {
        assert_eq!(Portable::LANES, Plain::LANES);
        let (a, b) = (numbers(1), numbers(2));
        for (a, b) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
            let (found, expected) = (results::<Portable>(a, b), results::<Plain>(a, b));
            for (index, (f, e)) in found.iter().zip(&expected).enumerate() {
                let same = f.to_bits() == e.to_bits() || (f.is_nan() && e.is_nan());
                // The largest of zeros may have either sign: nothing that uses it depends on that.
                assert!(
                    same || (index + 1 == found.len() && f == e),
                    "operation {}: {f:e} instead of {e:e} for {a:?} and {b:?}",
                    index / 4
                );
            }
        }
    }
}
