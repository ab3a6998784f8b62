//! Native tool of landline.

fn main() {}
