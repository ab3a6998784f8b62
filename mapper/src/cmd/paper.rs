//! `landline paper`: the paper's protocol on its data sets, its figures beside ours.

use crate::args::{ExtractorArgs, SceneArgs};
#[cfg(feature = "train")]
use crate::args::{TrainingArgs, WhenArgs};
use crate::dataset::Dataset;
use crate::extract::Extraction;
use crate::paper::{DataSet, Measured, Poses, joined_poses, measure, resumed, tables};
use crate::run_lock::RunLock;
use crate::teach::Request;
use crate::terminal::Terminal;
use crate::words::words;
use anyhow::Result;
use clap::builder::TypedValueParser;
use landline::front_end::FrontEndOptions;
use std::path::{Path, PathBuf};

/// Map and evaluate scenes of 7-Scenes or Indoor-6 by the paper's protocol, one after the other, and print its tables with ours.
///
/// Results are kept in the work folder: an interrupted run goes on with the next scene. The networks are the place's landmarks
/// unless options of training say more.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The data set.
    #[arg(value_parser = set())]
    set: DataSet,
    /// Its folder, with a folder for each scene.
    root: PathBuf,
    /// Only this scene; may be repeated. Without it, every one whose folder is there.
    #[arg(long = "scene", value_name = "NAME")]
    scenes: Vec<String>,
    /// Folder for scene files, features and results.
    #[arg(long, value_name = "DIR", default_value = "landline-paper")]
    work: PathBuf,
    /// Folder with structure-from-motion poses of 7-Scenes, `SCENE_train.txt` and `SCENE_test.txt`: reported first, beside the
    /// shipped ones.
    #[arg(long, value_name = "DIR")]
    sfm_poses: Option<PathBuf>,
    #[command(flatten)]
    extractor: ExtractorArgs,
    #[command(flatten)]
    scene: SceneArgs,
    #[cfg(feature = "train")]
    #[command(flatten)]
    when: WhenArgs,
    #[cfg(feature = "train")]
    #[command(flatten)]
    how: TrainingArgs,
    #[cfg(not(feature = "train"))]
    #[command(flatten)]
    _untrained: crate::args::Untrained,
}

fn set() -> impl TypedValueParser<Value = DataSet> {
    words([
        (
            "7scenes",
            DataSet::SevenScenes,
            "7-Scenes as shipped: SCENE/seq-01/frame-000000.{color.png,pose.txt}, TrainSplit.txt, TestSplit.txt",
        ),
        (
            "indoor6",
            DataSet::Indoor6,
            "Indoor-6: SCENE/images/NAME.{color.jpg,pose.txt,intrinsics.txt}, train_test_val.pkl",
        ),
    ])
}

/// Maps and evaluates.
///
/// # Errors
/// When a scene cannot be read, taught or evaluated.
pub fn run(args: Args) -> Result<()> {
    let chosen = args.set.chosen(&args.root, &args.scenes)?;
    let extractor = args.extractor.read()?;
    let _held = RunLock::hold(&args.work)?;
    let mut results = Vec::new();
    for scene in chosen {
        let folder = args.work.join(scene);
        let list = match &args.sfm_poses {
            Some(poses) => joined_poses(poses, scene, &folder.join("poses-sfm.txt"))?,
            None => None,
        };
        let options = FrontEndOptions::new(extractor.kind);
        let cache = folder.join("features");
        let extraction = Extraction::new(extractor.clone(), options, Some(&cache));
        for (poses, list) in [(Poses::Sfm, list.as_deref()), (Poses::Shipped, None)] {
            if poses == Poses::Sfm && list.is_none() {
                continue;
            }
            let dataset = args.set.open(&args.root, scene, list)?;
            println!("{scene}, {} poses\n{}", poses.name(), dataset.table());
            let measured = args.measured(&dataset, &extraction, poses, &folder)?;
            results.push((scene.to_owned(), poses, measured));
            println!("{}", tables(args.set, &results));
        }
    }
    Ok(())
}

impl Args {
    fn measured(
        &self,
        dataset: &Dataset,
        extraction: &Extraction,
        poses: Poses,
        folder: &Path,
    ) -> Result<Measured> {
        let file = |ending: &str| folder.join(format!("{}.{ending}", poses.name()));
        let identity = Measured::identity(
            dataset,
            &extraction.extractor().source_sha256,
            &self.options(),
        );
        resumed(&file("json"), &identity, || {
            let request = Request {
                dataset,
                extraction,
                model_points: false,
                scene: self.scene.request()?,
                #[cfg(feature = "train")]
                training: Some(self.how.training(
                    self.when.when(&self.how),
                    &self.scene,
                    file("run"),
                )?),
            };
            measure(&request, identity.clone(), &file("landline"), &mut Terminal)
        })
    }

    /// What changes a result.
    fn options(&self) -> String {
        #[cfg(feature = "train")]
        let training = format!("{:?} {:?}", self.when.when(&self.how), self.how);
        #[cfg(not(feature = "train"))]
        let training = "";
        format!("{:?} {training}", self.scene)
    }
}
