//! The executor to use on the CPU.

pub use super::oracle::OracleExecutor as CpuExecutor;
