//! What can be wrong with a network, its weights, or a call.

/// An error of the network runtime. Texts name the network's part, what was found and what was expected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NnError {
    /// An operation was given tensors that do not fit together.
    #[error("network `{graph}`, operation {node} ({op}): {problem}")]
    BadNode {
        /// Name of the graph.
        graph: String,
        /// Number of the operation in the graph.
        node: usize,
        /// Kind of the operation.
        op: &'static str,
        /// What does not fit.
        problem: String,
    },
    /// The graph as a whole is not usable.
    #[error("network `{graph}`: {problem}")]
    BadGraph {
        /// Name of the graph.
        graph: String,
        /// What is wrong.
        problem: String,
    },
    /// A tensor that the graph names is not among the weights.
    #[error("weight `{name}` is missing; expected shape {expected:?}")]
    MissingWeight {
        /// Name of the weight.
        name: String,
        /// Shape that the graph needs.
        expected: Vec<usize>,
    },
    /// A weight does not have the shape that the graph needs.
    #[error("weight `{name}` has shape {found:?}, expected {expected:?}")]
    WeightShape {
        /// Name of the weight.
        name: String,
        /// Shape found.
        found: Vec<usize>,
        /// Shape that the graph needs.
        expected: Vec<usize>,
    },
    /// A weight's data does not have as many numbers as its shape says.
    #[error("a weight of shape {shape:?} needs {expected} numbers, got {found}")]
    WeightLength {
        /// Shape given.
        shape: Vec<usize>,
        /// Numbers given.
        found: usize,
        /// Numbers that the shape needs.
        expected: usize,
    },
    /// A weight holds a NaN or an infinity.
    #[error("weight `{name}` holds a value that is not finite at position {index}")]
    WeightNotFinite {
        /// Name of the weight.
        name: String,
        /// First such position.
        index: usize,
    },
    /// The graph has no input, output or count of this name.
    #[error("network `{graph}` has no {kind} `{name}`")]
    UnknownName {
        /// Name of the graph.
        graph: String,
        /// `input`, `output` or `count`.
        kind: &'static str,
        /// The name asked for.
        name: String,
    },
    /// More rows than the graph was built for.
    #[error("network `{graph}`: count `{name}` set to {count}, capacity is {capacity}")]
    CountTooLarge {
        /// Name of the graph.
        graph: String,
        /// Name of the count.
        name: String,
        /// Rows asked for.
        count: usize,
        /// Rows there is room for.
        capacity: usize,
    },
    /// A count that the network itself computes cannot be set.
    #[error("network `{graph}`: count `{name}` is computed by the network and cannot be set")]
    CountIsDerived {
        /// Name of the graph.
        graph: String,
        /// Name of the count.
        name: String,
    },
    /// The device that runs the network failed.
    #[error("the device failed: {0}")]
    Device(String),
}
