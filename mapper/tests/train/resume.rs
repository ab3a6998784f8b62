//! An interrupted run that goes on ends with the tensors of one that was not interrupted.

use crate::parity::{folder, options};
use crate::room;
use landline::models::Preset;
use landline_mapper::train::cpu_device;
use landline_mapper::train::run::{Control, RunOptions, TrainError, Trained, train};
use std::path::Path;

fn run(
    options: &RunOptions,
    folder: &Path,
    resume: bool,
    stop_at: usize,
) -> Result<Trained, TrainError> {
    let control = Control {
        resume,
        stop: &|steps| steps == stop_at,
    };
    train(&room::labels(8), options, folder, &control, &cpu_device())
}

#[test]
fn a_resumed_run_ends_as_a_whole_one() {
    for (name, preset, network) in [
        ("compact", Preset::Compact, &[][..]),
        (
            "standard",
            Preset::Standard,
            &["point.width=16", "line.width=16"][..],
        ),
    ] {
        let options = RunOptions {
            hold_out_every: 4,
            ..options(preset, 20, network)
        };
        let whole_folder = folder(&format!("whole-{name}"));
        let whole = run(&options, &whole_folder, false, usize::MAX).expect("trains");
        assert_eq!(whole.held_out.len(), 2);
        assert_eq!(whole.held_out[0].delivered.poses.num_images, 2);

        // Once in the first branch, between two judgements, and once in the second.
        let cut_folder = folder(&format!("cut-{name}"));
        for (resume, stop_at) in [(false, 7), (true, whole.steps[0].1 + 5)] {
            let stopped = run(&options, &cut_folder, resume, stop_at).err();
            assert!(
                matches!(stopped, Some(TrainError::Stopped { .. })),
                "{name}: not stopped at step {stop_at} but {stopped:?}"
            );
        }
        let resumed = run(&options, &cut_folder, true, usize::MAX).expect("goes on");
        assert_eq!(whole.steps, resumed.steps);
        for ((spec, a), (_, b)) in whole.tensors.iter().zip(&resumed.tensors) {
            assert_eq!(a, b, "{name}: {} differs", spec.name);
        }
        assert_eq!(whole.held_out, resumed.held_out);
        for file in [
            "options.json",
            "log.csv",
            "curves.svg",
            "checkpoint.safetensors",
        ] {
            assert!(cut_folder.join(file).exists(), "{file} is missing");
        }

        let control = Control {
            resume: true,
            stop: &|_| false,
        };
        let another_room = train(
            &room::labels(9),
            &options,
            &cut_folder,
            &control,
            &cpu_device(),
        );
        let message = another_room.err().map_or(String::new(), |e| e.to_string());
        assert!(
            message.contains("other pictures, features or tracks"),
            "{name}: {message}"
        );
        let other = RunOptions { seed: 6, ..options };
        let refused = run(&other, &cut_folder, true, usize::MAX).err();
        assert!(
            matches!(refused, Some(TrainError::OtherRun { .. })),
            "{name}: another seed is another run, not {refused:?}"
        );
        for f in [whole_folder, cut_folder] {
            std::fs::remove_dir_all(f).expect("made by the runs");
        }
    }
}
