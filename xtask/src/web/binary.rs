//! Which instruction sets the shipped binary needs: exactly those that `build.json` declares, of relaxed SIMD to the instruction.

use super::config::Build;
use anyhow::{Result, bail};
use std::collections::BTreeSet;
use wasmparser::{Operator, Parser, Payload, Validator, WasmFeatures};

/// Validates the binary with the declared proposals, and finds it invalid without each required one.
///
/// # Errors
///
/// When the binary needs more, or lacks what it must use.
pub(super) fn check(wasm: &[u8], build: &Build, allowed: &[String]) -> Result<()> {
    let mut declared = base();
    for name in build.required.iter().chain(allowed) {
        declared |= feature(name)?;
    }
    if let Err(error) = validate(wasm, declared) {
        bail!(
            "the wasm binary needs an instruction set that pkg-config/build.json does not declare: {error}"
        );
    }
    for name in &build.required {
        if validate(wasm, declared - feature(name)?).is_ok() {
            bail!(
                "the wasm binary does not use {name}, which pkg-config/build.json requires: did the build lose its flags?"
            );
        }
    }
    let found = relaxed(wasm)?;
    let wanted: BTreeSet<&str> = build.relaxed.iter().map(String::as_str).collect();
    if found != wanted {
        bail!(
            "of relaxed SIMD the wasm binary uses {found:?}; pkg-config/build.json declares {wanted:?}"
        );
    }
    println!(
        "web     {}: {} used, nothing undeclared",
        build.out_name,
        build.required.join(", ")
    );
    Ok(())
}

/// The instructions of relaxed SIMD that a binary uses.
fn relaxed(wasm: &[u8]) -> Result<BTreeSet<&'static str>> {
    let mut found = BTreeSet::new();
    for payload in Parser::new(0).parse_all(wasm) {
        if let Payload::CodeSectionEntry(body) = payload? {
            for operator in body.get_operators_reader()? {
                found.extend(relaxed_name(&operator?));
            }
        }
    }
    Ok(found)
}

/// The name of an instruction of relaxed SIMD. Minimum and maximum have none here: they differ between processors for NaN and in
/// the sign of zero alone, and the compiler puts them only where it knows that neither matters.
fn relaxed_name(operator: &Operator<'_>) -> Option<&'static str> {
    Some(match operator {
        Operator::F32x4RelaxedMadd => "f32x4.relaxed_madd",
        Operator::F32x4RelaxedNmadd => "f32x4.relaxed_nmadd",
        Operator::F64x2RelaxedMadd => "f64x2.relaxed_madd",
        Operator::F64x2RelaxedNmadd => "f64x2.relaxed_nmadd",
        Operator::I8x16RelaxedSwizzle => "i8x16.relaxed_swizzle",
        Operator::I32x4RelaxedTruncF32x4S
        | Operator::I32x4RelaxedTruncF32x4U
        | Operator::I32x4RelaxedTruncF64x2SZero
        | Operator::I32x4RelaxedTruncF64x2UZero => "i32x4.relaxed_trunc",
        Operator::I8x16RelaxedLaneselect
        | Operator::I16x8RelaxedLaneselect
        | Operator::I32x4RelaxedLaneselect
        | Operator::I64x2RelaxedLaneselect => "relaxed_laneselect",
        Operator::I16x8RelaxedQ15mulrS => "i16x8.relaxed_q15mulr_s",
        Operator::I16x8RelaxedDotI8x16I7x16S | Operator::I32x4RelaxedDotI8x16I7x16AddS => {
            "relaxed_dot"
        }
        _ => return None,
    })
}

fn validate(wasm: &[u8], features: WasmFeatures) -> Result<(), wasmparser::BinaryReaderError> {
    Validator::new_with_features(features)
        .validate_all(wasm)
        .map(drop)
}

/// WebAssembly 1.0.
fn base() -> WasmFeatures {
    WasmFeatures::FLOATS | WasmFeatures::GC_TYPES
}

/// A proposal under the name that its repository has.
fn feature(name: &str) -> Result<WasmFeatures> {
    Ok(match name {
        "bulk-memory" => WasmFeatures::BULK_MEMORY,
        "multi-value" => WasmFeatures::MULTI_VALUE,
        "mutable-global" => WasmFeatures::MUTABLE_GLOBAL,
        "reference-types" => WasmFeatures::REFERENCE_TYPES,
        "relaxed-simd" => WasmFeatures::RELAXED_SIMD,
        "saturating-float-to-int" => WasmFeatures::SATURATING_FLOAT_TO_INT,
        "sign-extension" => WasmFeatures::SIGN_EXTENSION,
        "simd" => WasmFeatures::SIMD,
        "threads" => WasmFeatures::THREADS,
        other => {
            bail!("pkg-config/build.json names the proposal {other}, which the check does not know")
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owned(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// Checks a binary that must use some proposals, may use others, and uses some instructions of relaxed SIMD.
    fn verdict(wasm: &[u8], required: &[&str], allowed: &[&str], relaxed: &[&str]) -> Result<()> {
        let build = Build {
            required: owned(required),
            relaxed: owned(relaxed),
            ..Build::default()
        };
        check(wasm, &build, &owned(allowed))
    }

    /// A module with one function; `body` is its code without the final `end`.
    fn module(body: &[u8]) -> Vec<u8> {
        let size = |n: usize| u8::try_from(n).unwrap_or(u8::MAX);
        let mut wasm = b"\0asm\x01\0\0\0".to_vec();
        wasm.extend([1, 4, 1, 0x60, 0, 0, 3, 2, 1, 0]);
        wasm.extend([10, size(body.len() + 4), 1, size(body.len() + 2), 0]);
        wasm.extend(body);
        wasm.push(0x0b);
        wasm
    }

    /// `v128.const 0; drop`
    fn simd() -> Vec<u8> {
        let mut body = vec![0xfd, 0x0c];
        body.extend([0; 16]);
        body.push(0x1a);
        module(&body)
    }

    #[test]
    fn accepts_a_binary_that_uses_what_it_must() {
        assert!(
            verdict(&simd(), &["simd"], &[], &[]).is_ok(),
            "simd is required and there"
        );
    }

    #[test]
    fn refuses_a_binary_that_lost_its_simd() {
        let plain = module(&[]);
        assert!(
            verdict(&plain, &["simd"], &[], &[]).is_err(),
            "no vector instruction"
        );
        assert!(
            verdict(&plain, &[], &["simd"], &[]).is_ok(),
            "allowed is not required"
        );
    }

    #[test]
    fn refuses_an_undeclared_instruction_set() {
        assert!(
            verdict(&simd(), &[], &["bulk-memory"], &[]).is_err(),
            "simd is not declared"
        );
    }

    #[test]
    fn tells_instructions_of_relaxed_simd_apart() {
        // Three constants, `f32x4.relaxed_madd` or `f64x2.relaxed_madd`, `drop`.
        let fused = |code: u8| {
            let mut body = Vec::new();
            for _ in 0..3 {
                body.extend([0xfd, 0x0c]);
                body.extend([0; 16]);
            }
            body.extend([0xfd, code, 0x02, 0x1a]);
            module(&body)
        };
        let required = ["simd", "relaxed-simd"];
        let of_networks = ["f32x4.relaxed_madd"];
        assert!(
            verdict(&fused(0x85), &required, &[], &of_networks).is_ok(),
            "declared"
        );
        assert!(
            verdict(&fused(0x85), &required, &[], &[]).is_err(),
            "not declared"
        );
        assert!(
            verdict(&fused(0x87), &required, &[], &of_networks).is_err(),
            "double precision must not differ between builds"
        );
    }

    #[test]
    fn refuses_an_unknown_name() {
        assert!(verdict(&simd(), &["smid"], &[], &[]).is_err(), "misspelt");
    }
}
