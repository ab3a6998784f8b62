#![no_main]

#[macro_use]
mod shared;

target!("pickle");
