//! `cargo xtask rooms`: one table of all rooms that are known, so that no change is judged by one of them.
//!
//! Each room is taught from its landmarks alone and evaluated: the first pose, the second look, and full matching to the most
//! similar taught pictures as a peer, of the same features and with the same solver.

use crate::{paths, setup, shell};
use anyhow::{Context, Result, bail};
use serde::Deserialize;
use serde_json::Value;
use std::path::PathBuf;
use std::process::Command;
use std::time::Instant;

/// Teaches and evaluates every room of `benches/rooms.json`; prints a table for `docs/benchmarks/rooms.md`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the rooms
    #[arg(long, default_value = "../shared/data")]
    data: PathBuf,
    /// Only the room in this folder
    #[arg(long, value_name = "FOLDER")]
    only: Option<String>,
    /// Folder for scenes and labels, and for the features of each room where `--features` names none
    #[arg(long, default_value = "target/rooms")]
    work: PathBuf,
    /// Folder with a folder of cached features for each room
    #[arg(long)]
    features: Option<PathBuf>,
    /// Passed on to `landline map`
    #[arg(last = true)]
    rest: Vec<String>,
}

/// A room and the arguments that open it; paths are relative to the folder of the rooms.
#[derive(Debug, Deserialize)]
struct Room {
    name: String,
    folder: String,
    /// Of its poses, cameras and units.
    data: Vec<String>,
    /// Which pictures teach.
    train: Vec<String>,
    /// Which pictures test, where the others do not.
    test: Vec<String>,
}

/// Rows of an evaluation that the table shows, with the start of their name there; the first is the scene's own, whatever it is
/// called.
const ROWS: [(&str, &str); 6] = [
    ("look again", ""),
    ("look again, points only", "points only"),
    ("look again, lines only", "lines only"),
    ("first pose", "first pose"),
    ("nearest of as many landmarks", "nearest of"),
    ("full matching", "full matching"),
];
/// Shown besides medians, centimetres or degrees; `landline eval` has more.
const RECALLS: [f64; 3] = [2.0, 5.0, 10.0];

pub(crate) fn run(args: &Args) -> Result<()> {
    let list = paths::root().join("benches/rooms.json");
    let text =
        std::fs::read_to_string(&list).with_context(|| format!("reading {}", list.display()))?;
    let rooms: Vec<Room> =
        serde_json::from_str(&text).with_context(|| format!("in {}", list.display()))?;
    let wanted = |room: &&Room| args.only.as_ref().is_none_or(|only| *only == room.folder);
    let rooms: Vec<&Room> = rooms.iter().filter(wanted).collect();
    if rooms.is_empty() {
        bail!("no room of {} is in a folder of that name", list.display());
    }
    let tool = setup::fast_tool()?;
    let extractor = setup::weights()?.checkpoint;
    std::fs::create_dir_all(&args.work)
        .with_context(|| format!("making the folder {}", args.work.display()))?;
    println!("| room | method | located | median cm | median deg | 2/2 | 5/5 | 10/10 |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let mut sizes = Vec::new();
    for room in rooms {
        let file = |ending: &str| args.work.join(format!("{}.{ending}", room.folder));
        let features = args
            .features
            .as_ref()
            .map_or_else(|| file("features"), |folder| folder.join(&room.folder));
        let landline = |command: &str, split: &[String]| {
            let mut run = Command::new(&tool);
            run.current_dir(&args.data).arg(command);
            run.args(&room.data).args(&room.train).args(split);
            run.arg("--features").arg(absolute(&features));
            run.arg("--extractor").arg(&extractor);
            run
        };
        let (scene, labels) = (
            absolute(&file("landline")),
            absolute(&file("labels.safetensors")),
        );
        let start = Instant::now();
        let mut map = landline("map", &[]);
        map.arg(&room.folder).arg("--out").arg(&scene);
        map.arg("--labels").arg(&labels).args(&args.rest);
        shell::output(&mut map)?;
        let seconds = start.elapsed().as_secs_f64();
        let mut eval = landline("eval", &room.test);
        eval.arg("--labels").arg(&labels);
        eval.args(["--peer", "full", "--json"]);
        eval.arg(&scene).arg(&room.folder);
        let found: Value = serde_json::from_str(&shell::output(&mut eval)?)
            .with_context(|| format!("what `landline eval` says of {}", room.folder))?;
        print!("{}", rows(&room.name, &found)?);
        sizes.push(format!(
            "{}: scene of {} bytes, taught in {seconds:.0} s, located in {:.1} ms a picture",
            room.name,
            found["scene_bytes"],
            found["median_ms"]["all"]
                .as_f64()
                .context("`median_ms` has no `all`")?,
        ));
    }
    println!("\n{}", sizes.join("\n"));
    Ok(())
}

/// A path that means the same from another folder.
fn absolute(path: &std::path::Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// The room's rows of the table.
fn rows(room: &str, found: &Value) -> Result<String> {
    let methods = found["methods"].as_array().context("no `methods`")?;
    let thresholds = found["thresholds"].as_array().context("no `thresholds`")?;
    let columns = RECALLS.map(|wanted| {
        let is_it = |t: &Value| t["rotation_deg"].as_f64() == Some(wanted);
        thresholds.iter().position(is_it)
    });
    let mut out = String::new();
    for (shown, begins) in ROWS {
        let method = methods
            .iter()
            .find(|m| m["name"].as_str().is_some_and(|n| n.starts_with(begins)));
        let Some(method) = method else { continue };
        let figure = |name: &str, factor: f64, digits: usize| {
            let value = method[name].as_f64();
            value.map_or_else(|| "-".to_owned(), |v| format!("{:.digits$}", factor * v))
        };
        let recalls = columns.map(|column| {
            let share = column.and_then(|c| method["recalls"][c].as_f64());
            share.map_or_else(|| "-".to_owned(), |s| format!("{:.1}", 100.0 * s))
        });
        out.push_str(&format!(
            "| {room} | {shown} | {} of {} | {} | {} | {} |\n",
            method["num_located"],
            method["num_images"],
            figure("median_position", 100.0, 2),
            figure("median_rotation_deg", 1.0, 3),
            recalls.join(" | ")
        ));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn rows_are_found_by_name_and_figures_by_threshold() {
        let method = |name: &str, position: Option<f64>| {
            json!({ "name": name, "num_images": 4, "num_located": 3, "median_position": position,
                "median_rotation_deg": 0.25, "recalls": [0.1, 0.25, 0.5, 0.75] })
        };
        let threshold = |t: f64| json!({ "position": t / 100.0, "rotation_deg": t });
        let thresholds = [1.0, 2.0, 5.0, 10.0].map(threshold);
        let found = json!({
            "thresholds": thresholds,
            "methods": [method("points + lines", Some(0.0123)), method("full matching, 15 pictures", None)],
        });
        assert_eq!(
            rows("room", &found).expect("fits"),
            "| room | look again | 3 of 4 | 1.23 | 0.250 | 25.0 | 50.0 | 75.0 |\n\
             | room | full matching | 3 of 4 | - | 0.250 | 25.0 | 50.0 | 75.0 |\n"
        );
        assert!(rows("room", &json!({})).is_err());
    }

    #[test]
    fn the_list_of_rooms_is_read() {
        let rooms: Vec<Room> =
            serde_json::from_str(include_str!("../../benches/rooms.json")).expect("rooms");
        assert!(rooms.len() >= 3);
    }
}
