//! Poses for pictures at hand, out of whatever files lie with them: for a page that is given a folder.

use super::colmap::{self, RawImage};
use super::list::{self, ListKind};
use super::matrix::{matrix, of_color_camera};
use super::{FormatError, Found, Names, QuaternionOrder, TextFile, plain, rigid_from_quaternion};
use crate::geometry::{CamFromWorld, Camera, CameraError, CameraModel, CameraRecord};
use std::collections::{BTreeMap, HashMap};

/// A file with its path as far as it is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenFile {
    /// With its folders.
    pub path: String,
    /// All of it.
    pub bytes: Vec<u8>,
}

/// What is known of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPose {
    /// Where it was taken.
    pub cam_from_world: CamFromWorld,
    /// Its camera without distortion, where the files have it.
    pub camera: Option<Camera>,
    /// Its focal length in pixels, where that is all they have.
    pub focal: Option<f64>,
}

/// What is known of some pictures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KnownPoses {
    /// The file, or in words the files, that poses are from; empty without any.
    pub source: String,
    /// Sentences for people about what was chosen and what cannot be used.
    pub notes: Vec<String>,
    /// For each of the pictures.
    pub of_pictures: Vec<Option<KnownPose>>,
}

/// Poses of pictures, which are given by their paths as far as those are known, from the first of these that is there: a COLMAP
/// model, matrices beside the pictures, a list. A file that is damaged gives no pose and a note that names the place.
pub fn known_poses(pictures: &[String], files: Vec<GivenFile>) -> KnownPoses {
    let mut known = KnownPoses {
        of_pictures: vec![None; pictures.len()],
        ..KnownPoses::default()
    };
    let names = Names::new(pictures.iter().map(String::as_str));
    let mut files: BTreeMap<String, Vec<u8>> = files
        .into_iter()
        .map(|file| (plain(&file.path), file.bytes))
        .collect();
    let outcome = match model_folder(&files) {
        Some(folder) => known.read_model(&names, &mut files, &folder),
        None if files.keys().any(|path| path.ends_with(MATRIX)) => {
            known.read_matrices(&names, files)
        }
        None => known.read_list(&names, files),
    };
    if let Err(error) = outcome {
        known.notes.push(format!("{error}."));
        known.of_pictures.fill(None);
    }
    if known.of_pictures.iter().all(Option::is_none) {
        known.source.clear();
    }
    known
}

/// How files end that hold one matrix for the picture beside them.
const MATRIX: &str = ".pose.txt";

/// The folder with a COLMAP model, as a beginning of paths; of several the one whose pictures take most room.
fn model_folder(files: &BTreeMap<String, Vec<u8>>) -> Option<String> {
    let models = files.iter().filter_map(|(path, bytes)| {
        let folder = path.strip_suffix("images.bin");
        let folder = folder.or_else(|| path.strip_suffix("images.txt"))?;
        (folder.is_empty() || folder.ends_with('/')).then_some((bytes.len(), folder))
    });
    // Of equals the first by name.
    let most = models.max_by(|a, b| a.0.cmp(&b.0).then_with(|| b.1.cmp(a.1)));
    most.map(|(_, folder)| folder.to_owned())
}

impl KnownPoses {
    fn read_model(
        &mut self,
        names: &Names,
        files: &mut BTreeMap<String, Vec<u8>>,
        folder: &str,
    ) -> Result<(), FormatError> {
        let mut take = |name: &str| {
            let path = format!("{folder}{name}");
            files.remove(&path).map(|bytes| (path, bytes))
        };
        let (images, cameras) = match take("images.bin") {
            Some((path, bytes)) => (
                colmap::images_of_bytes(&path, &bytes)?,
                take("cameras.bin")
                    .map(|(path, bytes)| colmap::cameras_of_bytes(&path, &bytes))
                    .transpose()?,
            ),
            None => {
                let text = take("images.txt").unwrap_or_default();
                let cameras = take("cameras.txt").map(|(path, bytes)| {
                    colmap::cameras_of_text(&TextFile::from_bytes(path, bytes)?)
                });
                let images = colmap::images_of_text(&TextFile::from_bytes(text.0, text.1)?)?;
                (images, cameras.transpose()?)
            }
        };
        self.source = format!("the COLMAP model in {}", shown_folder(folder));
        if cameras.is_none() {
            self.notes
                .push("The model's cameras are not there: focal lengths are solved.".to_owned());
        }
        self.take_images(names, &images, &cameras.unwrap_or_default());
        Ok(())
    }

    fn take_images(
        &mut self,
        names: &Names,
        images: &[RawImage],
        records: &HashMap<u32, CameraRecord>,
    ) {
        let mut bent = 0;
        let mut cameras: HashMap<u32, Option<Camera>> = HashMap::new();
        for (id, record) in records {
            match camera_of(record) {
                Ok(camera) => {
                    bent += usize::from(camera.model.has_distortion());
                    cameras.insert(*id, pinhole(&camera));
                }
                Err(error) => self.notes.push(format!("Camera {id}: {error}.")),
            }
        }
        if bent > 0 {
            self.notes.push(format!(
                "The lens distortion of {bent} cameras is not taken into account."
            ));
        }
        let of_image = |image: &RawImage| {
            let pose = rigid_from_quaternion(
                QuaternionOrder::default().wxyz(image.quaternion),
                image.translation.into(),
            );
            let pose = pose.map(|cam_from_world| KnownPose {
                cam_from_world,
                camera: cameras.get(&image.camera).copied().flatten(),
                focal: None,
            });
            (image.name.clone(), pose.map_err(|e| e.to_string()))
        };
        self.assign(names, images.iter().map(of_image).collect());
    }

    fn read_matrices(
        &mut self,
        names: &Names,
        files: BTreeMap<String, Vec<u8>>,
    ) -> Result<(), FormatError> {
        self.source = "a .pose.txt of their own".to_owned();
        let mut poses = Vec::new();
        let mut num_moved = 0;
        for (path, bytes) in files {
            let Some(stem) = path.strip_suffix(MATRIX).map(str::to_owned) else {
                continue;
            };
            // The folders that 7-Scenes is shipped in, with poses of its depth camera.
            let is_depth = stem
                .rsplit('/')
                .nth(1)
                .is_some_and(|f| f.starts_with("seq-"));
            num_moved += usize::from(is_depth);
            let pose = matrix(&TextFile::from_bytes(path, bytes)?)?;
            let pose = pose.map(|world_from_cam| {
                let of_file = world_from_cam.inverse();
                KnownPose {
                    cam_from_world: if is_depth {
                        of_color_camera(&of_file)
                    } else {
                        of_file
                    },
                    camera: None,
                    focal: None,
                }
            });
            let name = [".color", ".rgb", ""].map(|kind| format!("{stem}{kind}"));
            let found = name.iter().find(|n| names.find(n) != Found::Nothing);
            let name = found.unwrap_or(&stem).clone();
            poses.push((name, pose.map_err(|e| e.to_string())));
        }
        if num_moved > 0 {
            self.notes.push(
                "Poses of 7-Scenes are the depth camera's: moved to the colour camera by the known transform."
                    .to_owned(),
            );
        }
        self.assign(names, poses);
        Ok(())
    }

    fn read_list(
        &mut self,
        names: &Names,
        files: BTreeMap<String, Vec<u8>>,
    ) -> Result<(), FormatError> {
        let texts = files.into_iter().filter_map(|(path, bytes)| {
            // What is no text is no list.
            let file = TextFile::from_bytes(path, bytes).ok()?;
            let kind = list::sniff(&file).filter(|kind| *kind != ListKind::Query)?;
            Some((file, kind))
        });
        let mut lists: Vec<(TextFile, ListKind)> = texts.collect();
        let best = (0..lists.len()).min_by_key(|i| list::rank(lists[*i].0.name()));
        let Some((file, kind)) = best.map(|i| lists.swap_remove(i)) else {
            return Ok(());
        };
        self.source = file.name().to_owned();
        if !lists.is_empty() {
            let others: Vec<&str> = lists.iter().map(|(f, _)| f.name()).collect();
            self.notes.push(format!(
                "{} is read; other lists of poses: {}.",
                file.name(),
                others.join(", ")
            ));
        }
        let mut poses = Vec::new();
        for line in file.lines() {
            let entry = list::entry(
                &line,
                kind,
                kind.usual_direction(),
                QuaternionOrder::default(),
            )?;
            if let Some(pose) = entry.cam_from_world {
                let pose = pose.map(|cam_from_world| KnownPose {
                    cam_from_world,
                    camera: None,
                    focal: entry.focal,
                });
                poses.push((entry.name, pose));
            }
        }
        self.assign(names, poses);
        Ok(())
    }

    /// Gives poses to the pictures that their names mean, and counts what cannot be used.
    fn assign(&mut self, names: &Names, poses: Vec<(String, Result<KnownPose, String>)>) {
        let (mut num_absent, mut num_several, mut num_twice) = (0, 0, 0);
        let mut lost: Vec<(String, usize, String)> = Vec::new();
        for (name, pose) in poses {
            let at = match names.find(&name) {
                Found::One(at) => at,
                Found::Nothing => {
                    num_absent += 1;
                    continue;
                }
                Found::Several(_) => {
                    num_several += 1;
                    continue;
                }
            };
            match pose {
                Ok(pose) if self.of_pictures[at].is_none() => self.of_pictures[at] = Some(pose),
                Ok(_) => num_twice += 1,
                Err(reason) => match lost.iter_mut().find(|l| l.0 == reason) {
                    Some(known) => known.1 += 1,
                    None => lost.push((reason, 1, name)),
                },
            }
        }
        for (reason, count, name) in lost {
            self.notes
                .push(format!("{count} poses cannot be used ({name}: {reason})."));
        }
        for (count, what) in [
            (num_absent, "are of pictures that are not here"),
            (
                num_several,
                "fit several pictures of one name: give the folder that holds theirs",
            ),
            (num_twice, "are of pictures that have one before"),
        ] {
            if count > 0 {
                self.notes.push(format!("{count} poses {what}."));
            }
        }
    }
}

/// The camera of a record, for what [`pinhole`] leaves of it: no model has to be fitted, as [`super::expressed`] would.
fn camera_of(record: &CameraRecord) -> Result<Camera, CameraError> {
    // The first numbers of `FULL_OPENCV` are those of `OPENCV`.
    let model = match (record.model.as_str(), record.params.as_slice()) {
        ("FULL_OPENCV", params @ [_, _, _, _, _, _, _, _, _, _, _, _]) => {
            CameraModel::from_colmap("OPENCV", &params[..8])?
        }
        (name, params) => CameraModel::from_colmap(name, params)?,
    };
    let camera = Camera {
        width: record.width,
        height: record.height,
        model,
    };
    camera.validate()?;
    Ok(camera)
}

/// A camera without its distortion. A fisheye's is what makes the picture: without it nothing fits.
fn pinhole(camera: &Camera) -> Option<Camera> {
    if matches!(camera.model, CameraModel::OpenCvFisheye { .. }) {
        return None;
    }
    let ((fx, fy), center) = (camera.focal_px(), camera.principal_point());
    let (cx, cy) = (center.x, center.y);
    Some(Camera {
        model: CameraModel::Pinhole { fx, fy, cx, cy },
        ..*camera
    })
}

fn shown_folder(folder: &str) -> &str {
    match folder.trim_end_matches('/') {
        "" => "this folder",
        folder => folder,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn known(pictures: &[&str], files: &[(&str, &str)]) -> KnownPoses {
        let pictures: Vec<String> = pictures.iter().map(|p| (*p).to_owned()).collect();
        let files = files.iter().map(|(path, text)| GivenFile {
            path: (*path).to_owned(),
            bytes: text.as_bytes().to_vec(),
        });
        known_poses(&pictures, files.collect())
    }

    fn position(known: &KnownPoses, at: usize) -> Option<Vector3<f64>> {
        Some(known.of_pictures[at]?.cam_from_world.center_in_world())
    }

    /// The row of a matrix that stands at (x, 0, 0) and looks along z.
    fn at(x: f64) -> String {
        format!("1 0 0 {x}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    }

    #[test]
    fn a_list_is_read_as_the_native_tool_reads_it() {
        // Quaternions map from the world; names may hold folders and spaces; nine numbers are ACE0's, the last its confidence.
        let list =
            "# made by hand\n./rgb/a b.JPG 1 0 0 0 -2 0 0 585 2000\nc.jpg 1 0 0 0 0 0 0 585 10\n";
        let known = known(&["x/rgb/a b.jpg", "x/c.jpg"], &[("x/poses.txt", list)]);
        assert_eq!(position(&known, 0), Some(Vector3::new(2.0, 0.0, 0.0)));
        assert_eq!(known.of_pictures[0].and_then(|p| p.focal), Some(585.0));
        assert_eq!(known.of_pictures[1], None);
        assert_eq!(known.source, "x/poses.txt");
        assert_eq!(
            known.notes,
            ["1 poses cannot be used (c.jpg: confidence of the pose is below 1000)."]
        );
    }

    #[test]
    fn what_is_no_pose_is_never_taken_for_one() {
        // A line of TUM RGB-D: a time in place of a name.
        let tum = known(&["a.png"], &[("poses.txt", "1305.1 1 2 3 0 0 0 1\n")]);
        assert_eq!(tum.of_pictures, [None]);
        assert_eq!(tum.notes, ["1 poses are of pictures that are not here."]);
        // A scaled matrix.
        let scaled = "a.png 2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n";
        let scaled = known(&["a.png"], &[("poses.txt", scaled)]);
        assert_eq!(scaled.of_pictures, [None]);
        assert!(scaled.notes[0].contains("similarity"), "{:?}", scaled.notes);
        // A line that is broken names itself, and the list counts for nothing.
        let broken = "a.png 1 0 0 0 0 0 0\nb.png 1 0 0 x 0 0 0\n";
        let broken = known(&["a.png", "b.png"], &[("poses.txt", broken)]);
        assert_eq!(broken.of_pictures, [None, None]);
        assert_eq!(broken.source, "");
        assert!(broken.notes[0].starts_with("poses.txt, line 2: `x`"));
        // COLMAP's list of pictures without the second lines.
        let images = "1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 0 0 0 1 b.png\n";
        let images = known(&["a.png", "b.png"], &[("images.txt", images)]);
        assert_eq!(images.of_pictures, [None, None]);
        assert!(images.notes[0].starts_with("images.txt, line 2: expected triples"));
    }

    #[test]
    fn matrices_belong_to_the_picture_beside_them_in_each_folder() {
        let pictures = [
            "r/one/f-1.color.png",
            "r/two/f-1.color.png",
            "r/two/f-2.png",
        ];
        let files = [
            ("r/one/f-1.pose.txt", at(1.0)),
            ("r/two/f-1.pose.txt", at(2.0)),
            ("r/two/f-2.pose.txt", "nan ".repeat(16)),
            ("r/two/f-3.pose.txt", at(3.0)),
        ];
        let files = files.each_ref().map(|(path, text)| (*path, text.as_str()));
        let found = known(&pictures, &files);
        assert_eq!(position(&found, 0), Some(Vector3::new(1.0, 0.0, 0.0)));
        assert_eq!(position(&found, 1), Some(Vector3::new(2.0, 0.0, 0.0)));
        assert_eq!(found.of_pictures[2], None);
        assert_eq!(found.notes.len(), 2, "{:?}", found.notes);
        // Without folders nobody can tell; a wrong pose would be worse than none.
        let flat = known(&["f-1.color.png", "f-1.color.png"], &files);
        assert_eq!(flat.of_pictures, [None, None]);
        // As 7-Scenes is shipped: the colour camera stands some centimetres beside the depth camera.
        let found = known(
            &["seq-01/f-1.color.png"],
            &[("seq-01/f-1.pose.txt", &at(1.0))],
        );
        let off = position(&found, 0).expect("posed") - Vector3::new(1.0, 0.0, 0.0);
        assert!((off.norm() - 0.0256).abs() < 1e-3, "{off}");
        assert!(found.notes[0].contains("7-Scenes"));
    }

    #[test]
    fn a_model_gives_poses_and_cameras_and_the_larger_of_two_is_read() {
        let images = "# two lines each\n7 1 0 0 0 -1 0 0 1 left/a b.jpg\n\n8 1 0 0 0 0 0 0 2 c.jpg\n10 20 -1\n";
        let cameras =
            "1 SIMPLE_PINHOLE 640 480 585 320 240\n2 OPENCV 640 480 500 501 320 240 0.1 0 0 0\n";
        let found = known(
            &["r/left/a b.jpg", "r/c.jpg"],
            &[
                ("r/sparse/0/images.txt", "1 1 0 0 0 9 9 9 1 c.jpg\n\n"),
                ("r/sparse/1/images.txt", images),
                ("r/sparse/1/cameras.txt", cameras),
                ("r/poses.txt", "c.jpg 1 0 0 0 5 5 5\n"),
            ],
        );
        assert_eq!(position(&found, 0), Some(Vector3::new(1.0, 0.0, 0.0)));
        let focal = |at: usize| found.of_pictures[at]?.camera.map(|c| c.focal_px());
        assert_eq!(
            (focal(0), focal(1)),
            (Some((585.0, 585.0)), Some((500.0, 501.0)))
        );
        assert_eq!(found.source, "the COLMAP model in r/sparse/1");
        assert_eq!(
            found.notes,
            ["The lens distortion of 1 cameras is not taken into account."]
        );
    }

    #[test]
    fn nothing_is_known_without_files() {
        let none = known(&["a.png"], &[("notes.txt", "hello\n")]);
        assert_eq!((none.source.as_str(), &none.notes[..]), ("", &[][..]));
        assert_eq!(none.of_pictures, [None]);
    }
}
