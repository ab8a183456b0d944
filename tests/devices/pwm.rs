//! The driver of PWM outputs against simulated ones, under the owner of their line, on a real pseudo-terminal, and
//! against the firmware of docs/pwm-regulator.c.

use std::future::Future;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::process::{Command as Process, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use freerig::clock::{Clock, Stepper};
use freerig::hardware::pwm::{PwmError, PwmOutput, frame, unframe};
use freerig::hardware::serial_line::{Line, LineError, LineStatistics};
use freerig::hardware::serial_owner::{SerialOwner, SerialStatistics};
use freerig::hardware::wiring::{DacChannel, PwmWiring, SerialWiring, UnitWiring};
use freerig::hardware::{HardwareError, serial};
use freerig::model::Free;
use freerig::signal::{Command, PressureSample, RegulatorHealth, RegulatorStatus};
use freerig::sim::chips::{AlicatChip, MemoryStream, Misbehaviour, Mischief, Pty, PwmChip, SerialLine};
use freerig::sim::{AnalogueSim, BenchConfig, ImuSim, Plant, PlantSim, RegulatorSim};
use freerig::units::PASCAL_PER_PSI;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use triple_buffer::{Input, Output, triple_buffer};

const PSI: f64 = PASCAL_PER_PSI;
const BAUD: u32 = 115_200;
/// 15 psi at the full duty, and nothing below code 95.
const ZERO: f64 = 95.0;
const SPAN: f64 = 15.0 * PSI / 4000.0;

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

fn output(free: usize) -> PwmWiring {
    PwmWiring { id: b'A' + free as u8, channel: DacChannel { free, zero_code: ZERO, pascals_per_code: SPAN } }
}

fn wiring(outputs: usize) -> SerialWiring {
    SerialWiring {
        name: "line".into(),
        device: PathBuf::from("/dev/simulated"),
        baud: BAUD,
        units: Vec::new(),
        pwms: (0..outputs).map(output).collect(),
    }
}

/// Outputs on a simulated line, each feeding a FREE of a simulated plant.
struct Bench {
    stepper: Stepper,
    plant: Arc<Mutex<Plant>>,
    line: Arc<Mutex<SerialLine>>,
    mischief: Vec<Mischief>,
}

impl Bench {
    /// So many outputs; `units` Alicat units follow them, with the ids and FREEs behind theirs.
    fn new(outputs: usize, units: &[UnitWiring]) -> Self {
        let regulator =
            RegulatorSim { lag: ms(20), dead_time: ms(5), slew: 1000.0 * PSI, noise: 0.0, full_scale: 15.0 * PSI };
        let sim = PlantSim {
            nominal: Free::published_code(),
            scatter: 0.0,
            hysteresis: 0.0,
            load_moment: 0.0,
            knob: None,
            regulator,
            analogue: None,
        };
        let config = BenchConfig {
            seed: 1,
            plants: vec![sim; outputs + units.len()],
            module: None,
            imu: ImuSim { delay: Duration::ZERO, noise: 0.0, rate_noise: 0.0 },
            dump_valve: false,
            one_shot: false,
        };
        let plant = Arc::new(Mutex::new(Plant::new(&config)));
        let mut line = SerialLine::new(BAUD, 1);
        let input = AnalogueSim { channel: 0, zero_code: ZERO, pascals_per_code: SPAN };
        let mischief =
            (0..outputs).map(|free| line.attach(PwmChip::new(b'A' + free as u8, free, input, plant.clone()))).collect();
        for unit in units {
            line.attach(AlicatChip::new(*unit, plant.clone()));
        }
        Self { stepper: Stepper::new(), plant, line: Arc::new(Mutex::new(line)), mischief }
    }

    fn line(&self) -> Line<MemoryStream> {
        let clock = self.stepper.clock();
        let stream = MemoryStream::open(&self.line, clock.clone()).unwrap();
        Line::new(stream, clock, BAUD, Arc::new(LineStatistics::default()))
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

    fn connected(&self, line: &mut Line<MemoryStream>) -> PwmOutput {
        let mut output = PwmOutput::new(output(0), "the line").unwrap();
        self.drive(output.on(line).identify()).unwrap();
        output
    }

    fn pressure(&self, free: usize) -> f64 {
        let now = self.stepper.now();
        self.plant.lock().unwrap().pressure(free, now)
    }

    fn code(&self, id: u8) -> u16 {
        self.line.lock().unwrap().output(id).unwrap().code(self.stepper.now())
    }
}

#[test]
fn the_wire_carries_what_the_page_says() {
    // The checks come from another program.
    assert_eq!(frame(b'A', 7, "0800"), "A07 0800*D3");
    assert_eq!(frame(b'A', 7, "0800="), "A07 0800=*84");
    assert_eq!(frame(b'A', 8, "V"), "A08 V*B8");
    assert_eq!(frame(b'A', 8, "PWM1 0250"), "A08 PWM1 0250*A6");
    let bench = Bench::new(1, &[]);
    let heard = bench.line.lock().unwrap().eavesdrop();
    let mut line = bench.line();
    let mut output = bench.connected(&mut line);
    let sample = bench.drive(output.on(&mut line).write(5.0 * PSI)).unwrap();
    let heard: Vec<_> = heard.lock().unwrap().iter().map(|c| String::from_utf8(c.clone()).unwrap()).collect();
    // 95 + 4000 * 5 / 15 = 1428.3.
    assert_eq!(heard, ["A01 0000*74", "A02 V*3F", "A03 0000*26", frame(b'A', 4, "1428").as_str()]);
    assert!((sample.setpoint - 5.0 * PSI).abs() <= 0.5 * SPAN && sample.pressure.is_nan());
    assert_eq!((sample.health, sample.status), (RegulatorHealth::Unmeasured, RegulatorStatus::default()));
    assert_eq!(bench.code(b'A'), 1428);
    // What is no pressure is no duty.
    for none in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
        bench.drive(output.on(&mut line).write(none)).unwrap();
        assert_eq!(bench.code(b'A'), 0, "{none}");
    }
    bench.drive(output.on(&mut line).write(f64::INFINITY)).unwrap();
    assert_eq!(bench.code(b'A'), 4095);
}

#[test]
fn no_line_with_one_wrong_byte_is_taken_for_another() {
    for line in ["A07 0800*D3", "A07 0800=*84", "A08 PWM1 0250*A6"] {
        let (id, sequence, text) = unframe(line.as_bytes()).unwrap();
        assert_eq!(frame(id, sequence, text), line);
        for at in 0..line.len() {
            for byte in 0..=u8::MAX {
                let mut wrong = line.as_bytes().to_vec();
                wrong[at] = byte;
                assert!(wrong == line.as_bytes() || unframe(&wrong).is_none(), "{}", wrong.escape_ascii());
            }
        }
        for end in 0..line.len() {
            assert_eq!(unframe(&line.as_bytes()[..end]), None);
        }
    }
}

#[test]
fn every_misbehaviour_is_named_and_the_next_exchange_works() {
    let cases = [
        (Misbehaviour::Garbage, "malformed"),
        (Misbehaviour::BitFlip, "malformed"),
        (Misbehaviour::WrongId, "malformed"),
        (Misbehaviour::Nak, "malformed"),
        (Misbehaviour::Stuck, "sequence"),
        (Misbehaviour::Truncated, "timeout"),
        (Misbehaviour::Silent, "timeout"),
        (Misbehaviour::Late(ms(70)), "timeout"),
    ];
    for (how, expected) in cases {
        let bench = Bench::new(1, &[]);
        let mut line = bench.line();
        let mut output = bench.connected(&mut line);
        bench.mischief[0].next(1, how);
        let error = bench.drive(output.on(&mut line).write(PSI)).unwrap_err();
        let found = match &error {
            PwmError::Line(LineError::TimedOut(_)) => "timeout",
            PwmError::Malformed(..) => "malformed",
            PwmError::Sequence { asked: 4, answered: 3 } => "sequence",
            other => panic!("{how:?}: {other}"),
        };
        assert_eq!(found, expected, "{how:?}: {error}");
        assert!(error.at(output.device()).is_transient(), "{error}");
        // At most one reply is sacrificed to get back in step.
        let mut next = bench.drive(output.on(&mut line).write(2.0 * PSI));
        if next.as_ref().is_err_and(|e| e.line() == Some(&LineError::OutOfStep)) {
            next = bench.drive(output.on(&mut line).write(2.0 * PSI));
        }
        let next = next.unwrap_or_else(|e| panic!("{how:?}: {e}"));
        assert!((next.setpoint - 2.0 * PSI).abs() <= 0.5 * SPAN, "{how:?}");
        // Without power it has been reset; that was the reply that was sacrificed.
        assert_eq!(next.status, RegulatorStatus::default(), "{how:?}");
    }
}

#[test]
fn a_reset_and_a_watchdog_that_has_acted_are_told_once() {
    let bench = Bench::new(1, &[]);
    let mut line = bench.line();
    let mut output = bench.connected(&mut line);
    bench.drive(output.on(&mut line).write(5.0 * PSI)).unwrap();
    bench.mischief[0].next(1, Misbehaviour::Reset);
    let mut statuses = Vec::new();
    for wait in [10, 10, 260, 10, 240] {
        statuses.push(bench.drive(output.on(&mut line).write(5.0 * PSI)).unwrap().status);
        bench.drive(bench.stepper.clock().sleep(ms(wait)));
    }
    let (fine, left) = (RegulatorStatus::default(), RegulatorStatus::ECHO_MISMATCH);
    assert_eq!(statuses, [left, fine, fine, left, fine]);
    assert_eq!(line.statistics().echo_mismatches.get(), 2);
    assert_eq!(bench.code(b'A'), 1428, "240 ms are within its patience");
}

#[test]
fn an_output_without_a_watchdog_is_refused_by_name() {
    for watchdog in [0, 99, 1001, 9999] {
        let bench = Bench::new(1, &[]);
        bench.line.lock().unwrap().output(b'A').unwrap().watchdog = ms(watchdog);
        let mut line = bench.line();
        let mut output = PwmOutput::new(output(0), "the line").unwrap();
        let error = bench.drive(output.on(&mut line).identify()).unwrap_err();
        assert_eq!(error, PwmError::Watchdog(ms(watchdog)));
        let error = error.at(output.device());
        assert!(matches!(&error, HardwareError::Unsafe { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("PWM output A on the line") && text.contains("WATCHDOG_MS"), "{text}");
    }
    for id in [b'a', b'1', b'*', b'\r'] {
        assert!(PwmOutput::new(PwmWiring { id, ..output(0) }, "the line").is_none());
    }
}

/// The owner of the line on the stepped clock.
struct Owner {
    bench: Bench,
    future: Pin<Box<dyn Future<Output = ()>>>,
    command: Input<Command>,
    samples: Vec<Output<PressureSample>>,
    statistics: Arc<SerialStatistics>,
    stop: Arc<AtomicBool>,
}

impl Owner {
    fn new(outputs: usize, units: &[UnitWiring]) -> Self {
        let bench = Bench::new(outputs, units);
        let wiring = SerialWiring { units: units.to_vec(), ..wiring(outputs) };
        let (command, commands) = triple_buffer(&Command::default());
        let count = outputs + units.len();
        let (publish, samples) = (0..count).map(|_| triple_buffer(&PressureSample::default())).unzip();
        let stop = Arc::new(AtomicBool::new(false));
        let (line, clock) = (bench.line.clone(), bench.stepper.clock());
        let open = move || {
            let opened = MemoryStream::open(&line, clock.clone()).map_err(|e| HardwareError::Open {
                device: "the line".into(),
                reason: e.to_string(),
                remedy: "Plug it in".into(),
            });
            std::future::ready(opened)
        };
        let clock = bench.stepper.clock();
        let owner = SerialOwner::new(&wiring, clock, ms(100), open, commands, publish, stop.clone()).unwrap();
        let statistics = owner.statistics();
        Self { bench, future: Box::pin(owner.run()), command, samples, statistics, stop }
    }

    /// Runs for `milliseconds`, with the tick giving `psi` every 2 ms where there is one. Returns whether it has ended.
    fn run(&mut self, milliseconds: u64, psi: Option<f64>) -> bool {
        let stepper = self.bench.stepper.clone();
        let end = stepper.now() + ms(milliseconds);
        let mut tick = stepper.now();
        while stepper.now() < end {
            if let Some(psi) = psi
                && stepper.now() >= tick
            {
                self.command.write(Command { time: tick, pressure: [psi * PSI; 6], vent: false });
                tick = tick + ms(2);
            }
            if self.future.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_ready() {
                return true;
            }
            let next = stepper.next_timer().unwrap_or(end).min(end);
            stepper.advance_to(if psi.is_some() { next.min(tick) } else { next });
        }
        false
    }

    fn sample(&mut self, unit: usize) -> PressureSample {
        *self.samples[unit].read()
    }
}

#[test]
fn four_outputs_and_an_alicat_unit_share_a_line() {
    let unit = UnitWiring { free: 4, gauge: false, id: b'Z', full_scale: 15.0 * PSI, pascals_per_unit: PSI };
    let mut owner = Owner::new(4, &[unit]);
    owner.run(1500, Some(4.0));
    for free in 0..5 {
        assert!((owner.bench.pressure(free) - 4.0 * PSI).abs() < 0.01 * PSI, "{free}: {}", owner.bench.pressure(free));
    }
    // Alicat units come first.
    assert_eq!(owner.sample(0).health, RegulatorHealth::Good);
    for unit in 1..5 {
        let sample = owner.sample(unit);
        assert_eq!((sample.health, sample.status), (RegulatorHealth::Unmeasured, RegulatorStatus::default()));
        // Five exchanges of at most 30.5 characters at 115200 Bd.
        assert!(owner.bench.stepper.now().since(sample.time) < ms(14));
    }
    let line = Arc::clone(&owner.statistics.line);
    assert_eq!((line.timeouts.get(), line.malformed.get(), line.echo_mismatches.get()), (0, 0, 0));
    // The owner leaves with every output at zero.
    owner.stop.store(true, Ordering::Relaxed);
    assert!(owner.run(200, Some(4.0)));
    assert!((0..4).all(|free| owner.bench.code(b'A' + free) == 0));
}

#[test]
fn a_silent_output_is_lost_and_hears_zero_first_when_it_comes_back() {
    let mut owner = Owner::new(2, &[]);
    owner.run(1000, Some(5.0));
    owner.bench.mischief[0].always(Misbehaviour::Silent);
    owner.run(1000, Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Lost);
    assert_eq!(owner.sample(1).health, RegulatorHealth::Unmeasured, "the other one goes on");
    assert!(owner.bench.pressure(0) < 0.01 * PSI && owner.bench.pressure(1) > 4.9 * PSI);
    let error = owner.statistics.units[0].last_error().unwrap().to_string();
    assert!(error.contains("PWM output A") && error.contains("does not answer"), "{error}");
    let heard = owner.bench.line.lock().unwrap().eavesdrop();
    owner.bench.mischief[0].stop();
    owner.run(1500, Some(5.0));
    let heard = heard.lock().unwrap();
    let to_a: Vec<_> = heard.iter().filter_map(|c| unframe(c)).filter(|c| c.0 == b'A').map(|c| c.2).collect();
    let asked = to_a.iter().position(|text| *text == "V").unwrap();
    assert!(to_a[..=asked + 1].iter().all(|text| matches!(*text, "0000" | "V")), "{to_a:?}");
    drop(heard);
    assert_eq!(owner.sample(0).status, RegulatorStatus::default());
    assert!(owner.bench.pressure(0) > 4.9 * PSI);
}

#[test]
fn an_output_that_hears_nothing_any_more_goes_to_zero_by_itself() {
    let mut owner = Owner::new(1, &[]);
    owner.run(1000, Some(5.0));
    owner.bench.line.lock().unwrap().plug(false);
    owner.run(230, Some(5.0));
    assert!(owner.bench.pressure(0) > 4.9 * PSI, "its patience is 250 ms");
    // 250 ms from the last command, the regulator's dead time of 5 ms, and six of its time constants of 20 ms.
    owner.run(20 + 5 + 120, Some(5.0));
    assert!(owner.bench.pressure(0) < 5.0 * PSI * (-6.0_f64).exp() * 1.1, "{}", owner.bench.pressure(0) / PSI);
    owner.run(500, Some(5.0));
    assert_eq!(owner.sample(0).health, RegulatorHealth::Lost);
    // Plugged in again: zero first, then what is commanded now; that its watchdog had acted is no news.
    let heard = owner.bench.line.lock().unwrap().eavesdrop();
    owner.bench.line.lock().unwrap().plug(true);
    owner.run(1000, Some(5.0));
    assert_eq!(unframe(&heard.lock().unwrap()[0]).unwrap().2, "0000");
    assert_eq!(owner.sample(0).status, RegulatorStatus::default());
    assert!(owner.bench.pressure(0) > 4.9 * PSI);
    assert_eq!(owner.statistics.line.reconnects.get(), 1);
}

#[test]
fn a_command_that_is_no_longer_renewed_counts_as_zero() {
    let mut owner = Owner::new(1, &[]);
    owner.run(1000, Some(5.0));
    owner.run(90, None);
    assert!(owner.sample(0).setpoint > 4.9 * PSI);
    owner.run(20, None);
    assert_eq!(owner.sample(0).setpoint, 0.0);
}

/// Waits, live, until `holds` does; the limit is generous, for a machine that stalls.
fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = std::time::Instant::now() + Duration::from_secs(30);
    while !holds() {
        assert!(std::time::Instant::now() < deadline, "waited for {what}");
        std::thread::sleep(ms(5));
    }
}

/// The owner of the line at `device`, live, with one output.
struct Live {
    command: Input<Command>,
    sample: Output<PressureSample>,
    statistics: Arc<SerialStatistics>,
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<()>,
}

impl Live {
    fn new(device: &Path) -> Self {
        let wiring = SerialWiring { device: device.to_owned(), ..wiring(1) };
        let (command, commands) = triple_buffer(&Command::default());
        let (publish, sample) = triple_buffer(&PressureSample::default());
        let stop = Arc::new(AtomicBool::new(false));
        let opened = wiring.clone();
        let open = move || std::future::ready(serial::open(&opened));
        let patience = Duration::from_secs(60);
        let owner = SerialOwner::new(&wiring, Clock::Live, patience, open, commands, vec![publish], stop.clone());
        let owner = owner.unwrap();
        let statistics = owner.statistics();
        let thread = serial::spawn("test", owner, || {}).unwrap();
        Self { command, sample, statistics, stop, thread }
    }

    fn tell(&mut self, psi: f64) {
        self.command.write(Command { time: Clock::Live.now(), pressure: [psi * PSI; 6], vent: false });
    }

    fn wait_at(&mut self, psi: f64) {
        let sample = &mut self.sample;
        wait_for("the set-point", || {
            let sample = *sample.read();
            sample.health == RegulatorHealth::Unmeasured && (sample.setpoint - psi * PSI).abs() <= 0.5 * SPAN
        });
    }

    fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

#[test]
fn the_same_driver_works_on_a_real_pseudo_terminal() {
    let bench = Bench::new(1, &[]);
    {
        let mut plant = bench.plant.lock().unwrap();
        *plant = plant.clone().starting_at(Clock::Live.now());
    }
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("usb-simulated");
    let mut pty = Pty::new(bench.line.clone(), &device, Arc::new(|| ())).unwrap();
    let mut live = Live::new(&device);
    live.tell(4.0);
    live.wait_at(4.0);
    pty.unplug();
    wait_for("the loss", || live.sample.read().health == RegulatorHealth::Lost);
    live.tell(1.0);
    pty.plug().unwrap();
    live.wait_at(1.0);
    assert!(live.statistics.line.reconnects.get() >= 1);
    assert_eq!(live.statistics.line.malformed.get(), 0);
    live.end();
    assert_eq!(bench.line.lock().unwrap().output(b'A').unwrap().code(Clock::Live.now()), 0);
}

#[test]
fn the_firmware_of_the_page_obeys_the_driver_and_its_own_watchdog() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/devices/pwm_board.c");
    let built = Process::new("cc").args(["-Wall", "-Wextra", "-Werror", "-o"]).arg(&board).arg(source).status();
    assert!(built.expect("a C compiler is installed").success());
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let device = PathBuf::from(ptsname(&master, Vec::new()).unwrap().into_string().unwrap());
    struct Board(std::process::Child);
    impl Drop for Board {
        fn drop(&mut self) {
            // It may have ended by itself.
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }
    let mut running = Board(Process::new(board).stdin(Stdio::from(master)).stderr(Stdio::piped()).spawn().unwrap());
    let (told, duties) = mpsc::channel();
    let spoken = BufReader::new(running.0.stderr.take().unwrap());
    std::thread::spawn(move || spoken.lines().map_while(Result::ok).try_for_each(|line| told.send(line)));
    let next = |duty: &str| {
        let deadline = std::time::Instant::now() + Duration::from_secs(30);
        while duties.recv_timeout(deadline - std::time::Instant::now()).unwrap() != duty {}
    };
    let mut live = Live::new(&device);
    live.tell(5.0);
    live.wait_at(5.0);
    next("A 1428");
    live.tell(2.0);
    live.wait_at(2.0);
    next("A 628");
    assert_eq!(live.statistics.line.malformed.get(), 0);
    // Garbage does not move it, and it is itself again behind the CR.
    live.end();
    next("A 0");
    let mut other = std::fs::OpenOptions::new().read(true).write(true).open(&device).unwrap();
    let say = |other: &mut std::fs::File, line: &str| std::io::Write::write_all(other, line.as_bytes()).unwrap();
    say(&mut other, "\rA07 0800*D4\rE07 0800*6D\rA07 9999*00\rA07 0800*D3 and so on, without an end\r\rA07 0800*D3\r");
    // Zero may be told once more: by the owner's end, or by the watchdog of a board that got no processor for so long.
    let mut heard = std::iter::repeat_with(|| duties.recv_timeout(Duration::from_secs(30)).unwrap());
    assert_eq!(heard.find(|duty| duty != "A 0").unwrap(), "A 800", "only the last of these is a command");
    // Nobody says anything any more.
    let begun = std::time::Instant::now();
    assert_eq!(duties.recv_timeout(Duration::from_secs(30)).unwrap(), "A 0");
    assert!(begun.elapsed() > ms(200), "{:?}", begun.elapsed());
}
