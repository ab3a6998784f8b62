//! Thousands of frames with everything that goes wrong: hands over the lens, blur, darkness, cuts, a camera that hangs, times
//! that run backwards, another size.

use super::{Located, Video, hand_over};
use anyhow::{Context, Result};
use landline::image::{FrameView, PixelFormat};
use landline::math::Rng;
use landline::session::{FollowOptions, FollowPose, FollowReport, FollowState, Follower};

/// What a soak gives.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Soak {
    /// Frames.
    pub(crate) num_frames: usize,
    /// Frames whose picture was usable, and those of them with a pose.
    pub(crate) usable: (usize, usize),
    /// Things that went wrong.
    pub(crate) num_faults: usize,
    /// Most answers that were needed after a fault until there was a pose again.
    pub(crate) most_answers: usize,
    /// Poses further than a tenth of a unit or five degrees from the truth: of usable frames, and of the others.
    pub(crate) wrong: (usize, usize),
    /// Bytes of kept pictures after a tenth of the frames, and at the end.
    pub(crate) bytes: [usize; 2],
    /// Whether every state came and went.
    pub(crate) num_states: usize,
}

/// What is wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    None,
    Hand,
    Dark,
    Blur,
    Hang,
    Backwards,
    Half,
    Cut,
}

const FAULTS: [Fault; 6] = [
    Fault::Hand,
    Fault::Dark,
    Fault::Blur,
    Fault::Hang,
    Fault::Backwards,
    Fault::Half,
];

/// Runs a video back and forth for so many frames, with faults at random and an answer every sixth frame, four frames late.
///
/// # Errors
/// When a frame is refused, which none should be.
pub(crate) fn soak(
    video: &Video,
    located: &[Option<Located>],
    options: FollowOptions,
    num_frames: usize,
) -> Result<Soak> {
    let mut rng = Rng::from_seed(11);
    let mut follower = Follower::new(options);
    let mut out = Soak {
        num_frames,
        ..Soak::default()
    };
    let mut states: Vec<FollowState> = Vec::new();
    let (mut at, mut forth) = (0_usize, true);
    let (mut fault, mut left) = (Fault::None, 0_usize);
    let mut now_ms = 0.0;
    // Shown picture and number of a frame under way, and when its answer arrives.
    let mut under_way: Option<(usize, u64, usize)> = None;
    let (mut answers, mut is_waiting) = (0, false);
    let mut bytes = Vec::new();
    // The last thing that went wrong, and the last frame that had it.
    let mut last_fault = (Fault::None, 0);
    for i in 0..num_frames {
        if left > 0 {
            left -= 1;
        } else if fault != Fault::None {
            (fault, is_waiting, answers) = (Fault::None, true, 0);
        } else if rng.below(60) == 0 {
            fault = FAULTS[rng.below(FAULTS.len() as u32) as usize];
            left = 1 + rng.below(40) as usize;
            out.num_faults += 1;
        } else if rng.below(200) == 0 {
            // A cut.
            at = rng.below(video.pictures.len() as u32) as usize;
            out.num_faults += 1;
            last_fault = (Fault::Cut, i);
            (is_waiting, answers) = (true, 0);
        }
        if fault != Fault::None {
            last_fault = (fault, i);
        }
        if let Some((shown, frame, due)) = under_way
            && i >= due
        {
            under_way = None;
            match &located[shown] {
                Some(answer) => {
                    hand_over(&mut follower, answer, frame);
                    answers += usize::from(fault == Fault::None);
                }
                None => follower.not_located(frame),
            }
        }
        if fault != Fault::Hang {
            let last = video.pictures.len() - 1;
            forth = (forth || at == 0) && at != last;
            at = if forth { at + 1 } else { at - 1 };
        }
        now_ms += if fault == Fault::Backwards {
            -20.0
        } else {
            33.3
        };
        let picture = &video.pictures[at];
        let view = picture.view();
        bytes.clear();
        bytes.extend_from_slice(view.bytes);
        let frame = disturbed(&view, fault, &mut bytes);
        let report = follower
            .frame(&frame, now_ms, None)
            .with_context(|| format!("frame {i}"))?;
        if !states.contains(&report.state) {
            states.push(report.state);
        }
        if under_way.is_none() && i % 6 == 0 && fault == Fault::None {
            follower.hold(report.frame);
            under_way = Some((at, report.frame, i + 4));
        }
        let is_usable = matches!(fault, Fault::None | Fault::Backwards);
        if is_usable {
            out.usable.0 += 1;
            out.usable.1 += usize::from(report.pose.is_some());
        }
        if let Some(pose) = &report.pose {
            if is_waiting && fault == Fault::None {
                out.most_answers = out.most_answers.max(answers);
                is_waiting = false;
            }
            if let Some(truth) = &picture.cam_from_world {
                let (distance, angle) = pose.cam_from_world.error_to(truth);
                if distance > 0.1 || angle.to_degrees() > 5.0 {
                    let count = if is_usable {
                        &mut out.wrong.0
                    } else {
                        &mut out.wrong.1
                    };
                    *count += 1;
                    print_wrong(i, last_fault, pose, &report, (distance, angle));
                }
            }
        }
        if i + 1 == num_frames / 10 {
            out.bytes[0] = follower.picture_bytes();
        }
    }
    out.bytes[1] = follower.picture_bytes();
    out.num_states = states.len();
    Ok(out)
}

/// What the follower believed of a pose that is far off.
fn print_wrong(
    i: usize,
    (fault, at): (Fault, usize),
    pose: &FollowPose,
    report: &FollowReport,
    (distance, angle): (f64, f64),
) {
    let sigma = |first: usize| pose.covariance.diagonal().rows(first, 3).sum().sqrt();
    println!(
        "wrong: frame {i}, {fault:?} {} frames ago, {:.1} hundredths and {:.2} deg off, believed to {:.1} and {:.2}; {:?}, points {:?}, lines {:?}, {} frames after the answer's",
        i - at,
        100.0 * distance,
        angle.to_degrees(),
        100.0 * sigma(3),
        sigma(0).to_degrees(),
        report.state,
        pose.num_points,
        pose.num_lines,
        pose.age_frames,
    );
}

/// A frame with its fault, in a buffer that holds the picture.
fn disturbed<'a>(view: &FrameView<'_>, fault: Fault, bytes: &'a mut Vec<u8>) -> FrameView<'a> {
    let (mut width, mut height, mut stride) = (view.width, view.height, view.stride);
    match fault {
        Fault::None | Fault::Hang | Fault::Backwards | Fault::Cut => {}
        Fault::Hand => bytes.fill(93),
        Fault::Dark => bytes.iter_mut().for_each(|v| *v /= 40),
        Fault::Blur => {
            // A running mean over 31 pixels of each row.
            for row in bytes.chunks_exact_mut(stride) {
                let before = row.to_vec();
                for (i, v) in row.iter_mut().enumerate() {
                    let around = (0..31).map(|k| (i + 3 * k).saturating_sub(45));
                    let channel = |j: usize| (j / 3 * 3 + i % 3).min(before.len() - 1);
                    let sum: u32 = around.map(|j| u32::from(before[channel(j)])).sum();
                    *v = (sum / 31) as u8;
                }
            }
        }
        Fault::Half => {
            (width, height, stride) = (
                view.width / 2,
                view.height / 2,
                3 * (view.width as usize / 2),
            );
            bytes.truncate(stride * height as usize);
        }
    }
    FrameView {
        bytes,
        width,
        height,
        stride,
        format: PixelFormat::Rgb8,
    }
}
