//! The 128-bit vectors of WebAssembly, with and without the fused multiply-add of relaxed SIMD.
use std::arch::wasm32::*;

use super::Lanes;

/// Four numbers; `FUSED` where products are added before they are rounded.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Vector<const FUSED: bool>(v128);

/// For the portable level.
pub(crate) type Simd128 = Vector<false>;
/// With fused multiply-add.
#[cfg(feature = "relaxed-simd")]
pub(crate) type Relaxed = Vector<true>;

impl<const FUSED: bool> Lanes for Vector<FUSED> {
    const INSTRUCTIONS: &'static str = if FUSED { "relaxed-simd" } else { "simd128" };
    const LANES: usize = 4;
    // V8 on x86-64 has 15 vector registers to give: 8 accumulators, 2 of the matrix and the broadcasts fit.
    const TILE_ROWS: usize = 4;
    const NARROW_TILE_ROWS: usize = 8;
    // Unrolled, V8 runs out of registers and falls to half speed.
    const UNROLL: bool = false;

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
    unsafe fn load_bytes(from: *const u8) -> Self {
        // SAFETY: the caller allows four bytes.
        let bytes = unsafe { v128_load32_zero(from.cast()) };
        let wide = u32x4_extend_low_u16x8(u16x8_extend_low_u8x16(bytes));
        Self(f32x4_convert_i32x4(wide))
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
        #[cfg(feature = "relaxed-simd")]
        if FUSED {
            return Self(f32x4_relaxed_madd(a.0, b.0, self.0));
        }
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
    fn where_greater(self, a: Self, b: Self) -> Self {
        Self(v128_and(self.0, f32x4_gt(a.0, b.0)))
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
