//! `NAME.place.json`: which rooms a place has, where their scenes are, and how they hang together.

use super::PlaceError;
use crate::geometry::{CamFromWorld, Rigid};
use crate::models::ExtractorKind;
use crate::scene_file::{MAX_WORKING_SIDE, SceneFile, SceneInfo};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Version of manifests. A newer one is refused.
pub const PLACE_VERSION: u32 = 1;
/// Most rooms of a place.
pub(super) const MAX_ROOMS: usize = 4096;
/// Longest name of a room, in bytes.
const MAX_ID: usize = 200;
/// Most corners of a room's outline.
const MAX_CORNERS: usize = 256;
/// How far a rotation's quaternion may be from unit length.
const UNIT_TOLERANCE: f64 = 1e-3;

/// A file beside the manifest, or elsewhere, and what it has to be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRef {
    /// Relative to the manifest, or absolute.
    pub url: String,
    /// Its length.
    pub bytes: u64,
    /// Of its bytes, in lower-case hexadecimal.
    pub sha256: String,
}

impl FileRef {
    /// Refuses bytes that are not the file's, told by their number and hash.
    ///
    /// # Errors
    /// [`PlaceError::WrongFile`].
    pub fn check(&self, bytes: u64, sha256: &str) -> Result<(), PlaceError> {
        if self.bytes == bytes && self.sha256 == sha256 {
            return Ok(());
        }
        Err(PlaceError::WrongFile {
            url: self.url.clone(),
            bytes: self.bytes,
            sha256: self.sha256.clone(),
            found_bytes: bytes,
            found_sha256: sha256.to_owned(),
        })
    }

    fn check_form(&self, what: &str) -> Result<(), PlaceError> {
        if self.url.is_empty() {
            return Err(PlaceError::value(
                format!("url of {what}"),
                "",
                "it is empty",
            ));
        }
        let is_hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
        if self.sha256.len() != 64 || !self.sha256.bytes().all(is_hex) {
            let what = format!("sha256 of {what}");
            let reason = "expected 64 lower-case hexadecimal digits";
            return Err(PlaceError::value(what, &self.sha256, reason));
        }
        Ok(())
    }
}

/// From a room's world to the frame of the place: `x_in_place = scale * rotation * x_in_room + translation`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Placed {
    /// Unit quaternion w, x, y, z.
    pub qwxyz: [f64; 4],
    /// In units of the place.
    pub t: [f64; 3],
    /// Units of the place in a unit of the room.
    #[serde(default = "one")]
    pub scale: f64,
}

fn one() -> f64 {
    1.0
}

impl Placed {
    fn check(&self, room: &str) -> Result<(), PlaceError> {
        let norm = self.qwxyz.iter().map(|q| q * q).sum::<f64>().sqrt();
        let is_far = !self.t.iter().all(|t| t.abs() < 1e12);
        let reason = if !((norm - 1.0).abs() <= UNIT_TOLERANCE) {
            "qwxyz must be a unit quaternion"
        } else if is_far {
            "t must be finite"
        } else if !(self.scale > 0.0 && self.scale < 1e12) {
            "scale must be positive"
        } else {
            return Ok(());
        };
        let found = format!("{self:?}");
        Err(PlaceError::value(
            format!("place_from_room of {room:?}"),
            found,
            reason,
        ))
    }

    /// A pose in the room as one in the place.
    pub fn cam_from_place(&self, cam_from_room: &CamFromWorld) -> CamFromWorld {
        let turn = Rigid::<(), ()>::from_quaternion_wxyz(self.qwxyz, Vector3::zeros()).rotation;
        let center = cam_from_room.center_in_world();
        let center = self.scale * (turn * center) + Vector3::from(self.t);
        let rotation = cam_from_room.rotation * turn.transpose();
        CamFromWorld::new(rotation, -(rotation * center))
    }
}

/// A room of a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RoomEntry {
    /// Its name among the others.
    pub id: String,
    /// What people call it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Where its scene is.
    pub scene: FileRef,
    /// Where it is in the place, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place_from_room: Option<Placed>,
    /// The floor that it is on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floor: Option<i32>,
    /// Rooms that one can walk to. That A is beside B and B beside A is as usual.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub neighbours: Vec<String>,
    /// Corners of its floor plan in the room's world, counter-clockwise seen from above: what pages draw.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outline: Vec<[f64; 3]>,
}

/// The manifest. Keys that this version does not know are ignored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlaceManifest {
    landline: String,
    format: u32,
    /// What people call the place.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Extractor of all rooms, by name.
    pub extractor: String,
    /// SHA-256 of the checkpoint that its weights came from.
    pub extractor_sha256: String,
    /// Longest side of the working image of all rooms, pixels.
    pub working_max_side: u32,
    /// The index of all rooms.
    pub index: FileRef,
    /// The rooms.
    pub rooms: Vec<RoomEntry>,
}

/// Of a manifest of any version.
#[derive(Deserialize)]
struct Head {
    #[serde(default)]
    landline: String,
    #[serde(default)]
    format: u32,
}

impl PlaceManifest {
    /// A place without rooms yet, for scenes like this one.
    pub fn for_scenes_like(info: &SceneInfo, index: FileRef) -> Self {
        Self {
            landline: "place".to_owned(),
            format: PLACE_VERSION,
            name: String::new(),
            extractor: info.extractor.name().to_owned(),
            extractor_sha256: info.extractor_sha256.clone(),
            working_max_side: info.working_max_side,
            index,
            rooms: Vec::new(),
        }
    }

    /// Reads and checks a manifest.
    ///
    /// # Errors
    /// [`PlaceError`] for everything that is not a place of this version.
    pub fn from_json(text: &str) -> Result<Self, PlaceError> {
        let json = |e: serde_json::Error| PlaceError::Json {
            reason: e.to_string(),
        };
        let head: Head = serde_json::from_str(text).map_err(json)?;
        if head.landline != "place" {
            return Err(PlaceError::Kind {
                found: head.landline.chars().take(40).collect(),
            });
        }
        if !(1..=PLACE_VERSION).contains(&head.format) {
            return Err(PlaceError::Version {
                found: head.format,
                supported: PLACE_VERSION,
            });
        }
        let manifest: Self = serde_json::from_str(text).map_err(json)?;
        manifest.check()?;
        Ok(manifest)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// [`PlaceError`] when it would be refused.
    pub fn to_json(&self) -> Result<String, PlaceError> {
        self.check()?;
        let text = serde_json::to_string_pretty(self);
        text.map_err(|e| PlaceError::Json {
            reason: e.to_string(),
        })
    }

    /// The extractor of all rooms.
    ///
    /// # Errors
    /// [`PlaceError::Value`] for a name that is none.
    pub fn extractor_kind(&self) -> Result<ExtractorKind, PlaceError> {
        let kind = ExtractorKind::from_name(&self.extractor);
        kind.ok_or_else(|| PlaceError::value("extractor", &self.extractor, "no known extractor"))
    }

    /// Position of a room.
    pub fn position(&self, id: &str) -> Option<usize> {
        self.rooms.iter().position(|room| room.id == id)
    }

    /// Refuses a room's scene that the place's front end cannot serve.
    ///
    /// # Errors
    /// [`PlaceError::Differs`].
    pub fn check_scene(&self, room: &str, scene: &SceneFile) -> Result<(), PlaceError> {
        let info = &scene.info;
        let sampler = self.extractor_kind()?.default_sampler();
        let side = self.working_max_side.to_string();
        for (what, found, expected) in [
            ("extractor", info.extractor.name(), self.extractor.as_str()),
            (
                "weights",
                info.extractor_sha256.as_str(),
                self.extractor_sha256.as_str(),
            ),
            ("sampler", info.sampler.name(), sampler.name()),
            (
                "a working side of",
                info.working_max_side.to_string().as_str(),
                side.as_str(),
            ),
        ] {
            if found != expected {
                return Err(PlaceError::Differs {
                    room: room.to_owned(),
                    what,
                    found: found.to_owned(),
                    expected: expected.to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Checks what a file may get wrong.
    ///
    /// # Errors
    /// [`PlaceError`] names the first thing that is wrong.
    pub fn check(&self) -> Result<(), PlaceError> {
        self.extractor_kind()?;
        if !(16..=MAX_WORKING_SIDE).contains(&self.working_max_side) {
            let reason = "it must be 16 to 2048 pixels";
            return Err(PlaceError::value(
                "working_max_side",
                self.working_max_side,
                reason,
            ));
        }
        if self.rooms.is_empty() || self.rooms.len() > MAX_ROOMS {
            return Err(PlaceError::Rooms {
                found: self.rooms.len(),
                limit: MAX_ROOMS,
            });
        }
        self.index.check_form("the index")?;
        let mut ids = BTreeSet::new();
        if let Some(twice) = self.rooms.iter().find(|room| !ids.insert(&room.id)) {
            return Err(PlaceError::DuplicateRoom {
                id: twice.id.clone(),
            });
        }
        for room in &self.rooms {
            if room.id.is_empty() || room.id.len() > MAX_ID || room.id.chars().any(char::is_control)
            {
                let reason = "a room's id has 1 to 200 bytes and no control characters";
                return Err(PlaceError::value("id", &room.id, reason));
            }
            room.scene.check_form(&format!("room {:?}", room.id))?;
            if let Some(placed) = &room.place_from_room {
                placed.check(&room.id)?;
            }
            check_outline(room)?;
            for neighbour in &room.neighbours {
                if *neighbour == room.id {
                    return Err(PlaceError::OwnNeighbour {
                        room: room.id.clone(),
                    });
                }
                if !ids.contains(neighbour) {
                    return Err(PlaceError::NoNeighbour {
                        room: room.id.clone(),
                        neighbour: neighbour.clone(),
                    });
                }
            }
        }
        Ok(())
    }
}

fn check_outline(room: &RoomEntry) -> Result<(), PlaceError> {
    let is_far = |corner: &[f64; 3]| !corner.iter().all(|v| v.abs() < 1e12);
    let reason = match room.outline.len() {
        1 | 2 => "a floor plan has three corners and more",
        len if len > MAX_CORNERS => "a floor plan has at most 256 corners",
        _ if room.outline.iter().any(is_far) => "its corners must be finite",
        _ => return Ok(()),
    };
    let what = format!("outline of {:?}", room.id);
    let found = format!("{} corners", room.outline.len());
    Err(PlaceError::value(what, found, reason))
}

#[cfg(test)]
pub(super) fn small() -> PlaceManifest {
    let file = |url: &str| FileRef {
        url: url.to_owned(),
        bytes: 3,
        sha256: "ab".repeat(32),
    };
    let info = SceneInfo::new(ExtractorKind::Xfeat, "ab".repeat(32));
    let mut place = PlaceManifest::for_scenes_like(&info, file("a.index"));
    for (id, neighbour) in [("hall", "shop"), ("shop", "hall")] {
        place.rooms.push(RoomEntry {
            id: id.to_owned(),
            name: None,
            scene: file(&format!("{id}.landline")),
            place_from_room: None,
            floor: Some(0),
            neighbours: vec![neighbour.to_owned()],
            outline: vec![[0.0; 3], [4.0, 0.0, 0.0], [4.0, 3.0, 0.0]],
        });
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_manifest_is_what_it_was_after_a_file_and_may_have_keys_of_later_days() {
        let place = small();
        let text = place.to_json().expect("rooms beside each other are usual");
        assert_eq!(PlaceManifest::from_json(&text).expect("reads"), place);
        let more = text.replacen('{', "{\"later\": [1],", 1);
        assert_eq!(PlaceManifest::from_json(&more).expect("reads"), place);
    }

    #[test]
    fn everything_that_can_be_wrong_is_named() {
        let refused = |change: &dyn Fn(&mut PlaceManifest)| {
            let mut place = small();
            change(&mut place);
            place.check().expect_err("must refuse")
        };
        assert!(matches!(
            refused(&|p| p.rooms.clear()),
            PlaceError::Rooms { found: 0, .. }
        ));
        assert!(matches!(
            refused(&|p| p.rooms[1].id = "hall".to_owned()),
            PlaceError::DuplicateRoom { .. }
        ));
        assert!(matches!(
            refused(&|p| p.rooms[0].neighbours = vec!["attic".to_owned()]),
            PlaceError::NoNeighbour { neighbour, .. } if neighbour == "attic"
        ));
        assert!(matches!(
            refused(&|p| p.rooms[0].neighbours.push("hall".to_owned())),
            PlaceError::OwnNeighbour { room } if room == "hall"
        ));
        let values: [&dyn Fn(&mut PlaceManifest); 9] = [
            &|p| p.rooms[0].outline.truncate(2),
            &|p| p.rooms[0].outline[1][2] = f64::INFINITY,
            &|p| p.rooms[0].id = String::new(),
            &|p| p.rooms[0].scene.url = String::new(),
            &|p| p.rooms[0].scene.sha256 = "AB".repeat(32),
            &|p| p.index.sha256 = "ab".to_owned(),
            &|p| p.extractor = "sift".to_owned(),
            &|p| p.working_max_side = 1 << 20,
            &|p| {
                p.rooms[0].place_from_room = Some(Placed {
                    qwxyz: [1.0, 1.0, 0.0, 0.0],
                    t: [0.0; 3],
                    scale: 1.0,
                });
            },
        ];
        for change in values {
            assert!(matches!(refused(change), PlaceError::Value { .. }));
        }
    }

    #[test]
    fn other_files_and_later_versions_are_refused() {
        let text = small().to_json().expect("writes");
        let refused = |text: &str| PlaceManifest::from_json(text).expect_err("must refuse");
        assert!(matches!(
            refused(&text.replace("\"format\": 1", "\"format\": 2")),
            PlaceError::Version {
                found: 2,
                supported: 1
            }
        ));
        assert!(matches!(
            refused("{\"type\": \"FeatureCollection\"}"),
            PlaceError::Kind { .. }
        ));
        assert!(matches!(refused("<html>"), PlaceError::Json { .. }));
        assert!(matches!(
            refused(&text.replace("\"rooms\"", "\"halls\"")),
            PlaceError::Json { .. }
        ));
    }

    #[test]
    fn a_file_that_is_another_one_is_told() {
        let file = small().index;
        file.check(3, &"ab".repeat(32)).expect("is the file");
        for (bytes, sha256) in [(4, "ab".repeat(32)), (3, "cd".repeat(32))] {
            let refused = file.check(bytes, &sha256);
            assert!(matches!(refused, Err(PlaceError::WrongFile { .. })));
        }
    }

    #[test]
    fn a_camera_in_a_room_stands_where_the_room_stands_in_the_place() {
        // A quarter turn about z, twice as large, shifted.
        let half = 0.5_f64.sqrt();
        let placed = Placed {
            qwxyz: [half, 0.0, 0.0, half],
            t: [10.0, 20.0, 30.0],
            scale: 2.0,
        };
        let center = Vector3::new(1.0, 2.0, 3.0);
        let rotation =
            Rigid::<(), ()>::from_quaternion_wxyz([0.9, 0.1, -0.3, 0.2], center).rotation;
        let in_room = CamFromWorld::new(rotation, -(rotation * center));
        let in_place = placed.cam_from_place(&in_room);
        let expected = Vector3::new(10.0 - 4.0, 20.0 + 2.0, 30.0 + 6.0);
        assert!((in_place.center_in_world() - expected).norm() < 1e-12);
        // What the room's x axis is in the camera, the place's y axis is.
        let axis = in_place.rotation * Vector3::y() - in_room.rotation * Vector3::x();
        assert!(axis.norm() < 1e-12);
    }
}
