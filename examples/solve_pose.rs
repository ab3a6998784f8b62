//! Finds a camera's pose from points and lines whose places in the world are known, a third of them wrong.
//!
//! ```sh
//! cargo run --example solve_pose
//! ```

use landline::geometry::{CamFromWorld, Camera, Pixel};
use landline::math::Rng;
use landline::pose::{LineCorrespondence, PointCorrespondence, PoseOptions, PoseScratch, estimate};
use nalgebra::Vector3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let camera = Camera::centered(640, 480, 520.0);
    let truth =
        CamFromWorld::from_quaternion_wxyz([0.9, 0.2, -0.3, 0.1], Vector3::new(0.3, -0.2, 0.5));
    let mut rng = Rng::from_seed(1);
    // A pixel, and the world point behind it; every third one is half a metre off.
    let mut observe = || {
        let pixel = Pixel {
            x: rng.range(0.0, 640.0),
            y: rng.range(0.0, 480.0),
        };
        let bearing = camera.bearing_from_pixel(pixel).unwrap_or_else(Vector3::z);
        let point_in_world = truth
            .inverse()
            .transform_point(&(bearing * rng.range(2.0, 5.0)));
        let error_m = if rng.below(3) == 0 { 0.5 } else { 0.005 };
        (
            pixel,
            point_in_world + Vector3::from_fn(|_, _| rng.range(-error_m, error_m)),
        )
    };
    let points: Vec<_> = (0..80)
        .map(|_| {
            let (pixel, point_in_world) = observe();
            PointCorrespondence {
                pixel,
                point_in_world,
                confidence: 0.7,
                sigma_m: 0.0,
                sigma_px: 0.0,
            }
        })
        .collect();
    let lines: Vec<_> = (0..40)
        .map(|_| {
            let ((start, start_in_world), (end, end_in_world)) = (observe(), observe());
            let (confidence, sigma_m) = (0.7, 0.0);
            LineCorrespondence {
                start,
                end,
                start_in_world,
                end_in_world,
                confidence,
                sigma_m,
                sigma_px: 0.0,
            }
        })
        .collect();

    // No time budget is set, so the clock is never asked.
    let mut scratch = PoseScratch::default();
    let options = PoseOptions::default();
    let outcome = estimate(
        &points,
        &lines,
        &camera,
        &options,
        &mut scratch,
        &mut || 0.0,
    )?;
    let Some(found) = outcome.located() else {
        println!("not located: {}", outcome.status.message());
        return Ok(());
    };
    let position = found.cam_from_world.inverse().translation;
    let error_m = (position - truth.inverse().translation).norm();
    println!(
        "camera at {position:.3?} m, {:.1} mm from the truth",
        error_m * 1e3
    );
    println!(
        "standard deviation {:.1} mm, {:.3} deg",
        found.sigma_m * 1e3,
        found.sigma_rad.to_degrees()
    );
    println!(
        "inliers: {} points, {} lines",
        found.num_point_inliers, found.num_line_inliers
    );
    Ok(())
}
