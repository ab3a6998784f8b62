//! Vectors of `f32` for each instruction set, behind one trait.
//!
//! The methods are safe to call only where the instruction set exists. That holds because the types are used only inside
//! functions made by [`entry`], which are reached only through a [`Level`] that [`Level::best`] found on this machine.

/// An instruction set that the kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Plain Rust, everywhere.
    Scalar,
    /// 8 lanes with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// 16 lanes with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 4 lanes with fused multiply-add.
    #[cfg(target_arch = "aarch64")]
    Neon,
    /// 4 lanes, no fused multiply-add.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    Simd128,
}

impl Level {
    /// The best level of this machine.
    pub fn best() -> Self {
        Self::available().last().copied().unwrap_or(Self::Scalar)
    }

    /// All levels that this machine can run, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "some targets have only the scalar level")]
        let mut levels = vec![Self::Scalar];
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
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        levels.push(Self::Simd128);
        levels
    }

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "avx512",
            #[cfg(target_arch = "aarch64")]
            Self::Neon => "neon",
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Self::Simd128 => "simd128",
        }
    }

    /// Numbers per vector.
    pub fn lanes(self) -> usize {
        match self {
            Self::Scalar => Plain::LANES,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::Avx2::LANES,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::Avx512::LANES,
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::Neon::LANES,
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Self::Simd128 => wasm::Simd128::LANES,
        }
    }
}

/// Compiles a generic kernel for every level and makes the function that chooses.
macro_rules! entry {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) => $generic:ident) => {
        $(#[$doc])*
        $visibility fn $name(level: $crate::nn::cpu::kernels::lanes::Level, $($arg: $type),*) {
            use $crate::nn::cpu::kernels::lanes::{Level, Plain};
            #[cfg(target_arch = "x86_64")]
            use $crate::nn::cpu::kernels::lanes::x86::{Avx2, Avx512};
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
            match level {
                Level::Scalar => $generic::<Plain>($($arg),*),
                #[cfg(target_arch = "x86_64")]
                // SAFETY: a level exists only where `Level::available` found its instructions.
                Level::Avx2 => unsafe { avx2($($arg),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                Level::Avx512 => unsafe { avx512($($arg),*) },
                #[cfg(target_arch = "aarch64")]
                Level::Neon => $generic::<$crate::nn::cpu::kernels::lanes::neon::Neon>($($arg),*),
                #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
                Level::Simd128 => $generic::<$crate::nn::cpu::kernels::lanes::wasm::Simd128>($($arg),*),
            }
        }
    };
}
pub(super) use entry;

/// Adding this rounds a small number to an integer, which then stands in the low bits of the sum.
const ROUNDER: f32 = 12_582_912.0;

/// A vector of `f32`.
pub(super) trait Lanes: Copy {
    /// Numbers in the vector.
    const LANES: usize;
    /// Rows of a matrix product's tile that is two vectors wide.
    const TILE_ROWS: usize;
    /// Rows of a tile that is one vector wide.
    const NARROW_TILE_ROWS: usize;

    fn splat(x: f32) -> Self;
    /// # Safety
    /// `LANES` numbers can be read.
    unsafe fn load(from: *const f32) -> Self;
    /// # Safety
    /// `LANES` numbers can be written.
    unsafe fn store(self, to: *mut f32);
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    /// `self + a * b`, rounded once or twice.
    fn mul_add(self, a: Self, b: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    /// Two to the power of `n`, given `ROUNDER + n` for integers from -126 to 127.
    fn power_of_rounded(self) -> Self;
    /// Sum of the lanes.
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

/// Four numbers in plain Rust.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plain([f32; 4]);

impl Plain {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        Self(std::array::from_fn(|lane| f(self.0[lane], other.0[lane])))
    }
}

impl Lanes for Plain {
    const LANES: usize = 4;
    const TILE_ROWS: usize = 4;
    const NARROW_TILE_ROWS: usize = 8;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 4])
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller allows four numbers.
        Self(unsafe { from.cast::<[f32; 4]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller allows four numbers.
        unsafe { to.cast::<[f32; 4]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self.add(a.mul(b))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { b } else { a })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if b < a { b } else { a })
    }
    #[inline(always)]
    fn power_of_rounded(self) -> Self {
        Self(
            self.0
                .map(|x| f32::from_bits(x.to_bits().wrapping_add(127) << 23)),
        )
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        (self.0[0] + self.0[2]) + (self.0[1] + self.0[3])
    }
    #[inline(always)]
    fn largest(self) -> f32 {
        self.0.into_iter().fold(f32::NEG_INFINITY, f32::max)
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    //! AVX2 with FMA, and AVX-512.
    use std::arch::x86_64::*;

    use super::Lanes;

    /// Eight numbers.
    #[derive(Debug, Clone, Copy)]
    pub(in crate::nn::cpu::kernels) struct Avx2(__m256);

    /// Wraps intrinsics that are safe wherever their instructions exist.
    macro_rules! simple {
        ($type:ident: $($name:ident($($arg:ident),*) = $body:expr;)*) => {
            $(
                #[inline(always)]
                fn $name(self $(, $arg: Self)*) -> Self {
                    $(let $arg = $arg.0;)*
                    let x = self.0;
                    // SAFETY: values of this type exist only where the instructions do (see the module).
                    $type(unsafe { $body(x $(, $arg)*) })
                }
            )*
        };
    }

    impl Lanes for Avx2 {
        const LANES: usize = 8;
        const TILE_ROWS: usize = 6;
        const NARROW_TILE_ROWS: usize = 12;

        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see the module.
            Self(unsafe { _mm256_set1_ps(x) })
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller allows eight numbers.
            Self(unsafe { _mm256_loadu_ps(from) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller allows eight numbers.
            unsafe { _mm256_storeu_ps(to, self.0) }
        }
        simple! { Avx2:
            add(b) = _mm256_add_ps;
            sub(b) = _mm256_sub_ps;
            mul(b) = _mm256_mul_ps;
            div(b) = _mm256_div_ps;
            max(b) = _mm256_max_ps;
            min(b) = _mm256_min_ps;
        }
        #[inline(always)]
        fn mul_add(self, a: Self, b: Self) -> Self {
            // SAFETY: see the module.
            Self(unsafe { _mm256_fmadd_ps(a.0, b.0, self.0) })
        }
        #[inline(always)]
        fn power_of_rounded(self) -> Self {
            // SAFETY: see the module.
            Self(unsafe {
                let n = _mm256_add_epi32(_mm256_castps_si256(self.0), _mm256_set1_epi32(127));
                _mm256_castsi256_ps(_mm256_slli_epi32::<23>(n))
            })
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            // SAFETY: see the module.
            unsafe {
                let four = _mm_add_ps(
                    _mm256_castps256_ps128(self.0),
                    _mm256_extractf128_ps::<1>(self.0),
                );
                let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
        #[inline(always)]
        fn largest(self) -> f32 {
            // SAFETY: see the module.
            unsafe {
                let four = _mm_max_ps(
                    _mm256_castps256_ps128(self.0),
                    _mm256_extractf128_ps::<1>(self.0),
                );
                let two = _mm_max_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
    }

    /// Sixteen numbers.
    #[derive(Debug, Clone, Copy)]
    pub(in crate::nn::cpu::kernels) struct Avx512(__m512);

    impl Lanes for Avx512 {
        const LANES: usize = 16;
        const TILE_ROWS: usize = 12;
        const NARROW_TILE_ROWS: usize = 12;

        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: see the module.
            Self(unsafe { _mm512_set1_ps(x) })
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller allows sixteen numbers.
            Self(unsafe { _mm512_loadu_ps(from) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller allows sixteen numbers.
            unsafe { _mm512_storeu_ps(to, self.0) }
        }
        simple! { Avx512:
            add(b) = _mm512_add_ps;
            sub(b) = _mm512_sub_ps;
            mul(b) = _mm512_mul_ps;
            div(b) = _mm512_div_ps;
            max(b) = _mm512_max_ps;
            min(b) = _mm512_min_ps;
        }
        #[inline(always)]
        fn mul_add(self, a: Self, b: Self) -> Self {
            // SAFETY: see the module.
            Self(unsafe { _mm512_fmadd_ps(a.0, b.0, self.0) })
        }
        #[inline(always)]
        fn power_of_rounded(self) -> Self {
            // SAFETY: see the module.
            Self(unsafe {
                let n = _mm512_add_epi32(_mm512_castps_si512(self.0), _mm512_set1_epi32(127));
                _mm512_castsi512_ps(_mm512_slli_epi32::<23>(n))
            })
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            // SAFETY: see the module.
            unsafe { _mm512_reduce_add_ps(self.0) }
        }
        #[inline(always)]
        fn largest(self) -> f32 {
            // SAFETY: see the module.
            unsafe { _mm512_reduce_max_ps(self.0) }
        }
    }
}

#[cfg(target_arch = "aarch64")]
pub(super) mod neon {
    //! NEON, which every 64-bit ARM has.
    use std::arch::aarch64::*;

    use super::Lanes;

    /// Four numbers.
    #[derive(Debug, Clone, Copy)]
    pub(in crate::nn::cpu::kernels) struct Neon(float32x4_t);

    macro_rules! simple {
        ($($name:ident($($arg:ident),*) = $body:expr;)*) => {
            $(
                #[inline(always)]
                fn $name(self $(, $arg: Self)*) -> Self {
                    $(let $arg = $arg.0;)*
                    let x = self.0;
                    // SAFETY: NEON is part of the target's base.
                    Neon(unsafe { $body(x $(, $arg)*) })
                }
            )*
        };
    }

    impl Lanes for Neon {
        const LANES: usize = 4;
        const TILE_ROWS: usize = 6;
        const NARROW_TILE_ROWS: usize = 12;

        #[inline(always)]
        fn splat(x: f32) -> Self {
            // SAFETY: NEON is part of the target's base.
            Self(unsafe { vdupq_n_f32(x) })
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller allows four numbers.
            Self(unsafe { vld1q_f32(from) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller allows four numbers.
            unsafe { vst1q_f32(to, self.0) }
        }
        simple! {
            add(b) = vaddq_f32;
            sub(b) = vsubq_f32;
            mul(b) = vmulq_f32;
            div(b) = vdivq_f32;
            max(b) = vmaxq_f32;
            min(b) = vminq_f32;
            mul_add(a, b) = vfmaq_f32;
        }
        #[inline(always)]
        fn power_of_rounded(self) -> Self {
            // SAFETY: NEON is part of the target's base.
            Self(unsafe {
                let n = vaddq_s32(vreinterpretq_s32_f32(self.0), vdupq_n_s32(127));
                vreinterpretq_f32_s32(vshlq_n_s32::<23>(n))
            })
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            // SAFETY: NEON is part of the target's base.
            unsafe { vaddvq_f32(self.0) }
        }
        #[inline(always)]
        fn largest(self) -> f32 {
            // SAFETY: NEON is part of the target's base.
            unsafe { vmaxvq_f32(self.0) }
        }
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
pub(super) mod wasm {
    //! The 128-bit vectors of WebAssembly.
    use std::arch::wasm32::*;

    use super::Lanes;

    /// Four numbers.
    #[derive(Debug, Clone, Copy)]
    pub(in crate::nn::cpu::kernels) struct Simd128(v128);

    impl Lanes for Simd128 {
        const LANES: usize = 4;
        // V8 on x86-64 has 15 vector registers to give: 8 accumulators, 2 of the matrix and the broadcasts fit.
        const TILE_ROWS: usize = 4;
        const NARROW_TILE_ROWS: usize = 8;

        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(f32x4_splat(x))
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: the caller allows four numbers.
            Self(unsafe { v128_load(from.cast()) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: the caller allows four numbers.
            unsafe { v128_store(to.cast(), self.0) }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(f32x4_add(self.0, other.0))
        }
        #[inline(always)]
        fn sub(self, other: Self) -> Self {
            Self(f32x4_sub(self.0, other.0))
        }
        #[inline(always)]
        fn mul(self, other: Self) -> Self {
            Self(f32x4_mul(self.0, other.0))
        }
        #[inline(always)]
        fn div(self, other: Self) -> Self {
            Self(f32x4_div(self.0, other.0))
        }
        #[inline(always)]
        fn mul_add(self, a: Self, b: Self) -> Self {
            Self(f32x4_add(self.0, f32x4_mul(a.0, b.0)))
        }
        // The `p` forms are one instruction on x86; they differ only for NaN and the sign of zero.
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(f32x4_pmax(self.0, other.0))
        }
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            Self(f32x4_pmin(self.0, other.0))
        }
        #[inline(always)]
        fn power_of_rounded(self) -> Self {
            Self(i32x4_shl(i32x4_add(self.0, i32x4_splat(127)), 23))
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            let x = self.0;
            let two = f32x4_add(x, i32x4_shuffle::<2, 3, 0, 1>(x, x));
            f32x4_extract_lane::<0>(two) + f32x4_extract_lane::<1>(two)
        }
        #[inline(always)]
        fn largest(self) -> f32 {
            let x = self.0;
            let two = f32x4_pmax(x, i32x4_shuffle::<2, 3, 0, 1>(x, x));
            f32x4_extract_lane::<0>(two).max(f32x4_extract_lane::<1>(two))
        }
    }
}
