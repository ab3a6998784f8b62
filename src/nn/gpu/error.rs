//! Why the GPU cannot be used, or no longer.

use crate::nn::NnError;

/// An error of the GPU backend. Each one is a reason to go on with the CPU; the text says it to the user.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// There is no adapter, or the browser has no WebGPU.
    #[error("no GPU adapter: {0}")]
    NoAdapter(String),
    /// The only adapter is a software one, which is slower than the CPU kernels.
    #[error("the only adapter is software ({0}), slower than the CPU")]
    SoftwareAdapter(String),
    /// The adapter offers less than WebGPU guarantees.
    #[error("adapter limit {limit} is {found}, at least {needed} is needed")]
    LimitTooLow {
        /// WebGPU's name of the limit.
        limit: &'static str,
        /// What the adapter has.
        found: u64,
        /// What is needed.
        needed: u64,
    },
    /// The adapter refused to give a device.
    #[error("the adapter gave no device: {0}")]
    NoDevice(String),
    /// A buffer of the network is larger than a binding may be.
    #[error("network `{network}` needs {needed} bytes of {what}, a binding holds {limit}")]
    TooLarge {
        /// Name of the graph.
        network: String,
        /// Which buffer.
        what: &'static str,
        /// Bytes needed.
        needed: u64,
        /// Bytes that the default limits allow.
        limit: u64,
    },
    /// An operation with sizes that its kernel does not support.
    #[error("network `{network}`, {op}: {problem}")]
    Unsupported {
        /// Name of the graph.
        network: String,
        /// Kind of the operation.
        op: &'static str,
        /// What is not supported.
        problem: String,
    },
    /// The driver refused a shader, a pipeline or a command.
    #[error("the driver refused {what}: {message}")]
    Refused {
        /// What was being made.
        what: String,
        /// The driver's text.
        message: String,
    },
    /// The device is gone.
    #[error("the GPU device was lost: {0}")]
    Lost(String),
    /// A result did not arrive in time.
    #[error("the GPU did not answer within {0} ms")]
    MapTimeout(u32),
    /// A result could not be read.
    #[error("the result could not be read: {0}")]
    MapFailed(String),
    /// The self-test gave a wrong answer.
    #[error("the GPU self-test is off by {found:e} where {allowed:e} is allowed ({what})")]
    SelfTest {
        /// Which part.
        what: String,
        /// Largest difference.
        found: f64,
        /// Tolerance.
        allowed: f64,
    },
    /// The network itself is not usable.
    #[error(transparent)]
    Network(#[from] NnError),
}
