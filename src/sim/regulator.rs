//! The pneumatic side of a simulated pressure regulator: lag, slew limit, full scale, supply, and its failures.

use super::RegulatorSim;

/// What the valve of a regulator does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Valve {
    /// Follows the set-point.
    #[default]
    Working,
    /// Neither feeds nor exhausts, whatever is commanded.
    Stuck,
    /// Feeds at the slew limit up to the supply pressure, whatever is commanded.
    StuckOpen,
}

/// One regulator and the volume that it feeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Regulator {
    spec: RegulatorSim,
    setpoint: f64,
    /// What its valve does.
    pub valve: Valve,
    /// Time constant of a leak to the atmosphere, s; infinite without one.
    pub leak: f64,
}

impl Regulator {
    /// At rest and vented.
    pub fn new(spec: RegulatorSim) -> Self {
        Self { spec, setpoint: 0.0, valve: Valve::Working, leak: f64::INFINITY }
    }

    /// What it was built with.
    pub fn spec(&self) -> &RegulatorSim {
        &self.spec
    }

    /// The set-point that the valve now follows (after the dead time), Pa; clipped to 0..=full scale.
    pub fn set(&mut self, setpoint: f64) {
        // What is no number counts as zero.
        self.setpoint = setpoint.max(0.0).min(self.spec.full_scale);
    }

    /// Pressure one step of `dt` (s) after `pressure`, Pa, fed from `supply`, Pa. `exhaust` is the time constant
    /// of the dump valve where it is open: it cuts the feed off and exhausts the volume.
    pub fn step(&self, pressure: f64, dt: f64, supply: f64, exhaust: Option<f64>) -> f64 {
        if let Some(time_constant) = exhaust {
            return pressure * (-dt / time_constant.min(self.leak)).exp();
        }
        let target = match self.valve {
            Valve::Working => self.setpoint,
            Valve::Stuck => pressure,
            Valve::StuckOpen => supply,
        };
        // Air flows in only from a supply at a higher pressure; it always flows out.
        let target = target.min(supply.max(pressure));
        let lag = self.spec.lag.as_secs_f64();
        let share = if lag > 0.0 { 1.0 - (-dt / lag).exp() } else { 1.0 };
        let step = ((target - pressure) * share).clamp(-self.spec.slew * dt, self.spec.slew * dt);
        (pressure + step) * (-dt / self.leak).exp()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn regulator() -> Regulator {
        Regulator::new(RegulatorSim {
            lag: Duration::from_millis(60),
            dead_time: Duration::ZERO,
            slew: 1e5,
            noise: 0.0,
            full_scale: 1e5,
        })
    }

    #[test]
    fn without_supply_the_pressure_cannot_rise_but_falls() {
        let mut r = regulator();
        r.set(5e4);
        assert_eq!(r.step(1e4, 1e-3, 0.0, None), 1e4);
        r.set(0.0);
        assert!(r.step(1e4, 1e-3, 0.0, None) < 1e4);
    }

    #[test]
    fn a_stuck_valve_holds_and_a_leak_empties() {
        let mut r = regulator();
        r.valve = Valve::Stuck;
        r.set(5e4);
        assert_eq!(r.step(1e4, 1e-3, 1e5, None), 1e4);
        r.leak = 0.05;
        assert!((r.step(1e4, 0.05, 1e5, None) - 1e4 * (-1f64).exp()).abs() < 1e-9);
    }
}
