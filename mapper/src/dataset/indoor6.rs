//! Indoor-6 folders: `images/NAME.color.jpg` beside `NAME.pose.txt` (3x4, camera from world) and `NAME.intrinsics.txt`
//! (`W H f cx cy ...`), and `train_test_val.pkl`.

use super::pictures::{FoundPicture, Pictures, list_files};
use super::text::read_text;
use super::{Dataset, DatasetError, DatasetImage, Split};
use crate::import::pickle::{Arena, Value};
use landline::formats::{block_and_translation, expressed, rigid_from_matrix};
use landline::geometry::CameraRecord;
use landline::scene_file::Units;
use std::collections::HashMap;
use std::path::Path;

/// Whether a folder has this layout.
pub(super) fn is_indoor6(root: &Path) -> bool {
    list_files(&root.join("images")).is_ok_and(|files| {
        files
            .iter()
            .any(|f| f.to_string_lossy().ends_with(".intrinsics.txt"))
    })
}

/// The lists of strings in a pickled dictionary. Only data is read; whatever would run Python code is refused.
fn string_lists(bytes: &[u8]) -> Result<HashMap<String, Vec<String>>, String> {
    let mut arena = Arena::default();
    let (top, _) = arena.read(bytes).map_err(|e| e.to_string())?;
    let Value::Dict(entries) = arena.get(top) else {
        return Err("it holds no dictionary".to_owned());
    };
    Ok(entries
        .iter()
        .filter_map(|(key, value)| match (arena.text(*key), arena.get(*value)) {
            (Some(key), Value::List(items)) => Some((
                key.to_owned(),
                items
                    .iter()
                    .filter_map(|item| arena.text(*item).map(str::to_owned))
                    .collect(),
            )),
            _ => None,
        })
        .collect())
}

/// Reads the folder.
pub(super) fn read(root: &Path, pictures: &Pictures) -> Result<Dataset, DatasetError> {
    let mut dataset = Dataset::empty("Indoor-6");
    dataset.units = Units::Metres;
    dataset.sources.push(root.to_owned());
    let pickled = root.join("train_test_val.pkl");
    let mut split_of: HashMap<String, Split> = HashMap::new();
    let has_split = pickled.is_file();
    if has_split {
        let bytes = std::fs::read(&pickled).map_err(DatasetError::io(&pickled))?;
        let lists =
            string_lists(&bytes).map_err(|what| DatasetError::parse(&pickled, "pickle", what))?;
        for (key, split) in [
            ("train", Split::Train),
            ("val", Split::Unused),
            ("test", Split::Test),
        ] {
            for name in lists.get(key).into_iter().flatten() {
                split_of.insert(name.clone(), split);
            }
        }
    } else {
        dataset
            .notes
            .push("no train_test_val.pkl: all pictures teach".to_owned());
    }
    for file in list_files(&root.join("images"))? {
        let file_name = file
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let Some(stem) = file_name.strip_suffix(".intrinsics.txt") else {
            continue;
        };
        let name = format!("{stem}.color.jpg");
        let intrinsics = read_text(&file)?;
        let Some(line) = intrinsics.lines().next() else {
            return Err(DatasetError::missing(&file, "it is empty"));
        };
        let fields = line.fields();
        let Some(&[w, h, f, cx, cy]) = fields.first_chunk::<5>() else {
            return Err(line.error("expected `W H f cx cy`").into());
        };
        let side = |v: &str| {
            line.number::<f64>(v)
                .map(|v| if v > 0.0 && v < 1e6 { v as u32 } else { 0 })
        };
        let record = CameraRecord {
            model: "SIMPLE_PINHOLE".to_owned(),
            width: side(w)?,
            height: side(h)?,
            params: line.finite(&[f, cx, cy])?,
        };
        let camera = expressed(&record).map_err(|e| line.error(e))?;
        let pose_file = file.with_file_name(format!("{stem}.pose.txt"));
        let pose_text = read_text(&pose_file)?;
        let mut numbers = Vec::with_capacity(12);
        for line in pose_text.lines() {
            for field in line.fields() {
                numbers.push(line.number::<f64>(field)?);
            }
        }
        if numbers.len() != 12 && numbers.len() != 16 {
            return Err(DatasetError::missing(
                &pose_file,
                format!("expected a 3x4 matrix, found {} numbers", numbers.len()),
            ));
        }
        let (block, translation) = block_and_translation(&numbers);
        let cam_from_world = match rigid_from_matrix(&block, translation) {
            Ok(t) => t,
            Err(problem) => {
                dataset.drop_image(name, format!("pose: {problem}"));
                continue;
            }
        };
        let Some(FoundPicture { name, path, .. }) = pictures.find(&name, &mut dataset) else {
            continue;
        };
        let split = split_of.get(&name).copied().unwrap_or(if has_split {
            Split::Unused
        } else {
            Split::Train
        });
        dataset.images.push(DatasetImage {
            name,
            path,
            camera,
            cam_from_world: Some(cam_from_world),
            split,
        });
    }
    Ok(dataset)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_lists_are_read_and_code_is_refused() {
        // pickle.dumps({'train': ['a', 'b'], 'train_idx': [1, 300], 'test': ['c']}, protocol=2)
        let dump = b"\x80\x02}q\x00(X\x05\x00\x00\x00trainq\x01]q\x02(X\x01\x00\x00\x00aq\x03X\x01\x00\x00\x00bq\x04eX\t\x00\x00\x00train_idxq\x05]q\x06(K\x01M,\x01eX\x04\x00\x00\x00testq\x07]q\x08X\x01\x00\x00\x00cq\tau.";
        let lists = string_lists(dump).expect("plain data");
        assert_eq!(lists["train"], ["a", "b"]);
        assert_eq!(lists["test"], ["c"]);
        assert!(lists["train_idx"].is_empty());
        // os.system('true')
        let code = b"\x80\x02cposix\nsystem\nq\x00X\x04\x00\x00\x00trueq\x01\x85q\x02Rq\x03.";
        assert!(string_lists(code).is_err());
        assert!(string_lists(&dump[..20]).is_err());
    }
}
