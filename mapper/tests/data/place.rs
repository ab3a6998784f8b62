//! Places on disk: made of scenes, changed room by room, and what is wrong with one told.

use crate::folder::Folder;
use landline::math::Rng;
use landline::models::ExtractorKind;
use landline::models::landmarks::{Anchor, untrained};
use landline::place::{PlaceManifest, RoomEntry};
use landline::scene_file::{Precision, SceneFile, SceneInfo};
use landline_mapper::place::PlaceFiles;
use std::path::PathBuf;

/// A scene of some landmarks that look like nothing else.
fn scene(seed: u64) -> SceneFile {
    let mut rng = Rng::from_seed(seed);
    let anchors: Vec<Anchor> = (0..40)
        .map(|_| {
            let key: Vec<f32> = (0..64).map(|_| rng.normal() as f32).collect();
            let norm = key.iter().map(|v| v * v).sum::<f32>().sqrt();
            Anchor {
                key: key.into_iter().map(|v| v / norm).collect(),
                value: vec![0.5; 3],
            }
        })
        .collect();
    let (config, weights) = untrained(64, &anchors, &[]).expect("fits");
    SceneFile {
        info: SceneInfo::new(ExtractorKind::Xfeat, "ab".repeat(32)),
        config,
        weights,
        landmarks: None,
    }
}

fn write(folder: &Folder, name: &str, scene: &SceneFile) -> PathBuf {
    let path = folder.0.join(name);
    let bytes = scene.to_bytes(Precision::Int8).expect("writes");
    std::fs::write(&path, bytes).expect("writable");
    path
}

fn entry<'a>(place: &'a mut PlaceFiles, id: &str) -> &'a mut RoomEntry {
    let at = place.manifest.position(id).expect("is a room");
    &mut place.manifest.rooms[at]
}

fn refusal(outcome: Result<impl Sized, anyhow::Error>) -> String {
    format!("{:#}", outcome.err().expect("must refuse"))
}

#[test]
fn a_place_is_made_of_scenes_and_changed_room_by_room() {
    let folder = Folder::new();
    for (name, seed) in [("hall.landline", 1), ("shop.landline", 2)] {
        write(&folder, name, &scene(seed));
    }
    let path = folder.0.join("museum.place.json");
    let mut place = PlaceFiles::build(&path, &folder.0).expect("builds");
    entry(&mut place, "shop").name = Some("Gift shop".to_owned());
    place.join("hall", "shop").expect("two rooms");
    place.write().expect("writes");
    let hall = entry(&mut place, "hall").scene.clone();

    // A new room, and one that was taught anew: the others stay as they are, and what was said of rooms stays.
    let attic = write(&folder, "attic.landline", &scene(3));
    let mut place = PlaceFiles::read(&path).expect("reads");
    assert_eq!(place.add(&attic, None).expect("fits"), "attic");
    let shop = write(&folder, "shop.landline", &scene(4));
    place.add(&shop, None).expect("fits");
    place.write().expect("writes");
    let mut place = PlaceFiles::read(&path).expect("reads");
    assert_eq!(place.index.rooms(), ["hall", "shop", "attic"]);
    assert_eq!(entry(&mut place, "hall").scene, hall);
    assert_eq!(entry(&mut place, "shop").name.as_deref(), Some("Gift shop"));
    assert_eq!(entry(&mut place, "shop").neighbours, ["hall"]);
    for room in 0..3 {
        place.scene(room).expect("is there");
    }

    place.remove("shop").expect("is a room");
    place.write().expect("writes");
    let mut place = PlaceFiles::read(&path).expect("reads");
    assert_eq!(place.index.rooms(), ["hall", "attic"]);
    assert!(entry(&mut place, "hall").neighbours.is_empty());

    // Built anew, the name that was given comes back with the room that never left, and the removed room without.
    entry(&mut place, "attic").floor = Some(3);
    place.write().expect("writes");
    let mut place = PlaceFiles::build(&path, &folder.0).expect("builds");
    assert_eq!(entry(&mut place, "attic").floor, Some(3));
    assert_eq!(entry(&mut place, "shop").name, None);
}

#[test]
fn what_is_wrong_with_a_place_is_told() {
    let folder = Folder::new();
    for (name, seed) in [("hall.landline", 1), ("shop.landline", 2)] {
        write(&folder, name, &scene(seed));
    }
    let path = folder.0.join("museum.place.json");
    let mut place = PlaceFiles::build(&path, &folder.0).expect("builds");
    // Taught anew without a word, and gone: the other room is as it was.
    write(&folder, "shop.landline", &scene(5));
    assert!(refusal(place.scene(1)).contains("SHA-256"));
    std::fs::remove_file(folder.0.join("shop.landline")).expect("is there");
    assert!(refusal(place.scene(1)).contains("cannot read"));
    place.scene(0).expect("is there");
    // Another extractor.
    let mut foreign = scene(3);
    foreign.info.extractor_sha256 = "cd".repeat(32);
    let foreign = write(&folder, "foreign.landline", &foreign);
    assert!(refusal(place.add(&foreign, None)).contains("weights"));
    assert!(refusal(PlaceFiles::build(&path, &folder.0)).contains("weights"));
    // Rooms that are none.
    assert!(refusal(place.remove("attic")).contains("attic"));
    assert!(refusal(place.join("hall", "attic")).contains("attic"));
    assert!(refusal(place.join("hall", "hall")).contains("neighbour"));
    // What does not lie beside the place.
    let other = Folder::new();
    let far = write(&other, "far.landline", &scene(6));
    assert!(refusal(place.add(&far, None)).contains("folder of the place"));
    // A damaged index, and a later manifest.
    let text = std::fs::read_to_string(&path).expect("is there");
    let index = folder.0.join("museum.place.index");
    std::fs::write(&index, b"not it").expect("writable");
    assert!(refusal(PlaceFiles::read(&path)).contains("SHA-256"));
    let later = text.replace("\"format\": 1", "\"format\": 2");
    assert!(PlaceManifest::from_json(&later).is_err());
    assert!(refusal(PlaceFiles::build(&folder.0.join("museum.json"), &folder.0)).contains("NAME"));
}

#[test]
fn the_schema_knows_every_key_that_is_written() {
    let folder = Folder::new();
    write(&folder, "hall.landline", &scene(1));
    let path = folder.0.join("museum.place.json");
    PlaceFiles::build(&path, &folder.0).expect("builds");
    let read = |path: &std::path::Path| -> serde_json::Value {
        let text = std::fs::read_to_string(path).expect("is there");
        serde_json::from_str(&text).expect("JSON")
    };
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/place.schema.json");
    let (schema, place) = (read(&root), read(&path));
    let keys = |value: &serde_json::Value| -> Vec<String> {
        let object = value.as_object().expect("an object");
        object.keys().cloned().collect()
    };
    for (what, described) in [
        (&place, &schema["properties"]),
        (&place["index"], &schema["$defs"]["file"]["properties"]),
        (&place["rooms"][0], &schema["$defs"]["room"]["properties"]),
    ] {
        let known = keys(described);
        assert!(keys(what).iter().all(|key| known.contains(key)), "{what}");
    }
    assert_eq!(schema["properties"]["format"]["const"], place["format"]);
}
