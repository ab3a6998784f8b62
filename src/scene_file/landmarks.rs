//! The landmark table in a scene file: tensors of whole bytes beside the weights, three metadata keys.

use super::info::{number, parse, vector, vector_text};
use super::tensor_file::RawTensor;
use super::{SceneFileError, TensorFile};
use crate::landmarks::LandmarkTable;
use crate::landmarks::code::SignCode;
use crate::landmarks::table::PositionGrid;
use std::collections::BTreeMap;

/// What the names of these tensors begin with.
pub(super) const PREFIX: &str = "landmark.";

const ORIGIN: &str = "landmark_origin";
const STEP: &str = "landmark_step";
const CLUSTERS: &str = "landmark_clusters";

const POINT_POSITIONS: &str = "landmark.point.positions";
const POINT_CODES: &str = "landmark.point.codes";
const POINT_VIEWS: &str = "landmark.point.views";
const POINT_CLUSTERS: &str = "landmark.point.clusters";
const POINT_MEAN: &str = "landmark.point.mean";
const LINE_POSITIONS: &str = "landmark.line.positions";
const LINE_CODES: &str = "landmark.line.codes";
const LINE_VIEWS: &str = "landmark.line.views";
const LINE_MEAN: &str = "landmark.line.mean";

/// Adds the metadata of a table and returns its tensors.
pub(super) fn to_raw(
    table: &LandmarkTable,
    metadata: &mut BTreeMap<String, String>,
) -> Vec<RawTensor> {
    let mut put = |key: &str, value: String| metadata.insert(key.to_owned(), value);
    put(ORIGIN, vector_text(&table.grid.origin));
    put(STEP, table.grid.step.to_string());
    put(CLUSTERS, table.num_clusters.to_string());
    let words = |positions: &mut dyn Iterator<Item = &[u16; 3]>| -> Vec<u8> {
        positions.flatten().flat_map(|v| v.to_le_bytes()).collect()
    };
    let codes = |codes: &[u64]| codes.iter().flat_map(|c| c.to_le_bytes()).collect();
    let mean = |code: &SignCode| code.mean.iter().flat_map(|m| m.to_le_bytes()).collect();
    let raw =
        |name: &'static str, dtype: &'static str, shape: &[usize], bytes: Vec<u8>| RawTensor {
            name,
            dtype,
            shape: shape.to_vec(),
            bytes,
        };
    let (n, m) = (table.point_positions.len(), table.line_positions.len());
    let mut out = vec![
        raw(
            POINT_MEAN,
            "F32",
            &[table.point_code.mean.len()],
            mean(&table.point_code),
        ),
        raw(
            POINT_POSITIONS,
            "U16",
            &[n, 3],
            words(&mut table.point_positions.iter()),
        ),
        raw(POINT_CODES, "U8", &[n, 8], codes(&table.point_codes)),
        raw(POINT_VIEWS, "U8", &[n, 3], table.point_views.concat()),
        raw(POINT_CLUSTERS, "U8", &[n, 2], table.point_clusters.concat()),
        raw(
            LINE_MEAN,
            "F32",
            &[table.line_code.mean.len()],
            mean(&table.line_code),
        ),
    ];
    // Tensors without elements are no good in safetensors.
    if m > 0 {
        out.extend([
            raw(
                LINE_POSITIONS,
                "U16",
                &[m, 6],
                words(&mut table.line_positions.iter().flatten()),
            ),
            raw(LINE_CODES, "U8", &[m, 8], codes(&table.line_codes)),
            raw(LINE_VIEWS, "U8", &[m, 3], table.line_views.concat()),
        ]);
    }
    out
}

/// The table of a file, if it has one; descriptors have `channels` numbers.
pub(super) fn from_file(
    file: &TensorFile<'_>,
    channels: usize,
) -> Result<Option<LandmarkTable>, SceneFileError> {
    let names: Vec<&str> = file.names().filter(|n| n.starts_with(PREFIX)).collect();
    if names.is_empty() {
        return Ok(None);
    }
    let known = [
        POINT_POSITIONS,
        POINT_CODES,
        POINT_VIEWS,
        POINT_CLUSTERS,
        POINT_MEAN,
        LINE_POSITIONS,
        LINE_CODES,
        LINE_VIEWS,
        LINE_MEAN,
    ];
    if let Some(name) = names.iter().find(|n| !known.contains(*n)) {
        return Err(SceneFileError::LandmarkTensor {
            tensor: (*name).to_owned(),
            reason: "is not part of a landmark table".to_owned(),
        });
    }
    let rows = |name: &'static str,
                dtype: &'static str,
                columns: usize|
     -> Result<&[u8], SceneFileError> { file.raw(name, dtype, Some(columns)) };
    let words = |name, columns| -> Result<Vec<u16>, SceneFileError> {
        let bytes = rows(name, "U16", columns)?;
        Ok(bytes
            .as_chunks::<2>()
            .0
            .iter()
            .map(|c| u16::from_le_bytes(*c))
            .collect())
    };
    let codes = |name| -> Result<Vec<u64>, SceneFileError> {
        let bytes = rows(name, "U8", 8)?;
        Ok(bytes
            .as_chunks::<8>()
            .0
            .iter()
            .map(|c| u64::from_le_bytes(*c))
            .collect())
    };
    let mean = |name| -> Result<SignCode, SceneFileError> {
        let bytes = file.raw(name, "F32", None)?;
        let floats = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|c| f32::from_le_bytes(*c));
        Ok(SignCode {
            mean: floats.collect(),
        })
    };
    let of_lines = [LINE_POSITIONS, LINE_CODES, LINE_VIEWS];
    let has_lines = of_lines.iter().any(|n| names.contains(n));
    let (line_positions, line_codes, line_views) = if has_lines {
        (
            words(LINE_POSITIONS, 6)?,
            codes(LINE_CODES)?,
            rows(LINE_VIEWS, "U8", 3)?,
        )
    } else {
        (Vec::new(), Vec::new(), &[][..])
    };
    let table = LandmarkTable {
        grid: PositionGrid {
            origin: vector(file, ORIGIN)?,
            step: number(file, STEP)?,
        },
        point_code: mean(POINT_MEAN)?,
        line_code: mean(LINE_MEAN)?,
        num_clusters: parse(file, CLUSTERS, |t| {
            t.parse::<usize>().map_err(|e| e.to_string())
        })?,
        point_positions: words(POINT_POSITIONS, 3)?.as_chunks::<3>().0.to_vec(),
        point_codes: codes(POINT_CODES)?,
        point_views: rows(POINT_VIEWS, "U8", 3)?.as_chunks::<3>().0.to_vec(),
        point_clusters: rows(POINT_CLUSTERS, "U8", 2)?.as_chunks::<2>().0.to_vec(),
        line_positions: line_positions
            .as_chunks::<6>()
            .0
            .iter()
            .map(|&[a, b, c, d, e, f]| [[a, b, c], [d, e, f]])
            .collect(),
        line_codes,
        line_views: line_views.as_chunks::<3>().0.to_vec(),
    };
    table.check(channels)?;
    Ok(Some(table))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_as_many_bytes_as_it_says() {
        let table = crate::landmarks::table::small();
        let raw = to_raw(&table, &mut BTreeMap::new());
        let bytes: usize = raw.iter().map(|t| t.bytes.len()).sum();
        assert_eq!(bytes, table.num_bytes());
    }
}
