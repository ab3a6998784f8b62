//! Pictures that EXIF turns, where the data do not say whether their poses are of the pixels as stored or upright: the
//! matches with their neighbours say it.

use crate::dataset::{Dataset, DatasetImage};
use landline::features::FeatureSet;
use landline::mapping::TrackParams;
use landline::reconstruction::{PosedView, agreement};
use std::collections::HashMap;

/// Pairs of pictures that are looked at.
const NUM_PAIRS: usize = 40;

/// How poses of turned pictures are read.
#[derive(Debug, Clone, PartialEq)]
pub struct Turned {
    /// Turned pictures among those that teach.
    pub num_pictures: usize,
    /// Their poses are of the pixels as stored.
    pub is_stored: bool,
    /// Share of the matches that agree if poses are of upright pixels.
    pub upright: f64,
    /// The same of stored ones.
    pub stored: f64,
    /// Pictures as they are in the other reading, by their place in the data set.
    stored_images: HashMap<usize, DatasetImage>,
}

impl Turned {
    /// Pictures of the data set at these places, as they are to be read.
    pub(super) fn chosen<'a>(
        &'a self,
        dataset: &'a Dataset,
        positions: &[usize],
    ) -> Vec<&'a DatasetImage> {
        let stored = |i: &usize| self.stored_images.get(i).filter(|_| self.is_stored);
        positions
            .iter()
            .map(|i| stored(i).unwrap_or(&dataset.images[*i]))
            .collect()
    }
}

impl core::fmt::Display for Turned {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            num_pictures,
            upright,
            stored,
            ..
        } = self;
        let [read, other] = if self.is_stored {
            ["as stored", "upright"]
        } else {
            ["upright", "as stored"]
        };
        let (mine, others) = if self.is_stored {
            (stored, upright)
        } else {
            (upright, stored)
        };
        write!(
            f,
            "{num_pictures} pictures are turned by EXIF: their poses are read as of pixels {read} ({:.0} % of the matches \
             agree, {:.0} % as of pixels {other})",
            100.0 * mine,
            100.0 * others
        )
    }
}

/// Decides for the pictures at these places, whose features are given; `None` where there is nothing to decide.
pub(super) fn decide(
    dataset: &Dataset,
    positions: &[usize],
    features: &[FeatureSet],
    params: &TrackParams,
) -> Option<Turned> {
    let stored_images: HashMap<usize, DatasetImage> = dataset
        .undecided
        .iter()
        .filter(|other| positions.contains(&other.image))
        .map(|other| {
            let image = DatasetImage {
                camera: other.camera,
                cam_from_world: other.cam_from_world,
                ..dataset.images[other.image].clone()
            };
            (other.image, image)
        })
        .collect();
    if stored_images.is_empty() {
        return None;
    }
    let share = |is_stored: bool| {
        let image = |i: &usize| match stored_images.get(i).filter(|_| is_stored) {
            Some(image) => image,
            None => &dataset.images[*i],
        };
        let posed: Vec<(usize, PosedView<'_>)> = positions
            .iter()
            .zip(features)
            .filter_map(|(i, features)| {
                let DatasetImage {
                    camera,
                    cam_from_world,
                    ..
                } = image(i);
                Some((*i, PosedView::new(*camera, (*cam_from_world)?, features)))
            })
            .collect();
        let (places, views): (Vec<usize>, Vec<PosedView<'_>>) = posed.into_iter().unzip();
        let is_turned = |at: usize| stored_images.contains_key(&places[at]);
        agreement(&views, is_turned, NUM_PAIRS, params.matches.min_cosine)
    };
    let (upright, stored) = (share(false)?, share(true)?);
    Some(Turned {
        num_pictures: stored_images.len(),
        is_stored: stored > upright,
        upright,
        stored,
        stored_images,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Split, Undecided};
    use landline::geometry::CamFromWorld;
    use landline_testkit::{film_camera, film_pictures};

    /// A film of which EXIF turns every second picture, read as of upright pixels.
    fn film(is_stored: bool) -> (Dataset, Vec<FeatureSet>) {
        let (views, poses) = film_pictures();
        let mut dataset = Dataset::empty("a film");
        for (i, pose) in poses.iter().enumerate() {
            let right = (film_camera(), Some(*pose));
            let (camera, turn) = film_camera().turned_clockwise();
            let wrong = CamFromWorld::new(turn * pose.rotation, turn * pose.translation);
            let wrong = (camera, Some(wrong));
            let is_turned = i % 2 == 1;
            let (upright, stored) = match is_stored {
                true => (wrong, right),
                false => (right, wrong),
            };
            let (camera, cam_from_world) = if is_turned { upright } else { right };
            dataset.images.push(DatasetImage {
                name: format!("{i}.jpg"),
                path: format!("{i}.jpg").into(),
                camera,
                cam_from_world,
                split: Split::Train,
            });
            if is_turned {
                let (camera, cam_from_world) = stored;
                dataset.undecided.push(Undecided {
                    image: i,
                    camera,
                    cam_from_world,
                });
            }
        }
        (dataset, views.into_iter().map(|v| v.features).collect())
    }

    #[test]
    fn poses_of_stored_pixels_are_told_by_the_matches() {
        let (_, poses) = film_pictures();
        let positions: Vec<usize> = (0..poses.len()).collect();
        for is_stored in [true, false] {
            let (dataset, features) = film(is_stored);
            let turned = decide(&dataset, &positions, &features, &TrackParams::default());
            let turned = turned.expect("there is something to decide");
            assert_eq!(turned.is_stored, is_stored, "{turned}");
            assert!((turned.stored - turned.upright).abs() > 0.5, "{turned}");
            let chosen = turned.chosen(&dataset, &positions);
            for (image, pose) in chosen.iter().zip(&poses) {
                assert_eq!(
                    (image.camera, image.cam_from_world),
                    (film_camera(), Some(*pose))
                );
            }
        }
        let (mut dataset, features) = film(true);
        dataset.undecided.clear();
        assert_eq!(
            decide(&dataset, &positions, &features, &TrackParams::default()),
            None
        );
    }
}
