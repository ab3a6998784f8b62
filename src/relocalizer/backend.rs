//! Where the networks run, and the way back to the CPU.

use super::calibration::{Calibration, Turn};
use super::gpu::GpuNetworks;
use crate::features::FeatureSet;
use crate::image::GrayView;
use crate::nn::gpu::GpuError;
use crate::regress::Predictions;

/// Late answers in a row that are forgiven: one may be another page's doing.
const FORGIVEN: u32 = 1;

/// The networks on a device, as long as it is worth it.
#[derive(Debug, Default)]
pub(super) struct Backend {
    networks: Option<GpuNetworks>,
    /// Present until it is decided whether the device is worth it.
    calibration: Option<Calibration>,
    failure: Option<String>,
    num_late: u32,
}

impl Backend {
    pub(super) fn new(networks: GpuNetworks, on_trial: bool) -> Self {
        Self {
            networks: Some(networks),
            calibration: on_trial.then(Calibration::default),
            ..Self::default()
        }
    }

    pub(super) fn networks(&self) -> Option<&GpuNetworks> {
        self.networks.as_ref()
    }

    /// Why the last frame ran on the CPU though a device was given.
    pub(super) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Starts the extractor on a picture; `false` when the CPU has to do it.
    pub(super) async fn begin(&mut self, working: &GrayView<'_>) -> bool {
        let is_measuring_cpu = self
            .calibration
            .as_ref()
            .is_some_and(|calibration| calibration.turn() == Turn::Cpu);
        let Some(networks) = self.networks.as_mut().filter(|_| !is_measuring_cpu) else {
            return false;
        };
        let submitted = networks.submit(working).await;
        self.note(submitted)
    }

    /// Runs the rest and waits for the answer; `false` when the CPU has to do it all.
    pub(super) async fn finish(
        &mut self,
        features: &mut FeatureSet,
        predictions: &mut Predictions,
    ) -> bool {
        let Some(networks) = &mut self.networks else {
            return false;
        };
        let finished = networks.finish(features, predictions).await;
        if self.note(finished) {
            self.num_late = 0;
            self.failure = None;
            return true;
        }
        false
    }

    fn note(&mut self, outcome: Result<(), GpuError>) -> bool {
        let Err(error) = outcome else { return true };
        let is_late = matches!(error, GpuError::MapTimeout(_));
        self.num_late += u32::from(is_late);
        if is_late && self.num_late <= FORGIVEN {
            self.failure = Some(format!("{error}: this frame ran on the CPU"));
        } else {
            self.leave(error.to_string());
        }
        false
    }

    /// Gives the device up for good.
    fn leave(&mut self, why: String) {
        self.networks = None;
        self.calibration = None;
        self.failure = Some(why);
    }

    /// Notes how long the networks of a frame took, while the device is on trial.
    pub(super) fn measured(&mut self, on_gpu: bool, networks_ms: f64) {
        let Some(calibration) = &mut self.calibration else {
            return;
        };
        if on_gpu {
            calibration.gpu_frame(networks_ms);
        } else if calibration.turn() == Turn::Cpu {
            let verdict = calibration.decide(networks_ms);
            self.calibration = None;
            if let Some(why) = verdict {
                self.leave(why);
            }
        }
    }
}
