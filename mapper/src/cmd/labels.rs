//! `landline labels`: features and 3D targets of training pictures in one file; and the part of it that `landline map`
//! and `landline eval` share.

use crate::dataset::{DataArgs, Dataset, DatasetImage, Split, open};
use crate::extract::Extraction;
use crate::labels::{
    Imported, LabelError, LabelParams, LabelStats, Labels, Origin, add_variants, build_from,
};
use crate::progress::Progress;
use crate::scene::ExtractorArgs;
use anyhow::{Context, Result};
use landline::front_end::FrontEndOptions;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Make training labels: extract features, match, triangulate points and lines, write one file.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    teaching: TeachingArgs,
    /// Image-space variants of each picture (turned, scaled, blurred, lit differently) to train on.
    #[arg(long, value_name = "N", default_value_t = 0)]
    variants: usize,
    /// The label file to write.
    #[arg(long, short)]
    out: PathBuf,
}

/// What is taught: pictures with poses, by which extractor, with which 3D targets.
#[derive(Debug, Clone, clap::Args)]
pub struct TeachingArgs {
    /// The pictures.
    #[command(flatten)]
    pub data: DataArgs,
    /// What describes them.
    #[command(flatten)]
    pub extractor: ExtractorArgs,
    /// Folder of cached features; an interrupted run goes on from there.
    #[arg(long, value_name = "DIR")]
    pub features: Option<PathBuf>,
    /// Where 3D points come from.
    #[arg(long, value_enum, default_value_t = PointSource::Pictures)]
    pub points_from: PointSource,
}

/// Where the 3D points of labels come from. Lines come from the line map that `--lines` gives, or from the pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PointSource {
    /// Matched and triangulated under the poses.
    Pictures,
    /// The data set's own model (COLMAP): a keypoint takes the point whose observation lies nearest.
    Model,
}

/// Pictures, features and targets, as a command gets them.
pub struct Teaching {
    /// What was opened.
    pub dataset: Dataset,
    /// What made the features; makes more of them.
    pub extraction: Extraction,
    /// Of the training pictures.
    pub labels: Labels,
    /// About them.
    pub stats: LabelStats,
}

impl TeachingArgs {
    /// Opens the data set, extracts features and makes labels, telling on standard output what was found and how long it
    /// took. Without `--features` they are kept in `cache`, if there is one. So many `variants` of each picture are added.
    ///
    /// # Errors
    /// When the data cannot be read, nothing can be triangulated, or the disk refuses.
    pub fn teach(&self, cache: Option<&Path>, variants: usize) -> Result<Teaching> {
        let dataset = open(&self.data)?;
        print!("{}", dataset.table());
        let extractor = self.extractor.read()?;
        let options = FrontEndOptions::new(extractor.kind);
        let extraction = Extraction::new(extractor, options, self.features.as_deref().or(cache));
        let start = Instant::now();
        let (mut labels, stats) = self.labels(&dataset, &extraction)?;
        print!("{stats}");
        if variants > 0 {
            let posed: Vec<&DatasetImage> = dataset
                .of_split(Split::Train)
                .into_iter()
                .map(|i| &dataset.images[i])
                .filter(|i| i.cam_from_world.is_some())
                .collect();
            let changed = extraction.all_variants(&posed, variants, Progress::Terminal)?;
            print!("{}", add_variants(&mut labels, changed));
        }
        println!(
            "  time               {:.1} s",
            start.elapsed().as_secs_f64()
        );
        Ok(Teaching {
            dataset,
            extraction,
            labels,
            stats,
        })
    }

    /// Labels of a data set's training pictures.
    ///
    /// # Errors
    /// When features cannot be made or nothing can be triangulated.
    pub fn labels(
        &self,
        dataset: &Dataset,
        extraction: &Extraction,
    ) -> Result<(Labels, LabelStats)> {
        let positions = dataset.of_split(Split::Train);
        let chosen: Vec<&DatasetImage> = positions.iter().map(|i| &dataset.images[*i]).collect();
        let num_posed = chosen.iter().filter(|i| i.cam_from_world.is_some()).count();
        if num_posed < 2 {
            // Before anything expensive happens.
            return Err(LabelError::TooFewPictures(num_posed).into());
        }
        let start = Instant::now();
        let features = match &dataset.segments {
            None => extraction.all(&chosen, Progress::Terminal)?,
            Some(segments) => {
                let own: Vec<&[[f64; 4]]> =
                    positions.iter().map(|i| segments[*i].as_slice()).collect();
                extraction.all_with_segments(&chosen, &own, Progress::Terminal)?
            }
        };
        eprintln!(
            "features of {} pictures: {:.1} s",
            chosen.len(),
            start.elapsed().as_secs_f64()
        );
        let origin = Origin {
            units: dataset.units,
            gravity: dataset.gravity,
            source: format!("{num_posed} pictures, {}", dataset.format),
            ..Origin::of_extractor(extraction.extractor(), extraction.options().max_side as u32)
        };
        let imported = Imported::new(dataset, &positions, self.points_from == PointSource::Model)?;
        Ok(build_from(
            &chosen,
            features,
            origin,
            &imported,
            &LabelParams::default(),
            &Progress::Terminal,
        )?)
    }
}

/// Makes the labels.
///
/// # Errors
/// When the data cannot be read, nothing can be triangulated, or the disk refuses.
pub fn run(args: Args) -> Result<()> {
    let teaching = args.teaching.teach(None, args.variants)?;
    teaching
        .labels
        .write(&args.out)
        .with_context(|| format!("writing labels to {}", args.out.display()))?;
    println!("wrote {}", args.out.display());
    Ok(())
}
