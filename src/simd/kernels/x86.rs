//! SSE2, AVX2 with FMA, and AVX-512.

use std::arch::x86_64::*;

use super::Lanes;

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

/// Four numbers, for the portable level: no fused multiply-add.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sse2(__m128);

impl Lanes for Sse2 {
    const INSTRUCTIONS: &'static str = "sse2";
    const LANES: usize = 4;
    const TILE_ROWS: usize = 4;
    const NARROW_TILE_ROWS: usize = 8;
    const UNROLL: bool = false;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        // SAFETY: SSE2 is part of the target's base.
        Self(unsafe { _mm_set1_ps(x) })
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller allows four numbers.
        Self(unsafe { _mm_loadu_ps(from) })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller allows four numbers.
        unsafe { _mm_storeu_ps(to, self.0) }
    }
    #[inline(always)]
    unsafe fn load_bytes(from: *const u8) -> Self {
        // SAFETY: the caller allows four bytes.
        Self(unsafe {
            let bytes = _mm_cvtsi32_si128(from.cast::<i32>().read_unaligned());
            let zero = _mm_setzero_si128();
            let wide = _mm_unpacklo_epi16(_mm_unpacklo_epi8(bytes, zero), zero);
            _mm_cvtepi32_ps(wide)
        })
    }
    simple! { Sse2:
        add(b) = _mm_add_ps;
        sub(b) = _mm_sub_ps;
        mul(b) = _mm_mul_ps;
        div(b) = _mm_div_ps;
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self.add(a.mul(b))
    }
    // Of equals the instruction takes its second operand, so it comes first here.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        // SAFETY: SSE2 is part of the target's base.
        Self(unsafe { _mm_max_ps(other.0, self.0) })
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        // SAFETY: SSE2 is part of the target's base.
        Self(unsafe { _mm_min_ps(other.0, self.0) })
    }
    #[inline(always)]
    fn where_greater(self, a: Self, b: Self) -> Self {
        // SAFETY: SSE2 is part of the target's base.
        Self(unsafe { _mm_and_ps(self.0, _mm_cmpgt_ps(a.0, b.0)) })
    }
    #[inline(always)]
    fn power_of_rounded(self) -> Self {
        // SAFETY: SSE2 is part of the target's base.
        Self(unsafe {
            let n = _mm_add_epi32(_mm_castps_si128(self.0), _mm_set1_epi32(127));
            _mm_castsi128_ps(_mm_slli_epi32::<23>(n))
        })
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: SSE2 is part of the target's base.
        unsafe {
            let two = _mm_add_ps(self.0, _mm_movehl_ps(self.0, self.0));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }
    #[inline(always)]
    fn largest(self) -> f32 {
        // SAFETY: SSE2 is part of the target's base.
        unsafe {
            let two = _mm_max_ps(self.0, _mm_movehl_ps(self.0, self.0));
            _mm_cvtss_f32(_mm_max_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }
}

/// Eight numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Avx2(__m256);

impl Lanes for Avx2 {
    const INSTRUCTIONS: &'static str = "avx2";
    const LANES: usize = 8;
    const TILE_ROWS: usize = 6;
    const NARROW_TILE_ROWS: usize = 12;
    const UNROLL: bool = true;

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
    #[inline(always)]
    unsafe fn load_bytes(from: *const u8) -> Self {
        // SAFETY: the caller allows eight bytes.
        Self(unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64(from.cast()))) })
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
    fn where_greater(self, a: Self, b: Self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm256_and_ps(self.0, _mm256_cmp_ps::<_CMP_GT_OQ>(a.0, b.0)) })
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
pub(crate) struct Avx512(__m512);

impl Lanes for Avx512 {
    const INSTRUCTIONS: &'static str = "avx512f";
    const LANES: usize = 16;
    const TILE_ROWS: usize = 12;
    const NARROW_TILE_ROWS: usize = 12;
    const UNROLL: bool = true;

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
    #[inline(always)]
    unsafe fn load_bytes(from: *const u8) -> Self {
        // SAFETY: the caller allows sixteen bytes.
        Self(unsafe { _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128(from.cast()))) })
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
    fn where_greater(self, a: Self, b: Self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(a.0, b.0), self.0) })
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
