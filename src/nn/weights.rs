//! Named tensors, as they come from a file: `f32` or `f16`, row-major.
//!
//! Executors take a whole [`Weights`] and free each tensor as soon as they have packed it, so that a network is never in
//! memory twice.

use std::collections::BTreeMap;

use half::f16;

use super::error::NnError;

/// Numbers of a weight.
#[derive(Debug, Clone, PartialEq)]
pub enum WeightData {
    /// 32 bit.
    F32(Vec<f32>),
    /// 16 bit (IEEE half), widened when packed.
    F16(Vec<f16>),
}

/// One weight: its shape and its numbers, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightTensor {
    shape: Vec<usize>,
    data: WeightData,
}

impl WeightTensor {
    /// A weight.
    ///
    /// # Errors
    /// [`NnError::WeightLength`] when the shape and the amount of data disagree.
    pub fn new(shape: &[usize], data: WeightData) -> Result<Self, NnError> {
        let found = match &data {
            WeightData::F32(data) => data.len(),
            WeightData::F16(data) => data.len(),
        };
        let expected = shape
            .iter()
            .try_fold(1_usize, |product, &n| product.checked_mul(n))
            .unwrap_or(usize::MAX);
        if found != expected {
            return Err(NnError::WeightLength {
                shape: shape.to_vec(),
                found,
                expected,
            });
        }
        Ok(Self {
            shape: shape.to_vec(),
            data,
        })
    }

    /// A weight of 32-bit numbers.
    ///
    /// # Errors
    /// [`NnError::WeightLength`] when the shape and the amount of data disagree.
    pub fn f32(shape: &[usize], data: Vec<f32>) -> Result<Self, NnError> {
        Self::new(shape, WeightData::F32(data))
    }

    /// A weight of 16-bit numbers.
    ///
    /// # Errors
    /// [`NnError::WeightLength`] when the shape and the amount of data disagree.
    pub fn f16(shape: &[usize], data: Vec<f16>) -> Result<Self, NnError> {
        Self::new(shape, WeightData::F16(data))
    }

    /// Sizes of the axes.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The numbers as they are stored.
    pub fn data(&self) -> &WeightData {
        &self.data
    }

    /// The numbers as `f32`.
    pub fn to_f32(&self) -> Vec<f32> {
        match &self.data {
            WeightData::F32(data) => data.clone(),
            WeightData::F16(data) => data.iter().map(|x| x.to_f32()).collect(),
        }
    }

    /// The numbers as `f32`, without a copy where they already are.
    pub fn into_f32(self) -> Vec<f32> {
        match self.data {
            WeightData::F32(data) => data,
            WeightData::F16(data) => data.iter().map(|x| x.to_f32()).collect(),
        }
    }
}

/// Named weights.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Weights {
    by_name: BTreeMap<String, WeightTensor>,
}

impl Weights {
    /// No weights.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a weight; returns the one that had the name before.
    pub fn insert(
        &mut self,
        name: impl Into<String>,
        tensor: WeightTensor,
    ) -> Option<WeightTensor> {
        self.by_name.insert(name.into(), tensor)
    }

    /// A weight by name.
    pub fn get(&self, name: &str) -> Option<&WeightTensor> {
        self.by_name.get(name)
    }

    /// Takes a weight out.
    pub fn remove(&mut self, name: &str) -> Option<WeightTensor> {
        self.by_name.remove(name)
    }

    /// Names and weights in alphabetical order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &WeightTensor)> {
        self.by_name
            .iter()
            .map(|(name, tensor)| (name.as_str(), tensor))
    }

    /// Number of weights.
    pub fn len(&self) -> usize {
        self.by_name.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.by_name.is_empty()
    }

    /// Takes a weight out as `f32` after checking that it has the expected shape and only finite numbers.
    ///
    /// # Errors
    /// [`NnError::MissingWeight`], [`NnError::WeightShape`], [`NnError::WeightNotFinite`].
    pub fn take_f32(&mut self, name: &str, expected: &[usize]) -> Result<Vec<f32>, NnError> {
        let Some(tensor) = self.by_name.remove(name) else {
            return Err(NnError::MissingWeight {
                name: name.to_owned(),
                expected: expected.to_vec(),
            });
        };
        if tensor.shape != expected {
            return Err(NnError::WeightShape {
                name: name.to_owned(),
                found: tensor.shape,
                expected: expected.to_vec(),
            });
        }
        let data = tensor.into_f32();
        match data.iter().position(|x| !x.is_finite()) {
            Some(index) => Err(NnError::WeightNotFinite {
                name: name.to_owned(),
                index,
            }),
            None => Ok(data),
        }
    }
}

impl FromIterator<(String, WeightTensor)> for Weights {
    fn from_iter<I: IntoIterator<Item = (String, WeightTensor)>>(iter: I) -> Self {
        Self {
            by_name: iter.into_iter().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_weights_that_do_not_fit() {
        assert!(matches!(
            WeightTensor::f32(&[2, 3], vec![0.0; 5]),
            Err(NnError::WeightLength {
                found: 5,
                expected: 6,
                ..
            })
        ));
        assert!(WeightTensor::f32(&[usize::MAX, 2], vec![0.0; 5]).is_err());
        let mut weights = Weights::new();
        weights.insert(
            "a",
            WeightTensor::f32(&[2], vec![1.0, f32::NAN]).expect("lengths agree"),
        );
        weights.insert(
            "h",
            WeightTensor::f16(&[1], vec![f16::from_f32(0.5)]).expect("lengths agree"),
        );
        assert!(matches!(
            weights.clone().take_f32("a", &[1, 2]),
            Err(NnError::WeightShape { .. })
        ));
        assert!(matches!(
            weights.take_f32("a", &[2]),
            Err(NnError::WeightNotFinite { index: 1, .. })
        ));
        assert!(matches!(
            weights.take_f32("b", &[2]),
            Err(NnError::MissingWeight { .. })
        ));
        assert_eq!(weights.take_f32("h", &[1]), Ok(vec![0.5]));
    }
}
