//! Kernels: WGSL text, its parameters, and the pipelines made from them.
//!
//! The parameter block of a kernel is written once, in the code that fills it: [`Params`] collects names, kinds and
//! values, and the `struct Params` of the shader is generated from the names.

use std::{collections::BTreeMap, fmt::Write as _, sync::Arc};

use super::{device::GpuDevice, error::GpuError, faults::Fault, lower::activate_wgsl};

/// Uniform parameters of one dispatch.
#[derive(Debug, Clone, Default)]
pub(super) struct Params {
    declaration: String,
    words: Vec<u32>,
}

impl Params {
    /// Adds an unsigned number.
    pub(super) fn u(mut self, name: &str, value: usize) -> Self {
        debug_assert!(
            u32::try_from(value).is_ok(),
            "{name} = {value} is too large for a shader"
        );
        let _ = writeln!(self.declaration, "    {name}: u32,");
        self.words.push(value as u32);
        self
    }

    /// Adds a number.
    pub(super) fn f(mut self, name: &str, value: f32) -> Self {
        let _ = writeln!(self.declaration, "    {name}: f32,");
        self.words.push(value.to_bits());
        self
    }

    /// The values as the shader sees them.
    pub(super) fn words(&self) -> &[u32] {
        &self.words
    }
}

/// Bytes between the parameter blocks of two dispatches: the alignment that every device accepts.
pub(super) const PARAMS_STRIDE: usize = 256;

/// The tiled product behind a kernel that says what its rows are.
const TILE_PRODUCT: &str = include_str!("wgsl/tile_product.wgsl");

/// Names of all kernels and the texts that each is made of.
pub(super) const KERNELS: &[(&str, &[&str])] = &[
    ("affine", &[include_str!("wgsl/affine.wgsl")]),
    ("attention", &[include_str!("wgsl/attention.wgsl")]),
    (
        "conv3x3",
        &[include_str!("wgsl/conv3x3.wgsl"), TILE_PRODUCT],
    ),
    ("conv3x3_small", &[include_str!("wgsl/conv3x3_small.wgsl")]),
    ("detector_heat", &[include_str!("wgsl/detector_heat.wgsl")]),
    ("instance_norm", &[include_str!("wgsl/instance_norm.wgsl")]),
    ("keep_gather", &[include_str!("wgsl/keep_gather.wgsl")]),
    ("keep_scan", &[include_str!("wgsl/keep_scan.wgsl")]),
    ("linear", &[include_str!("wgsl/linear.wgsl"), TILE_PRODUCT]),
    ("map", &[include_str!("wgsl/map.wgsl")]),
    ("norm", &[include_str!("wgsl/norm.wgsl")]),
    ("peaks", &[include_str!("wgsl/peaks.wgsl")]),
    ("peaks_compact", &[include_str!("wgsl/peaks_compact.wgsl")]),
    ("pool", &[include_str!("wgsl/pool.wgsl")]),
    ("resize", &[include_str!("wgsl/resize.wgsl")]),
    ("sample", &[include_str!("wgsl/sample.wgsl")]),
    ("soft_choice", &[include_str!("wgsl/soft_choice.wgsl")]),
    ("stem", &[include_str!("wgsl/stem.wgsl")]),
    ("token_pool", &[include_str!("wgsl/token_pool.wgsl")]),
    ("top_k", &[include_str!("wgsl/top_k.wgsl")]),
    ("unfold", &[include_str!("wgsl/unfold.wgsl")]),
];

const COMMON: &str = include_str!("wgsl/common.wgsl");

/// Pipelines of one device, made on first use and shared by all networks on it.
#[derive(Debug)]
pub struct Pipelines {
    layout: wgpu::BindGroupLayout,
    pipeline_layout: wgpu::PipelineLayout,
    made: BTreeMap<(String, String), Arc<wgpu::ComputePipeline>>,
}

impl Pipelines {
    /// No pipelines yet.
    pub fn new(gpu: &GpuDevice) -> Self {
        let storage = |binding, read_only| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let params = wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: true,
                min_binding_size: None,
            },
            count: None,
        };
        gpu.acting.count_created();
        let layout = gpu
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("landline"),
                entries: &[
                    params,
                    storage(1, false),
                    storage(2, true),
                    storage(3, false),
                ],
            });
        gpu.acting.count_created();
        let pipeline_layout = gpu
            .device
            .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("landline"),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
        Self {
            layout,
            pipeline_layout,
            made: BTreeMap::new(),
        }
    }

    /// Binds the four buffers of a network: parameters, activations, weights, counts.
    pub(super) fn bind(
        &self,
        gpu: &GpuDevice,
        label: &str,
        [params, arena, weights, counts]: [&wgpu::Buffer; 4],
    ) -> wgpu::BindGroup {
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        // One block at a time: the offset is given with each dispatch.
        let block = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: params,
            offset: 0,
            size: core::num::NonZeroU64::new(PARAMS_STRIDE as u64),
        });
        gpu.acting.count_created();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout: &self.layout,
            entries: &[
                entry(0, block),
                entry(1, arena.as_entire_binding()),
                entry(2, weights.as_entire_binding()),
                entry(3, counts.as_entire_binding()),
            ],
        })
    }

    /// The pipeline of a kernel; `constants` is WGSL text put before it. Whether the driver takes it shows in
    /// [`GpuDevice::attempt`] around this call.
    ///
    /// # Errors
    /// [`GpuError::Refused`] for a kernel that does not exist.
    pub(super) fn get(
        &mut self,
        gpu: &GpuDevice,
        kernel: &str,
        constants: &str,
        params: &Params,
    ) -> Result<Arc<wgpu::ComputePipeline>, GpuError> {
        let key = (
            kernel.to_owned(),
            format!("{constants}\nstruct Params {{\n{}}}\n", params.declaration),
        );
        if let Some(pipeline) = self.made.get(&key) {
            return Ok(Arc::clone(pipeline));
        }
        let texts = KERNELS
            .iter()
            .find(|(name, _)| *name == kernel)
            .map(|(_, texts)| texts.concat());
        let Some(text) = texts else {
            return Err(GpuError::Refused {
                what: format!("kernel `{kernel}`"),
                message: "no such kernel".to_owned(),
            });
        };
        let source = act_out(
            gpu.acting.fault(),
            format!("{}{}{COMMON}\n{text}", key.1, activate_wgsl()),
        );
        gpu.acting.count_created();
        let module = gpu
            .device
            .create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(kernel),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            });
        gpu.acting.count_created();
        let pipeline = gpu
            .device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(kernel),
                layout: Some(&self.pipeline_layout),
                module: &module,
                entry_point: Some("main"),
                compilation_options: wgpu::PipelineCompilationOptions {
                    // Workgroup memory is written before it is read; clearing it first costs time.
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
        let pipeline = Arc::new(pipeline);
        self.made.insert(key, Arc::clone(&pipeline));
        Ok(pipeline)
    }

    /// Number of pipelines made.
    pub fn len(&self) -> usize {
        self.made.len()
    }

    /// Whether none was made.
    pub fn is_empty(&self) -> bool {
        self.made.is_empty()
    }
}

/// The kernel with what is being simulated.
fn act_out(fault: Option<Fault>, source: String) -> String {
    match fault {
        Some(Fault::ShaderError) => source + "\nfn broken() -> f32 { return missing; }\n",
        Some(Fault::WrongAnswer) => source.replace("b, sum[1])", "b, sum[0])"),
        Some(Fault::WrongHalves) => {
            source.replace("select(pair.x, pair.y", "select(pair.y, pair.x")
        }
        _ => source,
    }
}
