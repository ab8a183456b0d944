//! A simulated rig under drill: armed, under pressure, looked at in every tick.

use std::sync::Arc;
use std::time::Duration;

use super::Case;
use crate::clock::Time;
use crate::config::Rig;
use crate::control::{Reaction, Request};
use crate::daemon::stepped::lock;
use crate::daemon::{Bench, DaemonError, Stepped, procedure};
use crate::signal::{FaultCode, FaultSet, Quantity, State, TickRecord, Truth};
use crate::sim::PlantFault;
use crate::trajectory::{Axis, Program, Sequence, Shape};

/// How finely the truth is looked at, s: the plant's own step.
const FINE: f64 = 250e-6;
/// A condition that the provocation has not brought about by then never comes, s.
const LONGEST_CAUSE: f64 = 10.0;
/// How long programs go on, s.
const LONG: f64 = 600.0;

/// What the rig does when the fault comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// The first FREE holds this share of its highest pressure.
    Press(f64),
    /// Every FREE holds this share of its soft angle, in its own direction; a client looks on.
    Turn(f64),
}

/// The rig on stage.
pub struct Scene {
    /// The rig's description.
    pub rig: Rig,
    /// The rig.
    pub bench: Stepped,
    /// Whether the client's heart beats.
    pub heart: bool,
}

impl Scene {
    /// The rig in Boot.
    pub fn new(rig: Rig) -> Result<Self, DaemonError> {
        Ok(Self { bench: Stepped::new(&rig)?, rig, heart: true })
    }

    /// Arms, and brings it to where the fault finds it.
    pub fn begin(&mut self, start: Start) -> Result<(), DaemonError> {
        procedure::arm(&mut self.bench, &self.rig, true)?;
        let frees = self.rig.control.frees.iter().enumerate();
        let to = |value: f64| {
            let way = Sequence::starting_at(0.0).then(Shape::Linear, value, 1.0).hold(LONG);
            way.build().map_err(|error| DaemonError::Rig(error.to_string()))
        };
        let axes: Vec<_> = match start {
            Start::Press(share) => {
                let sequence = to(share * self.rig.control.frees[0].limits.pressure_max)?;
                vec![(0, Axis { quantity: Quantity::Pressure, sequence })]
            }
            Start::Turn(share) => frees
                .map(|(index, free)| {
                    let soft = free.limits.angle_soft;
                    let far = if free.free.direction() > 0.0 { soft.1 } else { soft.0 };
                    Ok((index, Axis { quantity: Quantity::Angle, sequence: to(share * far)? }))
                })
                .collect::<Result<_, DaemonError>>()?,
        };
        let program = Program::new(axes).map_err(|error| DaemonError::Rig(error.to_string()))?;
        let attended = matches!(start, Start::Turn(_));
        self.bench.heartbeat();
        self.bench.request(Request::Start { program: Arc::new(program), attended, identify: false })?;
        self.pass(2.0)?;
        match self.bench.latest() {
            record if record.latched.is_empty() && record.state == State::Track => Ok(()),
            record => Err(DaemonError::Fault(record.latched)),
        }
    }

    /// Lets `seconds` pass; the heart beats in every tick.
    pub fn pass(&mut self, seconds: f64) -> Result<(), DaemonError> {
        let end = self.bench.now() + Duration::from_secs_f64(seconds);
        while self.bench.now() < end {
            if self.heart {
                self.bench.heartbeat();
            }
            self.bench.pass(self.rig.control.period.min(end.since(self.bench.now())))?;
        }
        Ok(())
    }

    /// When the truth is first as `begun` says.
    pub fn when(&mut self, begun: fn(&mut Scene) -> bool) -> Result<Time, DaemonError> {
        let end = self.bench.now() + Duration::from_secs_f64(LONGEST_CAUSE);
        while !begun(self) {
            if self.bench.now() >= end {
                return Err(DaemonError::Rig("the drill did not bring its fault about".into()));
            }
            self.pass(FINE)?;
        }
        Ok(self.bench.now())
    }

    /// When the rig reacts to the fault as the matrix says, and whether another fault was latched
    /// before; none within `longest` (s) of `begun`.
    pub fn detect(&mut self, case: &Case, begun: Time, longest: f64) -> Result<Option<(Time, bool)>, DaemonError> {
        let end = begun + Duration::from_secs_f64(longest);
        let before = self.bench.latest().latched;
        loop {
            let record = self.bench.latest();
            let new = FaultSet(record.latched.0 & !before.0 & !(1 << case.code as u32) & !case.along.0);
            if reacts(&record, case.code, case.reaction) {
                return Ok(Some((self.bench.now(), !new.is_empty())));
            }
            if self.bench.now() >= end {
                return Ok(None);
            }
            self.pass(FINE)?;
        }
    }

    /// From `seen` until every true pressure is below p_zero, s; infinite if that takes longer than `longest` (s).
    pub fn fall(&mut self, seen: Time, longest: f64) -> Result<f64, DaemonError> {
        loop {
            let took = self.bench.now().seconds_since(seen);
            let limits = |free: usize| self.rig.control.frees[free].limits.pressure_zero;
            if (0..self.rig.control.frees.len()).all(|free| self.truth(free).pressure < limits(free)) {
                return Ok(took);
            }
            if took > longest {
                return Ok(f64::INFINITY);
            }
            self.pass(1e-3)?;
        }
    }

    /// What a FREE really does now.
    pub fn truth(&self, free: usize) -> Truth {
        lock(&self.bench.sim().plant()).truth(free, self.bench.now())
    }

    /// What the sensor on the first FREE can show now: its true angle, as old as the sensor's delay; rad, in the FREE's
    /// own direction.
    pub fn shown_angle(&self) -> f64 {
        let then = self.bench.now() - self.rig.bench.imu.delay;
        self.rig.control.frees[0].free.direction() * lock(&self.bench.sim().plant()).truth(0, then).angle
    }

    /// Has the next tick come late, by more than the half period that counts.
    pub fn late(&mut self) {
        self.bench.wake_late(self.rig.control.period * 3 / 4);
    }

    /// A late tick, and the two after it.
    pub fn stall(&mut self) -> Result<(), DaemonError> {
        self.late();
        self.pass(3.0 * self.rig.control.period.as_secs_f64())
    }

    /// Lets something break in the plant now.
    pub fn inject(&mut self, fault: PlantFault) {
        lock(&self.bench.sim().plant()).inject(fault, self.bench.now());
    }

    /// Has a load turn the first FREE by `radians` in its own direction.
    pub fn turn(&mut self, radians: f64) {
        let free = &self.rig.control.frees[0].free;
        self.inject(PlantFault::Load(0, free.direction() * free.torsional_stiffness * radians));
    }
}

/// Whether the rig does in `record` what the matrix says about `code`.
fn reacts(record: &TickRecord, code: FaultCode, reaction: Reaction) -> bool {
    let free = record.frees().iter().fold(record.faults, |all, free| all.union(free.faults));
    let latched = record.latched.contains(code);
    match reaction {
        Reaction::None => false,
        Reaction::Warn => free.contains(code),
        Reaction::Hold => free.contains(code) && record.state == State::Faulting,
        Reaction::Ramp => latched,
        Reaction::Vent => latched && record.vent && record.frees().iter().all(|free| free.command == 0.0),
    }
}
