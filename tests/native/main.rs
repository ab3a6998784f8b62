//! Native tests that cross a module.
