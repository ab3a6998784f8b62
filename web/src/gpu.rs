//! Whether the networks run on the GPU, and why not.

use js_sys::{Function, Promise, Reflect};
use landline::nn::gpu::{AdapterChoice, GpuDevice, Timer};
use landline::relocalizer::{GpuNetworks, Relocalizer, RelocalizerOptions};
use landline::scene_file::{ExtractorFile, SceneFile};
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast as _, JsValue};
use wasm_bindgen_futures::JsFuture;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_name = setTimeout)]
    fn set_timeout(handler: &Function, milliseconds: u32) -> JsValue;
}

/// What the page asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Device {
    /// The faster of a hardware GPU and the CPU, as measured.
    Auto,
    /// Any adapter, without measuring.
    WebGpu,
    /// The CPU.
    Cpu,
}

impl Device {
    pub(crate) fn parse(name: &str) -> Option<Self> {
        match name {
            "auto" => Some(Self::Auto),
            "webgpu" => Some(Self::WebGpu),
            "cpu" => Some(Self::Cpu),
            _ => None,
        }
    }
}

/// `navigator.gpu` must exist before an adapter is asked for: Node and old browsers have none.
fn browser_has_webgpu() -> bool {
    let get = |of: &JsValue, name: &str| {
        Reflect::get(of, &JsValue::from_str(name))
            .ok()
            .filter(|v| v.is_object())
    };
    get(&js_sys::global(), "navigator")
        .and_then(|navigator| get(&navigator, "gpu"))
        .is_some()
}

fn timer() -> Timer {
    Box::new(|milliseconds| {
        let promise = Promise::new(&mut |resolve, _reject| {
            set_timeout(resolve.unchecked_ref(), milliseconds);
        });
        Box::pin(async move {
            // A timer's promise is never rejected.
            let _ = JsFuture::from(promise).await;
        })
    })
}

/// Why the GPU is out of the question, if that is already plain.
pub(crate) fn ruled_out(device: Device) -> Option<String> {
    if device == Device::Cpu {
        Some("the CPU was asked for".to_owned())
    } else if browser_has_webgpu() {
        None
    } else {
        Some("this browser has no WebGPU".to_owned())
    }
}

/// Moves the networks of a relocalizer to the GPU if it is there. The text says why not.
pub(crate) async fn choose(
    core: &mut Relocalizer,
    device: Device,
    scene: &SceneFile,
    extractor: &ExtractorFile,
    change: impl FnOnce(&mut RelocalizerOptions),
) -> Option<String> {
    let choice = match device {
        Device::Cpu => return ruled_out(device),
        Device::Auto => AdapterChoice::Hardware,
        Device::WebGpu => AdapterChoice::Any,
    };
    let networks = async {
        let gpu = GpuDevice::request(choice).await?;
        GpuNetworks::new(gpu, scene, extractor, change, Some(timer())).await
    };
    match networks.await {
        Ok(networks) if device == Device::Auto => core.try_gpu(networks),
        Ok(networks) => core.use_gpu(networks),
        Err(error) => return Some(error.to_string()),
    }
    None
}
