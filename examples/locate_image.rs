//! Finds where in a taught scene a picture was taken.
//!
//! ```sh
//! cargo xtask web    # makes the extractor's file, once
//! cargo run --release --example locate_image -- \
//!     www/scenes/sample/sample.landline dist/npm/landline/xfeat.safetensors www/scenes/sample/query-00.jpg
//! ```

use landline::image::{FrameView, PixelFormat};
use landline::relocalizer::{Outcome, Query, Relocalizer};
use std::error::Error;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(scene), Some(extractor), Some(picture)) = (words.next(), words.next(), words.next())
    else {
        return Err("give a scene file, the extractor's file and a picture".into());
    };
    // The relocalizer keeps every buffer: make it once and give it many frames.
    let mut relocalizer = Relocalizer::from_bytes(
        &std::fs::read(scene)?,
        &std::fs::read(extractor)?,
        |_options| {},
    )?;

    let picture = image::open(&picture)?.into_rgb8();
    let frame = FrameView::tight(
        picture.as_raw(),
        picture.width(),
        picture.height(),
        PixelFormat::Rgb8,
    );
    // Without a camera the focal length is solved with the pose; the scene's own camera serves pictures of its size.
    let camera = relocalizer
        .scene_info()
        .camera
        .filter(|c| (c.width, c.height) == picture.dimensions());
    let query = Query {
        camera,
        ..Query::default()
    };
    let start = Instant::now();
    let report = relocalizer.locate(&frame, &query, &mut || start.elapsed().as_secs_f64() * 1e3)?;

    match report.outcome {
        Outcome::Located(found) => {
            let position = found.cam_from_world.center_in_world();
            println!(
                "camera at ({:.3}, {:.3}, {:.3}), sure to {:.1} mm and {:.2} deg",
                position.x,
                position.y,
                position.z,
                found.estimate.sigma_m * 1e3,
                found.estimate.sigma_rad.to_degrees()
            );
            println!(
                "{} points and {} lines agree",
                report.counts.num_point_inliers, report.counts.num_line_inliers
            );
        }
        Outcome::NotLocated(reason) => println!("not located: {}", reason.message()),
    }
    println!("{:.0} ms", report.timings.total_ms);
    Ok(())
}
