//! The floor `fem`.
