//! Writes a film of the sample room with exact poses: `cargo run --release -p landline-testkit --example room -- DIR [FRAMES [TEST]]`.
//!
//! `DIR/film` is a walk of ten seconds, `DIR/test` are pictures from other places, numbered after the film, and
//! `DIR/poses.txt` has a line `NAME QW QX QY QZ TX TY TZ` (camera from world, metres) for each.

use landline_testkit::room::{Look, RenderOptions, Room, View, query_views, video_views};
use std::fmt::Write as _;
use std::path::PathBuf;

const SEED: u64 = 7;
const SIZE: (u32, u32) = (640, 480);
const SECONDS: f64 = 10.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let dir = PathBuf::from(args.next().ok_or("give a folder to write to")?);
    let frames: usize = args.next().map_or(Ok(150), |text| text.parse())?;
    let num_test: usize = args.next().map_or(Ok(100), |text| text.parse())?;
    let room = Room::new(SEED);
    let fps = frames as f64 / SECONDS;
    let film = video_views(&room, SEED, fps, SECONDS, SIZE, Look::Ahead);
    let test = query_views(&room, SEED, num_test, SIZE.0, SIZE.1);
    let mut poses = String::from("# NAME QW QX QY QZ TX TY TZ, camera from world\n");
    let kinds = film.iter().map(|v| ("film", v));
    let numbered = kinds.chain(test.iter().map(|v| ("test", v)));
    for (i, (kind, view)) in numbered.enumerate() {
        let name = format!("{kind}/{i:03}.png");
        std::fs::create_dir_all(dir.join(kind))?;
        take(&room, view, i as u64, &dir.join(&name))?;
        let q = view.cam_from_world.quaternion_wxyz();
        let t = view.cam_from_world.translation;
        write!(poses, "{name}")?;
        for number in q.iter().chain(t.iter()) {
            write!(poses, " {number}")?;
        }
        poses.push('\n');
    }
    std::fs::write(dir.join("poses.txt"), poses)?;
    Ok(())
}

/// Noise is of each picture's own. A picture that is there stays: a run that was broken off goes on.
fn take(
    room: &Room,
    view: &View,
    seed: u64,
    path: &std::path::Path,
) -> Result<(), Box<dyn std::error::Error>> {
    if path.exists() {
        return Ok(());
    }
    let options = RenderOptions {
        seed,
        ..RenderOptions::default()
    };
    let picture = room.render(&view.camera, &view.cam_from_world, &options);
    image::save_buffer(
        path,
        &picture.rgb,
        picture.width,
        picture.height,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(())
}
