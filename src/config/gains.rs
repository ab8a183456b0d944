//! Gains by name.

use crate::control::Gains;

/// What `gains` means where it is not written.
pub const DEFAULT: &str = "freerig";

/// Gains that every FREE knows by name, with what they are. A FREE's calibration may hold others, and its own of
/// the same name come first.
pub const PRESETS: [(&str, Gains, &str); 5] = [
    (
        DEFAULT,
        gains(11_600.0, 2.0e5, 0.0),
        "freerig's own, for 500 Hz, a regulator's lag of 60 ms and a sensor's delay of 15 ms: the zero stands on the \
         relaxation of the `paper` FREE (ct/kt = 58 ms), the crossover at 1 Hz",
    ),
    ("paper-pi", gains(32_000.0, 1.2e6, 0.0), "the paper's Fig. 5 read as PI; for an ideal plant"),
    ("paper-pd-printed", gains(32_000.0, 0.0, 1.2e6), "the paper's Fig. 5 as printed: reaches a twentieth of the way"),
    ("published-step", gains(10_342.0, 94_803.0, 0.0), "the authors' published code, step"),
    ("published-trajectory", gains(17_236.9, 603_291.5, 0.0), "the authors' published code, trajectory"),
];

/// The preset `name`.
pub fn preset(name: &str) -> Option<Gains> {
    PRESETS.iter().find(|preset| preset.0 == name).map(|preset| preset.1)
}

const fn gains(proportional: f64, integral: f64, derivative: f64) -> Gains {
    Gains { proportional, integral, derivative, derivative_filter: 0.0 }
}
