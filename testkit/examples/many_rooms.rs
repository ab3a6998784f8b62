//! Renders many rooms to teach, and other pictures of them to ask with:
//! `cargo run --release -p landline-testkit --example many_rooms -- DIR [ROOMS [TEACH [ASK [RAYS [WIDTH [alike]]]]]]`.
//!
//! `DIR/rooms/room-NN` and `DIR/asked/room-NN` hold pictures and `poses.txt`. Of four rooms or more the last four are two pairs
//! of twins: the same room, other pictures. With `alike` they all have the same furniture, moved a little, in other colours, under
//! other pictures. Rooms that are there are left as they are.

use landline_testkit::room::{RenderOptions, Room, View, query_views, training_views};
use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Rooms that are twins, at the end of the list, in pairs.
const TWINS: u64 = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let dir = PathBuf::from(args.next().ok_or("give a folder to write to")?);
    let mut number = |usual: usize| args.next().map_or(Ok(usual), |text| text.parse());
    let (rooms, teach, ask, rays) = (number(50)?, number(72)?, number(20)?, number(2)?);
    let width = number(640)?.clamp(64, 1920) as u32;
    let height = 3 * width / 4;
    let furnished = match args.next().as_deref() {
        Some("alike") => Room::alike,
        Some(other) => return Err(format!("{other} is no kind of rooms").into()),
        None => Room::varied,
    };
    for at in 0..rooms as u64 {
        let name = format!("room-{at:02}");
        let (taught, asked) = (dir.join("rooms").join(&name), dir.join("asked").join(&name));
        if asked.join("poses.txt").exists() {
            continue;
        }
        let first_twin = (rooms as u64).saturating_sub(TWINS);
        let is_twin = rooms as u64 >= TWINS && at >= first_twin;
        let seed = 100
            + if is_twin {
                at - (at - first_twin) % 2
            } else {
                at
            };
        let room = furnished(seed);
        // The first of its three rounds, outwards from the middle: neighbours then share most of what they show.
        let mut views = training_views(&room, 1000 + at, 3 * teach, width, height);
        views.truncate(teach);
        write(&taught, "walk", &room, &views, at, rays as u32)?;
        let views = query_views(&room, 2000 + at, ask, width, height);
        write(&asked, "asked", &room, &views, 500 + at, rays as u32)?;
        eprintln!("{name}: seed {seed}");
    }
    Ok(())
}

/// Pictures and, when all are there, their poses.
fn write(
    dir: &Path,
    kind: &str,
    room: &Room,
    views: &[View],
    seed: u64,
    supersampling: u32,
) -> Result<(), Box<dyn Error>> {
    std::fs::create_dir_all(dir)?;
    let mut poses = String::new();
    for (i, view) in views.iter().enumerate() {
        let options = RenderOptions {
            supersampling,
            exposure: 1.2 * (1.0 + 0.15 * (0.31 * i as f64).sin()),
            seed: 10_000 * seed + i as u64,
            ..RenderOptions::default()
        };
        let picture = room.render(&view.camera, &view.cam_from_world, &options);
        let name = format!("{kind}-{i:03}.jpg");
        image::save_buffer(
            dir.join(&name),
            &picture.rgb,
            picture.width,
            picture.height,
            image::ExtendedColorType::Rgb8,
        )?;
        let [w, x, y, z] = view.cam_from_world.quaternion_wxyz();
        let t = view.cam_from_world.translation;
        let focal = view.camera.focal_px().0;
        writeln!(
            poses,
            "{name} {w:.9} {x:.9} {y:.9} {z:.9} {:.6} {:.6} {:.6} {focal}",
            t.x, t.y, t.z
        )?;
    }
    std::fs::write(dir.join("poses.txt"), poses)?;
    Ok(())
}
