//! The interlocks: from readings, estimate and command to the faults of the matrix ([`super::fault::MATRIX`]).
//!
//! They judge the *age* of a reading and never wait for one. Age counts from the reading's own time or from its
//! arrival in the tick, whichever is earlier, so that neither a frozen time stamp nor one from the future hides a
//! silent device; time in which the loop itself stood still (up to [`STALL_MAX`]) is no silence of the device.
//! A debounce "n samples" counts readings. A debounce in seconds counts from the latest reading that was still good:
//! what the next one shows may have begun right after it.

use std::time::Duration;

use crate::clock::Time;
use crate::signal::{
    Estimate, FaultCode, FaultSet, FreeTick, ImuHealth, ImuSample, PressureSample, Quantity, Reference,
    RegulatorHealth, RegulatorStatus,
};

use super::estimator::Reading;
use super::fault::Reaction;
use super::{FreeControl, ImuChannel, Limits, RegulatorChannel};

/// overpressure_soft: s above p_warn.
pub const SOFT_DEBOUNCE: f64 = 0.1;
/// supply_low: s that the pressure switch says so.
pub const SUPPLY_DEBOUNCE: f64 = 0.5;
/// pressure_sensor_range, imu_implausible: readings in a row.
pub const SAMPLES_DEBOUNCE: u32 = 3;
/// Device periods after which a device is stale.
pub const STALE_PERIODS: f64 = 3.0;
/// Device periods after which the pressure is taken to have grown as fast as it can since.
pub const GROWTH_PERIODS: f64 = 1.5;
/// Age of the last good IMU reading from which a hold becomes a ramp, s.
pub const IMU_RAMP_AGE: f64 = 0.2;
/// pressure_not_following: s outside the tolerance, in sum.
pub const FOLLOW_BUDGET: f64 = 1.0;
/// pressure_not_following: tolerance as a share of the full scale, but at least [`FOLLOW_TOLERANCE_MIN`].
pub const FOLLOW_TOLERANCE: f64 = 0.03;
/// Least tolerance, Pa (0.3 psi: an analogue regulator's hysteresis).
pub const FOLLOW_TOLERANCE_MIN: f64 = 2068.0;
/// How far outside 0..full scale a pressure reading may lie, as a share of the full scale.
pub const RANGE_MARGIN: f64 = 0.02;
/// client_lost: s without a heartbeat.
pub const HEARTBEAT_MAX: f64 = 1.5;
/// deadline: stalls among the last 100 ticks to warn.
pub const LATE_WARN: u32 = 5;
/// deadline: stalls among the last 100 ticks to ramp down.
pub const LATE_RAMP: u32 = 20;
/// Longest stall of the loop that is taken off an age, s.
pub const STALL_MAX: f64 = 0.1;

/// The faults of a tick by what is to be done about them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// Every fault whose condition holds, after debounce.
    pub faults: FaultSet,
    /// Those that ask for more than a warning.
    pub blocking: FaultSet,
    /// Those that ask for a ramp or a vent, and latch.
    pub latching: FaultSet,
    /// The strongest reaction asked for.
    pub reaction: Reaction,
}

impl Verdict {
    /// Adds a fault with the reaction it asks for now.
    pub fn add(&mut self, code: FaultCode, reaction: Reaction) {
        self.faults.insert(code);
        if reaction >= Reaction::Hold {
            self.blocking.insert(code);
        }
        if reaction.latches() {
            self.latching.insert(code);
        }
        self.reaction = self.reaction.max(reaction);
    }

    /// Both verdicts together.
    pub fn merge(self, other: Verdict) -> Verdict {
        Verdict {
            faults: self.faults.union(other.faults),
            blocking: self.blocking.union(other.blocking),
            latching: self.latching.union(other.latching),
            reaction: self.reaction.max(other.reaction),
        }
    }
}

/// Whether a FREE counts as vented.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Vented {
    /// p < p_zero, or nothing measures the pressure and the regulator takes its commands.
    Yes,
    /// p >= p_zero.
    No,
    /// There is no fresh reading.
    #[default]
    Unknown,
}

/// Freshness of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Freshness {
    sequence: u32,
    taken: Option<Time>,
    stalled: f64,
}

impl Freshness {
    /// Takes note of a tick; true if a new reading arrived. The same reading may turn out to be worth less than was
    /// thought: it is as old as the oldest thing that is known of it.
    fn see(&mut self, sequence: u32, time: Time, alive: bool, now: Time, stall: f64) -> bool {
        self.stalled = (self.stalled + stall).min(STALL_MAX);
        let fresh = alive && (self.taken.is_none() || sequence != self.sequence);
        if fresh {
            *self = Self { sequence, taken: Some(time.min(now)), stalled: 0.0 };
        } else if alive {
            self.taken = self.taken.map(|taken| taken.min(time));
        }
        fresh
    }

    /// Age in s; `None` before the first reading.
    fn age(&self, now: Time) -> Option<f64> {
        self.taken.map(|taken| now.seconds_since(taken))
    }

    /// Age in s without the loop's own stalls; `None` before the first reading.
    fn silence(&self, now: Time) -> Option<f64> {
        self.age(now).map(|age| age - self.stalled)
    }
}

/// Whether the pressure goes where it is commanded: a budget of time outside a tolerance band round the expected
/// pressure, given back by time inside it (at half the rate) and by every approach.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Following {
    expected: Option<f64>,
    /// Time of the latest reading within the tolerance.
    good: Option<Time>,
    spent: f64,
    mark: Option<(f64, f64)>,
}

/// pressure_not_following: how far the pressure of `regulator` may be from the expected one, Pa.
pub fn follow_tolerance(regulator: &RegulatorChannel) -> f64 {
    (FOLLOW_TOLERANCE * regulator.full_scale).max(FOLLOW_TOLERANCE_MIN)
}

impl Following {
    /// One tick at `now`, with the latest `pressure`, Pa, read at `taken`.
    fn step(
        &mut self,
        regulator: &RegulatorChannel,
        (pressure, taken): (f64, Time),
        command: f64,
        (now, dt): (Time, f64),
    ) -> bool {
        let lag = (regulator.lag + regulator.dead_time + regulator.period).as_secs_f64().max(dt);
        let expected = self.expected.unwrap_or(pressure);
        let reach = (regulator.fastest_fill * dt).max(0.0);
        let expected = expected + ((command - expected) * dt / lag).max(-reach).min(reach);
        self.expected = Some(expected);
        let tolerance = follow_tolerance(regulator);
        let error = (pressure - expected).abs();
        if error <= tolerance {
            self.spent = (self.spent - 0.5 * dt).max(0.0);
            self.mark = None;
            self.good = Some(taken.min(now));
            return self.spent >= FOLLOW_BUDGET;
        }
        // Of the time before this reading arrived, nobody knows how much was good.
        let unseen = self
            .good
            .take()
            .map_or(0.0, |good| now.seconds_since(good).min(GROWTH_PERIODS * regulator.period.as_secs_f64()));
        self.spent = (self.spent + dt.max(unseen)).min(2.0 * FOLLOW_BUDGET);
        let (marked_pressure, marked_error) = match self.mark {
            Some(mark) if mark.1 >= error => mark,
            _ => *self.mark.insert((pressure, error)),
        };
        // An approach: since the gap was widest, the pressure itself has moved towards the expected one and the gap
        // has narrowed by as much.
        // A stuck reading fails the first, a leak under a moving command the second.
        let moved = (pressure - marked_pressure) * (expected - pressure).signum();
        let enough = 0.5 * tolerance;
        if moved >= enough && marked_error - error >= enough {
            self.spent = 0.0;
            self.mark = Some((pressure, error));
        }
        self.spent >= FOLLOW_BUDGET
    }
}

/// What the interlocks of one FREE look at in one tick.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// Nominal time of the tick.
    pub now: Time,
    /// Time since the tick before, s.
    pub dt: f64,
    /// How much of it the loop stood still, s.
    pub stall: f64,
    /// Latest IMU reading.
    pub imu: &'a ImuSample,
    /// What the estimator did with it.
    pub reading: Reading,
    /// What the estimator believes.
    pub estimate: &'a Estimate,
    /// Latest regulator reading.
    pub pressure: &'a PressureSample,
    /// The command of the tick before, Pa.
    pub command: f64,
    /// What is asked now; nothing outside a program.
    pub reference: &'a Reference,
    /// Armed: a regulator that holds or exhausts by itself is a fault then.
    pub armed: bool,
    /// The angle has been tared and the session is not over: its envelope counts.
    pub session: bool,
}

/// The interlocks of one FREE.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeInterlocks {
    limits: Limits,
    regulator: RegulatorChannel,
    imu: Option<ImuChannel>,
    pressure: Freshness,
    readings: Freshness,
    /// Accepted IMU readings only.
    accepted: Freshness,
    vented: Vented,
    /// Time of the latest reading below p_warn.
    below_warn: Option<Time>,
    above_warn: Option<Time>,
    out_of_range: u32,
    implausible: u32,
    /// What the IMU is waited for, until a good reading is back.
    imu_gone: Option<FaultCode>,
    following: Following,
    off_reference: Option<Time>,
}

impl FreeInterlocks {
    /// The interlocks of `free`, nothing seen yet.
    pub fn new(free: &FreeControl) -> Self {
        Self {
            limits: free.limits,
            regulator: free.regulator,
            imu: free.imu,
            pressure: Freshness::default(),
            readings: Freshness::default(),
            accepted: Freshness::default(),
            vented: Vented::Unknown,
            below_warn: None,
            above_warn: None,
            out_of_range: 0,
            implausible: 0,
            imu_gone: None,
            following: Following::default(),
            off_reference: None,
        }
    }

    /// Takes the devices' ages over from a recorded tick; debounces start anew.
    pub fn resume(&mut self, recorded: &FreeTick, now: Time) {
        let at = |sequence: u32, taken: Time| Freshness { sequence, taken: Some(taken.min(now)), stalled: 0.0 };
        let (imu, pressure) = (&recorded.imu, &recorded.pressure);
        if pressure.health != RegulatorHealth::Absent {
            self.pressure = at(pressure.sequence, pressure.time);
        }
        if recorded.estimate.valid {
            self.readings = at(imu.sequence, imu.time);
            self.accepted = at(imu.sequence, imu.time);
        }
    }

    /// Whether every device has been heard of, and is still being heard.
    pub fn complete(&self, now: Time) -> bool {
        self.pressure_fresh(now) && self.imu_fresh(now)
    }

    /// Whether the pressure was below p_zero at the latest tick.
    pub fn vented(&self) -> Vented {
        self.vented
    }

    /// Whether the regulator has been heard of recently.
    pub fn pressure_fresh(&self, now: Time) -> bool {
        self.pressure.silence(now).is_some_and(|age| !over(age, STALE_PERIODS * self.regulator.period.as_secs_f64()))
    }

    /// Whether the IMU has given a good reading recently; true where there is none.
    pub fn imu_fresh(&self, now: Time) -> bool {
        self.imu.is_none_or(|imu| {
            self.accepted.silence(now).is_some_and(|age| !over(age, STALE_PERIODS * imu.period.as_secs_f64()))
        })
    }

    /// One tick.
    pub fn step(&mut self, seen: &Seen) -> Verdict {
        let mut verdict = Verdict::default();
        self.judge_pressure(seen, &mut verdict);
        self.judge_imu(seen, &mut verdict);
        self.judge_angle(seen, &mut verdict);
        verdict
    }

    fn judge_pressure(&mut self, seen: &Seen, verdict: &mut Verdict) {
        let Seen { now, pressure: sample, .. } = *seen;
        let alive = matches!(sample.health, RegulatorHealth::Good | RegulatorHealth::Unmeasured);
        let fresh = self.pressure.see(sample.sequence, sample.time, alive, now, seen.stall);
        if sample.health == RegulatorHealth::Lost {
            verdict.add(FaultCode::BusLost, Reaction::Vent);
        }
        let period = self.regulator.period.as_secs_f64();
        let stale = self.pressure.silence(now).is_some_and(|age| over(age, STALE_PERIODS * period));
        if stale {
            verdict.add(FaultCode::PressureStale, Reaction::Vent);
        }
        if self.pressure.taken.is_none() {
            return;
        }
        self.judge_status(seen, verdict);
        if !self.regulator.measures {
            // What it was told last is all that is known of it; when it cannot be told any more, nothing is.
            self.vented = if stale || !alive { Vented::Unknown } else { Vented::Yes };
            return;
        }
        let p = if sample.health == RegulatorHealth::Good { sample.pressure } else { f64::NAN };
        let margin = RANGE_MARGIN * self.regulator.full_scale;
        let in_range = p >= -margin && p <= self.regulator.full_scale + margin;
        if alive {
            let off = !in_range || sample.status.intersects(RegulatorStatus::PRESSURE_OVER_RANGE);
            if fresh {
                self.out_of_range = if off { self.out_of_range.saturating_add(1) } else { 0 };
            }
            if self.out_of_range >= SAMPLES_DEBOUNCE {
                verdict.add(FaultCode::PressureSensorRange, Reaction::Vent);
            }
            if p > self.limits.pressure_hard {
                verdict.add(FaultCode::OverpressureHard, Reaction::Vent);
            }
            if p > self.limits.pressure_warn {
                let unseen = Duration::from_secs_f64(GROWTH_PERIODS * period);
                let since = self.below_warn.map_or(now, |below| below.max(now - unseen));
                let since = *self.above_warn.get_or_insert(since);
                if reached(now.seconds_since(since), SOFT_DEBOUNCE) {
                    verdict.add(FaultCode::OverpressureSoft, Reaction::Ramp);
                }
            } else if p <= self.limits.pressure_warn {
                (self.above_warn, self.below_warn) = (None, Some(sample.time.min(now)));
            }
            if let Some(age) = self.pressure.age(now)
                && over(age, GROWTH_PERIODS * period)
                && p + age * self.regulator.fastest_fill > self.limits.pressure_hard
            {
                verdict.add(FaultCode::PressureStale, Reaction::Vent);
            }
        }
        if p.is_finite() && self.following.step(&self.regulator, (p, sample.time), seen.command, (now, seen.dt)) {
            verdict.add(FaultCode::PressureNotFollowing, Reaction::Vent);
        }
        self.vented = if stale || !alive || !in_range {
            Vented::Unknown
        } else if p < self.limits.pressure_zero {
            Vented::Yes
        } else {
            Vented::No
        };
    }

    fn judge_status(&self, seen: &Seen, verdict: &mut Verdict) {
        let always = RegulatorStatus::CONVERTER_FAILED
            .with(RegulatorStatus::OVERPRESSURE_LIMIT)
            .with(RegulatorStatus::ECHO_MISMATCH)
            .with(RegulatorStatus::REJECTED)
            .with(RegulatorStatus::ANALOG_SOURCE);
        let armed = RegulatorStatus::HELD.with(RegulatorStatus::EXHAUSTING);
        let status = seen.pressure.status;
        if status.intersects(always) || (seen.armed && status.intersects(armed)) {
            verdict.add(FaultCode::RegulatorStatus, Reaction::Ramp);
        }
    }

    fn judge_imu(&mut self, seen: &Seen, verdict: &mut Verdict) {
        let Some(imu) = self.imu else { return };
        let Seen { now, imu: sample, .. } = *seen;
        let arrived = seen.reading != Reading::None;
        let accepted = seen.reading == Reading::Accepted;
        self.readings.see(sample.sequence, now, arrived, now, seen.stall);
        self.accepted.see(sample.sequence, sample.time, accepted, now, seen.stall);
        match seen.reading {
            Reading::Accepted => self.implausible = 0,
            Reading::Refused => self.implausible = self.implausible.saturating_add(1),
            Reading::None => {}
        }
        if sample.health == ImuHealth::Lost {
            verdict.add(FaultCode::BusLost, Reaction::Vent);
        }
        let Some(age) = self.accepted.silence(now) else { return };
        let reaction = if over(age, IMU_RAMP_AGE) { Reaction::Ramp } else { Reaction::Hold };
        if accepted {
            self.imu_gone = None;
        }
        // Only a good reading ends it: an IMU that stops being silent and begins to restart is not back.
        let stale = self.readings.silence(now).is_some_and(|s| over(s, STALE_PERIODS * imu.period.as_secs_f64()));
        if stale {
            self.imu_gone.get_or_insert(FaultCode::ImuStale);
        }
        if self.implausible >= SAMPLES_DEBOUNCE {
            self.imu_gone.get_or_insert(FaultCode::ImuImplausible);
            verdict.add(FaultCode::ImuImplausible, reaction);
        }
        if let Some(code) = self.imu_gone {
            verdict.add(code, reaction);
        }
    }

    fn judge_angle(&mut self, seen: &Seen, verdict: &mut Verdict) {
        let Seen { now, estimate, reference, .. } = *seen;
        let outside = |(lowest, highest): (f64, f64)| {
            estimate.valid && !(estimate.measured_angle >= lowest && estimate.measured_angle <= highest)
        };
        if seen.session && outside(self.limits.angle_hard) {
            verdict.add(FaultCode::AngleLimit, Reaction::Vent);
        } else if seen.session && outside(self.limits.angle_soft) {
            verdict.add(FaultCode::AngleLimit, Reaction::Ramp);
        }
        let (largest, time) = self.limits.tracking_error;
        let error = (reference.position - estimate.angle).abs();
        if seen.armed && reference.quantity == Quantity::Angle && (error > largest || error.is_nan()) {
            let since = *self.off_reference.get_or_insert(now);
            if reached(now.seconds_since(since), time) {
                verdict.add(FaultCode::TrackingError, Reaction::Ramp);
            }
        } else {
            self.off_reference = None;
        }
    }
}

/// Whether `time` is more than `limit`, to the nanosecond (both in s, each rounded on its own).
fn over(time: f64, limit: f64) -> bool {
    time > limit + 0.5e-9
}

/// Whether `time` has come up to `limit`, to the nanosecond.
pub(super) fn reached(time: f64, limit: f64) -> bool {
    time >= limit - 0.5e-9
}

/// Late ticks: one bit a tick, set where a stall begins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LateTicks {
    window: u128,
    late: bool,
    skipped: u64,
}

impl LateTicks {
    /// One tick: its own latency, the execution time of the one before, periods skipped so far. A tick is late that
    /// woke up more than half a period after its deadline, or follows one that overran the period.
    pub fn step(&mut self, latency_ns: u32, execution_ns: u32, skipped: u64, period_ns: u64) {
        let late =
            u64::from(latency_ns) > period_ns / 2 || u64::from(execution_ns) > period_ns || skipped > self.skipped;
        self.window = (self.window << 1 | u128::from(late && !self.late)) & ((1 << 100) - 1);
        self.late = late;
        self.skipped = skipped;
    }

    /// No late tick, with so many periods skipped before.
    pub fn after(skipped: u64) -> Self {
        Self { skipped, ..Self::default() }
    }

    /// Stalls among the last 100 ticks.
    pub fn count(&self) -> u32 {
        self.window.count_ones()
    }

    /// What the count asks for.
    pub fn reaction(&self) -> Reaction {
        match self.count() {
            LATE_RAMP.. => Reaction::Ramp,
            LATE_WARN.. => Reaction::Warn,
            _ => Reaction::None,
        }
    }
}
