//! Which instruction sets the shipped binary needs: exactly those that `build.json` declares.

use super::config::Proposals;
use anyhow::{Result, bail};
use wasmparser::{Validator, WasmFeatures};

/// Validates the binary with the declared proposals, and finds it invalid without each required one.
///
/// # Errors
///
/// When the binary needs more, or lacks what it must use.
pub(super) fn check(wasm: &[u8], proposals: &Proposals) -> Result<()> {
    let mut declared = base();
    for name in proposals.required.iter().chain(&proposals.allowed) {
        declared |= feature(name)?;
    }
    if let Err(error) = validate(wasm, declared) {
        bail!(
            "the wasm binary needs an instruction set that pkg-config/build.json does not declare: {error}"
        );
    }
    for name in &proposals.required {
        if validate(wasm, declared - feature(name)?).is_ok() {
            bail!(
                "the wasm binary does not use {name}, which pkg-config/build.json requires: did the build lose its flags?"
            );
        }
    }
    println!(
        "web     instruction sets: {} used, nothing undeclared",
        proposals.required.join(", ")
    );
    Ok(())
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

    fn proposals(required: &[&str], allowed: &[&str]) -> Proposals {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        Proposals {
            required: owned(required),
            allowed: owned(allowed),
        }
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
            check(&simd(), &proposals(&["simd"], &[])).is_ok(),
            "simd is required and there"
        );
    }

    #[test]
    fn refuses_a_binary_that_lost_its_simd() {
        let plain = module(&[]);
        assert!(
            check(&plain, &proposals(&["simd"], &[])).is_err(),
            "no vector instruction"
        );
        assert!(
            check(&plain, &proposals(&[], &["simd"])).is_ok(),
            "allowed is not required"
        );
    }

    #[test]
    fn refuses_an_undeclared_instruction_set() {
        assert!(
            check(&simd(), &proposals(&[], &["bulk-memory"])).is_err(),
            "simd is not declared"
        );
    }

    #[test]
    fn refuses_an_unknown_name() {
        assert!(
            check(&simd(), &proposals(&["smid"], &[])).is_err(),
            "misspelt"
        );
    }
}
