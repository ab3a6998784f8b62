//! Whether the device is really faster: measured on the first frames, because some drivers lose to the CPU.

/// Frames that are not counted: pipelines and caches warm up.
const WARM_UP: usize = 1;
/// Frames of the device of which the median counts.
const MEASURED: usize = 3;
/// The device stays when it needs at most this share of the CPU's time: below that the change of backend is noticeable.
const LARGEST_SHARE: f64 = 0.8;

/// What the next frame should run on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    Gpu,
    Cpu,
}

/// Frame times of both backends until the choice is made.
#[derive(Debug, Clone, Default)]
pub(super) struct Calibration {
    seen: usize,
    gpu_ms: Vec<f64>,
}

impl Calibration {
    /// The backend of the next frame: the CPU once the device has been measured.
    pub(super) fn turn(&self) -> Turn {
        if self.gpu_ms.len() < MEASURED {
            Turn::Gpu
        } else {
            Turn::Cpu
        }
    }

    /// Notes a frame of the device.
    pub(super) fn gpu_frame(&mut self, total_ms: f64) {
        self.seen += 1;
        if self.seen > WARM_UP {
            self.gpu_ms.push(total_ms);
        }
    }

    /// After the CPU's frame: why the CPU should stay, or `None` for the device.
    pub(super) fn decide(&self, cpu_ms: f64) -> Option<String> {
        let mut sorted = self.gpu_ms.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let gpu_ms = sorted.get(sorted.len() / 2).copied()?;
        (gpu_ms > LARGEST_SHARE * cpu_ms)
            .then(|| format!("measured: the GPU takes {gpu_ms:.0} ms for a frame's networks, the CPU {cpu_ms:.0} ms"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(frames: [f64; 4]) -> Calibration {
        let mut calibration = Calibration::default();
        for ms in frames {
            assert_eq!(calibration.turn(), Turn::Gpu);
            calibration.gpu_frame(ms);
        }
        assert_eq!(calibration.turn(), Turn::Cpu);
        calibration
    }

    #[test]
    fn a_fast_device_stays_whatever_its_first_frame_took() {
        assert_eq!(measured([900.0, 10.0, 12.0, 50.0]).decide(200.0), None);
    }

    #[test]
    fn a_slow_device_goes_and_both_times_are_told() {
        let why = measured([5.0, 190.0, 170.0, 180.0])
            .decide(200.0)
            .expect("the CPU stays");
        assert!(why.contains("180 ms") && why.contains("200 ms"), "{why}");
    }
}
