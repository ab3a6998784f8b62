//! A film's way to a scene, for [`crate::portable`]: matching, poses, points, lines, landmarks, and the bytes of the file.

use crate::film::film_pictures;
use landline::mapping::{FilmMap, FilmParams, Origin, SceneRequest, map_film};
use landline::models::ExtractorKind;
use landline::reconstruction::motion::CameraGroup;
use landline::reconstruction::{Stage, View};
use landline::scene_file::Precision;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

/// What comes of a film whose focal length nobody knows, stage by stage, so that a difference names where it begins.
///
/// # Panics
///
/// When there is no scene, or one without lines or without a picture's pose.
pub(crate) fn film() -> [(&'static str, Vec<f64>); 4] {
    let (mut views, _) = film_pictures();
    // Nothing here waits for anything but the observer, who does not.
    match pin!(made(&mut views)).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(numbers) => numbers,
        Poll::Pending => panic!("the film waits for something"),
    }
}

async fn made(views: &mut [View]) -> [(&'static str, Vec<f64>); 4] {
    let mut go_on = |_: Stage, _: usize, _: usize| true;
    let group = CameraGroup::unknown(640, 480);
    let map = map_film(views, &group, &FilmParams::default(), &mut go_on).await;
    let map = map.unwrap_or_else(|error| panic!("no map of the film: {error}"));
    assert_eq!(map.posed.len(), views.len(), "pictures without a pose");
    let origin = Origin {
        extractor: ExtractorKind::Xfeat,
        extractor_sha256: "0".repeat(64),
        working_max_side: 640,
        source: "portable".to_owned(),
    };
    let request = SceneRequest {
        anchors: None,
        lines: true,
        hold_out_every: 0,
        licence: String::new(),
        created: None,
        max_bytes: None,
        precision: Precision::Int8,
    };
    let scene = map.scene(views, &origin, &request, &mut go_on).await;
    let scene = scene.unwrap_or_else(|error| panic!("no scene of the film: {error}"));
    let bytes = scene.to_bytes(request.precision);
    let bytes = bytes.unwrap_or_else(|error| panic!("no file of the scene: {error}"));
    [
        ("film's poses", poses(&map)),
        ("film's points", points(&map)),
        ("film's lines", lines(&map)),
        ("film's file", bytes.into_iter().map(f64::from).collect()),
    ]
}

fn poses(map: &FilmMap) -> Vec<f64> {
    let (fx, fy) = map.main_camera().focal_px();
    let poses = map.cam_from_world.iter().flatten();
    poses
        .flat_map(|pose| pose.to_row_major())
        .chain([fx, fy])
        .collect()
}

fn points(map: &FilmMap) -> Vec<f64> {
    let points = map.points.iter();
    points
        .flat_map(|p| p.point_in_world.iter().copied())
        .collect()
}

fn lines(map: &FilmMap) -> Vec<f64> {
    let ends = map
        .lines
        .iter()
        .flat_map(|l| [l.start_in_world, l.end_in_world]);
    ends.flat_map(|end| [end.x, end.y, end.z]).collect()
}
