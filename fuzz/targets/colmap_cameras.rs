#![no_main]

#[macro_use]
mod shared;

target!("colmap_cameras");
