//! Whether the networks run on the GPU, and why not.

use js_sys::{Function, Promise, Reflect};
use landline::nn::gpu::Timer;
use landline::relocalizer::Device;
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast as _, JsValue};
use wasm_bindgen_futures::JsFuture;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_name = setTimeout)]
    fn set_timeout(handler: &Function, milliseconds: u32) -> JsValue;
}

/// The device that a page names.
pub(crate) fn device(name: &str) -> Option<Device> {
    match name {
        "auto" => Some(Device::Auto),
        "webgpu" => Some(Device::Gpu),
        "cpu" => Some(Device::Cpu),
        _ => None,
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

pub(crate) fn timer() -> Timer {
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
