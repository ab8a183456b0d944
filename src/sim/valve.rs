//! The simulated dump valve: one for the whole rig, normally closed, exhausting every FREE at once.

/// Time constant of the exhaust through the open valve, s.
pub const EXHAUST_TIME: f64 = 0.1;
/// From the coil's current to the open valve, s.
pub const OPENING_TIME: f64 = 0.01;

/// The dump valve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DumpValve {
    fitted: bool,
    stuck: bool,
    /// When the coil was switched on, s of plant time.
    energised: Option<f64>,
}

impl DumpValve {
    /// A closed valve, or none at all.
    pub fn new(fitted: bool) -> Self {
        Self { fitted, ..Self::default() }
    }

    /// Switches the coil at plant time `now`, s.
    pub fn switch(&mut self, open: bool, now: f64) {
        self.energised = if open { self.energised.or(Some(now)) } else { None };
    }

    /// Makes it stay closed whatever the coil does, or repairs it.
    pub fn stick(&mut self, stuck: bool) {
        self.stuck = stuck;
    }

    /// Time constant with which the FREEs exhaust at plant time `now` (s), where the valve is open.
    pub fn exhaust(&self, now: f64) -> Option<f64> {
        let open = self.fitted && !self.stuck && self.energised.is_some_and(|t| now - t >= OPENING_TIME);
        open.then_some(EXHAUST_TIME)
    }
}
