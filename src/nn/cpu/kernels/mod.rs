//! The inner loops: the only part of the runtime with SIMD and `unsafe`.
//!
//! Each kernel is generic over a vector type (`crate::simd`) and compiled for every instruction set of the target; the level
//! is chosen once, when an executor is made. Natively the levels are AVX-512, AVX2 with FMA, NEON with FMA, and the portable one;
//! in wasm the portable one by simd128, and in builds with the feature `relaxed-simd` one with its multiply-add.
#![expect(
    unsafe_code,
    reason = "vector instructions and unchecked tile accesses; sizes are asserted before each loop"
)]

pub(super) mod arena;
pub(super) mod attention;
pub(super) mod conv3x3;
pub(super) mod elementwise;
pub(super) mod gemm;
pub(super) mod nearest;
pub(super) mod norm;
pub(super) mod soft_choice;
pub(super) mod winograd;
