//! Why a still picture is not located, found out by trying: with another focal length, and turned by quarters.

use super::Relocalizer;
use super::error::LocateError;
use super::options::Query;
use super::result::{NotLocated, Report};
use crate::math::elementary::ln;

/// A picture that was changed explains a failure when its answer is so sure.
const LEAST_CONFIDENCE: f64 = 0.8;
/// And a focal length when it differs by so much, in ln f, from the given one.
const LEAST_FOCAL_LN: f64 = 0.05;

impl Relocalizer {
    /// The reason why the frame that was answered last was not located, or a better one: it is located without the intrinsics that
    /// came with it, or once it is turned. Descriptors do not see through turns: what lies on its side looks like another place.
    ///
    /// For single pictures: it takes up to four times as long as locating one, on the CPU, and makes copies of the picture. What the
    /// frame left behind ([`Self::points`], [`Self::features`]) is gone then.
    ///
    /// # Errors
    /// [`LocateError::OutOfOrder`] when another frame was begun meanwhile; [`LocateError`] for a camera that makes no sense.
    pub fn explain(
        &mut self,
        query: &Query,
        reason: NotLocated,
    ) -> Result<NotLocated, LocateError> {
        if self.num_observed != self.num_begun {
            return Err(LocateError::OutOfOrder {
                number: self.num_observed,
            });
        }
        if matches!(reason, NotLocated::FewFeatures | NotLocated::Timeout) {
            return Ok(reason);
        }
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
                return Ok(NotLocated::FocalMismatch);
            }
        }
        let mut camera = query.camera;
        for clockwise_deg in [90, 180, 270] {
            picture = picture.turned_clockwise();
            camera = camera.map(|camera| camera.turned_clockwise().0);
            // What else is known of the picture is of how it came.
            let turned = Query {
                camera,
                camera_source: query.camera_source,
                ..Query::default()
            };
            if is_sure(&self.locate(&picture.frame(), &turned, &mut || 0.0)?) {
                return Ok(NotLocated::Turned { clockwise_deg });
            }
        }
        Ok(reason)
    }
}

fn is_sure(report: &Report) -> bool {
    let located = report.outcome.located();
    located.is_some_and(|l| l.confidence > LEAST_CONFIDENCE)
}
