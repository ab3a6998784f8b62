//! Runs targets for long on a stable compiler: `cargo run --release -p landline-fuzz -- --cases 1000000 --finds DIR [TARGET...]`.

use clap::Parser;
use landline::math::Rng;
use landline_fuzz::{TARGETS, Tried, explore, target};
use std::path::PathBuf;
use std::time::Instant;

#[global_allocator]
static ALLOCATOR: landline_testkit::CountingAllocator = landline_testkit::CountingAllocator;

/// Inputs between two lines of output.
const ROUND: u64 = 20_000;

/// Tries changed inputs on the parsers of outside bytes.
#[derive(Parser)]
struct Args {
    /// Which; all without any.
    targets: Vec<String>,
    /// Changed inputs of each.
    #[arg(long, default_value_t = 1_000_000)]
    cases: u64,
    /// Seed of the changes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for inputs that a parser failed at; it goes on after each.
    #[arg(long, default_value = "target/fuzz-finds")]
    finds: PathBuf,
}

fn main() -> std::io::Result<()> {
    let args = Args::parse();
    let names = args.targets.iter().map(|name| target(name));
    let targets = if args.targets.is_empty() {
        TARGETS.to_vec()
    } else {
        names.collect()
    };
    let mut all = vec![(Tried::default(), 0_u64, 0.0); targets.len()];
    // In turns, so that an interrupted run has tried something of each.
    for round in 0..args.cases.div_ceil(ROUND) {
        for (target, (sum, num_finds, seconds)) in targets.iter().zip(&mut all) {
            let start = Instant::now();
            let mut rng = Rng::from_seed(args.seed.wrapping_add(round << 20));
            let cases = ROUND.min(args.cases - round * ROUND);
            match explore(*target, cases, &mut rng) {
                Ok(tried) => {
                    sum.num_inputs += tried.num_inputs;
                    sum.num_accepted += tried.num_accepted;
                    sum.most_bytes = sum.most_bytes.max(tried.most_bytes);
                }
                Err(find) => {
                    *num_finds += 1;
                    std::fs::create_dir_all(&args.finds)?;
                    let path = args.finds.join(format!("{}-{num_finds}", target.name));
                    std::fs::write(&path, &find.input)?;
                    println!("{}; the input is {}", find.what, path.display());
                }
            }
            *seconds += start.elapsed().as_secs_f64();
            println!(
                "{:<16} {:>11} inputs {:>11} accepted {num_finds:>4} finds {:>10} bytes at most {seconds:>8.1} s",
                target.name, sum.num_inputs, sum.num_accepted, sum.most_bytes
            );
        }
    }
    Ok(())
}
