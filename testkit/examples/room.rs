//! Writes pictures of the sample room: `cargo run --release -p landline-testkit --example room -- DIR [COUNT]`.

use landline_testkit::room::{RenderOptions, Room, query_views, training_views};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let dir = PathBuf::from(args.next().ok_or("give a folder to write to")?);
    let count: usize = args.next().map_or(Ok(4), |text| text.parse())?;
    std::fs::create_dir_all(&dir)?;
    let room = Room::new(7);
    let walk = training_views(&room, 7, count, 640, 480);
    let asked = query_views(&room, 7, count, 640, 480);
    for (kind, views) in [("walk", walk), ("query", asked)] {
        for (i, view) in views.iter().enumerate() {
            let picture = room.render(
                &view.camera,
                &view.cam_from_world,
                &RenderOptions::default(),
            );
            image::save_buffer(
                dir.join(format!("{kind}-{i:03}.png")),
                &picture.rgb,
                picture.width,
                picture.height,
                image::ExtendedColorType::Rgb8,
            )?;
        }
    }
    Ok(())
}
