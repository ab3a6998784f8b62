//! What happens while a place is taught, on the terminal.

use crate::progress::Progress;
use crate::teach::{Event, Observer};
use crate::units::accuracy;
#[cfg(feature = "train")]
use crate::{train::run::Trained, units::Ruler};
#[cfg(feature = "train")]
use landline::scene_file::Units;

/// Prints results on standard output, progress and times on standard error.
#[derive(Debug, Clone, Copy, Default)]
pub struct Terminal;

/// Shows progress and times on standard error, and leaves standard output to the command.
#[derive(Debug, Clone, Copy, Default)]
pub struct Bars;

impl Observer for Bars {
    fn progress(&self) -> Progress {
        Progress::Terminal
    }

    fn happened(&mut self, event: &Event<'_>) {
        if let Event::Features { pictures, seconds } = event {
            eprintln!("features of {pictures} pictures: {seconds:.1} s");
        }
    }
}

impl Observer for Terminal {
    fn progress(&self) -> Progress {
        Progress::Terminal
    }

    fn happened(&mut self, event: &Event<'_>) {
        match event {
            Event::Features { .. } => Bars.happened(event),
            Event::Turned(turned) => println!("{turned}"),
            Event::Up(Ok(v)) => println!(
                "up                 ({:.4}, {:.4}, {:.4}), from {} segments of {} pictures, {:.2} degrees off for themselves",
                v.up_in_world.x,
                v.up_in_world.y,
                v.up_in_world.z,
                v.num_segments,
                v.num_views,
                v.scatter_rad.to_degrees()
            ),
            Event::Up(Err(why)) => {
                println!("up                 not known: {why} (--up X,Y,Z says it)")
            }
            Event::Labels { stats, seconds } => {
                print!("{stats}");
                println!("  time               {seconds:.1} s");
            }
            Event::Variants(stats) => print!("{stats}"),
            Event::Untrained { held_out, units } => println!(
                "landmarks alone, on {} pictures that they do not know: {}",
                held_out.num_images,
                accuracy(held_out, *units)
            ),
            #[cfg(feature = "train")]
            Event::Trained { trained, units } => print_trained(trained, *units),
            Event::Landmarks(table) => println!(
                "landmarks: {} points and {} lines, {} clusters of views",
                table.point_positions.len(),
                table.line_positions.len(),
                table.num_clusters
            ),
        }
    }
}

#[cfg(feature = "train")]
fn print_trained(trained: &Trained, units: Units) {
    let ruler = Ruler::of(units);
    for judged in &trained.held_out {
        println!(
            "{:?}: {} held-out pictures, best at step {}",
            judged.kind, judged.delivered.poses.num_images, judged.step
        );
        for (when, h) in [("before", &judged.start), ("after", &judged.delivered)] {
            println!(
                "  {when:6} {}, mean {}; features {:.2} px, {:.1} % within 6 px",
                accuracy(&h.poses, units),
                ruler.text(h.score),
                h.median_px,
                100.0 * h.share_within_6px
            );
        }
    }
    println!(
        "trained in {:.0} s, steps {:?}",
        trained.seconds, trained.steps
    );
}
