//! What people look at: a located picture with the scene's lines on it, and a failure beside the truth.

use crate::draw::{
    Canvas, DIM_RED, Entry, Legend, Mark, RED, Stroke, WHITE, YELLOW, confidence_color,
};
use crate::export::Map;
use image::RgbImage;
use landline::geometry::{CamFromWorld, Camera};
use landline::pose::{LineCorrespondence, PointCorrespondence};

/// The picture under what is drawn on it.
const BRIGHTNESS: f64 = 0.62;

/// A picture that was or was not located.
pub struct Located<'a> {
    /// Points that went to the solver, and whether they agree with the pose.
    pub points: &'a [(PointCorrespondence, bool)],
    /// Lines that went to the solver, and whether they agree with the pose.
    pub lines: &'a [(LineCorrespondence, bool)],
    /// As solved, with the refined focal length.
    pub camera: Camera,
    /// None when the picture was not located.
    pub cam_from_world: Option<CamFromWorld>,
    /// What the legend says on top.
    pub title: String,
    /// Under it.
    pub text: Vec<String>,
}

/// Draws what was detected, what agrees, and the scene's lines where the pose puts them, in the colour of their
/// confidence.
pub fn located(picture: &RgbImage, located: &Located<'_>) -> RgbImage {
    let mut canvas = Canvas::new(picture, BRIGHTNESS);
    let thin = |color| Stroke {
        width_px: 1.2,
        color,
        edge_px: 0.0,
    };
    for (line, is_inlier) in located.lines {
        let color = if *is_inlier { WHITE } else { DIM_RED };
        canvas.line(line.start, line.end, thin(color));
    }
    for (point, is_inlier) in located.points {
        if !*is_inlier {
            canvas.ring(point.pixel, 2.5, DIM_RED);
        }
    }
    if let Some(cam_from_world) = &located.cam_from_world {
        // The surest on top.
        let mut agreeing: Vec<&LineCorrespondence> = located
            .lines
            .iter()
            .filter(|(_, is_inlier)| *is_inlier)
            .map(|(line, _)| line)
            .collect();
        agreeing.sort_by(|a, b| a.confidence.total_cmp(&b.confidence));
        for line in agreeing {
            let stroke = Stroke {
                width_px: 2.6,
                color: confidence_color(line.confidence),
                edge_px: 1.0,
            };
            canvas.world_segment(
                &located.camera,
                cam_from_world,
                [&line.start_in_world, &line.end_in_world],
                stroke,
            );
        }
    }
    for (point, is_inlier) in located.points {
        if *is_inlier {
            canvas.disc(point.pixel, 2.2, confidence_color(point.confidence));
        }
    }
    canvas.legend(&Legend {
        title: located.title.clone(),
        text: located.text.clone(),
        entries: vec![
            Entry::new(
                Mark::Line(confidence_color(1.0)),
                "line of the scene where the pose puts it",
            ),
            Entry::new(Mark::Disc(confidence_color(1.0)), "point that agrees"),
            Entry::new(Mark::Confidence, "confidence, 0 to 1"),
            Entry::new(Mark::ThinLine(WHITE), "segment in the picture"),
            Entry::new(Mark::Ring(DIM_RED), "does not agree (line or point)"),
        ],
    });
    canvas.into_picture()
}

/// The points and segments of a map, drawn once where the truth puts them and once where the estimate does; `legend` is
/// title and text.
pub fn failure(
    picture: &RgbImage,
    camera: &Camera,
    [truth, estimate]: &[Option<CamFromWorld>; 2],
    map: &Map,
    (title, text): (String, Vec<String>),
) -> RgbImage {
    let mut canvas = Canvas::new(picture, BRIGHTNESS);
    for (pose, color) in [(truth, YELLOW), (estimate, RED)] {
        let Some(pose) = pose else { continue };
        for [a, b] in &map.segments {
            let stroke = Stroke {
                width_px: 1.8,
                color,
                edge_px: 0.7,
            };
            canvas.world_segment(camera, pose, [a, b], stroke);
        }
        for point in &map.points {
            if let Some(pixel) = camera.pixel_from_cam(&pose.transform_point(point)) {
                canvas.disc(pixel, 1.6, color);
            }
        }
    }
    canvas.legend(&Legend {
        title,
        text,
        entries: vec![
            Entry::new(Mark::Line(YELLOW), "the map where it is"),
            Entry::new(Mark::Line(RED), "the map where the estimate puts it"),
        ],
    });
    canvas.into_picture()
}
