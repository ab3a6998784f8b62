//! Landmarks as a scene file stores them.
//!
//! A point takes 19 bytes: position 6, code 8, view 3, clusters 2. A line takes 23: both ends 12, code 8, view 3.
//! Positions are whole steps from an origin.

use super::code::SignCode;
use nalgebra::Vector3;

/// Most points, and most lines, of a table.
pub const MAX_LANDMARKS: usize = 1 << 17;
/// Number of a cluster that is none.
pub const NO_CLUSTER: u8 = u8::MAX;
/// Bytes of a stored point.
pub const POINT_BYTES: usize = 19;
/// Bytes of a stored line.
pub const LINE_BYTES: usize = 23;

/// Why a table was refused, or could not be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LandmarkError {
    /// There is no point.
    #[error(
        "there are no landmarks: a table needs at least one point; leave the table out instead"
    )]
    Empty,
    /// More than a frame could be matched with.
    #[error("{found} {what} are more than the limit of {limit}")]
    TooMany {
        /// `points`, `lines` or `clusters`.
        what: &'static str,
        /// How many.
        found: usize,
        /// How many are allowed.
        limit: usize,
    },
    /// Lists that belong together have different lengths.
    #[error("{what}: {found} rows where there are {expected} positions")]
    Rows {
        /// The list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Length of the positions.
        expected: usize,
    },
    /// The code was made for descriptors of another length.
    #[error("{what} has {found} numbers; the extractor's descriptors have {expected}")]
    Channels {
        /// The tensor.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Length of a descriptor.
        expected: usize,
    },
    /// A NaN or an infinity.
    #[error("{what} holds a number that is not finite at position {index}")]
    NotFinite {
        /// What.
        what: &'static str,
        /// Which of its numbers.
        index: usize,
    },
    /// The length of a step is no length.
    #[error("the step of positions is {0}; it must be positive and finite")]
    Step(f64),
    /// A cluster that does not exist.
    #[error("landmark {landmark} is in cluster {found} of {clusters}")]
    Cluster {
        /// The landmark.
        landmark: usize,
        /// Its code.
        found: u8,
        /// Clusters of the table.
        clusters: usize,
    },
    /// Too few bytes for landmarks that are of use.
    #[error(
        "{budget} bytes leave room for {fitting} landmarks; at least {least} are needed, with the networks' {networks} bytes: give {needed} bytes or more"
    )]
    Budget {
        /// Bytes that were allowed.
        budget: usize,
        /// Points that would fit.
        fitting: usize,
        /// Points that are needed.
        least: usize,
        /// Bytes of everything else.
        networks: usize,
        /// Bytes that would do.
        needed: usize,
    },
}

/// The positions' grid: `world = origin + step * whole number`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionGrid {
    /// World position of zero.
    pub origin: Vector3<f64>,
    /// World length of one.
    pub step: f64,
}

impl PositionGrid {
    /// The finest grid that holds a box.
    pub fn around(low: &Vector3<f64>, high: &Vector3<f64>) -> Self {
        let side = (high - low).max();
        Self {
            origin: *low,
            step: if side > 0.0 {
                side / f64::from(u16::MAX)
            } else {
                1.0
            },
        }
    }

    /// The nearest grid point; `None` outside.
    pub fn encode(&self, p: &Vector3<f64>) -> Option<[u16; 3]> {
        let mut out = [0; 3];
        for (o, v) in out.iter_mut().zip(((p - self.origin) / self.step).iter()) {
            let rounded = (v + 0.5).floor();
            if !(0.0..=f64::from(u16::MAX)).contains(&rounded) {
                return None;
            }
            *o = rounded as u16;
        }
        Some(out)
    }

    /// World position of a grid point.
    pub fn decode(&self, p: [u16; 3]) -> Vector3<f64> {
        self.origin + Vector3::from(p.map(f64::from)) * self.step
    }
}

/// The landmarks of a place. Lists of one kind have one entry for each landmark.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkTable {
    /// Of all positions.
    pub grid: PositionGrid,
    /// Of the points' descriptors.
    pub point_code: SignCode,
    /// Of the lines' descriptors.
    pub line_code: SignCode,
    /// Clusters of views in which points are numbered.
    pub num_clusters: usize,
    /// Points.
    pub point_positions: Vec<[u16; 3]>,
    /// Codes of their descriptors.
    pub point_codes: Vec<u64>,
    /// From where they were seen ([`super::view::ViewCone::encode`]).
    pub point_views: Vec<[u8; 3]>,
    /// The two clusters of views that saw them most; [`NO_CLUSTER`] for none.
    pub point_clusters: Vec<[u8; 2]>,
    /// Ends of the lines, in the order in which most image segments run.
    pub line_positions: Vec<[[u16; 3]; 2]>,
    /// Codes of their descriptors.
    pub line_codes: Vec<u64>,
    /// From where their middles were seen.
    pub line_views: Vec<[u8; 3]>,
}

impl LandmarkTable {
    /// Checks what a file may get wrong; descriptors have `channels` numbers.
    ///
    /// # Errors
    /// [`LandmarkError`] names the first thing that is wrong.
    pub fn check(&self, channels: usize) -> Result<(), LandmarkError> {
        let (points, lines) = (self.point_positions.len(), self.line_positions.len());
        if points == 0 {
            return Err(LandmarkError::Empty);
        }
        for (what, found, limit) in [
            ("points", points, MAX_LANDMARKS),
            ("lines", lines, MAX_LANDMARKS),
            ("clusters", self.num_clusters, usize::from(NO_CLUSTER)),
        ] {
            if found > limit {
                return Err(LandmarkError::TooMany { what, found, limit });
            }
        }
        for (what, found, expected) in [
            ("codes of points", self.point_codes.len(), points),
            ("views of points", self.point_views.len(), points),
            ("clusters of points", self.point_clusters.len(), points),
            ("codes of lines", self.line_codes.len(), lines),
            ("views of lines", self.line_views.len(), lines),
        ] {
            if found != expected {
                return Err(LandmarkError::Rows {
                    what,
                    found,
                    expected,
                });
            }
        }
        let step = self.grid.step;
        if !(step > 0.0 && step.is_finite()) {
            return Err(LandmarkError::Step(step));
        }
        if let Some(index) = self.grid.origin.iter().position(|v| !v.is_finite()) {
            return Err(LandmarkError::NotFinite {
                what: "the origin of positions",
                index,
            });
        }
        self.point_code.check("the mean of points", channels)?;
        self.line_code.check("the mean of lines", channels)?;
        for (landmark, clusters) in self.point_clusters.iter().enumerate() {
            for found in clusters {
                if *found != NO_CLUSTER && usize::from(*found) >= self.num_clusters {
                    return Err(LandmarkError::Cluster {
                        landmark,
                        found: *found,
                        clusters: self.num_clusters,
                    });
                }
            }
        }
        Ok(())
    }

    /// Bytes of the lists in a file.
    pub fn num_bytes(&self) -> usize {
        POINT_BYTES * self.point_positions.len()
            + LINE_BYTES * self.line_positions.len()
            + 4 * (self.point_code.mean.len() + self.line_code.mean.len())
    }
}

/// A small table for tests.
#[cfg(test)]
pub(crate) fn small() -> LandmarkTable {
    LandmarkTable {
        grid: PositionGrid {
            origin: Vector3::zeros(),
            step: 1e-3,
        },
        point_code: SignCode {
            mean: vec![0.0; 64],
        },
        line_code: SignCode {
            mean: vec![0.0; 64],
        },
        num_clusters: 2,
        point_positions: vec![[1, 2, 3], [4, 5, 6]],
        point_codes: vec![7, 8],
        point_views: vec![[0; 3]; 2],
        point_clusters: vec![[0, 1], [1, NO_CLUSTER]],
        line_positions: vec![[[1, 2, 3], [4, 5, 6]]],
        line_codes: vec![9],
        line_views: vec![[0; 3]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_that_can_be_wrong_is_named() {
        let refused = |change: &dyn Fn(&mut LandmarkTable)| {
            let mut table = small();
            change(&mut table);
            table.check(64).expect_err("must refuse")
        };
        small().check(64).expect("is right");
        assert!(matches!(
            small().check(256),
            Err(LandmarkError::Channels { found: 64, .. })
        ));
        assert_eq!(
            refused(&|t| {
                t.point_positions.clear();
                t.point_codes.clear();
            }),
            LandmarkError::Empty
        );
        assert!(matches!(
            refused(&|t| t.point_codes.push(0)),
            LandmarkError::Rows { found: 3, .. }
        ));
        assert!(matches!(
            refused(&|t| t.grid.step = f64::NAN),
            LandmarkError::Step(_)
        ));
        assert!(matches!(
            refused(&|t| t.grid.origin.y = f64::INFINITY),
            LandmarkError::NotFinite { index: 1, .. }
        ));
        assert!(matches!(
            refused(&|t| t.line_code.mean[5] = f32::NAN),
            LandmarkError::NotFinite { index: 5, .. }
        ));
        assert_eq!(
            refused(&|t| t.point_clusters[1][0] = 2),
            LandmarkError::Cluster {
                landmark: 1,
                found: 2,
                clusters: 2
            }
        );
        assert!(matches!(
            refused(&|t| t.num_clusters = 256),
            LandmarkError::TooMany {
                what: "clusters",
                ..
            }
        ));
    }

    #[test]
    fn the_grid_holds_its_box_to_half_a_step() {
        let (low, high) = (Vector3::new(-1.0, 2.0, 0.5), Vector3::new(3.0, 2.5, 1.5));
        let grid = PositionGrid::around(&low, &high);
        for p in [low, high, Vector3::new(0.123, 2.2, 0.77)] {
            let back = grid.decode(grid.encode(&p).expect("inside"));
            assert!((back - p).amax() <= 0.5 * grid.step * (1.0 + 1e-9));
        }
        assert_eq!(grid.encode(&(low - Vector3::new(0.1, 0.0, 0.0))), None);
        assert_eq!(grid.encode(&Vector3::new(f64::NAN, 2.2, 0.6)), None);
    }
}
