//! Every operation of the CPU executor against the reference, in wasm.

use landline::nn::cpu::{CpuExecutor, Level};
use landline_testkit::{CPU_KINDS, NN_KINDS, nn_case};
use wasm_bindgen_test::wasm_bindgen_test;

const CASES: u64 = 40;

#[wasm_bindgen_test]
fn every_operation_agrees_with_the_reference() {
    assert_eq!(
        Level::best().instructions(),
        "simd128",
        "the build has the vector instructions"
    );
    for level in Level::available() {
        for kind in NN_KINDS.into_iter().chain(CPU_KINDS) {
            for seed in 0..CASES {
                let case = nn_case(kind, seed);
                let expected = case.expected().expect("the reference runs every case");
                let mut cpu =
                    CpuExecutor::with_level(case.graph.clone(), case.weights.clone(), level)
                        .expect("fitting weights");
                let found = case.run(&mut cpu).expect("the CPU executor does not fail");
                if let Some(difference) = case.difference_on_cpu(&expected, &found) {
                    panic!("{}: {difference}", level.name());
                }
            }
        }
    }
}
