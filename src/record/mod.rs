//! The floor `record`.
