//! What a data set brings along: points of a structure-from-motion model, lines of a line map.

use super::LabelError;
use crate::dataset::{Dataset, ModelLine, ModelPoint};
use std::collections::HashMap;

/// 3D points and lines that take the place of triangulated ones. Observations count the pictures that
/// are labelled: those with a pose.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Imported {
    /// Points, if they are to be used.
    pub(super) points: Option<Vec<ModelPoint>>,
    /// Lines, if the data set came with some.
    pub(super) lines: Option<Vec<ModelLine>>,
}

impl Imported {
    /// What `dataset` has for the pictures at `positions`: its lines whenever there are some, its points when asked for.
    ///
    /// # Errors
    /// When points are asked for and there are none.
    pub fn new(
        dataset: &Dataset,
        positions: &[usize],
        with_points: bool,
    ) -> Result<Self, LabelError> {
        if with_points && dataset.points.is_empty() {
            return Err(LabelError::NoModelPoints(dataset.format));
        }
        let has_pose = |i: &usize| dataset.images[*i].cam_from_world.is_some();
        let place: HashMap<usize, usize> = positions
            .iter()
            .copied()
            .filter(has_pose)
            .zip(0..)
            .collect();
        let points = with_points.then(|| {
            let here = |p: &ModelPoint| ModelPoint {
                observations: p
                    .observations
                    .iter()
                    .filter_map(|(image, pixel)| Some((*place.get(image)?, *pixel)))
                    .collect(),
                ..*p
            };
            dataset.points.iter().map(here).collect()
        });
        let lines = (!dataset.lines.is_empty()).then(|| {
            let here = |l: &ModelLine| ModelLine {
                observations: l
                    .observations
                    .iter()
                    .filter_map(|(image, segment)| Some((*place.get(image)?, *segment)))
                    .collect(),
                ..*l
            };
            dataset.lines.iter().map(here).collect()
        });
        Ok(Self { points, lines })
    }
}
