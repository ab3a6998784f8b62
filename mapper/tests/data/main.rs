//! Data sets, labels and evaluation across modules.

mod folder;
mod labels;
mod readers;
