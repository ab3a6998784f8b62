//! What people type first, and what the tool says to it: each answer names the cause and what to do.

use crate::folder::Folder;
use std::path::Path;
use std::process::Command;

/// Runs the tool where nothing but its arguments counts; exit status and everything that it says.
fn said(folder: &Folder, line: &str) -> (bool, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_landline"))
        .args(line.split(' '))
        .current_dir(&folder.0)
        // Never opened: all that is asked here fails before, or is no matter of features.
        .env("LANDLINE_EXTRACTOR", "no-extractor")
        .output()
        .expect("the tool starts");
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.success(),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

fn refused(folder: &Folder, line: &str, words: &[&str]) {
    let (is_fine, text) = said(folder, line);
    assert!(!is_fine, "{line}: {text}");
    for word in words {
        assert!(text.contains(word), "{line}: no `{word}` in: {text}");
    }
}

fn sample(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../www/scenes/sample")
        .join(name)
}

/// The first bytes of a HEIC file.
fn heic(folder: &Folder, name: &str) {
    folder.text(name, "\0\0\0\u{18}ftypheic\0\0\0\0mif1heic");
}

#[test]
fn scene_and_pictures_in_the_wrong_places_are_called_so() {
    let folder = Folder::new();
    folder.picture("photo.jpg", 64, 48);
    folder.copy(&sample("sample.landline"), "room.landline");
    refused(
        &folder,
        "locate photo.jpg room.landline",
        &["photo.jpg is a picture", "scene file"],
    );
    refused(
        &folder,
        "eval . room.landline",
        &[". is a folder", "scene file"],
    );
    refused(
        &folder,
        "data photo.jpg",
        &["photo.jpg is a picture", "give the folder"],
    );
}

#[test]
fn pictures_of_telephones_that_are_not_decoded_are_counted_and_named() {
    let folder = Folder::new();
    heic(&folder, "phone/IMG_1.HEIC");
    heic(&folder, "phone/IMG_2.HEIC");
    folder.copy(&sample("sample.landline"), "room.landline");
    let advice = ["Most Compatible", "IMG_1.HEIC", "2 pictures"];
    refused(&folder, "data phone", &advice);
    refused(&folder, "locate room.landline phone", &advice);
    // The pictures beside them are too few.
    folder.picture("phone/a.jpg", 64, 48);
    let found = landline_mapper::unposed::find_pictures(&folder.0.join("phone"));
    let text = found.err().expect("too few").to_string();
    for word in ["1 readable picture:", "2 pictures (IMG_1.HEIC ...): HEIC"] {
        assert!(text.contains(word), "{text}");
    }
    // With enough of them the others are still told.
    for name in ["phone/b.jpg", "phone/c.jpg", "phone/._c.jpg"] {
        folder.picture(name, 64, 48);
    }
    let found = landline_mapper::unposed::find_pictures(&folder.0.join("phone"));
    let found = found.expect("three pictures");
    assert_eq!((found.images.len(), found.unreadable.len()), (3, 2));
    assert!(found.unread()[0].starts_with("2 pictures (IMG_1.HEIC ...)"));
}

#[test]
fn what_a_folder_holds_in_place_of_a_data_set_is_told() {
    let folder = Folder::new();
    folder.text("empty/notes.md", "nothing");
    for name in ["upper/phone/a.jpg", "upper/phone/b.jpg"] {
        folder.picture(name, 64, 48);
    }
    refused(
        &folder,
        "data empty",
        &["no pictures in it", "a folder of pictures or a video"],
    );
    refused(
        &folder,
        "data upper",
        &["2 pictures in its folder upper/phone: give that one"],
    );
    refused(
        &folder,
        "data upper/phone",
        &[
            "has no poses (2 pictures)",
            "`landline poses upper/phone --out DIR`",
            "`--pictures upper/phone`",
        ],
    );
    folder.text("film.mp4", "no film");
    refused(
        &folder,
        "data film.mp4",
        &["has no poses (a video)", "landline poses film.mp4"],
    );
}

#[test]
fn the_demo_outside_the_repository_says_where_it_belongs() {
    refused(
        &Folder::new(),
        "demo",
        &["sample.json", "in a checkout of it", "--dir FOLDER"],
    );
}

#[test]
fn places_to_write_to_are_looked_at_first() {
    let folder = Folder::new();
    folder.picture("photo.jpg", 64, 48);
    folder.text("taken", "a file");
    folder.copy(&sample("sample.landline"), "room.landline");
    refused(
        &folder,
        "locate room.landline photo.jpg --overlay taken/drawn",
        &["--overlay: cannot make the folder taken/drawn"],
    );
    refused(
        &folder,
        "map . --out taken/room.landline",
        &["taken/room.run"],
    );
    refused(
        &folder,
        "map . --out .",
        &[". is a folder", "room.landline"],
    );
}

#[test]
fn what_a_map_would_replace_is_its_own() {
    let folder = Folder::new();
    for name in ["phone/a.jpg", "phone/b.jpg", "phone/c.jpg"] {
        folder.picture(name, 64, 48);
    }
    folder.text("mine/poses/precious.txt", "somebody's");
    let line = "map phone --out x.landline --run mine";
    refused(&folder, line, &["precious.txt", "name another folder"]);
    let kept = std::fs::read(folder.0.join("mine/poses/precious.txt"));
    assert_eq!(kept.expect("is there"), b"somebody's");
    // An earlier map's poses come back where nothing comes of this one.
    folder.text("mine2/poses/images.txt", "the last run's");
    refused(
        &folder,
        "map phone --out x.landline --run mine2",
        &["no-extractor"],
    );
    let kept = std::fs::read(folder.0.join("mine2/poses/images.txt"));
    assert_eq!(kept.expect("is there"), b"the last run's");
}

#[test]
fn pictures_alone_do_not_tell_metres() {
    let folder = Folder::new();
    folder.picture("phone/a.jpg", 64, 48);
    let line = "map phone --out x.landline --units metres";
    refused(
        &folder,
        line,
        &["--units metres", "--scale-from", "--positions"],
    );
}
