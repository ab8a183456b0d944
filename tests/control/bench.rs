//! A controller with a model, of the test's own FREE.

use freerig::control::{ControlConfig, ControllerKind, FreeControl, ModelSpec};
use freerig::model::Free;
pub use freerig::sim::controlled::{Controlled, calibrated, follow, led_by_model, off_by_a_fifth, plant};

use crate::harness::{config, free_control};

/// A controller configuration for `free` with a model of it.
pub fn with_model(free: Free, spec: ModelSpec) -> ControlConfig {
    config(vec![FreeControl { free, controller: ControllerKind::Model(spec), ..free_control(-40.0) }])
}
