//! LIMAP line maps: `image_list.txt`, `segments/segments_<id>.txt`, `alltracks.txt` (or `fitnmerge_alltracks.txt`).
//!
//! Segment files of any detector in that layout will do; the tracks may be missing. Fields are separated by any white
//! space, because versions differ. Segment ends count pixel centres as integers, so half a pixel is added.

use super::text::read_text;
use super::{Dataset, DatasetError, ModelLine, segment_scale};
use landline::formats::Names;
use nalgebra::Vector3;
use std::collections::HashMap;
use std::path::Path;

/// Adds lines and segments of a folder to a data set.
pub(super) fn read_into(folder: &Path, dataset: &mut Dataset) -> Result<(), DatasetError> {
    dataset.sources.push(folder.to_owned());
    let known = Names::new(dataset.images.iter().map(|i| i.name.as_str()));
    let list = read_text(&folder.join("image_list.txt"))?;
    let mut position_of_id: HashMap<u64, usize> = HashMap::new();
    let mut unknown: Vec<&str> = Vec::new();
    for line in list.lines() {
        let Some((id, name)) = line.text.split_once(',') else {
            return Err(line.error("expected `id, name`").into());
        };
        // The header reads `number of images, N`.
        if id.trim().starts_with("number") {
            continue;
        }
        let id: u64 = line.number(id.trim())?;
        // Names may be absolute paths of another machine.
        match known.find(name.trim()).one() {
            Some(position) => drop(position_of_id.insert(id, position)),
            None => unknown.push(name.trim()),
        }
    }
    if position_of_id.is_empty() {
        return Err(DatasetError::missing(
            &folder.join("image_list.txt"),
            format!(
                "none of its {} pictures is in the data set ({})",
                unknown.len(),
                unknown.first().copied().unwrap_or_default()
            ),
        ));
    }
    if let Some(first) = unknown.first() {
        dataset.notes.push(format!(
            "{} pictures of the line map are not in the data set ({first})",
            unknown.len()
        ));
    }
    let mut segments = vec![Vec::new(); dataset.images.len()];
    for (id, position) in &position_of_id {
        let path = folder.join(format!("segments/segments_{id}.txt"));
        if !path.is_file() {
            return Err(DatasetError::missing(
                &path,
                "the segments of this picture are missing",
            ));
        }
        segments[*position] = read_segments(&path)?;
    }
    let tracks = ["alltracks.txt", "fitnmerge_alltracks.txt"]
        .iter()
        .map(|f| folder.join(f))
        .find(|p| p.is_file());
    if let Some(path) = tracks {
        dataset.lines = read_tracks(&path, &position_of_id, &segments)?;
    } else {
        dataset
            .notes
            .push("no alltracks.txt: segments only, lines are triangulated".to_owned());
    }
    if let Some(note) = segment_scale::fit_to_pictures(&dataset.images, &mut segments)
        .map_err(|what| DatasetError::missing(folder, what))?
    {
        dataset.notes.push(note);
    }
    dataset.segments = Some(segments);
    Ok(())
}

fn read_segments(path: &Path) -> Result<Vec<[f64; 4]>, DatasetError> {
    let file = read_text(path)?;
    let mut lines = file.lines();
    let Some(header) = lines.next() else {
        return Ok(Vec::new());
    };
    let count: usize = header.number(header.text)?;
    let mut segments = Vec::with_capacity(count.min(100_000));
    for line in lines {
        let v = line.finite(&line.fields())?;
        let Some(&[x1, y1, x2, y2]) = v.first_chunk::<4>() else {
            return Err(line
                .error(format!("expected `x1 y1 x2 y2`, found {} numbers", v.len()))
                .into());
        };
        segments.push([x1 + 0.5, y1 + 0.5, x2 + 0.5, y2 + 0.5]);
    }
    if segments.len() != count {
        return Err(header
            .error(format!(
                "{count} segments are announced, {} follow",
                segments.len()
            ))
            .into());
    }
    Ok(segments)
}

fn read_tracks(
    path: &Path,
    position_of_id: &HashMap<u64, usize>,
    segments: &[Vec<[f64; 4]>],
) -> Result<Vec<ModelLine>, DatasetError> {
    let file = read_text(path)?;
    // Lists of a track may be empty lines, so none is skipped.
    let mut lines = file.all_lines();
    let Some(header) = lines.next() else {
        return Err(DatasetError::missing(path, "it is empty"));
    };
    let count: usize = header.number(header.text)?;
    let mut tracks = Vec::new();
    for i in 0..count {
        let mut next = || {
            lines.next().ok_or_else(|| {
                DatasetError::missing(
                    path,
                    format!("{count} tracks are announced, it ends in track {i}"),
                )
            })
        };
        let _head = next()?;
        let mut point = || -> Result<Vector3<f64>, DatasetError> {
            let line = next()?;
            let v = line.finite(&line.fields())?;
            match v.as_slice() {
                &[x, y, z] => Ok(Vector3::new(x, y, z)),
                _ => Err(line
                    .error(format!("expected x y z, found {} numbers", v.len()))
                    .into()),
            }
        };
        let (start_in_world, end_in_world) = (point()?, point()?);
        let (images, ids) = (next()?, next()?);
        let (image_fields, id_fields) = (images.fields(), ids.fields());
        if image_fields.len() != id_fields.len() {
            return Err(ids
                .error(format!(
                    "{} segments for {} pictures",
                    id_fields.len(),
                    image_fields.len()
                ))
                .into());
        }
        let mut observations = Vec::new();
        for (image, segment) in image_fields.iter().zip(&id_fields) {
            let image: u64 = images.number(image)?;
            let segment: usize = ids.number(segment)?;
            let Some(position) = position_of_id.get(&image) else {
                continue;
            };
            let num_segments = segments.get(*position).map_or(0, Vec::len);
            if segment >= num_segments {
                return Err(ids
                    .error(format!(
                        "segment {segment} of picture {image}, which has {num_segments}"
                    ))
                    .into());
            }
            observations.push((*position, segment));
        }
        tracks.push(ModelLine {
            start_in_world,
            end_in_world,
            observations,
        });
    }
    Ok(tracks)
}
