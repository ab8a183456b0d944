//! The simulated dump valve: one for the whole rig, normally open, exhausting every FREE at once.

/// Time constant of the exhaust through the open valve, s.
pub const EXHAUST_TIME: f64 = 0.1;
/// From the loss of the coil's current to the open valve, s.
pub const OPENING_TIME: f64 = 0.01;

/// The dump valve. Its coil keeps it closed; without current, as it is at first, it is open.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DumpValve {
    fitted: bool,
    stuck: bool,
    /// Whether the coil has its current.
    closed: bool,
    /// When the current was last switched off, s of plant time.
    released: f64,
}

impl DumpValve {
    /// An open valve, or none at all.
    pub fn new(fitted: bool) -> Self {
        Self { fitted, released: f64::NEG_INFINITY, ..Self::default() }
    }

    /// Switches the coil off (open) or on at plant time `now`, s.
    pub fn switch(&mut self, open: bool, now: f64) {
        if open && self.closed {
            self.released = now;
        }
        self.closed = !open;
    }

    /// Makes it stay closed whatever the coil does, or repairs it.
    pub fn stick(&mut self, stuck: bool) {
        self.stuck = stuck;
    }

    /// Time constant with which the FREEs exhaust at plant time `now` (s), where the valve is open.
    pub fn exhaust(&self, now: f64) -> Option<f64> {
        let open = self.fitted && !self.stuck && !self.closed && now - self.released >= OPENING_TIME;
        open.then_some(EXHAUST_TIME)
    }
}
