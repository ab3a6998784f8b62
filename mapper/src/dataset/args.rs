//! What to read and how, as the command line gives it. The only module here that knows clap; readers get what they need of it
//! as plain values.

use super::split::IndexRange;
use crate::words::words;
use clap::builder::TypedValueParser;
use landline::formats::{PoseDirection, QuaternionOrder, expressed};
use landline::geometry::{CameraAxes, CameraRecord, Units};
use std::path::PathBuf;

/// Which data, and how to read it.
#[derive(Debug, Clone, clap::Args)]
pub struct DataArgs {
    /// Data set: a folder, a pose list, or a transforms.json.
    pub data: PathBuf,
    /// One of them.
    #[command(flatten)]
    pub one: OneOnly,
    /// Format; found out by itself when not given.
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// Folder of the pictures, when it is not beside the poses.
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// File with the poses, when the folder has several or others are wanted; relative to the data set.
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// What the poses of a list map.
    #[arg(long, value_name = "DIRECTION", value_parser = pose_direction())]
    pub pose_direction: Option<PoseDirection>,
    /// Order of the numbers of quaternions in a list or a COLMAP model.
    #[arg(long, value_name = "ORDER", value_parser = quaternion_order())]
    pub quaternions: Option<QuaternionOrder>,
    /// Where x, y and z of the camera point in the file: opencv, opengl, ros, or words as right-up-back.
    #[arg(long, value_name = "AXES")]
    pub camera_axes: Option<CameraAxes>,
    /// Use poses and cameras as they are given, even where the pictures contradict them.
    #[arg(long)]
    pub trust_poses: bool,
    /// 7-Scenes layout: the camera whose poses its files hold. As shipped they are the depth camera's and are moved to the
    /// colour camera; sets of other makers in that layout hold the colour camera's.
    #[arg(long, value_enum, value_name = "CAMERA")]
    pub poses_of: Option<PoseCamera>,
    /// One camera for all pictures: MODEL,width,height,parameters in COLMAP's order.
    #[arg(long, value_name = "MODEL,W,H,...", value_parser = parse_camera)]
    pub camera: Option<CameraRecord>,
    /// Cameras by picture: a list `name MODEL width height parameters...`.
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Folder of a LIMAP line map, or of any detector's segments in its layout.
    #[arg(long, value_name = "DIR")]
    pub lines: Option<PathBuf>,
    /// Pictures that teach, as positions in the sorted list (0-799, 0-99,160-).
    #[arg(long, value_name = "RANGE")]
    pub train: Option<IndexRange>,
    /// Pictures that test.
    #[arg(long, value_name = "RANGE")]
    pub test: Option<IndexRange>,
    /// Names of the pictures that test, one a line; an hloc query list will do. The others teach.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["train", "test"])]
    pub test_list: Option<PathBuf>,
    /// What one unit of length of the data set is; without it, a metre where the format says so and unknown elsewhere.
    #[arg(long, value_name = "UNITS", value_parser = units())]
    pub units: Option<Units>,
    /// Metres for one unit of length: the data set's lengths are multiplied by it and are metres then.
    #[arg(
        long,
        value_name = "F",
        conflicts_with = "units",
        allow_hyphen_values = true
    )]
    pub scale: Option<f64>,
    /// Which way is up in the data set's world: a direction, or `segments`, where upright edges in the pictures say it.
    #[arg(long, value_name = "X,Y,Z|segments", allow_hyphen_values = true, value_parser = parse_up)]
    pub up: Option<Up>,
}

impl DataArgs {
    /// A data set with nothing more said about it.
    pub fn of(data: PathBuf) -> Self {
        Self {
            data,
            one: OneOnly::default(),
            format: None,
            pictures: None,
            poses: None,
            pose_direction: None,
            quaternions: None,
            camera_axes: None,
            trust_poses: false,
            poses_of: None,
            camera: None,
            cameras: None,
            lines: None,
            train: None,
            test: None,
            test_list: None,
            units: None,
            scale: None,
            up: None,
        }
    }

    /// Whether the split is told, so that the data set's own counts for nothing.
    pub fn chooses_split(&self) -> bool {
        self.train.is_some() || self.test.is_some() || self.test_list.is_some()
    }
}

/// Who says which way is up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Up {
    /// The user, in the data set's world.
    Direction([f64; 3]),
    /// The segments of the pictures.
    Segments,
}

fn parse_up(text: &str) -> Result<Up, String> {
    match text.trim() {
        "segments" => Ok(Up::Segments),
        numbers => parse_vector(numbers)
            .map(Up::Direction)
            .map_err(|why| format!("{why}; or the word `segments`")),
    }
}

/// Refuses further paths after a data set, as a shell makes them of `room/*.jpg`.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct OneOnly {
    /// Nothing.
    #[arg(hide = true, value_name = "MORE", value_parser = no_more)]
    more: Vec<String>,
}

fn no_more(_: &str) -> Result<String, String> {
    Err(
        "one folder, file or video is taken here: give the folder that holds the pictures"
            .to_owned(),
    )
}

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// COLMAP sparse model, binary or text.
    Colmap,
    /// transforms.json of nerfstudio or instant-ngp.
    Transforms,
    /// 7-Scenes as shipped.
    SevenScenes,
    /// Folders `train|test/{rgb,poses,calibration}` of DSAC* and ACE.
    Ace,
    /// Indoor-6.
    Indoor6,
    /// TUM RGB-D.
    Tum,
    /// `name qw qx qy qz tx ty tz [f]`, or `name` and 16 numbers.
    PoseList,
    /// `name MODEL width height parameters...`: cameras without poses.
    QueryList,
}

/// Whose poses the files of a 7-Scenes folder are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PoseCamera {
    /// The depth camera's, as shipped.
    Depth,
    /// The colour camera's.
    Color,
}

/// Units of length.
pub fn units() -> impl TypedValueParser<Value = Units> {
    words([
        ("metres", Units::Metres, "One unit of length is one metre"),
        (
            "arbitrary",
            Units::Arbitrary,
            "Nobody knows how long one unit of length is",
        ),
    ])
}

fn pose_direction() -> impl TypedValueParser<Value = PoseDirection> {
    words([
        (
            "cam-from-world",
            PoseDirection::CamFromWorld,
            "World points into camera space (COLMAP)",
        ),
        (
            "world-from-cam",
            PoseDirection::WorldFromCam,
            "Camera points into the world; its translation is the camera's position",
        ),
    ])
}

fn quaternion_order() -> impl TypedValueParser<Value = QuaternionOrder> {
    words([
        (
            "wxyz",
            QuaternionOrder::Wxyz,
            "The real part first (COLMAP, Eigen's constructor)",
        ),
        (
            "xyzw",
            QuaternionOrder::Xyzw,
            "The real part last (ROS, scipy, TUM RGB-D)",
        ),
    ])
}

/// A camera from the command line: MODEL,width,height,parameters.
///
/// # Errors
/// In words.
pub fn parse_camera(text: &str) -> Result<CameraRecord, String> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let (&[model, width, height], params) = fields
        .split_first_chunk::<3>()
        .ok_or("expected MODEL,width,height,parameters")?;
    let number = |s: &str| s.parse::<f64>().map_err(|_| format!("`{s}` is no number"));
    let side = |s: &str| {
        s.parse::<u32>()
            .map_err(|_| format!("`{s}` is no size in pixels"))
    };
    let record = CameraRecord {
        model: model.to_ascii_uppercase(),
        width: side(width)?,
        height: side(height)?,
        params: params.iter().map(|p| number(p)).collect::<Result<_, _>>()?,
    };
    expressed(&record).map_err(|e| e.to_string())?;
    Ok(record)
}

/// Three numbers, `X,Y,Z`.
///
/// # Errors
/// In words.
pub fn parse_vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|field| {
            let field = field.trim();
            field.parse().map_err(|_| format!("`{field}` is no number"))
        })
        .collect::<Result<_, String>>()?;
    numbers
        .try_into()
        .map_err(|_| "expected X,Y,Z: three numbers with commas between them".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser as _;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        data: DataArgs,
    }

    fn parsed(words: &[&str]) -> Result<DataArgs, clap::Error> {
        Line::try_parse_from([&["test", "some/folder"], words].concat()).map(|line| line.data)
    }

    #[test]
    fn what_is_said_about_the_world_arrives() {
        let metres = parsed(&["--units", "metres"]).expect("a word");
        assert_eq!(metres.units, Some(Units::Metres));
        let unknown = parsed(&["--units", "arbitrary", "--up", "0,-3,4"]).expect("words");
        assert_eq!(
            (unknown.units, unknown.up),
            (
                Some(Units::Arbitrary),
                Some(Up::Direction([0.0, -3.0, 4.0]))
            )
        );
        let told = parsed(&["--up", "segments"]).expect("a word");
        assert_eq!(told.up, Some(Up::Segments));
        // Numbers that mean nothing are refused with the data set's name, where they are applied.
        for (word, scale) in [("--scale=-1", -1.0), ("--scale=1e300", 1e300)] {
            assert_eq!(parsed(&[word]).expect("a number").scale, Some(scale));
        }
    }

    #[test]
    fn words_that_are_none_are_refused() {
        for (words, said) in [
            (&["--units", "feet"][..], "metres, arbitrary"),
            (&["--up", "0,1"], "three numbers"),
            (&["--up", "a,b,c"], "`a` is no number"),
            (
                &["--units", "metres", "--scale", "2"],
                "cannot be used with",
            ),
            (&["some/other.jpg"], "give the folder"),
        ] {
            let error = parsed(words).expect_err("no such words").to_string();
            assert!(error.contains(said), "{words:?}: {error}");
        }
    }
}
