//! The floor `plan`.
