//! The simulated dump valve: one for the whole rig, normally open, exhausting every FREE at once.

/// Time constant of the exhaust through the open valve, s.
pub const EXHAUST_TIME: f64 = 0.1;
/// From the loss of the coil's current to the open valve, s.
pub const OPENING_TIME: f64 = 0.01;
/// A heartbeat that stands still for so long takes the coil's current away, s.
pub const ONE_SHOT_TIME: f64 = 0.03;

/// The dump valve. Its coil keeps it closed; without current, as it is at first, it is open.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DumpValve {
    fitted: bool,
    stuck: bool,
    /// When the one-shot in series with the coil last heard the heartbeat, s of plant time; none where there is none.
    beat: Option<f64>,
    /// Whether the coil has its current.
    closed: bool,
    /// When the current was last switched off, s of plant time.
    released: f64,
}

impl DumpValve {
    /// An open valve, or none at all; with a one-shot that wants a heartbeat, or without.
    pub fn new(fitted: bool, one_shot: bool) -> Self {
        let beat = one_shot.then_some(f64::NEG_INFINITY);
        Self { fitted, beat, released: f64::NEG_INFINITY, ..Self::default() }
    }

    /// The heartbeat's line changes at plant time `now`, s.
    pub fn beat(&mut self, now: f64) {
        self.beat = self.beat.map(|_| now);
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
        let starved = self.beat.is_some_and(|beat| now - beat >= ONE_SHOT_TIME + OPENING_TIME);
        let open = self.fitted && !self.stuck && (starved || (!self.closed && now - self.released >= OPENING_TIME));
        open.then_some(EXHAUST_TIME)
    }
}
