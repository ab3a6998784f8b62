//! `landline place`: many rooms as one place.

use crate::args::ExtractorArgs;
use crate::asked::{Asking, RoomPictures};
use crate::place::PlaceFiles;
use crate::shown::{shown, told};
use anyhow::{Result, ensure};
use clap::Subcommand;
use landline::formats::expressed;
use landline::geometry::CameraRecord;
use std::path::PathBuf;

/// Many rooms as one place: a manifest with an index that tells the rooms apart.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Make a place of all scenes of a folder.
    Build {
        /// Folder of the scene files; a room is called as its file.
        scenes: PathBuf,
        /// The manifest to write, NAME.place.json, in the folder of the scenes or above it.
        #[arg(long, short)]
        out: PathBuf,
        /// What people call the place.
        #[arg(long)]
        name: Option<String>,
    },
    /// Add scenes, or take the scenes of rooms that were taught anew.
    Add {
        /// The manifest.
        place: PathBuf,
        /// Scene files.
        #[arg(required = true)]
        scenes: Vec<PathBuf>,
        /// A room that one can walk to from there, and back.
        #[arg(long, value_name = "ROOM")]
        neighbour: Vec<String>,
        /// The floor.
        #[arg(long, allow_negative_numbers = true)]
        floor: Option<i32>,
    },
    /// Take rooms out; their scene files stay.
    Remove {
        /// The manifest.
        place: PathBuf,
        /// The rooms.
        #[arg(required = true)]
        rooms: Vec<String>,
    },
    /// Look whether everything is there and fits.
    Check {
        /// The manifest.
        place: PathBuf,
    },
    /// Locate pictures, whatever room they are of.
    Locate {
        /// The manifest.
        place: PathBuf,
        /// Pictures.
        #[arg(required = true)]
        pictures: Vec<PathBuf>,
        /// Camera of the pictures: MODEL,width,height,parameters in COLMAP's order. Otherwise the camera of each room
        /// where it takes pictures of the same shape, else the focal length is solved with the pose.
        #[arg(long, value_name = "MODEL,W,H,...", value_parser = crate::dataset::parse_camera)]
        camera: Option<CameraRecord>,
        #[command(flatten)]
        extractor: ExtractorArgs,
    },
    /// Ask with pictures whose rooms are known.
    Eval {
        /// The manifest.
        place: PathBuf,
        /// Folder with a folder of pictures for each room, called as the room.
        asked: PathBuf,
        /// Rooms of which one is taken for the other without fault.
        #[arg(long, value_name = "ROOM=ROOM")]
        twins: Vec<String>,
        #[command(flatten)]
        extractor: ExtractorArgs,
    },
}

/// Does it.
///
/// # Errors
/// When a file cannot be read, written or used; of `check`, when something is wrong.
pub fn run(args: Args) -> Result<()> {
    match args.what {
        What::Build { scenes, out, name } => {
            let mut place = PlaceFiles::build(&out, &scenes)?;
            if let Some(name) = name {
                place.manifest.name = name;
                place.write()?;
            }
            println!("wrote {}: {}", out.display(), summary(&place));
            Ok(())
        }
        What::Add {
            place: path,
            scenes,
            neighbour,
            floor,
        } => {
            let mut place = PlaceFiles::read(&path)?;
            for scene in &scenes {
                let id = place.add(scene, None)?;
                for other in &neighbour {
                    place.join(&id, other)?;
                }
                let at = place.manifest.position(&id);
                if let Some(entry) = at.and_then(|at| place.manifest.rooms.get_mut(at)) {
                    entry.floor = floor.or(entry.floor);
                }
                println!("{}", shown(&id));
            }
            place.write()?;
            println!("wrote {}: {}", path.display(), summary(&place));
            Ok(())
        }
        What::Remove { place: path, rooms } => {
            let mut place = PlaceFiles::read(&path)?;
            for room in &rooms {
                place.remove(room)?;
            }
            place.write()?;
            println!("wrote {}: {}", path.display(), summary(&place));
            Ok(())
        }
        What::Check { place: path } => check(&PlaceFiles::read(&path)?),
        What::Locate {
            place,
            pictures,
            camera,
            extractor,
        } => {
            let camera = camera.as_ref().map(expressed).transpose()?;
            let mut asking = Asking::new(PlaceFiles::read(&place)?, extractor.read()?)?;
            let mut num_failed = 0;
            for picture in &pictures {
                match asking.told(picture, camera) {
                    Ok(line) => println!("{} {line}", shown(&picture.display().to_string())),
                    Err(error) => {
                        num_failed += 1;
                        eprintln!("error: {}", told(&error));
                    }
                }
            }
            ensure!(num_failed == 0, "{num_failed} pictures could not be asked");
            Ok(())
        }
        What::Eval {
            place,
            asked,
            twins,
            extractor,
        } => {
            let pictures = RoomPictures::of_folder(&asked)?;
            let mut asking = Asking::new(PlaceFiles::read(&place)?, extractor.read()?)?;
            asking.evaluate(&pictures, &twins, &mut std::io::stdout().lock())
        }
    }
}

fn summary(place: &PlaceFiles) -> String {
    let bytes: u64 = place.manifest.rooms.iter().map(|r| r.scene.bytes).sum();
    format!(
        "{} rooms, {bytes} bytes of scenes, {} of the index",
        place.manifest.rooms.len(),
        place.manifest.index.bytes
    )
}

/// One line for each room; an error when one of them is not as it should be, once all have been looked at.
fn check(place: &PlaceFiles) -> Result<()> {
    let mut num_bad = 0;
    for (at, room) in place.manifest.rooms.iter().enumerate() {
        match place.scene(at) {
            Ok(_) => println!("{}: as it should be", shown(&room.id)),
            Err(error) => {
                num_bad += 1;
                println!("{}: {}", shown(&room.id), told(&error));
            }
        }
    }
    println!("{}", summary(place));
    ensure!(num_bad == 0, "{num_bad} rooms are not as they should be");
    Ok(())
}
