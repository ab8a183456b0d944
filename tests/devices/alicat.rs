//! The Alicat driver and its bus owner against simulated units: in memory on the stepped clock, and on a real
//! pseudo-terminal.

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use freerig::clock::{Clock, Stepper, Time};
use freerig::hardware::alicat::{AlicatError, SourceQuery, Unit};
use freerig::hardware::alicat_frame::FrameError;
use freerig::hardware::serial_line::{Line, LineError, LineStatistics};
use freerig::hardware::serial_owner::{SerialOwner, SerialStatistics};
use freerig::hardware::wiring::{SerialWiring, UnitWiring};
use freerig::hardware::{HardwareError, PressureRegulator, serial};
use freerig::model::Free;
use freerig::signal::{Command, PressureSample, RegulatorHealth, RegulatorStatus};
use freerig::sim::chips::{AlicatChip, MemoryStream, Misbehaviour, Mischief, Pty, SerialLine};
use freerig::sim::{BenchConfig, ImuSim, Plant, PlantSim, RegulatorSim};
use freerig::units::PASCAL_PER_PSI;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use triple_buffer::{Input, Output, triple_buffer};

const PSI: f64 = PASCAL_PER_PSI;
const BAUD: u32 = 19_200;

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

fn wiring(units: usize) -> SerialWiring {
    SerialWiring {
        name: "regulators".into(),
        device: PathBuf::from("/dev/simulated"),
        baud: BAUD,
        units: (0..units)
            .map(|free| UnitWiring {
                free,
                gauge: false,
                id: b'A' + free as u8,
                full_scale: 15.0 * PSI,
                pascals_per_unit: PSI,
            })
            .collect(),
        pwms: Vec::new(),
    }
}

/// What went over a line, by the computer's view.
type Transcript = Arc<Mutex<Vec<(Time, String)>>>;

/// Writes down what passes.
struct Tap<S> {
    inner: S,
    clock: Clock,
    transcript: Transcript,
}

impl<S> Tap<S> {
    fn note(&self, direction: char, bytes: &[u8]) {
        let text = format!("{direction} {}", bytes.escape_ascii());
        self.transcript.lock().unwrap().push((self.clock.now(), text));
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Tap<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let polled = Pin::new(&mut self.inner).poll_read(cx, buf);
        if buf.filled().len() > before {
            self.note('<', &buf.filled()[before..]);
        }
        polled
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Tap<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.note('>', bytes);
        Pin::new(&mut self.inner).poll_write(cx, bytes)
    }
    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(cx)
    }
    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(cx)
    }
}

/// Units on a simulated line, each feeding a FREE of a simulated plant.
struct Bench {
    stepper: Stepper,
    plant: Arc<Mutex<Plant>>,
    line: Arc<Mutex<SerialLine>>,
    mischief: Vec<Mischief>,
    transcript: Transcript,
}

impl Bench {
    fn new(units: usize) -> Self {
        let regulator =
            RegulatorSim { lag: ms(60), dead_time: ms(20), slew: 100.0 * PSI, noise: 0.0, full_scale: 15.0 * PSI };
        let nominal = Free::published_code();
        let sim = PlantSim {
            nominal,
            scatter: 0.0,
            hysteresis: 0.0,
            load_moment: 0.0,
            knob: None,
            regulator,
            analogue: None,
        };
        let imu = ImuSim { delay: Duration::ZERO, noise: 0.0, rate_noise: 0.0 };
        let config =
            BenchConfig { seed: 1, plants: vec![sim; units], module: None, imu, dump_valve: false, one_shot: false };
        let plant = Arc::new(Mutex::new(Plant::new(&config)));
        let mut line = SerialLine::new(BAUD, 1);
        let mischief = wiring(units).units.iter().map(|u| line.attach(AlicatChip::new(*u, plant.clone()))).collect();
        let line = Arc::new(Mutex::new(line));
        Self { stepper: Stepper::new(), plant, line, mischief, transcript: Arc::default() }
    }

    fn open(&self) -> Tap<MemoryStream> {
        let clock = self.stepper.clock();
        let inner = MemoryStream::open(&self.line, clock.clone()).unwrap();
        Tap { inner, clock, transcript: self.transcript.clone() }
    }

    fn line(&self) -> Line<Tap<MemoryStream>> {
        Line::new(self.open(), self.stepper.clock(), BAUD, Arc::new(LineStatistics::default()))
    }

    /// Polls `future` to its end, moving the time whenever it waits.
    fn drive<T>(&self, future: impl Future<Output = T>) -> T {
        let mut future = Box::pin(future);
        loop {
            if let Poll::Ready(done) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                return done;
            }
            self.stepper.advance_to(self.stepper.next_timer().expect("waits for nothing"));
        }
    }

    fn connected(&self, line: &mut Line<Tap<MemoryStream>>) -> Unit {
        let mut unit = Unit::new(wiring(1).units[0], "the line").unwrap();
        self.drive(unit.on(line).identify()).unwrap();
        self.transcript.lock().unwrap().clear();
        unit
    }

    fn said(&self) -> Vec<String> {
        self.transcript.lock().unwrap().drain(..).map(|t| t.1).collect()
    }
}

#[test]
fn the_wire_carries_what_the_manual_says() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = Unit::new(wiring(1).units[0], "the line").unwrap();
    let identity = bench.drive(unit.on(&mut line).connect()).unwrap();
    assert_eq!(identity.device, "Alicat unit A on the line");
    let said = bench.said();
    // The list comes in portions; here it is one text.
    let list: String = said[3..said.len() - 4].iter().map(|s| s.strip_prefix("< ").unwrap()).collect();
    assert_eq!(said[..3], [r"> AS0.0000\r", r"< A +00.000 +00.000\r", r"> A??D*\r"]);
    assert!(list.contains(r"A D02 006 Gauge Press                s decimal     7/3 010 03 PSIG\r"), "{list}");
    assert_eq!(
        said[said.len() - 4..],
        [r"> A$$R20\r", r"< A   020 = 00512\r", r"> AS0.0000\r", r"< A +00.000 +00.000\r"]
    );
    let sample = bench.drive(unit.on(&mut line).exchange(5.0 * PSI)).unwrap();
    assert_eq!(bench.said(), [r"> AS5.0000\r", r"< A +00.000 +05.000\r"]);
    assert!((sample.setpoint - 5.0 * PSI).abs() < 1e-9 && sample.pressure == 0.0);
    assert_eq!((sample.health, sample.status), (RegulatorHealth::Good, RegulatorStatus::default()));
    // A third of a hundredth is sent as it is.
    let sample = bench.drive(unit.on(&mut line).write(1.2345 * PSI)).unwrap();
    assert_eq!(sample.status, RegulatorStatus::default(), "the echo +01.234 is the same set-point");
    bench.drive(unit.on(&mut line).poll()).unwrap();
    bench.drive(unit.on(&mut line).hold_closed()).unwrap();
    bench.drive(unit.on(&mut line).cancel()).unwrap();
    bench.drive(unit.on(&mut line).exhaust()).unwrap();
    let said: Vec<_> = bench.said().into_iter().filter(|s| s.starts_with('>')).collect();
    assert_eq!(said, [r"> AS1.2345\r", r"> A\r", r"> AHC\r", r"> AC\r", r"> AE\r"]);
}

#[test]
fn hold_and_exhaust_show_in_the_status_and_cancel_ends_them() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    let held = bench.drive(unit.on(&mut line).hold_closed()).unwrap();
    assert_eq!(held.status, RegulatorStatus::HELD);
    assert_eq!(bench.drive(unit.on(&mut line).cancel()).unwrap().status, RegulatorStatus::default());
    assert_eq!(bench.drive(unit.on(&mut line).exhaust()).unwrap().status, RegulatorStatus::EXHAUSTING);
    bench.drive(unit.on(&mut line).cancel()).unwrap();
    // Tare only when vented.
    bench.drive(unit.on(&mut line).write(5.0 * PSI)).unwrap();
    bench.drive(bench.stepper.clock().sleep(ms(500)));
    let refused = bench.drive(unit.on(&mut line).tare(0.2 * PSI)).unwrap_err();
    assert!(matches!(refused, AlicatError::NotVented(p) if p > 4.0 * PSI), "{refused}");
}

#[test]
fn a_transaction_takes_sixteen_milliseconds_at_19200_baud() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    bench.drive(unit.on(&mut line).write(PSI)).unwrap();
    let before = bench.stepper.now();
    for _ in 0..10 {
        bench.drive(unit.on(&mut line).write(PSI)).unwrap();
    }
    let each = bench.stepper.now().seconds_since(before) / 10.0;
    // 9 bytes out, 18 back and 3.5 of idleness, 0.52 ms each.
    assert!((each - 16e-3).abs() < 0.2e-3, "{each}");
}

#[test]
fn set_points_that_no_unit_may_be_sent_are_not_sent() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    for wrong in [-1.0, 15.001 * PSI, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let error = bench.drive(unit.on(&mut line).write(wrong)).unwrap_err();
        assert!(matches!(error, AlicatError::Setpoint(..)), "{error}");
    }
    assert!(bench.said().is_empty());
    bench.drive(unit.on(&mut line).write(-0.0)).unwrap();
    assert_eq!(bench.said()[0], r"> AS0.0000\r");
    for id in [b'a', b'1', b'*', b'\r', b'@'] {
        assert!(Unit::new(UnitWiring { id, ..wiring(1).units[0] }, "the line").is_none());
    }
}

#[test]
fn a_unit_that_listens_to_its_analogue_input_is_found_out() {
    for query in [SourceQuery::Register, SourceQuery::Command] {
        let bench = Bench::new(1);
        bench.line.lock().unwrap().unit(b'A').unwrap().analog = true;
        let mut line = bench.line();
        let mut unit = Unit::new(wiring(1).units[0], "the line").unwrap().with_source_query(query);
        let sample = bench.drive(unit.on(&mut line).identify()).unwrap();
        assert!(unit.is_analog() && sample.status.contains(RegulatorStatus::ANALOG_SOURCE), "{query:?}");
        let sample = bench.drive(unit.on(&mut line).write(PSI)).unwrap();
        let both = RegulatorStatus::ANALOG_SOURCE.with(RegulatorStatus::ECHO_MISMATCH);
        assert!(sample.status.contains(both), "the echo shows it as well");
        assert_eq!(line.statistics().echo_mismatches.get(), 1);
        bench.line.lock().unwrap().unit(b'A').unwrap().analog = false;
        bench.drive(unit.on(&mut line).check_source()).unwrap();
        assert_eq!(bench.drive(unit.on(&mut line).write(PSI)).unwrap().status, RegulatorStatus::default());
    }
}

#[test]
fn older_firmware_that_lists_no_columns_has_the_two_of_the_factory() {
    let bench = Bench::new(1);
    bench.line.lock().unwrap().unit(b'A').unwrap().lists_columns = false;
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    assert_eq!(bench.drive(unit.on(&mut line).write(PSI)).unwrap().status, RegulatorStatus::default());
}

#[test]
fn a_unit_that_counts_in_other_units_is_refused() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let kilopascal = UnitWiring { pascals_per_unit: 1e3, ..wiring(1).units[0] };
    let mut unit = Unit::new(kilopascal, "the line").unwrap();
    let error = bench.drive(unit.on(&mut line).connect()).unwrap_err();
    assert!(matches!(&error, HardwareError::Unsafe { reason, .. } if reason.contains("PSIG")), "{error}");
}

#[test]
fn a_token_that_nobody_knows_is_a_warning_carried_verbatim() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    bench.line.lock().unwrap().unit(b'A').unwrap().tokens = "LCK QQQ".into();
    let sample = bench.drive(unit.on(&mut line).write(PSI)).unwrap();
    assert_eq!(sample.status, RegulatorStatus::LOCKED.with(RegulatorStatus::UNKNOWN_TOKEN));
    assert_eq!(line.statistics().unknown_tokens.get(), 1);
}

#[test]
fn every_misbehaviour_is_named_and_the_next_exchange_works() {
    let cases = [
        (Misbehaviour::Garbage, "malformed"),
        (Misbehaviour::BitFlip, "malformed"),
        (Misbehaviour::WrongId, "wrong id"),
        (Misbehaviour::Truncated, "timeout"),
        (Misbehaviour::Silent, "timeout"),
        (Misbehaviour::Late(ms(70)), "timeout"),
    ];
    for (how, expected) in cases {
        let bench = Bench::new(1);
        let mut line = bench.line();
        let mut unit = bench.connected(&mut line);
        bench.mischief[0].next(1, how);
        let error = bench.drive(unit.on(&mut line).write(PSI)).unwrap_err();
        let found = match &error {
            AlicatError::Line(LineError::TimedOut(_)) => "timeout",
            AlicatError::Frame(FrameError::WrongId { .. }) if how == Misbehaviour::WrongId => "wrong id",
            // One flipped bit of the CR takes the end of the line away.
            AlicatError::Frame(_) => "malformed",
            other => panic!("{how:?}: {other}"),
        };
        assert_eq!(found, expected, "{how:?}: {error}");
        assert!(error.at(unit.device()).is_transient(), "{error}");
        // At most one reply is sacrificed to get back in step.
        let next = match bench.drive(unit.on(&mut line).write(2.0 * PSI)) {
            Err(error) if error.line() == Some(&LineError::OutOfStep) => {
                bench.drive(unit.on(&mut line).write(2.0 * PSI))
            }
            other => other,
        };
        let next = next.unwrap_or_else(|e| panic!("{how:?}: {e}"));
        assert!((next.setpoint - 2.0 * PSI).abs() < 1e-9 && next.status == RegulatorStatus::default(), "{how:?}");
    }
}

#[test]
fn a_rejected_set_point_is_reported_with_a_reading() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    bench.mischief[0].next(1, Misbehaviour::Nak);
    let sample = bench.drive(unit.on(&mut line).write(PSI)).unwrap();
    assert_eq!((sample.status, sample.setpoint), (RegulatorStatus::REJECTED, 0.0));
    assert_eq!(bench.said(), [r"> AS1.0000\r", r"< ?\r", r"> A\r", r"< A +00.000 +00.000\r"]);
    assert_eq!(line.statistics().rejected.get(), 1);
}

#[test]
fn a_stuck_sensor_still_accepts_set_points() {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    bench.mischief[0].always(Misbehaviour::Stuck);
    for _ in 0..40 {
        let sample = bench.drive(unit.on(&mut line).write(5.0 * PSI)).unwrap();
        assert_eq!((sample.pressure, sample.status), (0.0, RegulatorStatus::default()));
    }
    assert!(bench.plant.lock().unwrap().pressure(0, bench.stepper.now()) > 4.9 * PSI);
    bench.mischief[0].stop();
    assert!(bench.drive(unit.on(&mut line).write(5.0 * PSI)).unwrap().pressure > 4.9 * PSI);
}

/// Whether some exchange got the reply of another one, over a run in which replies come late; and how many worked.
fn exchanges_with_late_replies(delay: u64, late: impl Fn(&Mischief, Misbehaviour)) -> (bool, u32) {
    let bench = Bench::new(1);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    late(&bench.mischief[0], Misbehaviour::Late(ms(delay)));
    let (mut mistaken, mut worked) = (false, 0);
    for i in 0..60u32 {
        // Every set-point differs from every other, so that the echo tells whose reply it was.
        let setpoint = f64::from(i + 1) * 0.1 * PSI;
        match bench.drive(unit.on(&mut line).write(setpoint)) {
            Ok(sample) => {
                worked += 1;
                mistaken |= sample.status.contains(RegulatorStatus::ECHO_MISMATCH);
            }
            Err(AlicatError::Line(LineError::TimedOut(_) | LineError::OutOfStep)) => {}
            Err(other) => panic!("{other}"),
        }
    }
    (mistaken, worked)
}

#[test]
fn a_late_reply_is_never_taken_for_the_next_one() {
    for delay in (0..640).step_by(7) {
        let (mistaken, worked) = exchanges_with_late_replies(delay, |m, how| m.next(1, how));
        assert!(!mistaken, "one reply late by {delay} ms");
        assert!(worked > 40, "one reply late by {delay} ms: {worked} exchanges worked");
        let (mistaken, _) = exchanges_with_late_replies(delay, |m, how| m.next(5, how));
        assert!(!mistaken, "five replies late by {delay} ms");
        let (mistaken, _) = exchanges_with_late_replies(delay, |m, how| m.always(how));
        assert!(!mistaken, "all replies late by {delay} ms");
    }
}

#[test]
fn another_units_late_reply_is_told_by_its_id() {
    let bench = Bench::new(2);
    let mut line = bench.line();
    let mut units: Vec<_> = wiring(2).units.iter().map(|u| Unit::new(*u, "the line").unwrap()).collect();
    for unit in &mut units {
        bench.drive(unit.on(&mut line).identify()).unwrap();
    }
    // A's reply falls into B's exchange: B waits on for its own.
    bench.mischief[0].next(1, Misbehaviour::Late(ms(85)));
    bench.drive(units[0].on(&mut line).write(PSI)).unwrap_err();
    let sample = bench.drive(units[1].on(&mut line).write(2.0 * PSI)).unwrap();
    assert_eq!(sample.status, RegulatorStatus::default());
    assert_eq!(line.statistics().late_frames.get(), 1);
    // And A is in step again.
    assert_eq!(bench.drive(units[0].on(&mut line).write(PSI)).unwrap().status, RegulatorStatus::default());
}

/// A bus owner on the stepped clock.
struct Owner {
    bench: Bench,
    future: Pin<Box<dyn Future<Output = ()>>>,
    command: Input<Command>,
    samples: Vec<Output<PressureSample>>,
    statistics: Arc<SerialStatistics>,
    stop: Arc<AtomicBool>,
    done: bool,
}

impl Owner {
    fn new(units: usize) -> Self {
        Self::with_stream(units, |stream| stream)
    }

    /// An owner whose line is what `wrap` makes of it.
    fn with_stream<S, W>(units: usize, wrap: W) -> Self
    where
        S: AsyncRead + AsyncWrite + Unpin + 'static,
        W: Fn(Tap<MemoryStream>) -> S + 'static,
    {
        let bench = Bench::new(units);
        let (command, commands) = triple_buffer(&Command::default());
        let (publish, samples) = (0..units).map(|_| triple_buffer(&PressureSample::default())).unzip();
        let stop = Arc::new(AtomicBool::new(false));
        let (line, clock, transcript) = (bench.line.clone(), bench.stepper.clock(), bench.transcript.clone());
        let open = move || {
            let opened = MemoryStream::open(&line, clock.clone())
                .map(|inner| wrap(Tap { inner, clock: clock.clone(), transcript: transcript.clone() }))
                .map_err(|e| HardwareError::Open {
                    device: "the line".into(),
                    reason: e.to_string(),
                    remedy: "Plug it in".into(),
                });
            std::future::ready(opened)
        };
        let clock = bench.stepper.clock();
        let owner = SerialOwner::new(&wiring(units), clock, ms(100), open, commands, publish, stop.clone()).unwrap();
        let statistics = owner.statistics();
        Self { bench, future: Box::pin(owner.run()), command, samples, statistics, stop, done: false }
    }

    /// Runs for `duration`, with the tick giving `pressure` (psi) every 2 ms where there is one.
    fn run(&mut self, duration: Duration, pressure: Option<f64>) {
        let stepper = self.bench.stepper.clone();
        let end = stepper.now() + duration;
        let mut tick = stepper.now();
        while stepper.now() < end && !self.done {
            if let Some(psi) = pressure
                && stepper.now() >= tick
            {
                self.command.write(Command { time: tick, pressure: [psi * PSI; 6], vent: false });
                tick = tick + ms(2);
            }
            self.done = self.future.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_ready();
            let next = stepper.next_timer().unwrap_or(end).min(end);
            stepper.advance_to(if pressure.is_some() { next.min(tick) } else { next });
        }
    }

    fn sample(&mut self, unit: usize) -> PressureSample {
        *self.samples[unit].read()
    }

    fn pressure(&self, free: usize) -> f64 {
        let now = self.bench.stepper.now();
        self.bench.plant.lock().unwrap().pressure(free, now)
    }
}

#[test]
fn the_owner_polls_its_units_in_turn() {
    let mut owner = Owner::new(4);
    owner.run(ms(2500), Some(5.0));
    for i in 0..4 {
        let sample = owner.sample(i);
        assert_eq!((sample.health, sample.status), (RegulatorHealth::Good, RegulatorStatus::default()), "{i}");
        assert!((sample.pressure - 5.0 * PSI).abs() < 0.01 * PSI, "{i}: {}", sample.pressure);
        // Four units on a 19200 baud line: 64 ms.
        assert!(owner.bench.stepper.now().since(sample.time) <= ms(66), "{i}");
    }
    let before: Vec<_> = (0..4).map(|i| owner.sample(i).sequence).collect();
    owner.run(ms(640), Some(5.0));
    for (i, before) in before.iter().enumerate() {
        assert!(owner.sample(i).sequence - before >= 9, "{i}");
    }
    assert_eq!(owner.statistics.line.timeouts.get(), 0);
}

#[test]
fn zero_goes_first_to_those_that_have_pressure() {
    let mut owner = Owner::new(4);
    owner.run(ms(2500), Some(5.0));
    owner.bench.transcript.lock().unwrap().clear();
    // The vent comes while some unit has its turn: after that exchange, only zeros, each unit once.
    owner.run(ms(80), Some(0.0));
    let said = owner.bench.said();
    let writes: Vec<_> = said.iter().filter(|s| s.starts_with('>')).collect();
    let zeros: Vec<_> = writes.iter().skip(usize::from(!writes[0].contains("S0.0"))).take(4).collect();
    assert!(zeros.iter().all(|w| w.contains("S0.0000")), "{writes:?}");
    let mut ids: Vec<_> = zeros.iter().map(|w| w.as_bytes()[2]).collect();
    ids.sort_unstable();
    assert_eq!(ids, *b"ABCD");
}

#[test]
fn a_command_that_is_no_longer_renewed_counts_as_zero() {
    let mut owner = Owner::new(1);
    owner.run(ms(1500), Some(5.0));
    assert!(owner.pressure(0) > 4.9 * PSI);
    // The tick is gone: 100 ms later the owner commands zero by itself.
    owner.run(ms(90), None);
    assert!(owner.sample(0).setpoint > 4.9 * PSI);
    owner.run(ms(60), None);
    assert_eq!(owner.sample(0).setpoint, 0.0);
    owner.run(ms(1000), None);
    assert!(owner.pressure(0) < 0.01 * PSI);
}

#[test]
fn a_silent_unit_is_lost_and_hears_zero_first_when_it_comes_back() {
    let mut owner = Owner::new(2);
    owner.run(ms(2000), Some(5.0));
    owner.bench.mischief[0].always(Misbehaviour::Silent);
    owner.run(ms(1000), Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Lost);
    assert_eq!(owner.sample(1).health, RegulatorHealth::Good, "the other one goes on");
    assert_eq!(owner.statistics.units[0].losses.get(), 1);
    let error = owner.statistics.units[0].last_error().unwrap().to_string();
    assert!(error.contains("Alicat unit A") && error.contains("does not answer"), "{error}");
    // While it is away it hears nothing but zero.
    owner.bench.transcript.lock().unwrap().clear();
    owner.run(ms(2000), Some(5.0));
    owner.bench.mischief[0].stop();
    owner.run(ms(2000), Some(5.0));
    let said = owner.bench.said();
    let to_a: Vec<_> = said.iter().filter(|s| s.starts_with("> A")).collect();
    let back = to_a.iter().position(|s| s.contains("??D*")).unwrap();
    assert!(to_a[..back].iter().all(|s| *s == r"> AS0.0000\r"), "{:?}", &to_a[..back]);
    assert_eq!(owner.sample(0).health, RegulatorHealth::Good);
    assert!((owner.sample(0).setpoint - 5.0 * PSI).abs() < 1.0, "and then what is commanded now");
    assert_eq!(owner.statistics.units[0].connects.get(), 2);
}

#[test]
fn an_unplugged_line_is_opened_again_and_zero_is_the_first_frame() {
    let mut owner = Owner::new(2);
    owner.run(ms(2000), Some(5.0));
    owner.bench.line.lock().unwrap().plug(false);
    owner.run(ms(1000), Some(5.0));
    for i in 0..2 {
        assert_eq!(owner.sample(i).health, RegulatorHealth::Lost);
    }
    owner.bench.transcript.lock().unwrap().clear();
    owner.bench.line.lock().unwrap().plug(true);
    owner.run(ms(1500), Some(5.0));
    let said = owner.bench.said();
    let writes: Vec<_> = said.iter().filter(|s| s.starts_with('>')).take(2).collect();
    assert_eq!(writes, [r"> AS0.0000\r", r"> BS0.0000\r"]);
    for i in 0..2 {
        assert_eq!(owner.sample(i).health, RegulatorHealth::Good);
    }
    assert_eq!(owner.statistics.line.reconnects.get(), 1);
}

#[test]
fn a_line_on_which_nobody_answers_is_opened_again_and_again() {
    let mut owner = Owner::new(1);
    owner.bench.mischief[0].always(Misbehaviour::Silent);
    owner.run(ms(5000), Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Lost);
    assert!(owner.statistics.line.reconnects.get() > 2);
    owner.bench.mischief[0].stop();
    owner.run(ms(2000), Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Good);
}

#[test]
fn the_owner_leaves_with_the_set_points_at_zero() {
    let mut owner = Owner::new(3);
    owner.run(ms(2500), Some(5.0));
    owner.stop.store(true, Ordering::Relaxed);
    owner.run(ms(200), Some(5.0));
    assert!(owner.done);
    let said = owner.bench.said();
    let last: Vec<_> = said.iter().rev().filter(|s| s.starts_with('>')).take(3).collect();
    assert_eq!(last, [r"> CS0.0000\r", r"> BS0.0000\r", r"> AS0.0000\r"]);
}

#[test]
fn the_same_run_twice_is_the_same_to_the_bit() {
    let run = || {
        let mut owner = Owner::new(3);
        owner.bench.mischief[1].next(4, Misbehaviour::Garbage);
        owner.run(ms(1500), Some(3.0));
        owner.bench.mischief[2].next(2, Misbehaviour::Late(ms(90)));
        owner.run(ms(1500), Some(6.0));
        let samples: Vec<_> = (0..3).map(|i| owner.sample(i)).collect();
        (owner.bench.said(), samples.iter().map(|s| (s.time, s.pressure.to_bits())).collect::<Vec<_>>())
    };
    assert_eq!(run(), run());
}

/// Waits, live, until `holds` does; the limit is generous, for a machine that stalls.
fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = std::time::Instant::now() + Duration::from_secs(30);
    while !holds() {
        assert!(std::time::Instant::now() < deadline, "waited for {what}");
        std::thread::sleep(ms(5));
    }
}

#[test]
fn the_same_driver_works_on_a_real_pseudo_terminal() {
    let bench = Bench::new(2);
    {
        let mut plant = bench.plant.lock().unwrap();
        *plant = plant.clone().starting_at(Clock::Live.now());
    }
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("usb-simulated");
    let mut pty = Pty::new(bench.line.clone(), &device, Arc::new(|| ())).unwrap();
    let wiring = SerialWiring { device: pty.path().to_owned(), ..wiring(2) };
    let (mut command, commands) = triple_buffer(&Command::default());
    let (publish, mut samples): (Vec<_>, Vec<_>) = (0..2).map(|_| triple_buffer(&PressureSample::default())).unzip();
    let stop = Arc::new(AtomicBool::new(false));
    let opened = wiring.clone();
    let open = move || std::future::ready(serial::open(&opened));
    let owner = SerialOwner::new(&wiring, Clock::Live, Duration::from_secs(60), open, commands, publish, stop.clone());
    let owner = owner.unwrap();
    let statistics = owner.statistics();
    let thread = serial::spawn("test", owner, || {}).unwrap();
    let mut tell = |psi: f64| command.write(Command { time: Clock::Live.now(), pressure: [psi * PSI; 6], vent: false });
    tell(4.0);
    wait_for("both units at 4 psi", || {
        samples.iter_mut().all(|s| {
            let s = *s.read();
            s.health == RegulatorHealth::Good && (s.pressure - 4.0 * PSI).abs() < 0.05 * PSI
        })
    });
    assert_eq!(statistics.line.malformed.get(), 0);
    // Unplugged: lost; plugged in again: back, with zero first.
    pty.unplug();
    assert!(!device.exists());
    wait_for("the loss", || samples.iter_mut().all(|s| s.read().health == RegulatorHealth::Lost));
    let error = statistics.units[0].last_error().unwrap().to_string();
    assert!(error.contains("cannot be opened") && error.contains("/dev/serial/by-id"), "{error}");
    tell(1.0);
    pty.plug().unwrap();
    wait_for("the return", || {
        samples.iter_mut().all(|s| {
            let s = *s.read();
            s.health == RegulatorHealth::Good && (s.setpoint - PSI).abs() < 0.01 * PSI
        })
    });
    assert!(statistics.line.reconnects.get() >= 1);
    stop.store(true, Ordering::Relaxed);
    thread.join().unwrap();
    for id in *b"AB" {
        assert_eq!(bench.line.lock().unwrap().unit(id).unwrap().setpoint(), 0.0);
    }
}

#[test]
fn a_line_that_babbles_is_named_and_zero_goes_out_all_the_same() {
    let bench = Bench::new(2);
    let mut line = bench.line();
    let mut unit = bench.connected(&mut line);
    bench.mischief[0].next(1, Misbehaviour::Babble);
    let heard = bench.line.lock().unwrap().eavesdrop();
    let error = bench.drive(unit.on(&mut line).write(PSI)).unwrap_err();
    assert_eq!(error.line(), Some(&LineError::Babble), "{error}");
    let before = bench.stepper.now();
    assert_eq!(bench.drive(unit.on(&mut line).zero_blindly()).unwrap_err().line(), Some(&LineError::Babble));
    // The unit hears with a wire of its own.
    bench.drive(bench.stepper.clock().sleep(ms(10)));
    assert_eq!(heard.lock().unwrap().last().unwrap(), b"AS0.0000");
    assert!(bench.stepper.now().since(before) < ms(400));
    bench.line.lock().unwrap().hush();
    let again = bench.drive(unit.on(&mut line).zero_blindly());
    assert!(again.as_ref().is_err_and(|e| e.line() == Some(&LineError::OutOfStep)), "{again:?}");
    bench.drive(unit.on(&mut line).zero_blindly()).unwrap();
}

#[test]
fn a_unit_that_babbles_does_not_keep_zero_from_the_others() {
    let mut owner = Owner::new(2);
    owner.run(ms(2000), Some(5.0));
    owner.bench.mischief[0].next(1, Misbehaviour::Babble);
    owner.run(ms(1500), Some(5.0));
    for i in 0..2 {
        assert_eq!(owner.sample(i).health, RegulatorHealth::Lost);
    }
    assert!(owner.pressure(1) < 0.01 * PSI, "{}", owner.pressure(1));
    let error = owner.statistics.units[1].last_error().unwrap().to_string();
    assert!(error.contains("babbles"), "{error}");
    owner.bench.line.lock().unwrap().hush();
    owner.run(ms(2500), Some(5.0));
    for i in 0..2 {
        assert_eq!(owner.sample(i).health, RegulatorHealth::Good);
    }
}

/// Panics in the write after `left` others.
struct Explosive<S> {
    inner: S,
    left: Arc<Mutex<u32>>,
}

impl<S: AsyncRead + Unpin> AsyncRead for Explosive<S> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Explosive<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let left = {
            let mut left = self.left.lock().unwrap();
            *left = left.wrapping_sub(1);
            *left
        };
        assert_ne!(left, 0, "the bug under test");
        Pin::new(&mut self.inner).poll_write(cx, bytes)
    }
    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(cx)
    }
    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(cx)
    }
}

#[test]
fn an_owner_that_panics_opens_the_line_again_and_zero_is_the_first_frame() {
    let left = Arc::new(Mutex::new(60));
    let fuse = left.clone();
    let mut owner = Owner::with_stream(1, move |inner| Explosive { inner, left: fuse.clone() });
    let heard = owner.bench.line.lock().unwrap().eavesdrop();
    let mut before = 0;
    while *left.lock().unwrap() <= 60 {
        before = heard.lock().unwrap().len();
        owner.run(ms(2), Some(5.0));
    }
    assert!(owner.pressure(0) > 1.0 * PSI);
    let panicked = owner.statistics.line.reconnects.get();
    owner.run(ms(300), Some(5.0));
    assert!(owner.statistics.line.reconnects.get() + panicked >= 1);
    assert_eq!(heard.lock().unwrap()[before], b"AS0.0000");
    owner.run(ms(2000), Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Good);
}

mod fuzz {
    use freerig::hardware::alicat_frame::{Columns, register};
    use proptest::prelude::*;

    use super::*;

    /// A frame as a unit writes it.
    fn frame() -> impl Strategy<Value = (f64, f64, String)> {
        let tokens = proptest::sample::subsequence(vec!["LCK", "HLD", "POV", "ADC", "EXH", "OPL", "MOV", "QQQ"], 0..4);
        (-2_000i32..110_000, 0i32..110_000, tokens).prop_map(|(pressure, setpoint, tokens)| {
            let (pressure, setpoint) = (f64::from(pressure) / 1e3, f64::from(setpoint) / 1e3);
            let mut text = format!("A {pressure:+08.3} {setpoint:+08.3}");
            for token in tokens {
                text.push(' ');
                text.push_str(token);
            }
            (pressure, setpoint, text)
        })
    }

    /// Letters that frames are made of, often with the unit's id before them.
    fn nearly_a_frame() -> impl Strategy<Value = String> {
        let letters: Vec<char> = " ?+-.".chars().chain('0'..='9').chain('A'..='Z').collect();
        let rest = proptest::collection::vec(proptest::sample::select(letters), 0..=60);
        (any::<bool>(), rest).prop_map(|(id, rest)| id.then_some('A').into_iter().chain(rest).collect())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]

        #[test]
        fn what_a_unit_writes_is_read((pressure, setpoint, text) in frame()) {
            let frame = Columns::default().parse(text.as_bytes(), b'A').unwrap();
            prop_assert_eq!((frame.pressure, frame.setpoint), (pressure, setpoint));
        }

        #[test]
        fn nothing_makes_the_parser_panic_or_invent_a_number(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            if let Ok(frame) = Columns::default().parse(&bytes, b'A') {
                prop_assert!(frame.pressure.is_finite() && frame.setpoint.is_finite());
            }
            register(&bytes, b'A');
            let lines: Vec<_> = bytes.split(|&c| c == b'\r').collect();
            // A list without its columns is none, or refused; it never panics.
            let _ = Columns::from_manifest(&lines, b'A');
        }

        #[test]
        fn text_that_looks_like_a_frame_is_read_to_the_letter_or_not_at_all(text in nearly_a_frame()) {
            if let Ok(frame) = Columns::default().parse(text.as_bytes(), b'A') {
                let mut tokens = text.split_ascii_whitespace();
                prop_assert_eq!(tokens.next(), Some("A"));
                prop_assert_eq!(tokens.next().unwrap().parse::<f64>(), Ok(frame.pressure));
                prop_assert_eq!(tokens.next().unwrap().parse::<f64>(), Ok(frame.setpoint));
                // Behind the columns there are words only.
                prop_assert!(tokens.all(|t| t.parse::<f64>().is_err() || !t.starts_with(|c: char| c.is_ascii_digit())));
            }
        }

        #[test]
        fn half_a_frame_is_no_frame((_, _, text) in frame(), share in 0.0..1.0f64) {
            let cut = &text.as_bytes()[..(text.len() as f64 * share) as usize];
            if let Ok(read) = Columns::default().parse(cut, b'A') {
                // Only what is missing of the last number or behind it can go unseen here: the line's CR is missing
                // too, and without it the line is not read.
                let whole = Columns::default().parse(text.as_bytes(), b'A').unwrap();
                prop_assert_eq!(read.pressure, whole.pressure);
            }
        }

        #[test]
        fn a_flipped_high_bit_is_never_read((_, _, text) in frame(), at in any::<prop::sample::Index>()) {
            let mut bytes = text.into_bytes();
            let at = at.index(bytes.len());
            bytes[at] ^= 0x80;
            prop_assert!(Columns::default().parse(&bytes, b'A').is_err());
        }

        /// Whatever goes wrong in whatever order: a reading is the answer to its set-point, or says that it is not.
        #[test]
        fn an_answer_to_something_else_is_never_passed_off_as_one(
            script in prop::collection::vec((0usize..6, 1u64..120), 1..12)
        ) {
            let bench = Bench::new(1);
            let mut line = bench.line();
            let mut unit = bench.connected(&mut line);
            let kinds = [
                Misbehaviour::None, Misbehaviour::Garbage, Misbehaviour::Truncated,
                Misbehaviour::WrongId, Misbehaviour::BitFlip, Misbehaviour::Nak,
            ];
            for (i, (kind, late)) in script.into_iter().enumerate() {
                let how = if late % 3 == 0 { Misbehaviour::Late(ms(late)) } else { kinds[kind] };
                bench.mischief[0].next(1, how);
                let setpoint = (i + 1) as f64 * 0.5 * PSI;
                if let Ok(sample) = bench.drive(unit.on(&mut line).write(setpoint)) {
                    let taken = (sample.setpoint - setpoint).abs() < 1e-3 * PSI;
                    let told = RegulatorStatus::REJECTED.with(RegulatorStatus::ECHO_MISMATCH);
                    prop_assert!(taken || sample.status.intersects(told), "{how:?}: {} psi", sample.setpoint / PSI);
                }
            }
        }
    }
}
