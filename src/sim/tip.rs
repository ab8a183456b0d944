//! The moving end of a simulated FREE: nonlinear lumped dynamics (Eqs 1-4, exact inextensible-fibre radius),
//! gravity, an external moment and force, Maxwell-slip friction, and hard stops where the model's domain would end.

use super::hysteresis::MaxwellSlip;
use super::knob::{KnobSim, Rubbing};
use crate::model::{Free, GRAVITY, Kinematics};
use crate::units::PASCAL_PER_PSI;

/// Top of the cycle for which the hysteresis loop's width is stated, Pa.
const CYCLE_TOP: f64 = 7.0 * PASCAL_PER_PSI;
/// Pressure steps of one half-cycle in the quasi-static loop.
const CYCLE_STEPS: u32 = 56;
/// The last slider slips after this share of the cycle's range of angle.
const REACH: f64 = 0.15;
/// Fastest rate times step that the explicit integrator is asked to take: well inside Runge-Kutta's 2.78.
const RATE_STEP: f64 = 1.0;

/// Where the end stops when the model would leave its domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HardStop {
    /// The FREE is stretched until its fibres nearly lie along the axis, or squeezed to half its length.
    Extension,
    /// The fibres are unwound to 55 % of their turns (the tube would grow without limit) or wound up to 200 %; or the
    /// knob on the end is at the end of its travel.
    Rotation,
}

/// State: extension (m), its rate, angle (rad), its rate.
type State = [f64; 4];

/// The end of one FREE.
#[derive(Clone, Debug)]
pub struct Tip {
    free: Free,
    friction: MaxwellSlip,
    /// Constant external moment, N m.
    pub load: f64,
    /// Constant external axial force, N, outwards.
    pub pull: f64,
    /// Moment of a hand that holds the end, N m; none where nobody does.
    pub grip: Option<f64>,
    /// Inertia on the end beside the FREE's own, kg m2.
    pub added_inertia: f64,
    knob: Option<KnobSim>,
    /// Range of the extension, m.
    extension_stops: (f64, f64),
    /// Range of the angle, rad.
    angle_stops: (f64, f64),
    state: State,
    stop: Option<HardStop>,
}

impl Tip {
    /// At rest and undeformed.
    pub fn new(free: Free, friction: MaxwellSlip, load: f64) -> Self {
        let reach = 0.98 * (1.0 / free.gamma.cos() - 1.0);
        let turns = free.length * free.gamma.tan() / free.radius;
        let (a, b) = (-0.45 * turns, turns);
        Self {
            free,
            friction,
            load,
            pull: 0.0,
            grip: None,
            added_inertia: 0.0,
            knob: None,
            extension_stops: (-0.5 * free.length, reach.min(0.5) * free.length),
            angle_stops: (a.min(b), a.max(b)),
            state: [0.0; 4],
            stop: None,
        }
    }

    /// Puts a knob on the end: off is here, and the other stop as far as its travel or the FREE's own stop goes.
    pub fn mount(&mut self, knob: KnobSim) {
        let (off, own) = (self.state[2], self.free.direction());
        let (low, high) = self.angle_stops;
        let end = (off + own * knob.travel).clamp(low, high);
        self.angle_stops = (off.min(end), off.max(end));
        self.knob = Some(knob);
    }

    /// Its parameters.
    pub fn free(&self) -> &Free {
        &self.free
    }

    /// End rotation, rad.
    pub fn angle(&self) -> f64 {
        self.state[2]
    }

    /// Rate of the end rotation, rad/s.
    pub fn rate(&self) -> f64 {
        self.state[3]
    }

    /// Extension, m.
    pub fn extension(&self) -> f64 {
        self.state[0]
    }

    /// Rate of the extension, m/s.
    pub fn velocity(&self) -> f64 {
        self.state[1]
    }

    /// The hard stop on which the end rests, where it does.
    pub fn hard_stop(&self) -> Option<HardStop> {
        self.stop
    }

    /// Lets the end sag to its equilibrium at zero pressure.
    pub fn settle(&mut self) {
        if let Some((s, angle)) = self.equilibrium(0.0) {
            self.state = [s, 0.0, angle, 0.0];
            self.friction.advance(angle);
        }
    }

    /// Moves the end by `dt` (s) under `pressure` (Pa): Runge-Kutta 4, in as many parts as the fastest mode needs.
    pub fn step(&mut self, pressure: f64, dt: f64) {
        let parts = (self.fastest_rate() * dt / RATE_STEP).ceil().max(1.0);
        for _ in 0..parts as u32 {
            self.part(pressure, dt / parts);
        }
    }

    fn part(&mut self, pressure: f64, dt: f64) {
        let x = self.state;
        let rubbing = self.rubbing(pressure);
        let add = |k: &State, h: f64| std::array::from_fn::<f64, 4, _>(|i| x[i] + h * k[i]);
        let k1 = self.derivative(&x, pressure, rubbing);
        let k2 = self.derivative(&add(&k1, 0.5 * dt), pressure, rubbing);
        let k3 = self.derivative(&add(&k2, 0.5 * dt), pressure, rubbing);
        let k4 = self.derivative(&add(&k3, dt), pressure, rubbing);
        self.state = std::array::from_fn(|i| x[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
        let [s, v, angle, rate] = &mut self.state;
        if let Rubbing::Slides(against) = rubbing
            && against * *rate > 0.0
        {
            // It came to rest on the way, the rate taken as linear; what friction does next is decided from there.
            let share = x[3] / (x[3] - *rate);
            (*angle, *rate) = (x[2] + 0.5 * share * dt * x[3], 0.0);
        }
        self.stop = None;
        if clip(s, v, self.extension_stops) {
            self.stop = Some(HardStop::Extension);
        }
        if clip(angle, rate, self.angle_stops) {
            self.stop = Some(HardStop::Rotation);
        }
        self.friction.advance(self.state[2]);
    }

    /// What the knob's friction does in the state as it is.
    fn rubbing(&self, pressure: f64) -> Rubbing {
        let Some(knob) = &self.knob else { return Rubbing::Slides(0.0) };
        let [s, _, angle, rate] = self.state;
        knob.rubbing(rate, self.balance(s, angle, pressure).1 + self.grip.unwrap_or(0.0))
    }

    fn derivative(&self, x: &State, pressure: f64, rubbing: Rubbing) -> State {
        let [s, v, angle, rate] = *x;
        let (force, moment) = self.balance(s, angle, pressure);
        let f = &self.free;
        let inertia = f.inertia + self.added_inertia;
        // Flesh damps what it holds: about critically.
        let grip = self.grip.map_or(0.0, |moment| moment - 2.0 * (f.torsional_stiffness * inertia).sqrt() * rate);
        let [turn, spin] = match rubbing {
            Rubbing::Held => [0.0, 0.0],
            Rubbing::Slides(against) => [rate, (moment + grip + against - f.torsional_damping * rate) / inertia],
        };
        [v, (force - f.axial_damping * v) / f.mass, turn, spin]
    }

    /// Force (N) and moment (N m) on the end at rest at (`s`, `angle`); positions are taken within the stops, which
    /// lie within the kinematics' domain.
    fn balance(&self, s: f64, angle: f64, pressure: f64) -> (f64, f64) {
        let f = &self.free;
        let s = s.clamp(self.extension_stops.0, self.extension_stops.1);
        let angle = angle.clamp(self.angle_stops.0, self.angle_stops.1);
        let actuation = Kinematics::Exact.actuation(f, s, angle).map_or((0.0, 0.0), |a| (a.force, a.moment));
        let preload = self.knob.map_or(0.0, |knob| f.direction() * knob.preload);
        (
            actuation.0 * pressure - f.axial_stiffness * s + f.mass * GRAVITY + self.pull,
            actuation.1 * pressure - f.torsional_stiffness * angle + self.load - preload + self.friction.moment(angle),
        )
    }

    /// An upper estimate of the fastest rate of the linearised motion, 1/s.
    fn fastest_rate(&self) -> f64 {
        let f = &self.free;
        let rate = |c: f64, k: f64, m: f64| (c / m).max((k / m).sqrt());
        // The slip elements add at most their whole stiffness, the pressure about as much as the FREE's own.
        let torsional = 2.0 * f.torsional_stiffness + self.friction.full_stiffness();
        let grip = self.grip.map_or(0.0, |_| 2.0 * (f.torsional_stiffness * (f.inertia + self.added_inertia)).sqrt());
        rate(f.axial_damping, 2.0 * f.axial_stiffness, f.mass).max(rate(
            f.torsional_damping + grip,
            torsional,
            f.inertia + self.added_inertia,
        ))
    }

    /// Equilibrium (extension, angle) at `pressure` near the present state, with the sliders where they stand;
    /// none if there is none within the stops. Newton's method with step halving.
    fn equilibrium(&self, pressure: f64) -> Option<(f64, f64)> {
        let f = &self.free;
        let (scale_f, scale_m) = (f.axial_stiffness * f.length, f.torsional_stiffness);
        let size = |(a, b): (f64, f64)| (a / scale_f).hypot(b / scale_m);
        let (mut s, mut angle) = (self.state[0], self.state[2]);
        let mut residual = self.balance(s, angle, pressure);
        for _ in 0..60 {
            if size(residual) < 1e-12 {
                let inside = |x: f64, (a, b): (f64, f64)| x > a && x < b;
                return (inside(s, self.extension_stops) && inside(angle, self.angle_stops)).then_some((s, angle));
            }
            let (hs, ha) = (1e-6 * f.length, 1e-6);
            let slope = |hs: f64, ha: f64, h: f64| {
                let (a, b) = (self.balance(s + hs, angle + ha, pressure), self.balance(s - hs, angle - ha, pressure));
                ((a.0 - b.0) / (2.0 * h), (a.1 - b.1) / (2.0 * h))
            };
            let ((ss, as_), (sa, aa)) = (slope(hs, 0.0, hs), slope(0.0, ha, ha));
            let determinant = ss * aa - sa * as_;
            let ds = (sa * residual.1 - aa * residual.0) / determinant;
            let da = (as_ * residual.0 - ss * residual.1) / determinant;
            let mut share = 1.0;
            loop {
                let next = self.balance(s + share * ds, angle + share * da, pressure);
                if size(next) < size(residual) || share < 1e-4 {
                    (s, angle, residual) = (s + share * ds, angle + share * da, next);
                    break;
                }
                share *= 0.5;
            }
        }
        None
    }

    /// Width of the second quasi-static cycle of `top` pascals, and its range of angle, rad.
    fn loop_width(mut self, top: f64) -> Option<(f64, f64)> {
        let n = CYCLE_STEPS;
        let mut angles = Vec::with_capacity(4 * n as usize + 1);
        for i in 0..=4 * n {
            let up = i % (2 * n);
            let pressure = top * f64::from(up.min(2 * n - up)) / f64::from(n);
            let (s, angle) = self.equilibrium(pressure)?;
            self.state = [s, 0.0, angle, 0.0];
            self.friction.advance(angle);
            angles.push(angle);
        }
        let second = &angles[2 * n as usize..];
        let (low, high) = second.iter().fold((f64::MAX, f64::MIN), |(a, b), &x| (a.min(x), b.max(x)));
        let width = (0..=n as usize).map(|i| (second[2 * n as usize - i] - second[i]).abs()).fold(0.0, f64::max);
        Some((width, high - low))
    }
}

/// Keeps `position` within `stops`; what runs into one comes to rest.
fn clip(position: &mut f64, velocity: &mut f64, stops: (f64, f64)) -> bool {
    // A state that is no number can only come from outside (a pressure that is none): rest at the origin.
    if !(position.is_finite() && velocity.is_finite()) {
        (*position, *velocity) = (0.0, 0.0);
        return true;
    }
    let clipped = position.clamp(stops.0, stops.1);
    if clipped == *position {
        return false;
    }
    (*position, *velocity) = (clipped, 0.0);
    true
}

/// The friction with which the loop of a quasi-static 0-7 psi cycle is `width` of its range wide. Where 7 psi is
/// beyond the FREE's domain, the largest cycle within it counts.
pub fn loop_friction(free: &Free, load: f64, width: f64) -> MaxwellSlip {
    let none = MaxwellSlip::new(0.0, 1.0);
    let tip = |friction: MaxwellSlip| Tip::new(*free, friction, load);
    let cycle = (0..8).map(|i| CYCLE_TOP * 0.75f64.powi(i)).find_map(|top| {
        let (_, range) = tip(none.clone()).loop_width(top)?;
        Some((top, range))
    });
    let (Some((top, range)), true) = (cycle, width > 0.0) else { return none };
    let reach = REACH * range;
    // The width grows with the moment: bracket it, then bisect.
    let too_narrow = |moment: f64| {
        let cycle = tip(MaxwellSlip::new(moment, reach)).loop_width(top);
        cycle.is_some_and(|(w, range)| w < width * range)
    };
    let unit = range * free.torsional_stiffness;
    let (mut low, mut high) = (0.0, width * unit);
    while too_narrow(high) && high < unit {
        (low, high) = (high, 2.0 * high);
    }
    for _ in 0..24 {
        let middle = 0.5 * (low + high);
        if too_narrow(middle) { low = middle } else { high = middle }
    }
    MaxwellSlip::new(0.5 * (low + high), reach)
}
