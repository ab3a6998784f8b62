//! What was wrong with a still picture, found out by trying: with another focal length, in a mirror, and turned by quarters.

use super::Relocalizer;
use super::accept::is_fitting;
use super::error::LocateError;
use super::options::Query;
use super::result::{Counts, NotLocated, Outcome, Report};
use crate::geometry::{Camera, Pixel};
use crate::image::GrayImage;
use crate::math::elementary::ln;

/// A picture that was changed explains a failure when its answer is so sure.
const LEAST_CONFIDENCE: f64 = 0.8;
/// And a focal length when it differs by so much, in ln f, from the given one.
const LEAST_FOCAL_LN: f64 = 0.05;
/// A position that is less sure is looked at in a mirror,
const SURE: f64 = 0.9;
/// and is none where so many times as much is found again there. Posters and tiles are much the same in a mirror: in the sample room
/// mirrored pictures found up to half of what they show as they should be.
const MIRROR_GAIN: f64 = 1.5;

impl Relocalizer {
    /// The report of the frame that was answered last, with a better reason why it is not located: it is located without the
    /// intrinsics that came with it, in a mirror, or once it is turned. Descriptors do not see through turns: what lies on its side
    /// looks like another place. A frame that is located, but little sure or by few of its matches, is not where clearly more of the
    /// scene is found in its mirror image.
    ///
    /// For single pictures: it takes up to five times as long as locating one, on the CPU, and makes copies of the picture. What the
    /// frame left behind ([`Self::points`], [`Self::features`]) is gone then.
    ///
    /// # Errors
    /// [`LocateError::OutOfOrder`] when another frame was begun meanwhile; [`LocateError`] for a camera that makes no sense.
    pub fn explain(&mut self, query: &Query, report: &Report) -> Result<Report, LocateError> {
        if self.num_observed != self.num_begun {
            return Err(LocateError::OutOfOrder {
                number: self.num_observed,
            });
        }
        let better = match report.outcome {
            Outcome::NotLocated(NotLocated::FewFeatures | NotLocated::Timeout) => None,
            Outcome::NotLocated(_) => self.cause(query)?,
            Outcome::Located(l) if l.confidence >= SURE && is_fitting(&report.counts) => None,
            Outcome::Located(_) => {
                let picture = self.front_end.picture().mirrored();
                let mirrored = self.locate_changed(&picture, query, mirrored)?;
                let is_more = num_found(&mirrored) > MIRROR_GAIN * num_found(report);
                (is_sure(&mirrored) && is_more).then_some(NotLocated::Mirrored)
            }
        };
        Ok(better.map_or(*report, |reason| Report {
            outcome: Outcome::NotLocated(reason),
            counts: Counts {
                num_point_inliers: 0,
                num_line_inliers: 0,
                ..report.counts
            },
            ..*report
        }))
    }

    /// What has to be changed for the picture to be located.
    fn cause(&mut self, query: &Query) -> Result<Option<NotLocated>, LocateError> {
        let mut picture = self.front_end.picture().clone();
        if let Some(given) = query.camera {
            let unknown = Query {
                camera: None,
                focal: None,
                ..*query
            };
            let report = self.locate(&picture.frame(), &unknown, &mut || 0.0)?;
            let other = ln(report.camera.focal_px().0 / given.focal_px().0).abs();
            if is_sure(&report) && other > LEAST_FOCAL_LN {
                return Ok(Some(NotLocated::FocalMismatch));
            }
        }
        if is_sure(&self.locate_changed(&picture.mirrored(), query, mirrored)?) {
            return Ok(Some(NotLocated::Mirrored));
        }
        let mut turned = *query;
        for clockwise_deg in [90, 180, 270] {
            picture = picture.turned_clockwise();
            turned.camera = turned.camera.map(|camera| camera.turned_clockwise().0);
            if is_sure(&self.locate_changed(&picture, &turned, |camera| camera)?) {
                return Ok(Some(NotLocated::Turned { clockwise_deg }));
            }
        }
        Ok(None)
    }

    /// Locates a picture that was made of the one that came. What else is known of that is of how it came.
    fn locate_changed(
        &mut self,
        picture: &GrayImage,
        query: &Query,
        camera: fn(Camera) -> Camera,
    ) -> Result<Report, LocateError> {
        let changed = Query {
            camera: query.camera.map(camera),
            camera_source: query.camera_source,
            ..Query::default()
        };
        self.locate(&picture.frame(), &changed, &mut || 0.0)
    }
}

/// The camera of the mirrored picture, but for tangential distortion, which no reason depends on.
fn mirrored(camera: Camera) -> Camera {
    let at = camera.principal_point();
    camera.with_principal_point(Pixel::new(f64::from(camera.width) - at.x, at.y))
}

fn is_sure(report: &Report) -> bool {
    let located = report.outcome.located();
    located.is_some_and(|l| l.confidence > LEAST_CONFIDENCE)
}

fn num_found(report: &Report) -> f64 {
    let found = report.found_again.unwrap_or_default();
    f64::from(found.found_points + found.found_lines)
}
