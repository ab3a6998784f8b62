//! Camera relocalization from regressed 3D points and lines: one picture in, a 6-DoF camera pose out.
//!
//! The modules are layers; `docs/ARCHITECTURE.md` has the table of what may import what, and a test holds the code to it.
//!
//! Conventions everywhere: pixels are corner-based (the centre of the first pixel is (0.5, 0.5)); transforms are
//! `cam_from_world` with OpenCV camera axes (x right, y down, z forward); lengths are metres when the scene is metric.

pub mod features;
pub mod formats;
pub mod front_end;
pub mod geometry;
pub mod image;
pub mod landmarks;
pub mod lsd;
pub mod mapping;
pub mod math;
pub mod models;
pub mod nn;
pub mod place;
pub mod pose;
pub mod reconstruction;
pub mod regress;
pub mod relocalizer;
pub mod scene_file;
pub mod session;
pub mod simd;
pub mod tracker;
