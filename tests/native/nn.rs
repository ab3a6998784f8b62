//! Every operation of the CPU executor against the reference, on every instruction set of this machine.

use landline::math::Rng;
use landline::nn::{
    Dense, Executor, GraphBuilder, NnError,
    cpu::{CpuExecutor, Level},
};
use landline_testkit::{CPU_KINDS, NN_KINDS, nn_case, random_weights};

const CASES: u64 = 60;

#[test]
fn every_operation_agrees_with_the_reference() {
    for level in Level::available() {
        for kind in NN_KINDS.into_iter().chain(CPU_KINDS) {
            for seed in 0..CASES {
                let case = nn_case(kind, seed);
                let expected = case.expected().expect("the reference runs every case");
                let mut cpu =
                    CpuExecutor::with_level(case.graph.clone(), case.weights.clone(), level)
                        .expect("fitting weights");
                // Twice: a run must not depend on what the last one left behind.
                for _ in 0..2 {
                    let found = case.run(&mut cpu).expect("the CPU executor does not fail");
                    if let Some(difference) = case.difference_on_cpu(&expected, &found) {
                        panic!("{}: {difference}", level.name());
                    }
                }
            }
        }
    }
}

#[test]
fn a_wrong_row_is_noticed() {
    let mut noticed = 0;
    for seed in 0..CASES {
        let case = nn_case("linear", seed);
        let expected = case.expected().expect("the reference runs every case");
        let columns = case.graph.outputs()[0].tensor.channels;
        if expected[0].1.len() > columns {
            let mut wrong = expected.clone();
            wrong[0].1.rotate_left(columns);
            noticed += u32::from(case.difference_on_cpu(&expected, &wrong).is_some());
        }
    }
    assert!(noticed > 20, "only {noticed} shifted results were noticed");
}

#[test]
fn fewer_rows_do_not_change_the_others() {
    let graph = |capacity: usize| {
        let mut g = GraphBuilder::new("rows");
        let n = g.count("n", capacity);
        let x = g.input_rows("x", n, 40);
        let q = g.linear(x, Dense::new("q", 32));
        let attended = g.attention([q, q, q], 2, 0.25, None);
        let y = g.linear(attended, Dense::new("y", 5));
        g.output("y", y);
        g.finish().expect("a valid network")
    };
    let mut rng = Rng::from_seed(3);
    let weights = random_weights(&graph(1), &mut rng);
    let input: Vec<f32> = (0..40 * 21).map(|_| rng.range(-1.0, 1.0) as f32).collect();
    let mut outputs = Vec::new();
    for capacity in [21, 100, 1000] {
        let mut cpu = CpuExecutor::new(graph(capacity), weights.clone()).expect("fitting weights");
        cpu.set_count("n", 21).expect("within the capacity");
        cpu.input("x").expect("an input").copy_from_slice(&input);
        cpu.run().expect("the CPU executor does not fail");
        outputs.push(cpu.output("y").expect("an output").to_vec());
        assert!(matches!(
            cpu.set_count("n", capacity + 1),
            Err(NnError::CountTooLarge { count, .. }) if count == capacity + 1
        ));
    }
    assert_eq!(outputs[0], outputs[1]);
    assert_eq!(outputs[0], outputs[2]);
}

#[test]
fn refuses_weights_that_do_not_fit() {
    let mut g = GraphBuilder::new("small");
    let n = g.count("n", 4);
    let x = g.input_rows("x", n, 3);
    let y = g.linear(x, Dense::new("layer", 2));
    g.output("y", y);
    let graph = g.finish().expect("a valid network");
    let mut weights = random_weights(&graph, &mut Rng::from_seed(1));
    let taken = weights.remove("layer.b").expect("the bias");
    assert!(matches!(
        CpuExecutor::new(graph.clone(), weights.clone()),
        Err(NnError::MissingWeight { name, .. }) if name == "layer.b"
    ));
    weights.insert("layer.b", taken);
    let mut cpu = CpuExecutor::new(graph, weights).expect("fitting weights");
    assert!(matches!(
        cpu.output("z"),
        Err(NnError::UnknownName { kind: "output", .. })
    ));
    assert!(matches!(
        cpu.input("z"),
        Err(NnError::UnknownName { kind: "input", .. })
    ));
}
