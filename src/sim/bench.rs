//! What the simulated rig is made of.

use std::time::Duration;

use super::{KnobSim, ModuleSim};
use crate::model::Free;

/// The whole simulated rig.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchConfig {
    /// Seed of noise, scatter and phases.
    pub seed: u64,
    /// By FREE, in the order of rig.toml.
    pub plants: Vec<PlantSim>,
    /// Four FREEs under one plate, where there are.
    pub module: Option<ModuleSim>,
    /// The IMUs.
    pub imu: ImuSim,
    /// Whether a dump valve is fitted.
    pub dump_valve: bool,
    /// Whether a one-shot in series with its coil wants a heartbeat.
    pub one_shot: bool,
}

/// One simulated FREE behind its regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantSim {
    /// The nominal FREE; the true one is off by the seeded `scatter`.
    pub nominal: Free,
    /// Relative standard deviation of every true parameter against the nominal one, drawn from the seed.
    pub scatter: f64,
    /// Width of the torsional hysteresis loop (Maxwell slip) over a 0-7 psi cycle, as a fraction of the range.
    pub hysteresis: f64,
    /// Constant external moment on the end, N m.
    pub load_moment: f64,
    /// The knob on the end, where there is one.
    pub knob: Option<KnobSim>,
    /// Its regulator.
    pub regulator: RegulatorSim,
    /// What stands between a DAC or a PWM output and its regulator; none of one that takes its set-point as a number.
    pub analogue: Option<AnalogueSim>,
}

/// The input of a simulated analogue regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalogueSim {
    /// Channel of the DAC (0 to 3) that it really hangs on, whatever rig.toml says; of no matter behind a PWM output.
    pub channel: usize,
    /// Nominal code at which it begins to open; the true one is off by the seeded scatter of
    /// [`AnalogueSim::ZERO_SPREAD`].
    pub zero_code: f64,
    /// Nominal pressure per code above it, Pa; the true one is off by the seeded scatter.
    pub pascals_per_code: f64,
}

impl AnalogueSim {
    /// Codes that the zero is off by for a scatter of one.
    pub const ZERO_SPREAD: f64 = 500.0;
}

/// One simulated pressure regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegulatorSim {
    /// First-order lag.
    pub lag: Duration,
    /// Dead time.
    pub dead_time: Duration,
    /// Fastest change of pressure, Pa/s.
    pub slew: f64,
    /// Standard deviation of the pressure reading, Pa.
    pub noise: f64,
    /// Full scale, Pa.
    pub full_scale: f64,
}

/// What the simulated IMUs do to the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSim {
    /// From the motion to the register.
    pub delay: Duration,
    /// Standard deviation of the orientation's noise, rad.
    pub noise: f64,
    /// Standard deviation of the gyro's noise, rad/s.
    pub rate_noise: f64,
}
