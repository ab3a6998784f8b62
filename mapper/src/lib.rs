//! Library behind the native tool `landline`.
