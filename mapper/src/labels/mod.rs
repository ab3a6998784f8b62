//! Features of training pictures with their 3D targets: what training starts from.
//!
//! Pixels are corner-based pixels of the picture as read, descriptors are as the extractor delivered them (unit vectors). World
//! coordinates are those of the data set. Targets are not stored: they are the tracks' observations the other way round
//! ([`Labels::targets`]).

mod advice;
mod build;
mod file;
mod from_model;
mod import;
mod variants;

pub use build::{LabelError, build, build_from};
pub use file::LabelFileError;
pub use from_model::{MAX_DISTANCE_PX, line_tracks_from_map, point_tracks_from_model};
pub use import::Imported;
pub use variants::{VariantStats, add_variants};

pub use landline::mapping::{Origin, TrackParams, TrackStats};

use landline::features::FeatureSet;
use landline::reconstruction::{Reconstruction, View, ViewTargets};

/// A map of a place with the pictures that it was made of, and changed copies of them to train on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// What made the features, and what the world's lengths and directions mean.
    pub origin: Origin,
    /// Pictures with poses in the data set's order, points and lines.
    pub map: Reconstruction,
    /// Changed copies of the pictures, for training only: no track counts them among its observations.
    pub variants: Vec<LabelledVariant>,
}

/// A picture that was turned, scaled, blurred or lit differently before its features were taken.
///
/// Features lie where they are in the unchanged picture, with that picture's camera and pose: what a network predicts does
/// not depend on where in the image a feature was, so reprojection needs no changed camera.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledVariant {
    /// Index into the map's views.
    pub of_view: u32,
    /// In pixels of that view.
    pub features: FeatureSet,
}

/// Which track each feature sees.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Targets {
    /// Of the map's views.
    pub views: Vec<ViewTargets>,
    /// Of the variants.
    pub variants: Vec<ViewTargets>,
}

/// A picture, or a changed copy of one, with its targets.
#[derive(Debug, Clone, Copy)]
pub struct Labelled<'a> {
    /// Camera and pose.
    pub view: &'a View,
    /// Of the picture or the copy.
    pub features: &'a FeatureSet,
    /// For these features.
    pub targets: &'a ViewTargets,
}

impl Labels {
    /// Targets of all features: those of pictures are the observations, those of variants the tracks of their picture that
    /// lie where the feature is.
    pub fn targets(&self) -> Targets {
        let views = self.map.targets();
        let variants = self
            .variants
            .iter()
            .map(|v| variants::targets(&self.map, &views, v))
            .collect();
        Targets { views, variants }
    }

    /// The pictures.
    pub fn pictures<'a>(&'a self, targets: &'a Targets) -> impl Iterator<Item = Labelled<'a>> {
        self.map
            .views
            .iter()
            .zip(&targets.views)
            .map(|(view, targets)| Labelled {
                view,
                features: &view.features,
                targets,
            })
    }

    /// Their changed copies, each with the index of its picture.
    pub fn changed_copies<'a>(
        &'a self,
        targets: &'a Targets,
    ) -> impl Iterator<Item = (usize, Labelled<'a>)> {
        self.variants
            .iter()
            .zip(&targets.variants)
            .filter_map(|(variant, targets)| {
                let of_view = variant.of_view as usize;
                let labelled = Labelled {
                    view: self.map.views.get(of_view)?,
                    features: &variant.features,
                    targets,
                };
                Some((of_view, labelled))
            })
    }
}
