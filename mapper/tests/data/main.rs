//! Data sets, labels and evaluation across modules.

mod cameras;
mod disk;
mod evaluation;
mod folder;
mod imported;
mod labels;
mod readers;
mod room;
mod splits;
