//! Recorded problems: random ones with the noise of a regressor, and two real ones of matched landmarks.

use super::{error, solve};
use landline::geometry::{CamFromWorld, Camera, Pixel};
use landline::pose::{
    LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch, PoseStatus, estimate,
};
use landline_testkit::{PoseScene, problem_file, shared_data};
use nalgebra::Vector3;

/// (setting, least share within 5 cm and 5 degrees: what PoseLib 2.0.5 reaches with the better of its calls, or the bar)
const RECORDED: [(&str, f64); 11] = [
    ("easy", 1.0),
    ("typical", 1.0),
    ("noisy3d", 0.82),
    ("few", 0.9),
    ("many", 1.0),
    ("lowinl", 1.0),
    ("badpts", 1.0),
    ("lines", 0.75),
    ("coherent", 1.0),
    ("coherrel", 1.0),
    ("verylow", 0.5),
];

#[test]
fn recorded_problems_are_solved_as_often_as_poselib_does() {
    let Some(dir) = shared_data("data/pose_problems") else {
        return;
    };
    let mut scratch = PoseScratch::new();
    for (setting, least) in RECORDED {
        let bytes = std::fs::read(dir.join(format!("{setting}.plb"))).expect("readable");
        let problems = problem_file::parse(&bytes).expect("valid");
        let (mut good, mut gross) = (0, 0);
        for p in &problems {
            let outcome = estimate(
                &p.points,
                &p.lines,
                &p.camera,
                &PoseOptions::default(),
                &mut scratch,
                &mut || 0.0,
            )
            .expect("valid input");
            let (m, rad) = error(&outcome, &p.cam_from_world);
            let is_given = matches!(outcome.status, PoseStatus::Ok | PoseStatus::Ambiguous);
            good += usize::from(is_given && m < 0.05 && rad < 5f64.to_radians());
            gross += usize::from(!is_given || m > 0.25 || rad > 5f64.to_radians());
        }
        let share = good as f64 / problems.len() as f64;
        println!("{setting}: {share:.3} within 5 cm and 5 degrees, {gross} gross failures");
        assert!(share >= least, "{setting}: {share} below {least}");
        assert_eq!(gross, 0, "{setting}: gross failures");
    }
}

#[test]
fn stairs_are_located_within_limaps_bar() {
    let Some(dir) = shared_data("data/stairs_pnp") else {
        return;
    };
    // The thresholds of LIMAP's 7-Scenes configuration.
    let options = PoseOptions {
        max_point_error_px: 5.0,
        max_line_error_px: 5.0,
        ..PoseOptions::default()
    };
    for name in ["stairs_1", "stairs_2"] {
        let text = std::fs::read_to_string(dir.join(format!("{name}.json"))).expect("readable");
        let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let rows = |key: &str| -> Vec<Vec<f64>> {
            serde_json::from_value(json[key].clone()).expect("rows of numbers")
        };
        let list = |v: &serde_json::Value| -> Vec<f64> {
            serde_json::from_value(v.clone()).expect("numbers")
        };
        let q = list(&json["cam_from_world_gt"]["qwxyz"]);
        let t = list(&json["cam_from_world_gt"]["t"]);
        let truth = CamFromWorld::from_quaternion_wxyz(
            [q[0], q[1], q[2], q[3]],
            Vector3::from_column_slice(&t),
        );
        let points = rows("points2d")
            .iter()
            .zip(&rows("points3d"))
            .map(|(p, x)| PointCorrespondence {
                pixel: Pixel::new(p[0], p[1]),
                point_in_world: Vector3::from_column_slice(x),
                confidence: 0.5,
                sigma_m: 0.0,
                sigma_px: 0.0,
            })
            .collect();
        // The segments count pixel centres as integers, the points do not.
        let lines = rows("segments2d")
            .iter()
            .zip(&rows("segments3d"))
            .map(|(s, x)| LineCorrespondence {
                start: Pixel::from_index_coordinates(s[0], s[1]),
                end: Pixel::from_index_coordinates(s[2], s[3]),
                start_in_world: Vector3::from_column_slice(&x[..3]),
                end_in_world: Vector3::from_column_slice(&x[3..]),
                confidence: 0.5,
                sigma_m: 0.0,
                sigma_px: 0.0,
            })
            .collect();
        let scene = PoseScene {
            camera: Camera::centered(640, 480, 525.0),
            cam_from_world: truth,
            points,
            lines,
        };
        for seed in 0..5 {
            let outcome = solve(&scene, &PoseOptions { seed, ..options });
            let (m, rad) = error(&outcome, &truth);
            println!(
                "{name}, seed {seed}: {m:.3} m, {:.2} degrees, {:?}",
                rad.to_degrees(),
                outcome.status
            );
            assert!(
                m < 0.5 && rad.to_degrees() < 2.0,
                "{name}: {m} m, {rad} rad"
            );
        }
    }
}
