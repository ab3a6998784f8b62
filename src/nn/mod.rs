//! The network runtime: a fixed list of operations, networks as data, and executors that walk them.
//!
//! * **In and out**: a [`Graph`] made with a [`GraphBuilder`], a set of named [`Weights`], and `f32` input rows; `f32`
//!   output rows come back through an [`Executor`].
//! * **Spaces and units**: none. A tensor is `[rows, channels]`, row-major; a picture is a tensor whose rows are its
//!   pixels (row by row, so NHWC) and which knows its height and width. A 1x1 convolution, a linear layer and a
//!   descriptor set are therefore the same thing.
//! * **Method**: no autodiff, no broadcasting, no dynamic types. What a network needs is in [`Op`]; where the rows are
//!   keypoints or segments their number is a *count* ([`CountId`]) with a capacity that is fixed when the graph is built,
//!   so that a frame with fewer rows runs the same plan.
//! * **Invariants**: a [`Graph`] that exists is valid (shapes fit, every tensor is written before it is read);
//!   [`Executor::run`] allocates nothing; rows past the current count are never read.
//! * **Cost**: [`Graph::macs`] counts multiply-adds, [`plan::Plan`] the bytes of the activations.
//!
//! # Executors
//!
//! [`oracle::OracleExecutor`] is scalar with `f64` accumulation: the definition of every operation, for tests.
//! [`cpu::CpuExecutor`] is the one to use: packed weights, one arena, SIMD. Both implement [`Executor`].
//!
//! # Example
//!
//! A two-layer network on up to 100 rows, run on three.
//!
//! ```
//! use landline::nn::{Activation, Dense, Executor, GraphBuilder, WeightTensor, Weights, cpu::CpuExecutor};
//!
//! let mut g = GraphBuilder::new("example");
//! let points = g.count("points", 100);
//! let x = g.input_rows("descriptors", points, 2);
//! let hidden = g.linear(x, Dense::new("layer.0", 3).activation(Activation::Relu));
//! let y = g.linear(hidden, Dense::new("layer.1", 1));
//! g.output("logit", y);
//! let graph = g.finish()?;
//!
//! let mut weights = Weights::new();
//! weights.insert("layer.0.w", WeightTensor::f32(&[3, 2], vec![1.0, 0.0, 0.0, 1.0, -1.0, 0.0])?);
//! weights.insert("layer.0.b", WeightTensor::f32(&[3], vec![0.0, 0.0, 0.5])?);
//! weights.insert("layer.1.w", WeightTensor::f32(&[1, 3], vec![1.0, 1.0, 1.0])?);
//! weights.insert("layer.1.b", WeightTensor::f32(&[1], vec![0.25])?);
//!
//! let mut net = CpuExecutor::new(graph, weights)?;
//! net.set_count("points", 3)?;
//! net.input("descriptors")?.copy_from_slice(&[1.0, 2.0, -1.0, 0.0, 0.0, -1.0]);
//! net.run()?;
//! assert_eq!(net.output("logit")?, [3.25, 1.75, 0.75]);
//! # Ok::<(), landline::nn::NnError>(())
//! ```

pub mod builder;
pub mod cpu;
pub mod error;
pub mod executor;
#[cfg(feature = "webgpu")]
pub mod gpu;
pub mod graph;
pub mod op;
pub mod oracle;
pub mod plan;
pub mod shape;
pub mod weights;

pub use builder::{Dense, GraphBuilder};
pub use error::NnError;
pub use executor::Executor;
pub use graph::{Graph, Node};
pub use op::{Activation, AxisMap, CHOICE_STATISTICS, Filter, Op};
pub use shape::{CountId, Grid, Rows, Tensor, ValueId, WeightId};
pub use weights::{WeightData, WeightTensor, Weights};
