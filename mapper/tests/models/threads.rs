//! The native tool computes networks on all threads; how many there are must not show in the result.

use crate::memory::noise;
use landline::models::{ExtractorKind, PointBranchConfig, Preset, RegressorConfig, ports};
use landline::nn::cpu::{CpuExecutor, Level};
use landline::nn::{Executor, Graph, Weights};

/// All outputs of one run, made and run in a pool of so many threads.
fn outputs(graph: &Graph, weights: &Weights, level: Level, threads: usize) -> Vec<Vec<f32>> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads start");
    pool.install(|| {
        let mut cpu =
            CpuExecutor::with_level(graph.clone(), weights.clone(), level).expect("weights fit");
        for port in graph.inputs() {
            let numbers = cpu.input(&port.name).expect("an input");
            for (index, number) in numbers.iter_mut().enumerate() {
                *number = (index * 7919 % 1009) as f32 / 1009.0 - 0.5;
            }
        }
        cpu.run().expect("runs");
        let ports = graph.outputs().iter();
        ports
            .map(|port| cpu.output(&port.name).expect("an output").to_vec())
            .collect()
    })
}

fn branch(preset: Preset) -> PointBranchConfig {
    let config = RegressorConfig::preset(preset, 64);
    let RegressorConfig::Branches { mut point, .. } = config else {
        panic!("the presets have branches")
    };
    if let PointBranchConfig::Attention(c) = &mut point {
        c.min_confidence = 0.0;
    }
    point
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let kind = ExtractorKind::Xfeat;
    let mut networks = vec![(
        kind.graph(320, 224, false).expect("builds"),
        noise(kind.tensors()),
    )];
    for preset in [Preset::Standard, Preset::Compact] {
        let point = branch(preset);
        let made = point
            .prepare(&mut noise(point.tensors()))
            .expect("prepares");
        networks.push((point.graph(301).expect("builds"), made));
    }
    for (graph, weights) in &networks {
        for level in Level::available() {
            let alone = outputs(graph, weights, level, 1);
            assert!(alone.iter().flatten().all(|x| x.is_finite()));
            for threads in [2, 3, 7] {
                let together = outputs(graph, weights, level, threads);
                assert!(
                    together == alone,
                    "{} on {threads} threads, {}",
                    graph.name(),
                    level.name()
                );
            }
        }
    }
    assert!(
        networks[1]
            .0
            .outputs()
            .iter()
            .any(|p| p.name == ports::COORDINATES)
    );
}
