//! A map as files that other programs open: PLY, OBJ, GLB, COLMAP text.

use crate::files;
use landline::geometry::{CamFromWorld, Camera};
use landline::reconstruction::Reconstruction;
use landline::scene_file::SceneFile;
use nalgebra::Vector3;
use serde_json::json;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::Path;

/// Points, segments and cameras in the world.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Map {
    /// Landmarks.
    pub points: Vec<Vector3<f64>>,
    /// Ends of each segment.
    pub segments: Vec<[Vector3<f64>; 2]>,
    /// Name, intrinsics and pose of pictures.
    pub cameras: Vec<(String, Camera, CamFromWorld)>,
    /// For each point: which picture's which pixel sees it. Empty when unknown.
    pub observations: Vec<Vec<(usize, usize)>>,
    /// Keypoints of each picture: x, y. Empty when unknown.
    pub keypoints: Vec<Vec<[f64; 2]>>,
    /// For each point its mean reprojection error. Empty when unknown.
    pub errors_px: Vec<f64>,
}

/// What a scene file holds in itself: the anchors of anchored branches. Other networks keep their map in their weights.
pub fn scene_map(scene: &SceneFile) -> Map {
    let mut map = Map::default();
    let values = |name: &str, width: usize| -> Vec<Vec<f64>> {
        let Some(tensor) = scene.weights.get(name) else {
            return Vec::new();
        };
        tensor
            .to_f32()
            .chunks_exact(width)
            .map(|row| row.iter().map(|v| f64::from(*v)).collect())
            .collect()
    };
    let world = |row: &[f64]| {
        scene
            .info
            .scale
            .world_from_network(Vector3::new(row[0], row[1], row[2]))
    };
    map.points = values("point.anchor.positions", 3)
        .iter()
        .map(|row| world(row))
        .collect();
    map.segments = values("line.anchor.segments", 6)
        .iter()
        .map(|row| [world(&row[..3]), world(&row[3..])])
        .collect();
    map
}

/// The tracks of a reconstruction, with its posed views.
pub fn from_reconstruction(map: &Reconstruction) -> Map {
    let posed = map
        .views
        .iter()
        .filter_map(|v| Some((v, v.cam_from_world?)));
    // Views without a pose are left out: observations count the others.
    let mut place = 0..;
    let places: Vec<Option<usize>> = map
        .views
        .iter()
        .map(|v| v.cam_from_world.and_then(|_| place.next()))
        .collect();
    Map {
        points: map.points.iter().map(|p| p.point_in_world).collect(),
        segments: map
            .lines
            .iter()
            .map(|l| [l.start_in_world, l.end_in_world])
            .collect(),
        cameras: posed
            .clone()
            .map(|(v, cam_from_world)| (v.name.clone(), v.camera, cam_from_world))
            .collect(),
        observations: map
            .points
            .iter()
            .map(|p| {
                p.observations
                    .iter()
                    .filter_map(|o| {
                        let view = places.get(o.view as usize).copied().flatten()?;
                        Some((view, o.feature as usize))
                    })
                    .collect()
            })
            .collect(),
        keypoints: posed
            .map(|(v, _)| {
                let pixels = v.features.keypoints.iter().map(|k| k.pixel);
                pixels.map(|p| [p.x, p.y]).collect()
            })
            .collect(),
        errors_px: map
            .points
            .iter()
            .map(|p| f64::from(p.mean_error_px))
            .collect(),
    }
}

/// Binary little-endian PLY: points in grey, ends of segments in cyan with an `edge` element.
///
/// # Errors
/// When the disk refuses.
pub fn write_ply(map: &Map, path: &Path) -> io::Result<()> {
    files::write_atomic(path, |out| {
        let num_vertices = map.points.len() + 2 * map.segments.len();
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment camera axes x right, y down, z forward\n\
             element vertex {num_vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\n\
             element edge {}\nproperty int vertex1\nproperty int vertex2\nend_header\n",
            map.segments.len()
        )?;
        let ends = map.segments.iter().flatten();
        let colored = map
            .points
            .iter()
            .map(|p| (p, [200u8, 200, 200]))
            .chain(ends.map(|p| (p, [30, 200, 255])));
        for (p, color) in colored {
            for v in p.iter() {
                out.write_all(&(*v as f32).to_le_bytes())?;
            }
            out.write_all(&color)?;
        }
        for i in 0..map.segments.len() {
            let first = (map.points.len() + 2 * i) as i32;
            out.write_all(&first.to_le_bytes())?;
            out.write_all(&(first + 1).to_le_bytes())?;
        }
        Ok(())
    })
}

/// OBJ: `v` and `l`, points as `p`.
///
/// # Errors
/// When the disk refuses.
pub fn write_obj(map: &Map, path: &Path) -> io::Result<()> {
    let mut text = String::new();
    for p in map.points.iter().chain(map.segments.iter().flatten()) {
        let _ = writeln!(text, "v {:.6} {:.6} {:.6}", p.x, p.y, p.z);
    }
    for i in 0..map.points.len() {
        let _ = writeln!(text, "p {}", i + 1);
    }
    for i in 0..map.segments.len() {
        let first = map.points.len() + 2 * i + 1;
        let _ = writeln!(text, "l {first} {}", first + 1);
    }
    files::write_bytes(path, text.as_bytes())
}

/// GLB (glTF 2.0, one binary file): points and lines as primitives, cameras as nodes; y up, as viewers expect, by turning
/// the root.
///
/// # Errors
/// When the disk refuses.
pub fn write_glb(map: &Map, path: &Path) -> io::Result<()> {
    let mut binary: Vec<u8> = Vec::new();
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    let mut primitives = Vec::new();
    let ends: Vec<Vector3<f64>> = map.segments.iter().flatten().copied().collect();
    // Modes of glTF: 0 points, 1 lines.
    for (mode, vertices) in [(0, &map.points), (1, &ends)] {
        let Some(first) = vertices.first() else {
            continue;
        };
        let offset = binary.len();
        let (mut low, mut high) = (first.map(|v| v as f32), first.map(|v| v as f32));
        for p in vertices {
            let p = p.map(|v| v as f32);
            low = low.inf(&p);
            high = high.sup(&p);
            for v in p.iter() {
                binary.extend(v.to_le_bytes());
            }
        }
        views.push(
            json!({ "buffer": 0, "byteOffset": offset, "byteLength": binary.len() - offset }),
        );
        accessors.push(json!({
            "bufferView": views.len() - 1, "componentType": 5126, "count": vertices.len(), "type": "VEC3",
            "min": [low.x, low.y, low.z], "max": [high.x, high.y, high.z],
        }));
        primitives.push(json!({
            "attributes": { "POSITION": accessors.len() - 1 }, "mode": mode, "material": mode,
        }));
    }
    let mut nodes = vec![json!({ "name": "world", "rotation": [1.0, 0.0, 0.0, 0.0] })];
    let mut children: Vec<usize> = Vec::new();
    if !primitives.is_empty() {
        children.push(nodes.len());
        nodes.push(json!({ "name": "map", "mesh": 0 }));
    }
    let mut cameras = Vec::new();
    for (name, camera, cam_from_world) in &map.cameras {
        let (_, fy) = camera.focal_px();
        let height = f64::from(camera.height);
        cameras.push(json!({
            "type": "perspective",
            "perspective": {
                "yfov": 2.0 * (0.5 * height / fy).atan(),
                "aspectRatio": f64::from(camera.width) / height,
                "znear": 0.01,
            },
        }));
        // glTF cameras have y up and look along -z: half a turn about x from ours.
        let world_from_cam = cam_from_world.inverse();
        let [w, x, y, z] = world_from_cam.quaternion_wxyz();
        let t = world_from_cam.translation;
        children.push(nodes.len());
        nodes.push(json!({
            "name": name, "camera": cameras.len() - 1,
            // q * (0, 1, 0, 0): the half turn applied first. glTF writes x, y, z, w.
            "rotation": [w, z, -y, -x],
            "translation": [t.x, t.y, t.z],
        }));
    }
    if let Some(root) = nodes.first_mut().and_then(|n| n.as_object_mut())
        && !children.is_empty()
    {
        root.insert("children".to_owned(), json!(children));
    }
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "landline" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": nodes,
    });
    if let Some(object) = document.as_object_mut() {
        if !primitives.is_empty() {
            object.insert("meshes".to_owned(), json!([{ "primitives": primitives }]));
            object.insert(
                "materials".to_owned(),
                json!([
                    { "name": "points", "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.8, 0.8, 1.0] } },
                    { "name": "lines", "pbrMetallicRoughness": { "baseColorFactor": [0.1, 0.8, 1.0, 1.0] } },
                ]),
            );
            object.insert("accessors".to_owned(), json!(accessors));
            object.insert("bufferViews".to_owned(), json!(views));
            object.insert(
                "buffers".to_owned(),
                json!([{ "byteLength": binary.len() }]),
            );
        }
        if !cameras.is_empty() {
            object.insert("cameras".to_owned(), json!(cameras));
        }
    }
    let mut text = serde_json::to_vec(&document)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    files::write_atomic(path, |out| {
        let has_binary = !binary.is_empty();
        let total = 12 + 8 + text.len() + if has_binary { 8 + binary.len() } else { 0 };
        let word = |n: usize| {
            u32::try_from(n)
                .map(u32::to_le_bytes)
                .map_err(|_| io::Error::other("a GLB file cannot be larger than 4 GB"))
        };
        out.write_all(b"glTF")?;
        out.write_all(&2u32.to_le_bytes())?;
        out.write_all(&word(total)?)?;
        out.write_all(&word(text.len())?)?;
        out.write_all(b"JSON")?;
        out.write_all(&text)?;
        if has_binary {
            out.write_all(&word(binary.len())?)?;
            out.write_all(b"BIN\0")?;
            out.write_all(&binary)?;
        }
        Ok(())
    })
}

/// A COLMAP text model: cameras, images, points with their tracks.
///
/// # Errors
/// When the disk refuses.
pub fn write_colmap(map: &Map, folder: &Path) -> io::Result<()> {
    use landline::geometry::CameraRecord;
    let mut cameras: Vec<CameraRecord> = Vec::new();
    let mut images = String::new();
    let mut owner: Vec<Vec<Option<usize>>> =
        map.keypoints.iter().map(|k| vec![None; k.len()]).collect();
    for (point, seen) in map.observations.iter().enumerate() {
        for (image, keypoint) in seen {
            if let Some(slot) = owner.get_mut(*image).and_then(|o| o.get_mut(*keypoint)) {
                *slot = Some(point);
            }
        }
    }
    for (i, (name, camera, cam_from_world)) in map.cameras.iter().enumerate() {
        let record = CameraRecord::from_camera(camera);
        let id = cameras
            .iter()
            .position(|c| *c == record)
            .unwrap_or_else(|| {
                cameras.push(record);
                cameras.len() - 1
            })
            + 1;
        let [w, x, y, z] = cam_from_world.quaternion_wxyz();
        let t = cam_from_world.translation;
        let _ = writeln!(
            images,
            "{} {w} {x} {y} {z} {} {} {} {id} {name}",
            i + 1,
            t.x,
            t.y,
            t.z
        );
        if let (Some(keypoints), Some(owner)) = (map.keypoints.get(i), owner.get(i)) {
            for ([px, py], point) in keypoints.iter().zip(owner) {
                match point {
                    Some(p) => drop(write!(images, "{px} {py} {} ", p + 1)),
                    None => drop(write!(images, "{px} {py} -1 ")),
                }
            }
        }
        images.push('\n');
    }
    let mut camera_text = String::new();
    for (i, c) in cameras.iter().enumerate() {
        let params: Vec<String> = c.params.iter().map(f64::to_string).collect();
        let _ = writeln!(
            camera_text,
            "{} {} {} {} {}",
            i + 1,
            c.model,
            c.width,
            c.height,
            params.join(" ")
        );
    }
    let mut points = String::new();
    for (i, p) in map.points.iter().enumerate() {
        // COLMAP writes -1 for an error that was not computed.
        let error = map.errors_px.get(i).copied().unwrap_or(-1.0);
        let _ = write!(
            points,
            "{} {} {} {} 200 200 200 {error}",
            i + 1,
            p.x,
            p.y,
            p.z
        );
        for (image, keypoint) in map.observations.get(i).into_iter().flatten() {
            let _ = write!(points, " {} {keypoint}", image + 1);
        }
        points.push('\n');
    }
    files::write_bytes(&folder.join("cameras.txt"), camera_text.as_bytes())?;
    files::write_bytes(&folder.join("images.txt"), images.as_bytes())?;
    files::write_bytes(&folder.join("points3D.txt"), points.as_bytes())
}
