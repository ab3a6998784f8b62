//! Sizes of tensors: rows that are fixed or counted at run time, channels, and the grid of a picture.
//!
//! A [`Tensor`] is a small handle: which value of the graph, and which window of its numbers. Windows make a slice of the
//! channels ([`Tensor::channel_range`]) and the joining of neighbouring rows ([`Tensor::join_rows`]) free.

use std::ops::Range;

/// Number of a value (the output of an operation, or an input) in its graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ValueId(pub usize);

/// Number of a count (a run-time number of rows) in its graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CountId(pub usize);

/// Number of a weight in its graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WeightId(pub usize);

/// Number of rows of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Rows {
    /// The same in every run.
    Fixed(usize),
    /// `per` rows for each element of a count: 1 for keypoints, the number of tokens for segments.
    Counted {
        /// The count.
        count: CountId,
        /// Rows per element.
        per: usize,
    },
}

impl Rows {
    /// Rows in a run with these counts, or the most there can be when given the capacities.
    pub fn at(self, counts: &[usize]) -> usize {
        match self {
            Self::Fixed(rows) => rows,
            Self::Counted { count, per } => counts[count.0] * per,
        }
    }
}

/// Height and width of a picture whose pixels are the rows of a tensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Grid {
    /// Pixel rows.
    pub height: usize,
    /// Pixel columns.
    pub width: usize,
}

impl Grid {
    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.height * self.width
    }
}

/// A window of a value of the graph: `rows` rows of `channels` numbers, `row_stride` numbers apart, from `offset` on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Tensor {
    /// The value that holds the numbers.
    pub value: ValueId,
    /// Number of rows.
    pub rows: Rows,
    /// Numbers per row.
    pub channels: usize,
    /// First number of the first row, from the start of the value.
    pub offset: usize,
    /// Numbers from the start of one row to the start of the next.
    pub row_stride: usize,
    /// Height and width if the rows are the pixels of a picture.
    pub grid: Option<Grid>,
}

impl Tensor {
    /// The same rows with only some of the channels. Free of cost.
    ///
    /// # Panics
    /// If the range is empty or not within the channels: a mistake in the network's description.
    pub fn channel_range(self, range: Range<usize>) -> Self {
        assert!(
            range.start < range.end && range.end <= self.channels,
            "channel range {range:?} of a tensor with {} channels",
            self.channels
        );
        Self {
            channels: range.end - range.start,
            offset: self.offset + range.start,
            ..self
        }
    }

    /// Joins each `times` neighbouring rows into one row with `times` as many channels. Free of cost.
    ///
    /// Returns `None` when the rows do not lie side by side or their number does not divide.
    pub fn join_rows(self, times: usize) -> Option<Self> {
        if times == 0 || self.row_stride != self.channels {
            return None;
        }
        let rows = match self.rows {
            Rows::Fixed(rows) if rows % times == 0 => Rows::Fixed(rows / times),
            Rows::Counted { count, per } if per % times == 0 => Rows::Counted {
                count,
                per: per / times,
            },
            _ => return None,
        };
        Some(Self {
            rows,
            channels: self.channels * times,
            row_stride: self.row_stride * times,
            grid: None,
            ..self
        })
    }
}
