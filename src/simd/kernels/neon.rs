//! NEON, which every 64-bit ARM has, with and without fused multiply-add.

use std::arch::aarch64::*;

use super::Lanes;

/// Four numbers with fused multiply-add.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Neon(float32x4_t);

/// Four numbers for the portable level: products are rounded before they are added.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Separate(float32x4_t);

/// Wraps intrinsics.
macro_rules! simple {
    ($($name:ident($($arg:ident),*) = $body:expr;)*) => {
        $(
            #[inline(always)]
            fn $name(self $(, $arg: Self)*) -> Self {
                $(let $arg = $arg.0;)*
                let x = self.0;
                // SAFETY: NEON is part of the target's base.
                Self(unsafe { ($body)(x $(, $arg)*) })
            }
        )*
    };
}

/// What both have in common; the rest of the trait's methods follow in braces.
macro_rules! lanes {
    ($type:ident { $($rest:tt)* }) => {
        impl Lanes for $type {
            const INSTRUCTIONS: &'static str = "neon";
            const LANES: usize = 4;
            const TILE_ROWS: usize = 6;
            const NARROW_TILE_ROWS: usize = 12;
            const UNROLL: bool = true;

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
            #[inline(always)]
            unsafe fn load_bytes(from: *const u8) -> Self {
                // SAFETY: the caller allows four bytes.
                Self(unsafe {
                    let bytes = vcreate_u8(u64::from(from.cast::<u32>().read_unaligned()));
                    vcvtq_f32_u32(vmovl_u16(vget_low_u16(vmovl_u8(bytes))))
                })
            }
            simple! {
                add(b) = vaddq_f32;
                sub(b) = vsubq_f32;
                mul(b) = vmulq_f32;
                div(b) = vdivq_f32;
            }
            #[inline(always)]
            fn where_greater(self, a: Self, b: Self) -> Self {
                // SAFETY: NEON is part of the target's base.
                Self(unsafe { vbslq_f32(vcgtq_f32(a.0, b.0), self.0, vdupq_n_f32(0.0)) })
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
            fn largest(self) -> f32 {
                // SAFETY: NEON is part of the target's base.
                unsafe { vmaxvq_f32(self.0) }
            }
            $($rest)*
        }
    };
}

lanes! { Neon {
    simple! {
        max(b) = vmaxq_f32;
        min(b) = vminq_f32;
        mul_add(a, b) = vfmaq_f32;
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: NEON is part of the target's base.
        unsafe { vaddvq_f32(self.0) }
    }
} }

lanes! { Separate {
    simple! {
        max(b) = |a, b| vbslq_f32(vcltq_f32(a, b), b, a);
        min(b) = |a, b| vbslq_f32(vcltq_f32(b, a), b, a);
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self.add(a.mul(b))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: NEON is part of the target's base.
        unsafe {
            let two = vadd_f32(vget_low_f32(self.0), vget_high_f32(self.0));
            vget_lane_f32::<0>(two) + vget_lane_f32::<1>(two)
        }
    }
} }
