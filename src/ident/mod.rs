//! The floor `ident`.
