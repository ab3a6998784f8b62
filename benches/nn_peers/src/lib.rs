//! The networks behind plain functions, so that Node and Python can time them beside other engines.
//!
//! `networks.py` makes weights and inputs, `wasm.mjs` and `native.py` run this library and its peers in one process.
#![expect(
    unsafe_code,
    reason = "exported functions that take pointers from the host"
)]

mod memory;

use std::cell::RefCell;

use landline::{
    models::{ExtractorKind, Preset, RegressorConfig},
    nn::{Dense, Executor, GraphBuilder, Rows, WeightTensor, Weights, cpu::CpuExecutor},
};
use rten_gemm::{GemmExecutor, GemmInputA, GemmInputB};
use rten_tensor::NdTensorView;

/// Something to time.
enum Engine {
    Network(Box<CpuExecutor>),
    /// Left and right matrix, result, sizes m and k.
    Rten(Box<RtenGemm>),
}

struct RtenGemm {
    gemm: GemmExecutor<f32, f32, f32>,
    a: Vec<f32>,
    b: rten_gemm::PackedBMatrix<f32>,
    c: Vec<f32>,
    sizes: [usize; 2],
}

thread_local! {
    static ENGINES: RefCell<Vec<Engine>> = const { RefCell::new(Vec::new()) };
}

/// Room for `len` bytes, never freed.
#[unsafe(no_mangle)]
pub extern "C" fn reserve(len: usize) -> *mut u8 {
    // Aligned for f32.
    Box::leak(vec![0_f32; len.div_ceil(4)].into_boxed_slice())
        .as_mut_ptr()
        .cast()
}

fn weights_from(bytes: &[u8]) -> Weights {
    let file =
        safetensors::SafeTensors::deserialize(bytes).expect("a safetensors file of networks.py");
    let tensors = file.tensors().into_iter().map(|(name, view)| {
        let numbers = view
            .data()
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let tensor =
            WeightTensor::f32(view.shape(), numbers.collect()).expect("the file's own shape");
        (name, tensor)
    });
    tensors.collect()
}

fn add_engine(engine: Engine) -> usize {
    ENGINES.with_borrow_mut(|engines| {
        engines.push(engine);
        engines.len() - 1
    })
}

fn network<T>(handle: usize, f: impl FnOnce(&mut CpuExecutor) -> T) -> T {
    ENGINES.with_borrow_mut(|engines| match &mut engines[handle] {
        Engine::Network(executor) => f(executor),
        Engine::Rten(_) => panic!("engine {handle} is not a network"),
    })
}

/// A network: 0 XFeat or 1 SuperPoint for a picture of this size, 2 the point or 3 the line branch of the paper for `width`
/// elements, all of which are kept; weights are a safetensors file.
///
/// # Safety
/// `weights` points to `len` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn network_new(
    kind: usize,
    width: usize,
    height: usize,
    weights: *const u8,
    len: usize,
) -> usize {
    // SAFETY: the caller's promise.
    let mut weights = weights_from(unsafe { std::slice::from_raw_parts(weights, len) });
    let executor = match kind {
        0 | 1 => {
            let kind = [ExtractorKind::Xfeat, ExtractorKind::SuperPointV1][kind];
            let graph = kind.graph(width, height, true).expect("a valid size");
            CpuExecutor::new(graph, weights)
        }
        _ => {
            let RegressorConfig::Branches { point, line } =
                memory::keeping_all(RegressorConfig::preset(Preset::Paper, 256))
            else {
                panic!("the preset has branches");
            };
            let (graph, weights) = match line {
                Some(line) if kind == 3 => (line.graph(width), line.prepare(&mut weights)),
                _ => (point.graph(width), point.prepare(&mut weights)),
            };
            CpuExecutor::new(
                graph.expect("a valid size"),
                weights.expect("fitting weights"),
            )
        }
    };
    add_engine(Engine::Network(Box::new(
        executor.expect("fitting weights"),
    )))
}

/// A single 3x3 convolution with ReLU, random weights.
#[unsafe(no_mangle)]
pub extern "C" fn convolution_new(
    height: usize,
    width: usize,
    channels: usize,
    out: usize,
    stride: usize,
) -> usize {
    let mut g = GraphBuilder::new("conv");
    let x = g.input_grid("x", height, width, channels);
    let layer = Dense::new("l", out)
        .stride(stride)
        .activation(landline::nn::Activation::Relu);
    let y = g.conv3x3(x, layer);
    g.output("y", y);
    let graph = g.finish().expect("a valid graph");
    let mut weights = Weights::new();
    let w = pattern(out * channels * 9);
    weights.insert(
        "l.w",
        WeightTensor::f32(&[out, channels, 3, 3], w).expect("sizes agree"),
    );
    weights.insert(
        "l.b",
        WeightTensor::f32(&[out], pattern(out)).expect("sizes agree"),
    );
    add_engine(Engine::Network(Box::new(
        CpuExecutor::new(graph, weights).expect("fitting weights"),
    )))
}

/// A single matrix product `[m, k] x [k, n]`, ours or rten's.
#[unsafe(no_mangle)]
pub extern "C" fn product_new(m: usize, k: usize, n: usize, rten: bool) -> usize {
    if rten {
        let gemm = GemmExecutor::default();
        let b = pattern(k * n);
        let view = NdTensorView::from_data([k, n], &b[..]);
        let b = gemm.prepack_b(view);
        let engine = RtenGemm {
            gemm,
            a: pattern(m * k),
            b,
            c: vec![0.0; m * n],
            sizes: [m, k],
        };
        return add_engine(Engine::Rten(Box::new(engine)));
    }
    let mut g = GraphBuilder::new("product");
    let x = g.input("x", Rows::Fixed(m), k, None);
    let y = g.linear(x, Dense::new("l", n).without_bias());
    g.output("y", y);
    let mut weights = Weights::new();
    weights.insert(
        "l.w",
        WeightTensor::f32(&[n, k], pattern(n * k)).expect("sizes agree"),
    );
    let graph = g.finish().expect("a valid graph");
    add_engine(Engine::Network(Box::new(
        CpuExecutor::new(graph, weights).expect("fitting weights"),
    )))
}

fn pattern(len: usize) -> Vec<f32> {
    (0..len as u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 16) as f32 / 32_768.0 - 1.0)
        .collect()
}

/// Copies `input` into the network's first input and runs it; null keeps what is there.
///
/// # Safety
/// `input` is null or points to as many numbers as the input has.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn run(handle: usize, input: *const f32) {
    ENGINES.with_borrow_mut(|engines| match &mut engines[handle] {
        Engine::Network(executor) => {
            if !input.is_null() {
                let name = executor.graph().inputs()[0].name.clone();
                let to = executor.input(&name).expect("the graph's own input");
                // SAFETY: the caller's promise.
                to.copy_from_slice(unsafe { std::slice::from_raw_parts(input, to.len()) });
            }
            executor.run().expect("the CPU executor does not fail");
        }
        Engine::Rten(work) => {
            let RtenGemm {
                gemm,
                a,
                b,
                c,
                sizes: [m, k],
            } = &mut **work;
            let a = NdTensorView::from_data([*m, *k], &a[..]);
            gemm.gemm(
                c,
                GemmInputA::Unpacked(a),
                GemmInputB::Packed(b),
                Default::default(),
            )
            .expect("sizes agree");
        }
    });
}

/// Runs one operation alone.
#[unsafe(no_mangle)]
pub extern "C" fn run_node(handle: usize, node: usize) {
    network(handle, |executor| executor.run_node(node));
}

/// Number of operations.
#[unsafe(no_mangle)]
pub extern "C" fn num_nodes(handle: usize) -> usize {
    network(handle, |executor| executor.graph().nodes().len())
}

/// Multiply-adds of an operation, in thousands.
#[unsafe(no_mangle)]
pub extern "C" fn node_kilo_macs(handle: usize, node: usize) -> usize {
    network(handle, |executor| {
        let graph = executor.graph();
        (graph.node_macs(&graph.nodes()[node], &graph.capacities()) / 1000) as usize
    })
}

/// Name of an operation: pointer to a byte string that ends with a zero, never freed.
#[unsafe(no_mangle)]
pub extern "C" fn node_label(handle: usize, node: usize) -> *const u8 {
    network(handle, |executor| {
        let node = &executor.graph().nodes()[node];
        let text = format!("{} {}\0", node.op.name(), node.label);
        Box::leak(text.into_bytes().into_boxed_slice()).as_ptr()
    })
}

/// Start of an output by number (in the order of the graph) after a run.
#[unsafe(no_mangle)]
pub extern "C" fn output(handle: usize, index: usize) -> *const f32 {
    network(handle, |executor| {
        let name = executor.graph().outputs()[index].name.clone();
        executor
            .output(&name)
            .expect("the graph's own output")
            .as_ptr()
    })
}

/// Bytes held: weights, activations, scratch (`part` 0, 1, 2).
#[unsafe(no_mangle)]
pub extern "C" fn bytes(handle: usize, part: usize) -> usize {
    network(handle, |executor| {
        let memory = executor.memory();
        [memory.weights, memory.arena, memory.scratch][part]
    })
}
