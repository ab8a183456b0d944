//! A simulated BNO055: register file with pages, modes and their change times, reset, units, quantisation,
//! 100 Hz fusion frames with latency and noise (Bosch BST-BNO055-DS000).

use std::time::Duration;

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::i2c::{I2cChip, Nak};
use crate::clock::Time;
use crate::sim::ImuSim;

/// From power-on or reset to the first acknowledge: table 0-2 gives 650 ms as typical, and this chip is a slow one.
const START: Duration = Duration::from_millis(690);
/// From CONFIG to any other mode, and back (table 3-6).
const LEAVE_CONFIG: Duration = Duration::from_millis(7);
const ENTER_CONFIG: Duration = Duration::from_millis(19);
/// Standard deviation of the linear acceleration, m/s2: 150 ug/sqrt(Hz) over 62.5 Hz of bandwidth.
const ACCELERATION_NOISE: f64 = 0.0116;
/// The fusion calls the gyro calibrated after this many frames at rest without a profile, and with one.
const STILL_FRAMES: (u32, u32) = (300, 10);
/// Below it the sensor counts as at rest, rad/s.
const STILL_RATE: f64 = 0.02;

const PAGE_ID: u8 = 0x07;
const DATA: std::ops::Range<u8> = 0x08..0x35;
const CALIB_STAT: u8 = 0x35;
const UNIT_SEL: u8 = 0x3B;
const OPR_MODE: u8 = 0x3D;
const PWR_MODE: u8 = 0x3E;
const SYS_TRIGGER: u8 = 0x3F;
const AXIS_MAP_CONFIG: u8 = 0x41;
const AXIS_MAP_SIGN: u8 = 0x42;
const PROFILE: std::ops::RangeInclusive<u8> = 0x55..=0x6A;

/// How the sensor moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// Unit quaternion (w, x, y, z), sensor to world.
    pub quaternion: [f64; 4],
    /// Angular rate in the sensor's frame, rad/s.
    pub rate: [f64; 3],
    /// Linear acceleration in the sensor's frame without gravity, m/s2.
    pub acceleration: [f64; 3],
}

/// Where the motion comes from. It is asked for the time of a fusion frame less the sensor's delay: a little
/// before the present (at most one frame and the delay), and never a time before an earlier question's.
pub type Motion = Box<dyn FnMut(Time) -> Orientation + Send>;

/// What a BNO055 is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Bno055Sim {
    /// Delay and noise.
    pub imu: ImuSim,
    /// Period of the fusion frames: 10 ms, of the chip's own oscillator.
    pub frame: Duration,
    /// Its own unique number.
    pub unique_id: [u8; 16],
    /// Seed of noise and phase.
    pub seed: u64,
}

impl Bno055Sim {
    /// A sensor whose oscillator, number and noise follow from `seed`; the oscillator is off by up to 0.5 %.
    pub fn new(imu: ImuSim, seed: u64) -> Self {
        let mut draw = Pcg64::seed_from_u64(seed);
        let frame = Duration::from_nanos(draw.random_range(9_950_000..=10_050_000));
        Self { imu, frame, unique_id: draw.random(), seed: draw.random() }
    }
}

/// The chip.
pub struct Bno055Chip {
    sim: Bno055Sim,
    motion: Motion,
    noise: Pcg64,
    page: [[u8; 128]; 2],
    /// Register of the next read.
    pointer: u8,
    /// From when on it answers.
    awake: Time,
    /// When the present mode has been reached: frames are counted from here.
    running_since: Time,
    /// Frames that the registers have seen.
    frames: u64,
    still: u32,
    calibrated: bool,
    frozen: bool,
}

impl Bno055Chip {
    /// A chip that measures `motion`.
    pub fn new(sim: Bno055Sim, motion: Motion) -> Self {
        let noise = Pcg64::seed_from_u64(sim.seed);
        Self {
            sim,
            motion,
            noise,
            page: [[0; 128]; 2],
            pointer: 0,
            awake: Time::ZERO,
            running_since: Time::ZERO,
            frames: 0,
            still: 0,
            calibrated: false,
            frozen: false,
        }
    }

    fn mode(&self) -> u8 {
        self.page[0][usize::from(OPR_MODE)] & 0x0F
    }

    fn is_fusion(&self) -> bool {
        (0x08..=0x0C).contains(&self.mode())
    }

    /// Registers at their reset values (table 4-2).
    fn reset(&mut self, now: Time) {
        self.page = [[0; 128]; 2];
        self.awake = now + START;
        self.running_since = self.awake;
        (self.frames, self.still, self.calibrated) = (0, 0, false);
        for (register, value) in [
            (0x00, 0xA0), // chip
            (0x01, 0xFB), // accelerometer
            (0x02, 0x32), // magnetometer
            (0x03, 0x0F), // gyro
            (0x04, 0x11), // software 3.11
            (0x05, 0x03),
            (0x06, 0x15), // boot loader
            (0x34, 25),   // degrees Celsius
            (0x36, 0x0F), // every self-test passed
            (0x38, 0x00),
            (UNIT_SEL, 0x80),
            (OPR_MODE, 0x10), // CONFIG; the upper half is reserved and not zero
            (AXIS_MAP_CONFIG, 0x24),
        ] {
            self.page[0][usize::from(register)] = value;
        }
        let page = &mut self.page[1];
        page[0x08..0x0B].copy_from_slice(&[0x0D, 0x6D, 0x38]);
        page[0x50..0x60].copy_from_slice(&self.sim.unique_id);
    }

    /// Brings status, data and calibration up to `now`.
    fn refresh(&mut self, now: Time) {
        if self.frozen {
            return;
        }
        let running = now >= self.running_since;
        let status = match (self.mode(), running) {
            (0, _) | (_, false) => 0,
            _ if self.is_fusion() => 5,
            _ => 6,
        };
        self.page[0][0x39] = status;
        if status != 5 {
            return;
        }
        let elapsed = now.since(self.running_since).as_nanos() as u64;
        let frame = self.sim.frame.as_nanos() as u64;
        let frames = elapsed / frame;
        if frames > self.frames {
            let at = self.running_since + Duration::from_nanos(frames * frame);
            let motion = (self.motion)(at - self.sim.imu.delay);
            self.count_still(frames - self.frames, &motion);
            // The noise belongs to the frame, not to how often somebody looks.
            self.noise = Pcg64::seed_from_u64(self.sim.seed ^ at.as_nanos().wrapping_mul(0x9E37_79B9_7F4A_7C15));
            self.frames = frames;
            self.show(motion);
        }
    }

    fn count_still(&mut self, frames: u64, motion: &Orientation) {
        let at_rest = Vector3::from(motion.rate).norm() < STILL_RATE;
        let frames = u32::try_from(frames).unwrap_or(u32::MAX);
        self.still = if at_rest { self.still.saturating_add(frames) } else { 0 };
        let profile = self.page[0][usize::from(*PROFILE.start())..=usize::from(*PROFILE.end())].iter().any(|&b| b != 0);
        let wanted = if profile { STILL_FRAMES.1 } else { STILL_FRAMES.0 };
        if self.still >= wanted && !self.calibrated {
            self.calibrated = true;
            if !profile {
                self.find_offsets();
            }
        }
        let gyro = if self.calibrated { 3 } else { (self.still * 3 / wanted).min(2) as u8 };
        let accelerometer = if profile { 3 } else { 0 };
        let system = if gyro == 3 && accelerometer == 3 { 3 } else { 0 };
        self.page[0][usize::from(CALIB_STAT)] = system << 6 | gyro << 4 | accelerometer << 2;
    }

    /// What the chip makes of its rest: offsets of accelerometer and gyro, each sensor's own, and the radii that it
    /// begins with.
    fn find_offsets(&mut self) {
        let mut own = Pcg64::seed_from_u64(self.sim.seed ^ 0x55);
        let offsets: [i16; 9] = std::array::from_fn(|i| match i {
            0..=2 => own.random_range(-30..=30),
            // The magnetometer is not used.
            3..=5 => 0,
            _ => own.random_range(-8..=8),
        });
        let registers = offsets.into_iter().chain([1000, 480]).flat_map(i16::to_le_bytes);
        for (register, byte) in PROFILE.zip(registers) {
            self.page[0][usize::from(register)] = byte;
        }
    }

    /// Writes one fusion frame into the data registers, with noise, axis map, units and quantisation.
    fn show(&mut self, motion: Orientation) {
        let imu = self.sim.imu;
        let map = self.axis_map();
        let [w, x, y, z] = motion.quaternion;
        let shake = UnitQuaternion::from_scaled_axis(self.normal() * imu.noise);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(map));
        let q = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)) * shake * turn.inverse();
        let rate = map * (Vector3::from(motion.rate) + self.normal() * imu.rate_noise);
        let acceleration = map * (Vector3::from(motion.acceleration) + self.normal() * ACCELERATION_NOISE);
        let units = self.page[0][usize::from(UNIT_SEL)];
        // Table 3-22 and those after it: least significant bits per SI unit.
        let per_rate = if units & 2 == 0 { 16f64.to_degrees() } else { 900.0 };
        let per_acceleration = if units & 1 == 0 { 100.0 } else { 1000.0 / 9.80665 };
        let per_angle = if units & 4 == 0 { 16f64.to_degrees() } else { 900.0 };
        let (roll, pitch, heading) = q.euler_angles();
        let gravity = q.inverse() * Vector3::new(0.0, 0.0, 9.80665);
        let heading = (-heading).rem_euclid(std::f64::consts::TAU);
        self.put(0x08, &(acceleration + gravity), per_acceleration);
        self.put(0x14, &rate, per_rate);
        self.put(0x1A, &Vector3::new(heading, roll, pitch), per_angle);
        self.put(0x22, &q.imag(), 16384.0);
        self.put_one(0x20, q.w, 16384.0);
        self.put(0x28, &acceleration, per_acceleration);
        self.put(0x2E, &gravity, per_acceleration);
    }

    fn put(&mut self, register: u8, value: &Vector3<f64>, scale: f64) {
        for (i, v) in (0u8..).zip(value.iter()) {
            self.put_one(register + 2 * i, *v, scale);
        }
    }

    fn put_one(&mut self, register: u8, value: f64, scale: f64) {
        let raw = (value * scale).round().clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16;
        self.page[0][usize::from(register)..][..2].copy_from_slice(&raw.to_le_bytes());
    }

    fn normal(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.noise.sample(StandardNormal))
    }

    /// From the chip's own axes to the mapped ones (section 3.4); a map that is no rotation counts as none.
    fn axis_map(&self) -> Matrix3<f64> {
        let (config, sign) = (self.page[0][usize::from(AXIS_MAP_CONFIG)], self.page[0][usize::from(AXIS_MAP_SIGN)]);
        let mut map = Matrix3::<f64>::zeros();
        for row in 0..3 {
            let column = usize::from(config >> (2 * row) & 3);
            if column < 3 {
                map[(row, column)] = if sign >> (2 - row) & 1 == 1 { -1.0 } else { 1.0 };
            }
        }
        if (map.determinant() - 1.0).abs() < 1e-9 { map } else { Matrix3::identity() }
    }

    fn store(&mut self, now: Time, register: u8, value: u8) {
        if register == PAGE_ID {
            let page = value & 1;
            self.page[0][usize::from(PAGE_ID)] = page;
            self.page[1][usize::from(PAGE_ID)] = page;
            return;
        }
        let config = self.mode() == 0;
        let page = usize::from(self.page[0][usize::from(PAGE_ID)]);
        match (page, register) {
            (0, SYS_TRIGGER) if value & 0x20 != 0 => self.reset(now),
            (0, SYS_TRIGGER) => self.page[0][usize::from(SYS_TRIGGER)] = value & 0x80,
            (0, OPR_MODE) => self.enter(now, value & 0x0F),
            // Silently ignored outside CONFIG mode.
            (0, UNIT_SEL | PWR_MODE | AXIS_MAP_CONFIG | AXIS_MAP_SIGN) if config => {
                self.page[0][usize::from(register)] = value;
            }
            (0, r) if config && PROFILE.contains(&r) => self.page[0][usize::from(register)] = value,
            (1, 0x08..=0x1F) if config => self.page[1][usize::from(register)] = value,
            _ => {}
        }
    }

    fn enter(&mut self, now: Time, mode: u8) {
        if mode == self.mode() || mode > 0x0C {
            return;
        }
        self.page[0][usize::from(OPR_MODE)] = 0x10 | mode;
        self.running_since = now + if mode == 0 { ENTER_CONFIG } else { LEAVE_CONFIG };
        (self.frames, self.still, self.calibrated) = (0, 0, false);
        self.page[0][usize::from(DATA.start)..usize::from(DATA.end - 1)].fill(0);
        self.page[0][usize::from(CALIB_STAT)] = 0;
    }
}

impl I2cChip for Bno055Chip {
    fn write(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak> {
        if now < self.awake {
            return Err(Nak);
        }
        let Some((&pointer, values)) = bytes.split_first() else { return Ok(()) };
        self.pointer = pointer;
        for &value in values {
            self.store(now, self.pointer, value);
            self.pointer = self.pointer.wrapping_add(1);
        }
        Ok(())
    }

    fn read(&mut self, now: Time, bytes: &mut [u8]) -> Result<(), Nak> {
        if now < self.awake {
            return Err(Nak);
        }
        self.refresh(now);
        let page = usize::from(self.page[0][usize::from(PAGE_ID)]);
        for byte in bytes {
            let register = self.page[page].get(usize::from(self.pointer)).copied().unwrap_or(0);
            *byte = register;
            self.pointer = self.pointer.wrapping_add(1);
        }
        Ok(())
    }

    fn attached(&mut self, now: Time) {
        self.reset(now);
        self.awake = now;
    }

    fn power_on(&mut self, now: Time) {
        self.frozen = false;
        self.reset(now);
    }

    fn freeze(&mut self, now: Time, frozen: bool) {
        self.refresh(now);
        self.frozen = frozen;
    }
}
