//! A pose for every frame of a video, beside localisation alone: the figures of `docs/benchmarks/tracking.md`.

mod replay;

use anyhow::{Context, Result, bail};
use clap::Parser;
use landline::relocalizer::RelocalizerOptions;
use landline::session::FollowOptions;
use landline_mapper::args::{ExtractorArgs, KernelArgs};
use landline_mapper::dataset::{DataArgs, DatasetImage, Split, open};
use landline_mapper::progress::Progress;
use landline_mapper::scene::{read_scene, relocalizer};
use landline_testkit::room::Look;
use replay::{
    Figures, Located, Replay, Simulation, Video, at_once, locate_all, rendered, replay, soak,
};
use std::path::PathBuf;

/// Play pictures as a video: what stands on the screen with tracking and without.
///
/// The test pictures of a data set are played in their order; `around:10` in place of a data set is a walk of ten seconds through
/// the demo's rendered room, looking around, and `ahead:10` one that turns all the time. A relocalizer with the latency of a browser's is simulated beside.
#[derive(Debug, Parser)]
struct Args {
    /// The scene file.
    scene: PathBuf,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    extractor: ExtractorArgs,
    #[command(flatten)]
    kernels: KernelArgs,
    /// Seed of the rendered room; that of the sample scene when not given.
    #[arg(long, default_value_t = 7)]
    room_seed: u64,
    /// Folder that keeps rendered pictures.
    #[arg(long, default_value = "target/track")]
    work: PathBuf,
    /// Pictures a second.
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Shortest and longest time from a frame to its answer, in milliseconds.
    #[arg(long, num_args = 2, default_values_t = [80.0, 350.0])]
    latency: Vec<f64>,
    /// Write what the follower says about every frame: a table with commas.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the frames' true poses, `NAME QW QX QY QZ TX TY TZ` (camera from world) a line.
    #[arg(long, value_name = "FILE")]
    write_poses: Option<PathBuf>,
    /// Frames with faults of every kind.
    #[arg(long, value_name = "FRAMES")]
    soak: Option<usize>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let (scene, _) = read_scene(&args.scene)?;
    let extractor = args.extractor.read()?;
    let change = |options: &mut RelocalizerOptions| options.kernels = args.kernels.level();
    let mut relocalizer = relocalizer(scene, extractor, change)?;
    let video = video(&args)?;
    if video.pictures.is_empty() {
        bail!("there are no test pictures; choose some with --test (for example --test 800-899)");
    }
    if let Some(path) = &args.write_poses {
        landline_mapper::files::write_bytes(path, video.pose_list().as_bytes())?;
    }
    let bar = Progress::Terminal.bar("locating", video.pictures.len());
    let located = locate_all(&mut relocalizer, &video, || bar.inc(1))?;
    bar.finish();
    let mut options = FollowOptions::default();
    options.tracker.kernels = args.kernels.level();
    let simulation = Simulation {
        fps: args.fps,
        latency_ms: (args.latency[0], args.latency[1]),
        answers_until_ms: f64::INFINITY,
    };
    let played = replay(&video, &located, &simulation, options)?;
    println!("{}", Figures::HEADING);
    let first = played.after.first().map_or(0, |s| s.frame);
    let alone = at_once(&video, &located);
    println!(
        "{}",
        Figures::of(&alone[first..]).row("located by itself, at once")
    );
    println!(
        "{}",
        Figures::of(&played.before).row("before: the last answer")
    );
    println!("{}", Figures::of(&played.after).row("after: tracked"));
    print_times(&args, &played);
    if let Some(path) = &args.csv {
        landline_mapper::files::write_bytes(path, csv(&played).as_bytes())?;
    }
    print_drift(&video, &located, &simulation, options)?;
    print_still(&video, &located, &simulation, options)?;
    if let Some(frames) = args.soak {
        let soak = soak(&video, &located, options, frames)?;
        println!("soak: {soak:?}");
    }
    Ok(())
}

fn video(args: &Args) -> Result<Video> {
    let name = args.data.data.to_str().unwrap_or_default();
    let walk = [("around:", Look::Around), ("ahead:", Look::Ahead)]
        .into_iter()
        .find_map(|(prefix, look)| Some((name.strip_prefix(prefix)?, look)));
    if let Some((seconds, look)) = walk {
        let seconds = seconds.parse().ok().filter(|s| (0.1..=600.0).contains(s));
        let seconds: f64 = seconds
            .with_context(|| format!("{name:?} names no walk; write around:10 for ten seconds"))?;
        let bar = Progress::Terminal.bar("rendering", (seconds * args.fps) as usize);
        return rendered(args.room_seed, look, args.fps, seconds, &args.work, || {
            bar.inc(1)
        });
    }
    let dataset = open(&args.data)?;
    let tests: Vec<&DatasetImage> = dataset
        .of_split(Split::Test)
        .into_iter()
        .map(|i| &dataset.images[i])
        .collect();
    Video::of_images(&tests)
}

/// One line a frame.
fn csv(played: &Replay) -> String {
    let mut text = String::from(
        "frame,state,loss,age_frames,points,found,agree,lines,found,agree,position,rotation_deg,overlay_px,ms\n",
    );
    let first = played.after.first().map_or(0, |s| s.frame);
    for (report, ms) in played.reports.iter().zip(&played.frame_ms) {
        let at = (report.frame as usize).checked_sub(first);
        let shown = at.and_then(|i| played.after.get(i));
        let error = shown.and_then(|s| s.error);
        let pose = report.pose.as_ref();
        let [a, b, c] = pose.map_or([0; 3], |p| p.num_points);
        let [d, e, f] = pose.map_or([0; 3], |p| p.num_lines);
        let number = |v: Option<f64>| v.map_or_else(String::new, |v| format!("{v:.4}"));
        let words = |text: String| text.replace(',', ";");
        text += &format!(
            "{},{},{},{},{a},{b},{c},{d},{e},{f},{},{},{},{ms:.3}\n",
            report.frame,
            words(format!("{:?}", report.state)),
            report.loss.map_or_else(String::new, |l| format!("{l:?}")),
            pose.map_or(0, |p| p.age_frames),
            number(error.map(|e| e.position)),
            number(error.map(|e| e.rotation_deg)),
            number(shown.and_then(|s| s.overlay_px)),
        );
    }
    text
}

fn print_times(args: &Args, played: &Replay) {
    let of = |values: &[f64], q: f64| replay::quantile(&mut values.to_vec(), q).unwrap_or(f64::NAN);
    println!(
        "tracker, {} kernels: a frame {:.2} ms (median), {:.2} ms (99 %); an answer {:.2} ms (median), {:.2} ms (most)",
        args.kernels.level().name(),
        of(&played.frame_ms, 0.5),
        of(&played.frame_ms, 0.99),
        of(&played.answer_ms, 0.5),
        of(&played.answer_ms, 1.0),
    );
    let mut states: Vec<(String, usize)> = Vec::new();
    for report in &played.reports {
        let name = format!("{:?}", report.state);
        match states.iter_mut().find(|(known, _)| *known == name) {
            Some((_, count)) => *count += 1,
            None => states.push((name, 1)),
        }
    }
    println!("states: {states:?}");
}

/// How far the tracker drifts in two seconds without an answer: the movement since the last reference against the true one.
fn print_drift(
    video: &Video,
    located: &[Option<Located>],
    simulation: &Simulation,
    options: FollowOptions,
) -> Result<()> {
    let mut all = Vec::new();
    let length_ms = video.pictures.len() as f64 * 1e3 / simulation.fps;
    let mut until = 0.0;
    while until + 2400.0 < length_ms {
        let cut = Simulation {
            answers_until_ms: until,
            ..*simulation
        };
        let played = replay(video, located, &cut, options)?;
        let at = played
            .last_answer
            .map(|frame| frame + (2.0 * simulation.fps) as usize);
        let pose = at.and_then(|at| {
            let report = played.reports.get(at)?.pose?;
            let from = played.last_answer?;
            let answer = located[from].as_ref()?.pose();
            let truth = |i: usize| video.pictures[i].cam_from_world;
            // The true movement on top of the answer's own pose.
            let moved = truth(at)? * truth(from)?.inverse() * answer;
            Some(report.believed.error_to(&moved))
        });
        all.push((until, pose));
        until += 500.0;
    }
    for (until, drift) in &all {
        match drift {
            Some((distance, angle)) => println!(
                "drift after 2 s without an answer, from {until:.0} ms: {:.2} hundredths, {:.3} deg",
                100.0 * distance,
                angle.to_degrees()
            ),
            None => println!("drift after 2 s without an answer, from {until:.0} ms: no pose"),
        }
    }
    Ok(())
}

/// Movement from frame to frame of a still camera.
fn print_still(
    video: &Video,
    located: &[Option<Located>],
    simulation: &Simulation,
    options: FollowOptions,
) -> Result<()> {
    let Some(frame) = located.iter().position(Option::is_some) else {
        return Ok(());
    };
    let still = video.still(frame, 40, 4.0);
    // One answer; the trembling of answers is not that of the tracker.
    let answers: Vec<Option<Located>> = vec![located[frame].clone(); 40];
    let once = Simulation {
        answers_until_ms: 0.0,
        ..*simulation
    };
    let played = replay(&still, &answers, &once, options)?;
    let mut moved: Vec<f64> = played
        .after
        .windows(2)
        .filter_map(|pair| pair[1].movement_px(&pair[0]))
        .collect();
    let most = replay::quantile(&mut moved, 1.0).unwrap_or(f64::NAN);
    let median = replay::quantile(&mut moved, 0.5).unwrap_or(f64::NAN);
    println!(
        "still camera, noise of 4 levels: {median:.3} px from frame to frame (median), {most:.3} px (most)"
    );
    Ok(())
}
