//! The BNO055 orientation sensor (Bosch BST-BNO055-DS000).
//!
//! Set-up, modes and the calibration profile go through the `bno055` crate, whose delays are *deferred*: a step
//! returns when to go on ([`Bno055::advance`]), so that the 650 ms of a reset block nobody else on the bus. The
//! cyclic reading is one raw burst of 26 bytes, gyro to linear acceleration, all from one fusion frame.
//!
//! What the chip and the crate do wrong without saying, and what stands against it here:
//!
//! | trap | answer |
//! | --- | --- |
//! | after a brown-out every reading is zero, and OK | norm check, and the mode is read again every second |
//! | axis map, units and power mode are ignored outside CONFIG mode | written in CONFIG mode, read back |
//! | units are never written by the crate (reset value: Android) | written here |
//! | the crate believes a mode before the chip has it | the crate's cached mode is set from the chip each time |
//! | the profile is lost without power | restored at each set-up, read back, compared |
//! | something else takes it out of its mode | put back without a reset, in 60 ms: readings, and a tare, go on |
//! | a profile fits one sensor only | refused when the unique number differs |
//! | clock stretching corrupts bits on some controllers | norm, and the jump against the gyro |
//! | two readings within one fusion frame | [`Reading::Repeated`], not published again |

use std::sync::Arc;
use std::time::Duration;

use bno055::{BNO055Calibration, BNO055OperationMode, BNO055PowerMode, Bno055 as Chip};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;
use nalgebra::{Quaternion, Vector3};

use super::i2c::transfer_error;
use super::wiring::ImuProfile;
use super::{HardwareError, Identity, Implausible, Imu, Reading};
use crate::clock::{Clock, Time};
use crate::signal::{ImuHealth, ImuSample};

const PAGE_ID: u8 = 0x07;
const GYRO_DATA: u8 = 0x14;
const CALIB_STAT: u8 = 0x35;
const UNIT_SEL: u8 = 0x3B;
const SYS_TRIGGER: u8 = 0x3F;
const AXIS_MAP: u8 = 0x41;
const UNIQUE_ID: u8 = 0x50;

/// m/s2, deg/s, degrees, Celsius.
const UNITS: u8 = 0x00;
/// The axes as the chip has them: X, Y, Z, none reversed.
const AXES: [u8; 2] = [0x24, 0x00];
/// IMU mode: accelerometer and gyro, no magnetometer, for pneumatic benches are full of iron.
const MODE: BNO055OperationMode = BNO055OperationMode::IMU;
/// Self-test bits of accelerometer, gyro and microcontroller; the magnetometer is not used.
const SELF_TEST: u8 = 0b1101;
/// Raw quaternions per one.
const QUATERNION_SCALE: f64 = 1.0 / 16384.0;
/// Degrees per second per raw count, in rad/s.
const RATE_SCALE: f64 = std::f64::consts::PI / 180.0 / 16.0;
/// Metres per second squared per raw count.
const ACCELERATION_SCALE: f64 = 0.01;

/// Largest deviation of the quaternion's norm from one.
pub const NORM_TOLERANCE: f64 = 0.02;
/// A turn between readings that is always allowed, rad: several times the noise, and a tenth of the turn that
/// the flip of a high bit makes.
pub const JUMP_FLOOR: f64 = 0.1;
/// How much faster than the gyro's larger reading the orientation may have turned: the gyro's 32 Hz low-pass
/// halves short peaks.
pub const JUMP_FACTOR: f64 = 2.0;
/// After this long of nothing but jumps the new orientation is believed: by then the fault has been seen
/// (three readings) and the pressures are going down; the next arming tares anew.
const REBASE_AFTER: Duration = Duration::from_millis(500);
/// How often mode, units, axis map and calibration status are looked at.
const SUPERVISION_PERIOD: Duration = Duration::from_secs(1);
/// A chip that has just been powered or reset answers nothing for this long: the 650 ms of table 0-2 are typical ones.
const START_LIMIT: Duration = Duration::from_millis(850);
/// Between two looks whether it does.
const START_POLL: Duration = Duration::from_millis(10);
/// From the change of mode to the first fusion frame, at most.
const FIRST_FRAME: Duration = Duration::from_millis(30);

/// Takes the delay that the `bno055` crate asks for, for the caller to wait itself.
#[derive(Default)]
struct Deferred(Duration);

impl DelayNs for Deferred {
    fn delay_ns(&mut self, ns: u32) {
        self.0 += Duration::from_nanos(ns.into());
    }
}

/// Where the set-up stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Probe,
    Configure,
    Profile,
    /// Out of its mode, but not reset: back by way of CONFIG mode.
    Return,
    Identify,
    Check,
    Running,
}

/// What a step of the set-up came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// Go on at this time; the bus is free until then.
    Wait(Time),
    /// It does not answer yet, as one that has just been reset may: ask again at this time.
    Silent(Time),
    /// The sensor runs.
    Running(Identity),
}

/// Driver of one BNO055.
pub struct Bno055<I> {
    bus: I,
    clock: Clock,
    address: u8,
    device: Arc<str>,
    profile: Option<ImuProfile>,
    step: Step,
    /// When it was reset last, as far as is known.
    reset: Option<Time>,
    identity: Identity,
    unique_id: [u8; 16],
    supervised: Time,
    calibration: u8,
    frame: [u8; 26],
    accepted: Option<ImuSample>,
    sequence: u32,
}

impl<I: I2c> Bno055<I> {
    /// A driver for the chip at `address` (0x28 or 0x29) of the bus called `name`; touches nothing yet.
    pub fn new(bus: I, clock: Clock, name: &str, address: u8, profile: Option<ImuProfile>) -> Self {
        Self {
            bus,
            clock,
            address,
            device: format!("BNO055 at {address:#04x} on {name}").into(),
            profile,
            step: Step::Probe,
            reset: None,
            identity: Identity::default(),
            unique_id: [0; 16],
            supervised: Time::ZERO,
            calibration: 0,
            frame: [0; 26],
            accepted: None,
            sequence: 0,
        }
    }

    /// Model, address and bus, as in every message.
    pub fn device(&self) -> &Arc<str> {
        &self.device
    }

    /// Goes on with another handle on the same bus.
    pub fn replace_bus(&mut self, bus: I) {
        self.bus = bus;
    }

    /// Starts the set-up from nothing.
    pub fn restart(&mut self) {
        self.step = Step::Probe;
        self.accepted = None;
        self.frame = [0; 26];
    }

    /// Its power or its reset line has come back just now: it may need a while until it answers.
    pub fn was_reset(&mut self) {
        self.reset = Some(self.clock.now());
    }

    /// Does the next step of the set-up: a few transfers, no waiting. After an error the set-up starts over.
    pub fn advance(&mut self) -> Result<Progress, HardwareError> {
        let outcome = match self.step {
            Step::Probe => self.probe(),
            Step::Configure => self.configure(),
            Step::Profile => self.restore_profile(),
            Step::Return => self.return_to_mode(),
            Step::Identify => self.identify(),
            Step::Check => self.check(),
            Step::Running => Ok((Step::Running, Duration::ZERO)),
        };
        match outcome {
            Ok((Step::Running, _)) => {
                self.step = Step::Running;
                Ok(Progress::Running(self.identity.clone()))
            }
            Ok((next, pause)) => {
                self.step = next;
                Ok(Progress::Wait(self.clock.now() + pause))
            }
            // To reset it again would only begin anew.
            Err(HardwareError::NoAnswer { .. }) if self.is_starting() => {
                Ok(Progress::Silent(self.clock.now() + START_POLL))
            }
            Err(error) => {
                self.restart();
                Err(error)
            }
        }
    }

    fn is_starting(&self) -> bool {
        matches!(self.step, Step::Probe | Step::Configure)
            && self.reset.is_some_and(|reset| self.clock.now().since(reset) < START_LIMIT)
    }

    /// Reads the profile that the chip has found by itself, with its unique number. Stops the fusion for about
    /// 50 ms: not while armed.
    pub fn save_profile(&mut self) -> Result<ImuProfile, HardwareError> {
        let mut clock = self.clock.clone();
        let registers = self.chip(MODE, |chip| chip.calibration_profile(&mut clock))?;
        let registers = <[u8; 22]>::try_from(registers.as_bytes()).unwrap_or([0; 22]);
        self.accepted = None;
        Ok(ImuProfile { unique_id: self.unique_id, registers })
    }

    /// Reads the chip's id `count` times and returns how many readings failed or were wrong: the error rate of
    /// the bus, for `doctor`.
    pub fn probe_errors(&mut self, count: u32) -> u32 {
        (0..count).filter(|_| !matches!(self.register(0x00), Ok([bno055::BNO055_ID]))).count() as u32
    }

    fn probe(&mut self) -> Result<(Step, Duration), HardwareError> {
        let id = self.chip(BNO055OperationMode::CONFIG_MODE, |chip| chip.id())?;
        if id != bno055::BNO055_ID {
            return Err(HardwareError::WrongIdentity {
                device: self.device.clone(),
                expected: format!("chip id {:#04x}", bno055::BNO055_ID),
                found: format!("{id:#04x}"),
            });
        }
        let mut wait = Deferred::default();
        self.chip(BNO055OperationMode::CONFIG_MODE, |chip| chip.soft_reset(&mut wait))?;
        self.was_reset();
        Ok((Step::Configure, wait.0))
    }

    fn configure(&mut self) -> Result<(Step, Duration), HardwareError> {
        let mode = self.chip(BNO055OperationMode::CONFIG_MODE, |chip| chip.get_mode())?;
        if mode != BNO055OperationMode::CONFIG_MODE {
            return Err(self.not_taken("the reset", "CONFIG mode", format!("{mode:?}")));
        }
        self.chip(mode, |chip| chip.set_power_mode(BNO055PowerMode::NORMAL))?;
        self.write(&[SYS_TRIGGER, 0])?;
        self.write(&[UNIT_SEL, UNITS])?;
        self.write(&[AXIS_MAP, AXES[0], AXES[1]])?;
        // The crate's getter of the axis map returns X three times: compare raw.
        let [units] = self.register(UNIT_SEL)?;
        let axes = self.register(AXIS_MAP)?;
        if units != UNITS {
            return Err(self.not_taken("its units", format!("{UNITS:#04x}"), format!("{units:#04x}")));
        }
        if axes != AXES {
            return Err(self.not_taken("its axis map", format!("{AXES:02x?}"), format!("{axes:02x?}")));
        }
        Ok((Step::Identify, Duration::ZERO))
    }

    fn identify(&mut self) -> Result<(Step, Duration), HardwareError> {
        self.write(&[PAGE_ID, 1])?;
        let unique_id = self.register::<16>(UNIQUE_ID);
        // Back to page 0 whatever happened: every other address depends on it.
        self.write(&[PAGE_ID, 0])?;
        self.unique_id = unique_id?;
        let revision = self.chip(BNO055OperationMode::CONFIG_MODE, |chip| chip.get_revision())?;
        let [self_test] = self.register(0x36)?;
        if self_test & SELF_TEST != SELF_TEST {
            let detail =
                format!("self-test {self_test:#06b} (bits: microcontroller, gyro, magnetometer, accelerometer)");
            return Err(HardwareError::DeviceFault { device: self.device.clone(), detail });
        }
        self.identity = Identity {
            device: self.device.to_string(),
            serial: hexadecimal(&self.unique_id),
            firmware: format!("{:x}.{:02x}", revision.software >> 8, revision.software & 0xFF),
        };
        Ok((Step::Profile, Duration::ZERO))
    }

    fn return_to_mode(&mut self) -> Result<(Step, Duration), HardwareError> {
        let mut wait = Deferred::default();
        let mode = self.chip(BNO055OperationMode::CONFIG_MODE, |chip| chip.get_mode())?;
        self.chip(mode, |chip| chip.set_mode(BNO055OperationMode::CONFIG_MODE, &mut wait))?;
        Ok((Step::Profile, wait.0))
    }

    fn restore_profile(&mut self) -> Result<(Step, Duration), HardwareError> {
        let config = BNO055OperationMode::CONFIG_MODE;
        let mut wait = Deferred::default();
        if let Some(profile) = self.profile {
            if profile.unique_id != self.unique_id {
                return Err(HardwareError::Unsafe {
                    device: self.device.clone(),
                    reason: format!(
                        "the saved calibration profile belongs to sensor {}, but this is sensor {}",
                        hexadecimal(&profile.unique_id),
                        self.identity.serial
                    ),
                    remedy:
                        "Put the former sensor back, or remove `sensor_id` and `profile` from `[imu]` of the FREE's \
                             calibration, start again, and run `freerig calibrate imu`"
                            .into(),
                });
            }
            let wanted = BNO055Calibration::from_buf(&profile.registers);
            self.chip(config, |chip| chip.set_calibration_profile(wanted, &mut wait))?;
            let read = self.chip(config, |chip| chip.calibration_profile(&mut wait))?;
            if read != wanted {
                let (written, read) = (hexadecimal(wanted.as_bytes()), hexadecimal(read.as_bytes()));
                return Err(self.not_taken("its calibration profile", written, read));
            }
        }
        self.chip(config, |chip| chip.set_mode(MODE, &mut wait))?;
        Ok((Step::Check, wait.0 + FIRST_FRAME))
    }

    fn check(&mut self) -> Result<(Step, Duration), HardwareError> {
        let state = self.supervise()?;
        let [status, error] = [state[4], state[5]];
        if let Some(wrong) = wrong_setting(&state) {
            return Err(self.not_taken(wrong.0, wrong.1, wrong.2));
        }
        if status != 5 || error != 0 {
            let detail = format!("SYS_STATUS {status} (5 is running), SYS_ERR {error}");
            return Err(HardwareError::DeviceFault { device: self.device.clone(), detail });
        }
        Ok((Step::Running, Duration::ZERO))
    }

    /// Registers CALIB_STAT to AXIS_MAP_SIGN in one burst, from page 0 for certain.
    fn supervise(&mut self) -> Result<[u8; 14], HardwareError> {
        self.write(&[PAGE_ID, 0])?;
        let state = self.register::<14>(CALIB_STAT)?;
        self.calibration = state[0];
        self.supervised = self.clock.now();
        Ok(state)
    }

    /// The burst, and what it says.
    fn read_frame(&mut self) -> Result<Reading, HardwareError> {
        // The chip holds its registers from the start of the transfer on.
        let time = self.clock.now();
        let frame = self.register::<26>(GYRO_DATA)?;
        let due = time.since(self.supervised) >= SUPERVISION_PERIOD;
        // All zero is what a chip in CONFIG mode shows; a spoilt transfer rarely does.
        let suspicious = frame[12..20] == [0; 8];
        if due || suspicious {
            let state = self.supervise()?;
            if wrong_setting(&state).is_some() {
                let whole = only_mode_is_wrong(&state);
                self.restart();
                if whole {
                    self.step = Step::Return;
                }
                return Ok(Reading::Reset);
            }
        }
        if frame == self.frame {
            return Ok(Reading::Repeated);
        }
        self.frame = frame;
        self.sequence = self.sequence.wrapping_add(1);
        let mut sample = decode(&frame);
        (sample.time, sample.sequence, sample.calibration) = (time, self.sequence, self.calibration);
        Ok(match self.judge(&mut sample) {
            Ok(()) => {
                self.accepted = Some(sample);
                Reading::Fresh(sample)
            }
            Err(why) => {
                sample.health = ImuHealth::Implausible;
                Reading::Implausible(sample, why)
            }
        })
    }

    /// Checks `sample` against itself and its predecessor, and makes its quaternion a unit one.
    fn judge(&self, sample: &mut ImuSample) -> Result<(), Implausible> {
        let [w, x, y, z] = sample.quaternion;
        let q = Quaternion::new(w, x, y, z);
        let norm = q.norm();
        if (norm - 1.0).abs() > NORM_TOLERANCE {
            return Err(Implausible::Norm { norm });
        }
        sample.quaternion = [w / norm, x / norm, y / norm, z / norm];
        let Some(before) = self.accepted else { return Ok(()) };
        if sample.time.since(before.time) > REBASE_AFTER {
            return Ok(());
        }
        let [bw, bx, by, bz] = before.quaternion;
        let turn = Quaternion::new(bw, bx, by, bz).conjugate() * (q / norm);
        let angle = 2.0 * turn.imag().norm().atan2(turn.w.abs());
        let rate = Vector3::from(sample.rate).norm().max(Vector3::from(before.rate).norm());
        let allowed = JUMP_FLOOR + JUMP_FACTOR * rate * sample.time.seconds_since(before.time);
        if angle > allowed { Err(Implausible::Jump { angle, allowed }) } else { Ok(()) }
    }

    /// Calls the crate with the mode that the chip is in.
    fn chip<R>(
        &mut self,
        mode: BNO055OperationMode,
        call: impl FnOnce(&mut Chip<&mut I>) -> Result<R, bno055::Error<I::Error>>,
    ) -> Result<R, HardwareError> {
        let mut chip = Chip::new(&mut self.bus);
        if self.address == 0x28 {
            chip = chip.with_alternative_address();
        }
        chip.mode = mode;
        call(&mut chip).map_err(|error| match error {
            bno055::Error::I2c(error) => transfer_error(&self.device, &error),
            other => HardwareError::Malformed { device: self.device.clone(), detail: format!("{other:?}") },
        })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), HardwareError> {
        self.bus.write(self.address, bytes).map_err(|error| transfer_error(&self.device, &error))
    }

    fn register<const N: usize>(&mut self, register: u8) -> Result<[u8; N], HardwareError> {
        let mut bytes = [0; N];
        self.bus
            .write_read(self.address, &[register], &mut bytes)
            .map_err(|error| transfer_error(&self.device, &error))?;
        Ok(bytes)
    }

    fn not_taken(&self, what: &'static str, written: impl Into<String>, read: impl Into<String>) -> HardwareError {
        HardwareError::NotTaken { device: self.device.clone(), what, written: written.into(), read: read.into() }
    }
}

impl<I: I2c> Imu for Bno055<I> {
    /// Resets and sets up; blocks for 0.7 s, or longer if the chip has only just got its power.
    fn connect(&mut self) -> Result<Identity, HardwareError> {
        self.restart();
        self.was_reset();
        loop {
            match self.advance()? {
                Progress::Running(identity) => return Ok(identity),
                Progress::Wait(until) | Progress::Silent(until) => self.clock.block_until(until),
            }
        }
    }

    fn read(&mut self) -> Result<Reading, HardwareError> {
        match self.step {
            Step::Running => self.read_frame(),
            _ => Ok(Reading::Reset),
        }
    }
}

/// The setting that is not as it was written, of the registers from CALIB_STAT on: name, written, read.
fn wrong_setting(state: &[u8; 14]) -> Option<(&'static str, String, String)> {
    let at = |register: u8| state[usize::from(register - CALIB_STAT)];
    // The upper half of OPR_MODE is reserved.
    let mode = at(0x3D) & 0x0F;
    if mode != MODE.bits() {
        return Some(("its mode", format!("{:#04x}", MODE.bits()), format!("{mode:#04x}")));
    }
    if at(UNIT_SEL) != UNITS {
        return Some(("its units", format!("{UNITS:#04x}"), format!("{:#04x}", at(UNIT_SEL))));
    }
    let axes = [at(AXIS_MAP), at(AXIS_MAP + 1)];
    (axes != AXES).then(|| ("its axis map", format!("{AXES:02x?}"), format!("{axes:02x?}")))
}

/// Whether the chip has only left its mode: a reset would have taken its units along.
fn only_mode_is_wrong(state: &[u8; 14]) -> bool {
    let mut state = *state;
    state[usize::from(0x3D - CALIB_STAT)] = MODE.bits();
    wrong_setting(&state).is_none()
}

/// Gyro, Euler angles (unused: they jump beyond 20 degrees of tilt), quaternion, linear acceleration.
fn decode(frame: &[u8; 26]) -> ImuSample {
    let raw = |at: usize| f64::from(i16::from_le_bytes([frame[at], frame[at + 1]]));
    let vector = |at: usize, scale: f64| [0, 2, 4].map(|i| raw(at + i) * scale);
    ImuSample {
        rate: vector(0, RATE_SCALE),
        quaternion: [12, 14, 16, 18].map(|at| raw(at) * QUATERNION_SCALE),
        acceleration: vector(20, ACCELERATION_SCALE),
        health: ImuHealth::Good,
        ..ImuSample::default()
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
