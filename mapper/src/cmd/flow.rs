//! `landline flow`: where points of one picture are in another.

use crate::args::KernelArgs;
use crate::picture;
use anyhow::{Context, Result, bail};
use landline::geometry::Pixel;
use landline::math::stats::median_in_place;
use landline::tracker::{Flow, PointFlow};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Instant;

/// Find points of a picture in another one, by the tracker's patches; prints JSON.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The first picture.
    from: PathBuf,
    /// The second one, of the same size.
    to: PathBuf,
    /// Points of the first: lines `x y`, the centre of the first pixel being (0.5, 0.5).
    #[arg(long, value_name = "FILE")]
    points: PathBuf,
    /// Leave out the way back.
    #[arg(long)]
    no_way_back: bool,
    /// Do it so often, and tell the median time.
    #[arg(long, default_value_t = 1)]
    repeat: usize,
    #[command(flatten)]
    kernels: KernelArgs,
}

/// Finds.
///
/// # Errors
/// When a file cannot be read.
pub fn run(args: Args) -> Result<()> {
    let (from, to) = (
        picture::read_gray(&args.from)?,
        picture::read_gray(&args.to)?,
    );
    if (from.width, from.height) != (to.width, to.height) {
        bail!(
            "the pictures are {}x{} and {}x{} pixels; they must be of one size",
            from.width,
            from.height,
            to.width,
            to.height
        );
    }
    let text = std::fs::read_to_string(&args.points)
        .with_context(|| format!("reading {}", args.points.display()))?;
    let mut points = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let numbers: Vec<f64> = line
            .split_whitespace()
            .map_while(|v| v.parse().ok())
            .collect();
        let [x, y] = numbers[..] else {
            bail!("{}, line {}: not two numbers", args.points.display(), i + 1);
        };
        points.push(Pixel::new(x, y));
    }
    let (mut flow, mut flows) = (PointFlow::default(), Vec::new());
    let kernels = args.kernels.level();
    let mut times_ms = Vec::new();
    for _ in 0..args.repeat.max(1) {
        let start = Instant::now();
        flow.load(&from.view(), &to.view(), kernels)?;
        flow.find(&points, !args.no_way_back, kernels, &mut flows);
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    let one = |flow: &Option<Flow>| -> Value {
        flow.map_or(Value::Null, |f| {
            json!([f.pixel.x, f.pixel.y, f.correlation, f.way_back_px])
        })
    };
    println!(
        "{}",
        json!({
            "kernels": kernels.name(),
            "ms": median_in_place(&mut times_ms),
            "points": flows.iter().map(one).collect::<Vec<_>>(),
        })
    );
    Ok(())
}
