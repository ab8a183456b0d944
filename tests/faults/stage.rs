//! A simulated rig under observation: every tick's record is held to what must never happen.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use freerig::clock::Time;
use freerig::config::Rig;
use freerig::control::Request;
use freerig::control::fault::{Reaction, row};
use freerig::daemon::{Bench, DaemonError, Pump, Stepped, procedure};
use freerig::hardware::DeviceStatistics;
use freerig::record::Recorder;
use freerig::signal::Quantity;
use freerig::signal::{FaultCode, FaultSet, State, TickRecord, Trim};
use freerig::sim::chips::{Mischief, SerialLine};
use freerig::sim::{Plant, PlantFault};
use freerig::trajectory::{Axis, Program, Sequence, Shape};
use freerig::units::PASCAL_PER_PSI;
use tempfile::TempDir;

pub const PSI: f64 = PASCAL_PER_PSI;

/// Without the dump valve of the rig as delivered.
pub const NO_DUMP_VALVE: (&str, &str) = ("dump_valve = true", "dump_valve = false");

/// Room to turn, for what is about pressure.
pub const TURNS_FAR: [(&str, &str); 2] = [("[-120, 120]", "[-400, 400]"), ("[-150, 150]", "[-500, 500]")];

/// A second FREE, on an analogue regulator behind a DAC.
pub const SECOND_FREE: (&str, &str) = (
    "[sim]\nseed",
    "[[free]]\nname = \"second\"\ncalibration = \"second\"\n\
     [free.imu]\nbus = \"main\"\naddress = 0x29\naxis = [0, 0, 1]\n\
     [free.regulator]\nkind = \"mcp4728\"\nbus = \"main\"\naddress = 0x60\nchannel = \"A\"\nfull_scale_psi = 15\n\
     [free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\n\n[sim]\nseed",
);

/// A second FREE, on a second unit of the same line.
pub const SECOND_UNIT: (&str, &str) = (
    "[sim]\nseed",
    "[[free]]\nname = \"second\"\ncalibration = \"second\"\n\
     [free.imu]\nbus = \"main\"\naddress = 0x29\naxis = [0, 0, 1]\n\
     [free.regulator]\nkind = \"alicat\"\nline = \"line\"\nunit = \"B\"\nfull_scale_psi = 15\n\
     [free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\n\n[sim]\nseed",
);

pub fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// rig.toml with some of its text replaced.
pub fn rig(folder: &Path, changes: &[(&str, &str)]) -> Rig {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut text = std::fs::read_to_string(here.join("rig.toml")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "rig.toml no longer says `{from}`");
        text = text.replace(from, to);
    }
    let calibrations = folder.join("calibration");
    std::fs::create_dir(&calibrations).unwrap();
    let paper = std::fs::read_to_string(here.join("calibration/paper.toml")).unwrap();
    let measured = "[regulator]\nzero_code = { value = 60.0, method = \"test\" }\n\
                    span_pa_per_code = { value = 26.0, method = \"test\" }\n";
    let second = paper.replace("name = \"paper\"", "name = \"second\"").replace("[regulator]\n", measured);
    std::fs::write(calibrations.join("paper.toml"), paper).unwrap();
    std::fs::write(calibrations.join("second.toml"), second).unwrap();
    let path = folder.join("rig.toml");
    std::fs::write(&path, text).unwrap();
    Rig::load(&path).unwrap_or_else(|error| panic!("{error}"))
}

/// The rig, and what has been seen of it.
pub struct Stage {
    pub bench: Stepped,
    pub rig: Rig,
    pub last: TickRecord,
    /// When each fault was first seen in a record, its condition or its latch.
    pub first: BTreeMap<FaultCode, Time>,
    /// Whether a client's heart beats.
    pub heart: bool,
    /// Something in the plant is broken: its pressure may be anything.
    pub broken: bool,
    /// Every state that the rig went through.
    pub states: Vec<State>,
    _folder: TempDir,
}

impl Stage {
    /// A rig in Boot.
    pub fn new(changes: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig(folder.path(), changes);
        Self {
            bench: Stepped::new(&rig).unwrap(),
            rig,
            last: TickRecord::default(),
            first: BTreeMap::new(),
            heart: true,
            broken: false,
            states: Vec::new(),
            _folder: folder,
        }
    }

    /// Armed, the pressures at zero.
    pub fn armed(changes: &[(&str, &str)]) -> Self {
        let mut stage = Self::new(changes);
        let rig = stage.rig.clone();
        procedure::arm(&mut stage, &rig, true).unwrap_or_else(|error| panic!("{error}: {}", error.remedy()));
        stage.first.clear();
        stage
    }

    /// Armed and tracking 60 degrees with every FREE.
    pub fn tracking(changes: &[(&str, &str)]) -> Self {
        let mut stage = Self::armed(changes);
        stage.track(60.0, false);
        for free in 0..stage.rig.control.frees.len() {
            let pressure = stage.truth(free);
            assert!(pressure > 2.0 * PSI, "the FREE is under pressure: {}", pressure / PSI);
        }
        stage
    }

    /// Starts to track `degrees` (in each FREE's own direction), and goes on for a minute.
    pub fn track(&mut self, degrees: f64, attended: bool) {
        let axes = self.rig.control.frees.iter().enumerate().map(|(free, control)| {
            let angle = control.free.direction() * degrees.to_radians();
            let sequence = Sequence::starting_at(0.0).then(Shape::Cubic, angle, 1.5).hold(60.0).build().unwrap();
            (free, Axis { quantity: Quantity::Angle, sequence })
        });
        let program = Program::new(axes.collect::<Vec<_>>()).unwrap();
        self.request(Request::Start { program: Arc::new(program), attended, identify: false }).unwrap();
        self.pass(ms(2500)).unwrap();
        assert_eq!(self.last.state, State::Track);
    }

    /// Starts to take the first FREE to `psi` within a second, and to stay there for a minute.
    pub fn go_to(&mut self, psi: f64) {
        let sequence = Sequence::starting_at(0.0).then(Shape::Linear, psi * PSI, 1.0).hold(60.0).build().unwrap();
        let program = Arc::new(Program::pressure(0, sequence).unwrap());
        self.request(Request::Start { program, attended: false, identify: false }).unwrap();
    }

    /// Takes the first FREE to `psi`.
    pub fn press(&mut self, psi: f64) {
        self.go_to(psi);
        self.pass(ms(2000)).unwrap();
        assert_eq!(self.last.state, State::Track);
        assert!((self.truth(0) - psi * PSI).abs() < 0.1 * PSI);
    }

    pub fn line(&self) -> Arc<Mutex<SerialLine>> {
        Arc::clone(self.bench.sim().line(0).unwrap())
    }

    pub fn imu(&self) -> &Mischief {
        self.bench.sim().imu(0).unwrap()
    }

    pub fn regulator(&self, free: usize) -> &Mischief {
        self.bench.sim().regulator(free).unwrap()
    }

    /// The tokens of the Alicat unit's frames.
    pub fn tokens(&self, tokens: &str) {
        self.line().lock().unwrap().unit(b'A').unwrap().tokens = tokens.into();
    }

    pub fn plant(&self) -> Arc<Mutex<Plant>> {
        self.bench.sim().plant()
    }

    /// Lets something break now.
    pub fn inject(&mut self, fault: PlantFault) {
        self.broken = true;
        let now = self.now();
        self.plant().lock().unwrap().inject(fault, now);
    }

    /// The true pressure in a FREE, Pa.
    pub fn truth(&self, free: usize) -> f64 {
        let now = self.bench.now();
        self.plant().lock().unwrap().pressure(free, now)
    }

    /// Every fault whose condition holds, and every one that is latched.
    pub fn faults(&self) -> FaultSet {
        seen(&self.last)
    }

    /// Lets time pass until the record fits, tick by tick; returns how long that took.
    pub fn until(&mut self, longest: Duration, what: &str, fits: impl Fn(&TickRecord) -> bool) -> Duration {
        let begun = self.now();
        loop {
            self.pass(self.rig.control.period).unwrap();
            let took = self.now().since(begun);
            if fits(&self.last) {
                return took;
            }
            assert!(
                took <= longest,
                "no {what} within {longest:?}: {} with {:?}",
                self.last.state.name(),
                self.faults().iter().map(FaultCode::name).collect::<Vec<_>>()
            );
        }
    }

    /// Waits for `code`, which must come within `longest` and before any other fault, and checks that the rig
    /// reacts as stated in the very same tick. Returns how long it took.
    pub fn expect(&mut self, code: FaultCode, reaction: Reaction, longest: Duration) -> Duration {
        let row = row(code);
        assert!(row.reaction <= reaction && reaction <= row.then, "the matrix says otherwise");
        let before = self.last.state;
        let took = self.until(longest, code.name(), |r| seen(r).contains(code));
        let record = self.last;
        let others: Vec<_> = self.first.keys().filter(|&&c| c != code).collect();
        assert!(others.is_empty(), "{} came after {others:?}", code.name());
        match reaction {
            Reaction::None | Reaction::Warn => assert_eq!(record.state, before, "a warning, no more"),
            Reaction::Hold => {
                assert_eq!(record.state, State::Faulting);
                assert!(record.latched.is_empty() && !record.vent);
            }
            Reaction::Ramp => {
                // Where there is nothing to take down, the ramp is over at once.
                assert!(matches!(record.state, State::Faulting | State::Faulted));
                assert!(record.latched.contains(code) && (!record.vent || record.state == State::Faulted));
            }
            Reaction::Vent => {
                assert!(matches!(record.state, State::Faulting | State::Faulted));
                assert!(record.latched.contains(code) && record.vent);
                assert!(record.frees().iter().all(|f| f.command == 0.0), "zero in the very same tick");
            }
        }
        let remedy = DaemonError::Fault(record.latched).remedy();
        assert!(!reaction.latches() || remedy.contains(row.remedy), "{remedy}");
        took
    }

    /// Waits until the rig is Faulted, and checks that it was vented in time after `reaction` had begun, and truly.
    pub fn rests_vented(&mut self, reaction: Reaction) {
        let control = &self.rig.control;
        let (ramp, vent) = (control.ramp_time, control.vent_time);
        let longest = if reaction == Reaction::Ramp { ramp + vent } else { vent } + control.period;
        self.until(longest, "faulted", |r| r.state == State::Faulted);
        self.is_vented();
        assert!(!self.last.latched.contains(FaultCode::VentFailed));
        self.pass(ms(500)).unwrap();
        assert_eq!(self.last.state, State::Faulted, "latched");
        self.is_vented();
    }

    /// Commands and true pressures are gone.
    pub fn is_vented(&self) {
        for (free, control) in self.rig.control.frees.iter().enumerate() {
            assert!(self.truth(free) < control.limits.pressure_zero, "{}: {}", control.name, self.truth(free) / PSI);
            assert_eq!(self.last.frees[free].command, 0.0);
        }
    }

    /// While the cause is there, clearing is refused with the fault and its remedy.
    pub fn will_not_clear(&mut self, code: FaultCode) {
        let rig = self.rig.clone();
        let error = procedure::clear(self, &rig).unwrap_err();
        match &error {
            DaemonError::Refused { refusal, .. } => assert_eq!(refusal.fault, Some(code), "{error}"),
            other => panic!("{other}"),
        }
        assert_eq!(error.remedy(), row(code).remedy);
        assert_eq!(self.last.state, State::Faulted);
    }

    /// The cause is gone: clears, arms, and disarms.
    pub fn works_again(&mut self) {
        let rig = self.rig.clone();
        // The devices are set up again, the last readings are in.
        self.pass(ms(3000)).unwrap();
        self.broken = false;
        let done = procedure::clear(self, &rig)
            .and_then(|()| procedure::arm(self, &rig, true))
            .and_then(|()| procedure::disarm(self, &rig));
        done.unwrap_or_else(|error| panic!("{error}: {}", error.remedy()));
        assert_eq!(self.last.state, State::Disarmed);
        self.is_vented();
    }

    /// What must hold in every tick, whatever happens.
    fn look(&mut self) {
        let record = self.bench.latest();
        if record.time == self.last.time {
            return;
        }
        let moving = record.state.is_armed() || matches!(record.state, State::RampDown | State::Faulting);
        for (free, control) in self.rig.control.frees.iter().enumerate() {
            let (tick, p_max) = (record.frees[free], control.limits.pressure_max);
            assert!((0.0..=p_max).contains(&tick.command), "a command of {} Pa", tick.command);
            assert!(tick.command == 0.0 || moving, "a command in {}", record.state.name());
            assert!(tick.command == 0.0 || !record.vent, "a command under a vent");
            if !self.broken {
                let pressure = self.plant().lock().unwrap().pressure(free, record.time);
                assert!(pressure <= p_max * (1.0 + 1e-9), "{} psi in a FREE", pressure / PSI);
            }
        }
        for wiring in self.rig.wiring.serial.iter().flat_map(|line| &line.units) {
            let setpoint = self.line().lock().unwrap().unit(wiring.id).unwrap().setpoint();
            let p_max = self.rig.control.frees[wiring.free].limits.pressure_max;
            // The unit rounds to its own 64000 steps.
            assert!(setpoint <= p_max + wiring.full_scale / 64_000.0, "a set-point of {setpoint} Pa");
        }
        let faulted = matches!(record.state, State::Faulting | State::Faulted);
        assert!(record.latched.is_empty() || faulted, "latched in {}", record.state.name());
        for code in seen(&record).iter() {
            self.first.entry(code).or_insert(record.time);
        }
        if record.state != self.last.state {
            self.states.push(record.state);
        }
        self.last = record;
    }
}

/// Every fault of a record.
fn seen(record: &TickRecord) -> FaultSet {
    record.frees().iter().fold(record.faults.union(record.latched), |all, free| all.union(free.faults))
}

/// A rig that is looked at in every tick.
impl Bench for Stage {
    fn now(&self) -> Time {
        self.bench.now()
    }

    fn request(&mut self, request: Request) -> Result<(), DaemonError> {
        self.bench.request(request)
    }

    fn trim(&mut self, trim: Trim) {
        self.bench.trim(trim);
    }

    fn devices(&self) -> Vec<Arc<DeviceStatistics>> {
        self.bench.devices()
    }

    fn pass(&mut self, duration: Duration) -> Result<(), DaemonError> {
        let end = self.now() + duration;
        while self.now() < end {
            if self.heart {
                self.bench.heartbeat();
            }
            let step = self.rig.control.period.min(end.since(self.now()));
            self.bench.pass(step)?;
            self.look();
        }
        Ok(())
    }

    fn heartbeat(&mut self) {
        self.bench.heartbeat();
    }

    fn with_pump<R>(&mut self, look: impl FnOnce(&mut Pump) -> R) -> R {
        self.bench.with_pump(look)
    }

    fn latest(&mut self) -> TickRecord {
        self.bench.latest()
    }

    fn attach(&mut self, recorder: Recorder) {
        self.bench.attach(recorder);
    }

    fn detach(&mut self) -> Result<Option<Recorder>, DaemonError> {
        self.bench.detach()
    }
}
