//! The trained tensors of a branch: values, optimiser state, running average. Names and shapes are those of
//! `landline::models`, in its order, so that a second definition of a network has no place here.

use burn::optim::{AdamW, AdamWConfig, AdamWState, AdaptiveMomentumState, Optimizer};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use landline::models::TensorSpec;
use std::collections::HashMap;

/// One tensor, seen as a matrix: a vector is one row.
#[derive(Clone)]
struct Entry {
    spec: TensorSpec,
    value: Tensor<2>,
    average: Tensor<2>,
    state: Option<AdamWState<2>>,
    /// Factor on the learning rate.
    rate: f64,
}

/// Optimiser settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamSettings {
    /// Decay of the first moment.
    pub beta_1: f32,
    /// Decay of the second moment.
    pub beta_2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
    /// Decoupled decay of matrices; vectors never decay.
    pub weight_decay: f32,
    /// Largest norm of the gradient over all tensors; `None` leaves it alone.
    pub max_gradient_norm: Option<f32>,
}

/// Trained tensors of one branch.
#[derive(Clone)]
pub struct Parameters {
    entries: Vec<Entry>,
    index: HashMap<String, usize>,
    device: Device,
}

/// The same tensors as leaves of one forward pass.
pub struct Leaves<'a> {
    parameters: &'a Parameters,
    tensors: Vec<Tensor<2>>,
}

fn matrix_dims(shape: &[usize]) -> [usize; 2] {
    match shape {
        [rows, rest @ ..] if !rest.is_empty() => [*rows, rest.iter().product()],
        _ => [1, shape.iter().product()],
    }
}

impl Parameters {
    /// Tensors with the given start values.
    ///
    /// # Panics
    /// When `start` yields another number of values than a shape has: the initialiser and the configuration disagree.
    pub fn new(
        specs: Vec<TensorSpec>,
        device: &Device,
        mut start: impl FnMut(&TensorSpec) -> Vec<f32>,
    ) -> Self {
        let entries: Vec<Entry> = specs
            .into_iter()
            .map(|spec| {
                let dims = matrix_dims(&spec.shape);
                let data = start(&spec);
                assert_eq!(data.len(), dims[0] * dims[1], "start of {}", spec.name);
                let value = Tensor::from_data(TensorData::new(data, dims), device);
                Entry {
                    average: value.clone(),
                    value,
                    state: None,
                    rate: 1.0,
                    spec,
                }
            })
            .collect();
        let index = entries
            .iter()
            .enumerate()
            .map(|(i, e)| (e.spec.name.clone(), i))
            .collect();
        Self {
            entries,
            index,
            device: device.clone(),
        }
    }

    /// Names and shapes, in the order of the configuration.
    pub fn specs(&self) -> impl Iterator<Item = &TensorSpec> {
        self.entries.iter().map(|e| &e.spec)
    }

    /// Where the tensors live.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Whether there is a tensor of this name.
    pub fn has(&self, name: &str) -> bool {
        self.index.contains_key(name)
    }

    /// Multiplies the learning rate of the tensors whose name ends so.
    pub fn scale_rate(&mut self, name_end: &str, factor: f64) {
        for entry in &mut self.entries {
            if entry.spec.name.ends_with(name_end) {
                entry.rate = factor;
            }
        }
    }

    /// Leaves of a forward pass that is differentiated.
    pub fn leaves(&self) -> Leaves<'_> {
        Leaves {
            parameters: self,
            tensors: self
                .entries
                .iter()
                .map(|e| e.value.clone().autodiff().require_grad())
                .collect(),
        }
    }

    /// The running average as constants, for evaluation.
    pub fn averages(&self) -> Leaves<'_> {
        Leaves {
            parameters: self,
            tensors: self.entries.iter().map(|e| e.average.clone()).collect(),
        }
    }

    /// The running average as numbers, in the order of [`Self::specs`].
    pub fn average_values(&self) -> Vec<Vec<f32>> {
        self.entries.iter().map(|e| numbers(&e.average)).collect()
    }

    /// The same tensors with other averages, in the order of [`Self::specs`]; for evaluation.
    ///
    /// # Panics
    /// When a tensor has another number of values.
    #[must_use]
    pub fn with_averages(&self, values: &[Vec<f32>]) -> Self {
        let mut out = self.clone();
        for (e, data) in out.entries.iter_mut().zip(values) {
            let dims = matrix_dims(&e.spec.shape);
            e.average = Tensor::from_data(TensorData::new(data.clone(), dims), &self.device);
        }
        out
    }

    /// Everything that the next step depends on, by name: `value/X`, `average/X`, `moment1/X`, `moment2/X`; and the number
    /// of steps that the optimiser has taken.
    pub fn state(&self) -> (Vec<(String, Vec<f32>)>, usize) {
        let mut out = Vec::new();
        let mut time = 0;
        for e in &self.entries {
            let name = &e.spec.name;
            out.push((format!("value/{name}"), numbers(&e.value)));
            out.push((format!("average/{name}"), numbers(&e.average)));
            if let Some(state) = &e.state {
                time = state.momentum.time;
                out.push((format!("moment1/{name}"), numbers(&state.momentum.moment_1)));
                out.push((format!("moment2/{name}"), numbers(&state.momentum.moment_2)));
            }
        }
        (out, time)
    }

    /// Takes over what [`Self::state`] gave.
    ///
    /// # Errors
    /// The name of a tensor that is missing or of another size.
    pub fn restore(
        &mut self,
        mut take: impl FnMut(&str) -> Option<Vec<f32>>,
        time: usize,
    ) -> Result<(), String> {
        for e in &mut self.entries {
            let dims = matrix_dims(&e.spec.shape);
            let mut get = |kind: &str| -> Result<Tensor<2>, String> {
                let name = format!("{kind}/{}", e.spec.name);
                match take(&name) {
                    Some(data) if data.len() == dims[0] * dims[1] => {
                        Ok(Tensor::from_data(TensorData::new(data, dims), &self.device))
                    }
                    _ => Err(name),
                }
            };
            e.value = get("value")?;
            e.average = get("average")?;
            e.state = if time == 0 {
                None
            } else {
                Some(AdamWState::new(AdaptiveMomentumState::new(
                    time,
                    get("moment1")?,
                    get("moment2")?,
                )))
            };
        }
        Ok(())
    }

    /// One step of AdamW, then the running average with weight `1 - average_decay` for the new values (0 copies them).
    /// Returns the norm of the gradient before clipping.
    pub fn step(
        &mut self,
        gradients: GradientList,
        rate: f64,
        settings: &AdamSettings,
        average_decay: f64,
    ) -> f64 {
        let norm = gradients.norm();
        let scale = match settings.max_gradient_norm {
            Some(max) if norm > f64::from(max) => f64::from(max) / norm,
            _ => 1.0,
        };
        let config = AdamWConfig::new()
            .with_beta_1(settings.beta_1)
            .with_beta_2(settings.beta_2)
            .with_epsilon(settings.epsilon);
        let (plain, decaying): (AdamW, AdamW) = (
            config.clone().with_weight_decay(0.0).build(),
            config.with_weight_decay(settings.weight_decay).build(),
        );
        for (e, gradient) in self.entries.iter_mut().zip(gradients.tensors) {
            if let Some(gradient) = gradient {
                let is_matrix = e.spec.shape.len() > 1 && e.spec.name.ends_with(".w");
                let adam = if is_matrix { &decaying } else { &plain };
                let (value, state) = adam.step(
                    rate * e.rate,
                    e.value.clone(),
                    gradient.mul_scalar(scale),
                    e.state.take(),
                );
                e.value = value;
                e.state = state;
            }
            e.average = if average_decay > 0.0 {
                e.average.clone().mul_scalar(average_decay)
                    + e.value.clone().mul_scalar(1.0 - average_decay)
            } else {
                e.value.clone()
            };
        }
        norm
    }
}

/// One gradient for each tensor that the loss depends on.
pub struct GradientList {
    tensors: Vec<Option<Tensor<2>>>,
}

impl GradientList {
    /// Euclidean norm over all tensors.
    pub fn norm(&self) -> f64 {
        let sum: f64 = self
            .tensors
            .iter()
            .flatten()
            .map(|g| f64::from(g.clone().square().sum().into_scalar::<f32>()))
            .sum();
        sum.sqrt()
    }
}

impl Leaves<'_> {
    /// A tensor by name, as a matrix.
    ///
    /// # Panics
    /// When the configuration has no such tensor: forward pass and configuration disagree.
    pub fn get(&self, name: &str) -> Tensor<2> {
        let index = self.parameters.index.get(name);
        let index = index.unwrap_or_else(|| panic!("the configuration has no tensor `{name}`"));
        self.tensors[*index].clone()
    }

    /// Whether the configuration has this tensor.
    pub fn has(&self, name: &str) -> bool {
        self.parameters.has(name)
    }

    /// `x W^T + b` with `NAME.w` `[out, in]` and `NAME.b`.
    pub fn linear(&self, name: &str, x: Tensor<2>) -> Tensor<2> {
        x.matmul(self.get(&format!("{name}.w")).transpose()) + self.get(&format!("{name}.b"))
    }

    /// Where the tensors live.
    pub fn device(&self) -> &Device {
        &self.parameters.device
    }

    /// Collects the gradients of these leaves.
    pub fn gradients(self, mut gradients: Gradients) -> GradientList {
        GradientList {
            tensors: self
                .tensors
                .iter()
                .map(|t| t.grad_remove(&mut gradients))
                .collect(),
        }
    }
}

/// A tensor's numbers.
///
/// # Panics
/// When the device fails; there is nothing to continue with then.
pub fn numbers<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    match tensor.clone().try_into_vec_as::<f32>() {
        Ok(values) => values,
        Err(e) => panic!("reading a tensor back failed: {e:?}"),
    }
}
