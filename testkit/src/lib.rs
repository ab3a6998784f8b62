//! Test support of landline.
