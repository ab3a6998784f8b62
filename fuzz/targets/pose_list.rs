#![no_main]

#[macro_use]
mod shared;

target!("pose_list");
