//! One target for a while: its seeds, and changes of them.

use crate::{Target, mutated};
use landline::math::Rng;
use landline_testkit::peak_bytes;
use std::panic::catch_unwind;

/// No input here is larger than some kilobytes, and none has a right to more.
const MAX_BYTES: usize = 64 << 20;

/// What was tried.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tried {
    /// Inputs, seeds among them.
    pub num_inputs: u64,
    /// Inputs that the parser accepted.
    pub num_accepted: u64,
    /// Most memory that one took, where an allocator counts.
    pub most_bytes: usize,
}

/// Why an input is a find.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Find {
    /// What went wrong.
    pub what: String,
    /// The input.
    pub input: Vec<u8>,
}

/// Runs the seeds and `cases` changed inputs, spread over the seeds; stops at the first find.
///
/// # Errors
/// The find.
pub fn explore(target: Target, cases: u64, rng: &mut Rng) -> Result<Tried, Find> {
    let mut tried = Tried::default();
    let seeds = (target.seeds)();
    for seed in &seeds {
        one(target, seed, &mut tried)?;
    }
    for i in 0..cases {
        let seed = &seeds[(i % seeds.len() as u64) as usize];
        one(target, &mutated(seed, rng), &mut tried)?;
    }
    Ok(tried)
}

fn one(target: Target, input: &[u8], tried: &mut Tried) -> Result<(), Find> {
    let find = |what: String| Find {
        what: format!("{}: {what}", target.name),
        input: input.to_vec(),
    };
    let (accepted, peak) = peak_bytes(|| catch_unwind(|| (target.run)(input)));
    let accepted = accepted.map_err(|_| find("panicked".to_owned()))?;
    if peak > MAX_BYTES {
        return Err(find(format!("took {peak} bytes")));
    }
    tried.num_inputs += 1;
    tried.num_accepted += u64::from(accepted);
    tried.most_bytes = tried.most_bytes.max(peak);
    Ok(())
}
