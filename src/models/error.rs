//! What can be wrong with a configuration or its weights.

use crate::nn::NnError;

/// Why a network could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// A size of the configuration is outside its range.
    #[error("configuration: {field} is {found}, allowed are {min} to {max}")]
    Size {
        /// The field.
        field: &'static str,
        /// Its value.
        found: usize,
        /// Smallest value.
        min: usize,
        /// Largest value.
        max: usize,
    },
    /// Two parts of the configuration do not fit together.
    #[error("configuration: {0}")]
    Mismatch(String),
    /// A number of the configuration is not finite or outside its range.
    #[error("configuration: {field} is {found}, allowed are {min} to {max}")]
    Number {
        /// The field.
        field: &'static str,
        /// Its value.
        found: f32,
        /// Smallest value.
        min: f32,
        /// Largest value.
        max: f32,
    },
    /// The weights hold a tensor that the network has not.
    #[error(
        "tensor `{name}` does not belong to the network; the configuration and the weights disagree"
    )]
    UnexpectedTensor {
        /// The tensor.
        name: String,
    },
    /// A tensor is missing, misshapen or not finite, or the graph cannot be built.
    #[error(transparent)]
    Nn(#[from] NnError),
}

pub(super) fn check_size(
    field: &'static str,
    found: usize,
    min: usize,
    max: usize,
) -> Result<(), ModelError> {
    if (min..=max).contains(&found) {
        Ok(())
    } else {
        Err(ModelError::Size {
            field,
            found,
            min,
            max,
        })
    }
}

pub(super) fn check_probability(field: &'static str, found: f32) -> Result<(), ModelError> {
    // NaN is in no range.
    if (0.0..1.0).contains(&found) {
        Ok(())
    } else {
        Err(ModelError::Number {
            field,
            found,
            min: 0.0,
            max: 1.0,
        })
    }
}
