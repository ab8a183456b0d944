//! The simulated rig's physics: regulators, dump valve, FREEs, and a memory of the motion for delayed sensors.
//!
//! Time is cut into fixed substeps of [`STEP`]. Whatever acts from outside is an event with its own time, and
//! takes effect at the first grid point at or after it; a state depends only on events before it. So the plant
//! gives the same bits however often, and in whatever portions, it is advanced.
//!
//! The plant is not the controller's model: its parameters are off by a seeded scatter, its tip drags
//! Maxwell-slip friction, and the regulator has its own lag, dead time and slew limit.

use std::collections::BTreeMap;
use std::time::Duration;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::chips::Orientation;
use super::plate::{Plate, Swinging};
use super::regulator::{Regulator, Valve};
use super::tip::{HardStop, Tip, loop_friction};
use super::valve::DumpValve;
use super::{BenchConfig, PlantSim};
use crate::clock::Time;
use crate::model::Free;
use crate::signal::Truth;

/// The substep.
pub const STEP: Duration = Duration::from_micros(250);
/// How many states are remembered: 2.048 s.
const MEMORY: usize = 8192;
/// Pressure of the supply, as a multiple of the largest full scale.
const SUPPLY_MARGIN: f64 = 1.5;
/// Scatter is cut off at this many standard deviations, so that no parameter can change its sign.
pub(super) const SCATTER_CUT: f64 = 2.5;

/// Something that goes wrong with the rig's mechanics or pneumatics, or that a person does to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlantFault {
    /// The FREE or its tube leaks with this time constant, s; 0.01 is a burst, infinity repairs it.
    Leak(usize, f64),
    /// The valve of the FREE's regulator works, sticks, or sticks open.
    Valve(usize, Valve),
    /// The external moment on the FREE's end becomes this, N m.
    Load(usize, f64),
    /// The external force that pulls at the FREE's end becomes this, N: a weight that hangs there.
    Pull(usize, f64),
    /// The supply pressure becomes this, Pa.
    Supply(f64),
    /// The dump valve stays closed (true), or is repaired.
    DumpStuck(bool),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    Setpoint(usize, f64),
    Grip(usize, Option<f64>),
    AddedInertia(usize, f64),
    Dump(bool),
    Beat,
    Fault(PlantFault),
}

#[derive(Clone, Copy, Debug, Default)]
struct Snapshot {
    angle: f64,
    rate: f64,
    extension: f64,
    acceleration: f64,
    pressure: f64,
}

impl Snapshot {
    fn between(a: &Snapshot, b: &Snapshot, x: f64) -> Snapshot {
        let mix = |a: f64, b: f64| a + (b - a) * x;
        Snapshot {
            angle: mix(a.angle, b.angle),
            rate: mix(a.rate, b.rate),
            extension: mix(a.extension, b.extension),
            acceleration: mix(a.acceleration, b.acceleration),
            pressure: mix(a.pressure, b.pressure),
        }
    }
}

/// One FREE behind its regulator.
#[derive(Clone, Debug)]
struct Branch {
    tip: Tip,
    regulator: Regulator,
    pressure: f64,
    memory: Vec<Snapshot>,
}

/// The whole simulated rig.
#[derive(Clone, Debug)]
pub struct Plant {
    seed: u64,
    branches: Vec<Branch>,
    /// The plate on the ends of a module's FREEs.
    module: Option<Swinging>,
    dump: DumpValve,
    supply: f64,
    /// Below it the supply's pressure switch opens, Pa: the largest full scale.
    switch: f64,
    /// Grid points passed.
    step: u64,
    /// By grid point of effect, then in the order of their arrival.
    events: BTreeMap<(u64, u64), Event>,
    arrivals: u64,
    /// By FREE: when its set-point becomes zero unless it is told another before.
    lapses: BTreeMap<usize, (u64, u64)>,
}

impl Plant {
    /// The rig at rest and vented at time zero.
    pub fn new(config: &BenchConfig) -> Self {
        let mut rng = Pcg64::seed_from_u64(config.seed);
        let branches: Vec<_> = config.plants.iter().map(|p| Branch::new(p, &mut rng)).collect();
        let largest = config.plants.iter().map(|p| p.regulator.full_scale).fold(0.0, f64::max);
        Self {
            seed: config.seed,
            branches,
            module: None,
            dump: DumpValve::new(config.dump_valve, config.one_shot),
            supply: SUPPLY_MARGIN * largest,
            switch: largest,
            step: 0,
            events: BTreeMap::new(),
            arrivals: 0,
            lapses: BTreeMap::new(),
        }
    }

    /// The same rig, at rest until `time`: a live clock's epoch lies far back.
    #[must_use]
    pub fn starting_at(mut self, time: Time) -> Self {
        self.step = grid(time);
        self
    }

    /// Fixes the ends of `frees` to `plate`: from now on they move as it does.
    pub fn mount(&mut self, frees: Vec<usize>, plate: Plate) {
        self.module = Some(Swinging::new(frees, plate, MEMORY));
    }

    /// How many FREEs there are.
    pub fn free_count(&self) -> usize {
        self.branches.len()
    }

    /// The true parameters of a FREE; none where there is no such FREE.
    pub fn true_free(&self, free: usize) -> Option<&Free> {
        self.branches.get(free).map(|b| b.tip.free())
    }

    /// Gives the regulator of `free` a set-point (Pa) at `at`; it acts after the regulator's dead time.
    pub fn set_setpoint(&mut self, free: usize, pascals: f64, at: Time) {
        if let Some(branch) = self.branches.get(free) {
            let effect = at + branch.regulator.spec().dead_time;
            if let Some(lapse) = self.lapses.remove(&free) {
                self.events.remove(&lapse);
            }
            self.schedule(effect, Event::Setpoint(free, pascals));
        }
    }

    /// The set-point of `free` becomes zero at `at` unless it is given one before: a watchdog of whatever gives it.
    pub fn lapse_at(&mut self, free: usize, at: Time) {
        if let Some(branch) = self.branches.get(free) {
            let lapse = self.schedule(at + branch.regulator.spec().dead_time, Event::Setpoint(free, 0.0));
            self.lapses.insert(free, lapse);
        }
    }

    /// Switches the dump valve at `at`.
    pub fn set_dump(&mut self, open: bool, at: Time) {
        self.schedule(at, Event::Dump(open));
    }

    /// The dump valve's heartbeat changes at `at`.
    pub fn beat(&mut self, at: Time) {
        self.schedule(at, Event::Beat);
    }

    /// Lets something go wrong (or be repaired) at `at`.
    pub fn inject(&mut self, fault: PlantFault, at: Time) {
        self.schedule(at, Event::Fault(fault));
    }

    /// A hand takes hold of a FREE's end at `at` and turns it with `moment` (N m), or lets it go.
    pub(super) fn grip(&mut self, free: usize, moment: Option<f64>, at: Time) {
        self.schedule(at, Event::Grip(free, moment));
    }

    /// The inertia on a FREE's end beside its own becomes `inertia` (kg m2) at `at`.
    pub(super) fn add_inertia(&mut self, free: usize, inertia: f64, at: Time) {
        self.schedule(at, Event::AddedInertia(free, inertia));
    }

    /// The seed of everything random.
    pub(super) fn seed(&self) -> u64 {
        self.seed
    }

    /// Brings the state to `time` (the next grid point where it falls between two); never goes back.
    pub fn advance_to(&mut self, time: Time) {
        let target = grid(time);
        while self.step < target {
            self.advance();
        }
    }

    /// Pressure inside a FREE at `time`, Pa, without the sensor's noise.
    pub fn pressure(&mut self, free: usize, time: Time) -> f64 {
        self.at(free, time).pressure
    }

    /// What the regulator's own sensor measures at `time`, Pa: the pressure with noise, clipped at 110 % of the
    /// full scale.
    pub fn reading(&mut self, free: usize, time: Time) -> f64 {
        let pressure = self.at(free, time).pressure;
        let Some(branch) = self.branches.get(free) else { return pressure };
        let spec = branch.regulator.spec();
        let noise = spec.noise * normal(self.seed, free as u64, grid(time));
        (pressure + noise).min(1.1 * spec.full_scale)
    }

    /// Motion of a FREE's end at `time`, as a sensor fixed to it with its z along the FREE sees it, by interpolation
    /// between the remembered states (2 s of them).
    pub fn orientation(&mut self, free: usize, time: Time) -> Orientation {
        self.advance_to(time);
        let (before, after, x) = self.around(time);
        if let Some(module) = self.module.as_ref().filter(|module| module.holds(free)) {
            return module.orientation(before, after, x);
        }
        let s = self.at(free, time);
        let (sin, cos) = (0.5 * s.angle).sin_cos();
        Orientation {
            quaternion: [cos, 0.0, 0.0, sin],
            rate: [0.0, 0.0, s.rate],
            acceleration: [0.0, 0.0, s.acceleration],
        }
    }

    /// What a FREE really does at `time`.
    pub fn truth(&mut self, free: usize, time: Time) -> Truth {
        let s = self.at(free, time);
        let (before, after, x) = self.around(time);
        if let Some(module) = self.module.as_ref().filter(|module| module.holds(free)) {
            return Truth { pressure: s.pressure, ..module.truth(before, after, x) };
        }
        let length = self.branches.get(free).map_or(0.0, |b| b.tip.free().length);
        let position = [0.0, 0.0, length + s.extension];
        Truth { angle: s.angle, extension: s.extension, pressure: s.pressure, position }
    }

    /// Whether the module's plate is where it has no equilibrium any more.
    pub fn plate_stuck(&self) -> bool {
        self.module.as_ref().is_some_and(|module| module.plate().stuck())
    }

    /// Which hard stop a FREE's end rests on, where it does.
    pub fn hard_stop(&self, free: usize) -> Option<HardStop> {
        self.branches.get(free).and_then(|b| b.tip.hard_stop())
    }

    /// Returns the event's place.
    fn schedule(&mut self, at: Time, event: Event) -> (u64, u64) {
        let place = (grid(at), self.arrivals);
        self.events.insert(place, event);
        self.arrivals += 1;
        place
    }

    /// Whether the supply's pressure switch is closed at `time`.
    pub fn supply_suffices(&mut self, time: Time) -> bool {
        self.advance_to(time);
        self.supply >= self.switch
    }

    /// The state at `time`; everything zero where there is no such FREE.
    fn at(&mut self, free: usize, time: Time) -> Snapshot {
        self.advance_to(time);
        let Some(branch) = self.branches.get(free) else { return Snapshot::default() };
        let (before, after, x) = self.around(time);
        Snapshot::between(&branch.memory[before], &branch.memory[after], x)
    }

    /// Places in the memory of the states before and after `time`, and where between them it lies, 0 to 1.
    fn around(&self, time: Time) -> (usize, usize, f64) {
        let oldest = self.step.saturating_sub(MEMORY as u64 - 1);
        let (before, rest) = (time.as_nanos() / step_nanos(), time.as_nanos() % step_nanos());
        let before = before.clamp(oldest, self.step);
        let after = (before + 1).min(self.step);
        (slot(before), slot(after), rest as f64 / step_nanos() as f64)
    }

    /// One substep.
    fn advance(&mut self) {
        while let Some(entry) = self.events.first_entry()
            && entry.key().0 <= self.step
        {
            let event = entry.remove();
            self.apply(event);
        }
        let dt = STEP.as_secs_f64();
        let exhaust = self.dump.exhaust(self.step as f64 * dt);
        self.step += 1;
        let held = |free: usize| self.module.as_ref().is_some_and(|module| module.holds(free));
        for (free, branch) in self.branches.iter_mut().enumerate() {
            branch.advance(dt, self.supply, exhaust, slot(self.step), !held(free));
        }
        if let Some(module) = &mut self.module {
            module.advance(|free| self.branches.get(free).map_or(0.0, |b| b.pressure), dt, slot(self.step));
        }
    }

    fn apply(&mut self, event: Event) {
        let now = self.step as f64 * STEP.as_secs_f64();
        match event {
            Event::Setpoint(free, pascals) => self.branch(free, |b| b.regulator.set(pascals)),
            Event::Grip(free, moment) => self.branch(free, |b| b.tip.grip = moment),
            Event::AddedInertia(free, inertia) => self.branch(free, |b| b.tip.added_inertia = inertia.max(0.0)),
            Event::Dump(open) => self.dump.switch(open, now),
            Event::Beat => self.dump.beat(now),
            Event::Fault(PlantFault::Leak(free, time)) => self.branch(free, |b| b.regulator.leak = time.max(1e-6)),
            Event::Fault(PlantFault::Valve(free, valve)) => self.branch(free, |b| b.regulator.valve = valve),
            Event::Fault(PlantFault::Load(free, moment)) => self.branch(free, |b| b.tip.load = moment),
            Event::Fault(PlantFault::Pull(free, force)) => self.branch(free, |b| b.tip.pull = force),
            Event::Fault(PlantFault::Supply(pascals)) => self.supply = pascals,
            Event::Fault(PlantFault::DumpStuck(stuck)) => self.dump.stick(stuck),
        }
    }

    fn branch(&mut self, free: usize, f: impl FnOnce(&mut Branch)) {
        if let Some(branch) = self.branches.get_mut(free) {
            f(branch);
        }
    }
}

impl Branch {
    fn new(sim: &PlantSim, rng: &mut Pcg64) -> Self {
        let free = scattered(&sim.nominal, sim.scatter, rng);
        // It has been under pressure before.
        let friction = loop_friction(&free, sim.load_moment, sim.hysteresis).rested(free.direction());
        let mut tip = Tip::new(free, friction, sim.load_moment);
        tip.settle();
        if let Some(knob) = sim.knob {
            tip.mount(knob);
        }
        let mut branch = Self {
            tip,
            regulator: Regulator::new(sim.regulator),
            pressure: 0.0,
            memory: vec![Snapshot::default(); MEMORY],
        };
        // It has always been at rest.
        branch.remember(0, 0.0);
        let rest = branch.memory[0];
        branch.memory.fill(rest);
        branch
    }

    /// `own`: its end moves on its own, not with a plate.
    fn advance(&mut self, dt: f64, supply: f64, exhaust: Option<f64>, slot: usize, own: bool) {
        let before = self.pressure;
        self.pressure = self.regulator.step(before, dt, supply, exhaust);
        let velocity = self.tip.velocity();
        if own {
            self.tip.step(0.5 * (before + self.pressure), dt);
        }
        self.remember(slot, (self.tip.velocity() - velocity) / dt);
    }

    fn remember(&mut self, slot: usize, acceleration: f64) {
        self.memory[slot] = Snapshot {
            angle: self.tip.angle(),
            rate: self.tip.rate(),
            extension: self.tip.extension(),
            acceleration,
            pressure: self.pressure,
        };
    }
}

fn step_nanos() -> u64 {
    STEP.as_nanos() as u64
}

/// First grid point at or after `time`.
fn grid(time: Time) -> u64 {
    time.as_nanos().div_ceil(step_nanos())
}

fn slot(step: u64) -> usize {
    (step % MEMORY as u64) as usize
}

/// The nominal FREE with every parameter off by `scatter` (relative standard deviation).
fn scattered(nominal: &Free, scatter: f64, rng: &mut Pcg64) -> Free {
    let mut off = |value: f64| {
        let x: f64 = StandardNormal.sample(rng);
        value * (1.0 + scatter * x.clamp(-SCATTER_CUT, SCATTER_CUT))
    };
    Free {
        gamma: off(nominal.gamma),
        length: off(nominal.length),
        radius: off(nominal.radius),
        mass: off(nominal.mass),
        inertia: off(nominal.inertia),
        axial_stiffness: off(nominal.axial_stiffness),
        torsional_stiffness: off(nominal.torsional_stiffness),
        axial_damping: off(nominal.axial_damping),
        torsional_damping: off(nominal.torsional_damping),
    }
}

/// A standard normal number that depends only on its arguments, not on how often it is asked for: SplitMix64
/// over the arguments, then Box-Muller.
fn normal(seed: u64, stream: u64, index: u64) -> f64 {
    let mix = |x: u64| {
        let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    };
    let key = mix(seed.wrapping_add(mix(stream.wrapping_add(0x9e37_79b9_7f4a_7c15))));
    let uniform = |n: u64| {
        let bits = mix(key.wrapping_add((2 * index + n).wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        ((bits >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    };
    (-2.0 * uniform(0).ln()).sqrt() * (std::f64::consts::TAU * uniform(1)).cos()
}
