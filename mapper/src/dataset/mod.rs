//! Data sets of other tools, turned into one type: pictures with cameras and poses in our conventions.

pub mod camera;
