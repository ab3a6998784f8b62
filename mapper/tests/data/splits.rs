//! Which pictures test: lists beside a model, lists that are given, and what the import table says about a model.

use crate::folder::Folder;
use crate::readers::read;
use landline_mapper::dataset::{Dataset, Split};

/// A model of three pictures and two points, one of them seen 3 px beside where it projects.
fn model() -> Folder {
    let folder = Folder::new();
    for name in ["a.png", "b.png", "c d.png"] {
        folder.picture(&format!("images/x/{name}"), 64, 48);
    }
    folder.text("sparse/0/cameras.txt", "1 PINHOLE 64 48 50 50 32 24\n");
    folder.text(
        "sparse/0/images.txt",
        "1 1 0 0 0 0 0 0 1 x/a.png\n32 24 1 42 24 2\n\
         2 1 0 0 0 -1 0 0 1 x/b.png\n7 24 1 20 24 2\n\
         3 1 0 0 0 0 0 0 1 x/c d.png\n\n",
    );
    folder.text(
        "sparse/0/points3D.txt",
        "1 0 0 2 9 9 9 0 1 0 2 0\n2 0.52 0 2 9 9 9 0 1 1 2 1\n",
    );
    folder
}

fn tests(dataset: &Dataset) -> Vec<&str> {
    let images = dataset.images.iter();
    images
        .filter(|i| i.split == Split::Test)
        .map(|i| i.name.as_str())
        .collect()
}

#[test]
fn lists_beside_a_model_choose_the_test_pictures() {
    let folder = model();
    assert!(tests(&read(&folder.0, &[]).expect("a model")).is_empty());
    folder.text("list_test.txt", "x/c d.png\n");
    let dataset = read(&folder.0, &[]).expect("a model and a list");
    assert_eq!(tests(&dataset), ["x/c d.png"]);
    assert!(dataset.table().to_string().contains("list_test.txt"));

    // hloc's query list, without folders in its names, outranks nothing but says the same.
    let list = folder.text("queries.txt", "b.png PINHOLE 64 48 50 50 32 24\n");
    let list = list.to_str().expect("UTF-8");
    let dataset = read(&folder.0, &["--test-list", list]).expect("a list");
    assert_eq!(tests(&dataset), ["x/b.png"]);
    let list = folder.text("other.txt", "z.png\n");
    let list = list.to_str().expect("UTF-8");
    let message = read(&folder.0, &["--test-list", list])
        .expect_err("nothing in common")
        .to_string();
    assert!(
        message.contains("other.txt") && message.contains("1 of the 1 pictures"),
        "{message}"
    );
}

#[test]
fn the_table_tells_how_well_a_model_fits_its_pictures() {
    let folder = model();
    let table = read(&folder.0, &[]).expect("a model").table().to_string();
    // Of two points one projects where it was seen, the other 3 px beside: the upper median.
    assert!(
        table.contains("2 (4 observations, median reprojection 3.00 px)"),
        "{table}"
    );
}

#[test]
fn pictures_that_were_not_fetched_are_told_from_broken_ones() {
    let folder = model();
    folder.text(
        "images/x/a.png",
        "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n",
    );
    let table = read(&folder.0, &[])
        .expect("two are left")
        .table()
        .to_string();
    assert!(table.contains("git lfs pull"), "{table}");
}

#[test]
fn a_fourth_radial_number_of_a_perspective_camera_is_refused() {
    let folder = Folder::new();
    folder.picture("a.png", 64, 48);
    folder.picture("b.png", 64, 48);
    let frame = |name: &str, k4: f64| {
        format!(
            r#"{{"file_path": "{name}", "k4": {k4}, "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#
        )
    };
    folder.text(
        "transforms.json",
        &format!(
            r#"{{"fl_x": 50, "frames": [{}, {}]}}"#,
            frame("a.png", 0.0),
            frame("b.png", 0.1)
        ),
    );
    let dataset = read(&folder.0, &[]).expect("one is left");
    assert_eq!(dataset.images.len(), 1);
    assert!(
        dataset
            .table()
            .to_string()
            .contains("`k4` is not supported")
    );
}
