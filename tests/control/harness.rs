//! A rig without devices: readings made by hand or by a small plant, one tick after the other.

use std::sync::Arc;
use std::time::Duration;

use freerig::clock::Time;
use freerig::control::{
    ControlConfig, Controller, ControllerKind, DerivativeOn, FreeControl, Gains, ImuChannel, Limits, RegulatorChannel,
    Request, TickInput,
};
use freerig::model::Free;
use freerig::signal::*;
use freerig::trajectory::{Axis, Program, Sequence};

pub const PSI: f64 = 6894.757293168;
pub const TICK: Duration = Duration::from_millis(2);
pub const IMU_TICKS: u64 = 5;
pub const REGULATOR_TICKS: u64 = 8;

pub fn paper(gamma_deg: f64) -> Free {
    Free {
        gamma: gamma_deg.to_radians(),
        length: 0.11,
        radius: 0.007,
        mass: 0.028,
        inertia: 0.028 * 0.007 * 0.007,
        axial_stiffness: 10110.0,
        torsional_stiffness: 0.086,
        axial_damping: 5.0,
        torsional_damping: 0.005,
    }
}

pub fn free_control(gamma_deg: f64) -> FreeControl {
    FreeControl {
        name: "paper".into(),
        free: paper(gamma_deg),
        controller: ControllerKind::Pid,
        gains: Gains { proportional: 30928.0, integral: 262406.0, derivative: 911.0, derivative_filter: 20.0 },
        derivative_on: DerivativeOn::Measurement,
        feedforward: 0.0,
        limits: Limits {
            pressure_max: 10.0 * PSI,
            pressure_warn: 10.5 * PSI,
            pressure_hard: 11.0 * PSI,
            pressure_zero: 0.2 * PSI,
            slew: 30.0 * PSI,
            angle_soft: (-1.6, 1.6),
            angle_hard: (-2.0, 2.0),
            tracking_error: (f64::INFINITY, 0.0),
        },
        imu: Some(ImuChannel {
            axis: [0.0, 0.0, 1.0],
            period: TICK * IMU_TICKS as u32,
            delay: Duration::from_millis(15),
        }),
        regulator: RegulatorChannel {
            period: TICK * REGULATOR_TICKS as u32,
            lag: Duration::from_millis(60),
            dead_time: Duration::from_millis(15),
            fastest_fill: 30.0 * PSI,
            full_scale: 15.0 * PSI,
            measures: true,
        },
    }
}

pub fn config(frees: Vec<FreeControl>) -> ControlConfig {
    ControlConfig {
        period: TICK,
        vent_time: Duration::from_millis(1500),
        ramp_time: Duration::from_secs(3),
        command_timeout: Duration::from_millis(100),
        require_realtime: false,
        dump_valve: false,
        frees,
    }
}

/// What a test may do to a FREE's readings.
#[derive(Clone, Debug)]
pub struct Device {
    /// The IMU goes on reading.
    pub imu_runs: bool,
    /// The regulator goes on reading.
    pub regulator_runs: bool,
    /// Added to the pressure that is read, Pa.
    pub offset: f64,
    /// Read instead of the pressure, Pa.
    pub stuck: Option<f64>,
    pub angle: f64,
    pub rate: f64,
    pub norm: f64,
    pub calibration: u8,
    pub status: RegulatorStatus,
    pub imu_health: ImuHealth,
    pub regulator_health: RegulatorHealth,
    /// Pressure inside, Pa.
    pub pressure: f64,
    /// Commands on their way through the dead time, the newest first, Pa.
    pub commands: [f64; DELAY_TICKS],
    /// Angle and rate on their way through the IMU, the newest first.
    pub motion: [(f64, f64); DELAY_TICKS],
}

/// Dead time and IMU delay: 16 ms.
pub const DELAY_TICKS: usize = 8;

impl Default for Device {
    fn default() -> Self {
        Self {
            imu_runs: true,
            regulator_runs: true,
            offset: 0.0,
            stuck: None,
            angle: 0.0,
            rate: 0.0,
            norm: 1.0,
            calibration: 0xff,
            status: RegulatorStatus::default(),
            imu_health: ImuHealth::Good,
            regulator_health: RegulatorHealth::Good,
            pressure: 0.0,
            commands: [0.0; DELAY_TICKS],
            motion: [(0.0, 0.0); DELAY_TICKS],
        }
    }
}

/// The rig: controller, readings, time.
pub struct Rig {
    pub controller: Controller,
    pub devices: Vec<Device>,
    pub input: TickInput,
    pub last: TickRecord,
    pub records: Vec<TickRecord>,
    pub keep: bool,
    /// Whether the angle follows the pressure through the linear plant.
    pub plant: bool,
    frees: Vec<Free>,
}

impl Rig {
    pub fn new(config: &ControlConfig) -> Self {
        Self {
            controller: Controller::new(config).unwrap(),
            devices: vec![Device::default(); config.frees.len()],
            input: TickInput {
                tick: 0,
                time: Time::from_nanos(1_000_000_000),
                latency_ns: 10_000,
                execution_ns: 5_000,
                skipped: 0,
                imu: [ImuSample::default(); MAX_FREES],
                pressure: [PressureSample::default(); MAX_FREES],
                request: None,
                estop: false,
                realtime: true,
                config_changed: false,
                supply_low: false,
                heartbeat: Time::ZERO,
                trim: Trim::default(),
            },
            last: TickRecord::default(),
            records: Vec::with_capacity(20_000),
            keep: false,
            plant: false,
            frees: config.frees.iter().map(|f| f.free).collect(),
        }
    }

    pub fn one() -> Self {
        Self::new(&config(vec![free_control(-40.0)]))
    }

    /// Armed and holding.
    pub fn armed() -> Self {
        let mut rig = Self::one();
        rig.arm();
        rig
    }

    /// Armed, and pressurised to `psi` by a program that goes on for a minute.
    pub fn tracking(psi: f64) -> Self {
        let mut rig = Self::armed();
        rig.pressurise(psi);
        rig
    }

    pub fn pressurise(&mut self, psi: f64) {
        self.start(pressure_program(psi * PSI, 60.0), false);
        self.run_for(1.0);
        assert!((self.last.frees[0].command - psi * PSI).abs() < 1.0);
        assert_eq!(self.last.state, State::Track);
    }

    pub fn arm(&mut self) {
        self.run_for(0.05);
        assert_eq!(self.last.state, State::Disarmed);
        assert_eq!(self.ask(Request::Arm).refusal, Refusal::NONE);
        assert_eq!(self.last.state, State::Arming);
        self.run_for(0.5);
        assert_eq!(self.last.state, State::Hold, "{:?}", self.last.refusal);
    }

    pub fn start(&mut self, program: Arc<Program>, attended: bool) {
        let record = self.ask(Request::Start { program, attended, identify: false });
        assert_eq!((record.refusal, record.state), (Refusal::NONE, State::Track));
    }

    /// One tick with a request.
    pub fn ask(&mut self, request: Request) -> TickRecord {
        self.input.request = Some(request);
        self.tick()
    }

    pub fn tick(&mut self) -> TickRecord {
        self.prepare();
        let record = self.controller.tick(&self.input);
        self.take(record);
        record
    }

    /// Moves the time on and makes the readings of the next tick.
    pub fn prepare(&mut self) {
        self.input.tick += 1;
        self.input.time = self.input.time + TICK;
        self.read();
    }

    /// Lets the rig react to a tick's record.
    pub fn take(&mut self, record: TickRecord) {
        self.input.request = None;
        if record.state != State::Track {
            self.controller.take_retired();
        }
        self.move_on(&record);
        if self.keep {
            self.records.push(record);
        }
        self.last = record;
    }

    fn read(&mut self) {
        let (tick, time) = (self.input.tick, self.input.time);
        for (index, device) in self.devices.iter().enumerate() {
            let imu = &mut self.input.imu[index];
            if device.imu_runs && tick.is_multiple_of(IMU_TICKS) {
                let (angle, rate) =
                    if self.plant { device.motion[DELAY_TICKS - 1] } else { (device.angle, device.rate) };
                let half = 0.5 * angle;
                *imu = ImuSample {
                    time,
                    sequence: imu.sequence.wrapping_add(1),
                    quaternion: [half.cos(), 0.0, 0.0, half.sin()].map(|x| x * device.norm),
                    rate: [0.0, 0.0, rate],
                    acceleration: [0.0; 3],
                    calibration: device.calibration,
                    health: device.imu_health,
                };
            }
            let sample = &mut self.input.pressure[index];
            if device.regulator_runs && tick.is_multiple_of(REGULATOR_TICKS) {
                *sample = PressureSample {
                    time,
                    sequence: sample.sequence.wrapping_add(1),
                    pressure: device.stuck.unwrap_or(device.pressure) + device.offset,
                    setpoint: self.last.frees[index].command,
                    status: device.status,
                    health: device.regulator_health,
                };
            }
        }
    }

    /// The pressure follows the command through dead time, slew and lag; with the plant on, the angle follows the
    /// pressure.
    fn move_on(&mut self, record: &TickRecord) {
        let dt = TICK.as_secs_f64();
        for (index, device) in self.devices.iter_mut().enumerate() {
            device.commands.rotate_right(1);
            device.commands[0] = record.frees[index].command;
            let late = if self.plant { device.commands[DELAY_TICKS - 1] } else { device.commands[0] };
            device.pressure += (late - device.pressure).clamp(-1.8 * PSI, 1.8 * PSI) * dt / 0.06;
            device.motion.rotate_right(1);
            device.motion[0] = (device.angle, device.rate);
            if self.plant {
                let free = &self.frees[index];
                let tangent = free.gamma.tan();
                let radius = free.radius / (1.0 + device.angle * free.radius / (free.length * tangent));
                let a = -2.0 * std::f64::consts::PI * radius.powi(3) / tangent;
                // Overdamped (ct/I = 3644 /s): the fast pole is taken as settled within the tick.
                device.rate = (a * device.pressure - free.torsional_stiffness * device.angle) / free.torsional_damping;
                device.angle += device.rate * dt;
            }
        }
    }

    pub fn run_for(&mut self, seconds: f64) -> TickRecord {
        for _ in 0..(seconds / TICK.as_secs_f64()).round() as u64 {
            self.tick();
        }
        self.last
    }

    /// Ticks until `done`, at most `seconds`; the time it took, s.
    pub fn until(&mut self, seconds: f64, done: impl Fn(&TickRecord) -> bool) -> f64 {
        let mut t = 0.0;
        while t < seconds {
            t += TICK.as_secs_f64();
            if done(&self.tick()) {
                return t;
            }
        }
        panic!("not within {seconds} s: {:?} {:?}", self.last.state, self.last.frees[0].faults);
    }

    pub fn faults(&self) -> FaultSet {
        self.last.faults.union(self.last.frees[0].faults)
    }
}

pub fn pressure_program(pascals: f64, seconds: f64) -> Arc<Program> {
    Arc::new(Program::pressure(0, Sequence::constant(pascals, seconds).unwrap()).unwrap())
}

pub fn angle_program(sequence: Sequence) -> Arc<Program> {
    Arc::new(Program::new([(0, Axis { quantity: Quantity::Angle, sequence })]).unwrap())
}

pub fn set(codes: &[FaultCode]) -> FaultSet {
    let mut set = FaultSet::NONE;
    for &code in codes {
        set.insert(code);
    }
    set
}
