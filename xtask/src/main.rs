//! Developer commands of landline.

fn main() {}
