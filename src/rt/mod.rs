//! The floor `rt`.
