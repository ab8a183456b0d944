//! The floor `daemon`.
