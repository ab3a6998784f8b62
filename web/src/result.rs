//! Results as flat numbers. The layout is read by `web/ts/decode.ts`; change both and the version together.
//!
//! | from | what |
//! | --- | --- |
//! | 0 | layout version |
//! | 1 | 1 when located |
//! | 2 | code of the reason when not |
//! | 3, 4 | code of the state over frames, code of what limits it |
//! | 5 | `cam_from_world`, 16 numbers row-major; smoothed when smoothing is on |
//! | 21 | the same before smoothing; NaN when smoothing is off |
//! | 37 | fx, fy, cx, cy, width, height, code of the source, relative standard deviation or NaN |
//! | 45 | keypoints, segments, point and line correspondences, point and line inliers, median error, confidence |
//! | 53 | 1 when a covariance follows; 36 numbers row-major |
//! | 90 | milliseconds: preprocess, features, lines, regress, solve, total |
//! | 96 | code of the backend |
//! | 97 | numbers of points, lines and segments that follow |
//! | 100 | 1 when the frame contradicts the intrinsics that came with it; degrees clockwise of the reason `turned` |
//! | 102 | points: pixel, world, confidence, inlier (7 each); lines: ends in pixels, ends in the world, confidence, inlier (12 each); segments: ends (4 each) |

use landline::geometry::CamFromWorld;
use landline::relocalizer::{CameraSource, NotLocated, Outcome, Relocalizer};
use landline::session::{LimitedReason, SessionReport, SessionState};

/// Must equal `layoutVersion` in `web/ts/decode.ts`.
const LAYOUT_VERSION: f64 = 2.0;
const HEADER: usize = 102;
/// Numbers of a point and of a line.
const POINT: usize = 7;
const LINE: usize = 12;

/// Bits of what to include.
pub(crate) const POINTS: u32 = 1;
pub(crate) const LINES: u32 = 2;
pub(crate) const SEGMENTS: u32 = 4;

/// Writes a report and the lists that were asked for.
pub(crate) fn encode(
    relocalizer: &Relocalizer,
    answer: &SessionReport,
    include: u32,
    out: &mut Vec<f64>,
) {
    let report = &answer.frame;
    out.clear();
    out.resize(HEADER, 0.0);
    let mut put = |at: usize, values: &[f64]| {
        if let Some(room) = out.get_mut(at..at + values.len()) {
            room.copy_from_slice(values);
        }
    };
    put(0, &[LAYOUT_VERSION]);
    put(21, &[f64::NAN; 16]);
    match &report.outcome {
        Outcome::NotLocated(reason) => put(2, &[reason_code(*reason)]),
        Outcome::Located(found) => {
            put(1, &[1.0]);
            let raw = &found.cam_from_world;
            put(5, &answer.smoothed.as_ref().unwrap_or(raw).to_row_major());
            if answer.smoothed.is_some() {
                put(21, &CamFromWorld::to_row_major(raw));
            }
            put(51, &[found.median_error_px, found.confidence, 1.0]);
            for r in 0..6 {
                for c in 0..6 {
                    put(54 + 6 * r + c, &[found.estimate.covariance[(r, c)]]);
                }
            }
        }
    }
    let (state, limited) = state_codes(answer.state);
    put(3, &[state, limited]);
    let (fx, fy) = report.camera.focal_px();
    let center = report.camera.principal_point();
    let (width, height) = (
        f64::from(report.camera.width),
        f64::from(report.camera.height),
    );
    let source = source_code(report.camera_source);
    let sigma = report.focal_sigma_ln.unwrap_or(f64::NAN);
    put(
        37,
        &[fx, fy, center.x, center.y, width, height, source, sigma],
    );
    let n = report.counts;
    let counts = [
        n.num_keypoints,
        n.num_segments,
        n.num_point_correspondences,
        n.num_line_correspondences,
        n.num_point_inliers,
        n.num_line_inliers,
    ];
    put(45, &counts.map(|n| n as f64));
    let t = report.timings;
    let timings = [
        t.preprocess_ms,
        t.features_ms,
        t.lines_ms,
        t.regress_ms,
        t.solve_ms,
        t.total_ms,
    ];
    put(90, &timings);
    put(100, &[f64::from(u8::from(report.has_focal_mismatch))]);
    put(96, &[f64::from(u8::from(report.on_gpu))]);
    if include & POINTS != 0 {
        put(97, &[n.num_point_correspondences as f64]);
    }
    if include & LINES != 0 {
        put(98, &[n.num_line_correspondences as f64]);
    }
    if include & SEGMENTS != 0 {
        put(99, &[relocalizer.segments().count() as f64]);
    }
    if include & POINTS != 0 {
        for (c, is_inlier) in relocalizer.points() {
            out.extend([c.pixel.x, c.pixel.y]);
            out.extend(c.point_in_world.iter());
            out.extend([f64::from(c.confidence), f64::from(u8::from(is_inlier))]);
        }
    }
    if include & LINES != 0 {
        for (c, is_inlier) in relocalizer.lines() {
            out.extend([c.start.x, c.start.y, c.end.x, c.end.y]);
            out.extend(c.start_in_world.iter());
            out.extend(c.end_in_world.iter());
            out.extend([f64::from(c.confidence), f64::from(u8::from(is_inlier))]);
        }
    }
    if include & SEGMENTS != 0 {
        for s in relocalizer.segments() {
            out.extend([s.start.x, s.start.y, s.end.x, s.end.y]);
        }
    }
}

/// Writes what was found out later of a frame that is not located over what [`encode`] wrote: nothing agrees with a position.
pub(crate) fn encode_explained(answer: &SessionReport, out: &mut [f64]) {
    let Outcome::NotLocated(reason) = answer.frame.outcome else {
        return;
    };
    let clockwise_deg = match reason {
        NotLocated::Turned { clockwise_deg } => f64::from(clockwise_deg),
        _ => 0.0,
    };
    let (state, limited) = state_codes(answer.state);
    let (header, lists) = out.split_at_mut(HEADER);
    let mut put = |at: usize, values: &[f64]| header[at..at + values.len()].copy_from_slice(values);
    put(1, &[0.0, reason_code(reason), state, limited]);
    put(49, &[0.0; 5]);
    put(101, &[clockwise_deg]);
    let (points, lines) = lists.split_at_mut(POINT * header[97] as usize);
    let points = points.iter_mut().skip(POINT - 1).step_by(POINT);
    let lines = lines.iter_mut().skip(LINE - 1).step_by(LINE);
    for agrees in points.chain(lines.take(header[98] as usize)) {
        *agrees = 0.0;
    }
}

fn reason_code(reason: NotLocated) -> f64 {
    match reason {
        NotLocated::FewFeatures => 0.0,
        NotLocated::FewCorrespondences => 1.0,
        NotLocated::FewInliers => 2.0,
        NotLocated::Degenerate => 3.0,
        NotLocated::Ambiguous => 4.0,
        NotLocated::Timeout => 5.0,
        NotLocated::OtherPlace => 6.0,
        NotLocated::Mirrored => 7.0,
        NotLocated::FocalMismatch => 8.0,
        NotLocated::Turned { .. } => 9.0,
    }
}

fn state_codes(state: SessionState) -> (f64, f64) {
    match state {
        SessionState::Searching => (0.0, 0.0),
        SessionState::Tracking => (1.0, 0.0),
        SessionState::Limited(reason) => (
            2.0,
            match reason {
                LimitedReason::Lost => 0.0,
                LimitedReason::Jump => 1.0,
                LimitedReason::FocalUncertain => 2.0,
            },
        ),
    }
}

fn source_code(source: CameraSource) -> f64 {
    match source {
        CameraSource::Given => 0.0,
        CameraSource::Track => 1.0,
        CameraSource::Exif => 2.0,
        CameraSource::Remembered => 3.0,
        CameraSource::Estimated => 4.0,
        CameraSource::Assumed => 5.0,
        CameraSource::Scene => 6.0,
    }
}
