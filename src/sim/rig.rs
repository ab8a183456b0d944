//! The whole simulated rig: plant and chips on the buses of a wiring, for the real drivers to find.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use embedded_hal::digital;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::chips::{
    Ads1115Chip, AlicatChip, Bno055Chip, Bno055Sim, Mcp4728Chip, MemoryStream, Mischief, Orientation, Promote, Pty,
    PwmChip, SerialLine, SimI2c,
};
use super::plant::SCATTER_CUT;
use super::{AnalogueSim, BenchConfig, Plant};
use crate::clock::Clock;
use crate::hardware::HardwareError;
use crate::hardware::gpio::{Contact, GpioValve, OpenPin};
use crate::hardware::wiring::{AdcWiring, DacWiring, ImuWiring, SerialWiring, Wiring};
use crate::signal::mounting;

/// The buses run at the Linux default.
const I2C_HERTZ: u32 = 100_000;
/// An MCP4728 on its internal reference at gain 2 gives one millivolt per code.
const CODES_PER_VOLT: f64 = 1000.0;

/// A simulated rig.
pub struct SimRig {
    plant: Arc<Mutex<Plant>>,
    buses: Vec<(SimI2c, Clock)>,
    lines: Vec<Arc<Mutex<SerialLine>>>,
    imus: BTreeMap<usize, Mischief>,
    regulators: BTreeMap<usize, Mischief>,
    sensors: BTreeMap<usize, Mischief>,
    /// Whether the wire between a FREE's pressure sensor and its ADC is cut.
    cut: BTreeMap<usize, Arc<AtomicBool>>,
    button: Button,
    one_shot: bool,
    /// The output behind the dump valve's coil keeps its level whatever it is told.
    coil_stuck: Arc<AtomicBool>,
}

impl SimRig {
    /// The rig of `bench` on `wiring`, at rest and vented, from `clock`'s present on. `axes` are the FREEs' axes
    /// in their sensors' frames, by FREE.
    pub fn new(bench: &BenchConfig, wiring: &Wiring, axes: &[[f64; 3]], clock: &Clock) -> Self {
        let plant = Arc::new(Mutex::new(Plant::new(bench).starting_at(clock.now())));
        let mut rig = Self {
            plant,
            buses: Vec::new(),
            lines: Vec::new(),
            imus: BTreeMap::new(),
            regulators: BTreeMap::new(),
            sensors: BTreeMap::new(),
            cut: BTreeMap::new(),
            button: Button::default(),
            one_shot: bench.one_shot,
            coil_stuck: Arc::default(),
        };
        for wiring in &wiring.i2c {
            let clock = clock.fork();
            let bus = SimI2c::new(clock.clone(), I2C_HERTZ);
            for imu in &wiring.imus {
                rig.attach_imu(bench, imu, axes, &bus);
            }
            for dac in &wiring.dacs {
                rig.attach_dac(bench, dac, &bus);
            }
            for adc in &wiring.adcs {
                rig.attach_adc(adc, &bus);
            }
            rig.buses.push((bus, clock));
        }
        for (index, wiring) in wiring.serial.iter().enumerate() {
            let line = rig.line_of(bench, wiring, bench.seed.wrapping_add(index as u64));
            rig.lines.push(line);
        }
        rig
    }

    fn attach_imu(&mut self, bench: &BenchConfig, wiring: &ImuWiring, axes: &[[f64; 3]], bus: &SimI2c) {
        let Some(&free) = wiring.frees.first() else { return };
        let axis = axes.get(free).copied().unwrap_or([0.0, 0.0, 1.0]);
        let plant = self.plant();
        let turn = mounting(axis);
        let motion = move |time| {
            let motion = plant.lock().unwrap_or_else(PoisonError::into_inner).orientation(free, time);
            // The sensor's frame has the FREE's z along `axis`, turned there the short way.
            let along = |v: [f64; 3]| <[f64; 3]>::from(turn * Vector3::from(v));
            let [w, x, y, z] = motion.quaternion;
            let [i, j, k] = along([x, y, z]);
            Orientation { quaternion: [w, i, j, k], rate: along(motion.rate), acceleration: along(motion.acceleration) }
        };
        let sim = Bno055Sim::new(bench.imu, bench.seed.wrapping_mul(31).wrapping_add(free as u64));
        let mischief = bus.attach(wiring.address, Bno055Chip::new(sim, Box::new(motion)));
        for &free in &wiring.frees {
            self.imus.insert(free, mischief.clone());
        }
    }

    fn attach_dac(&mut self, bench: &BenchConfig, wiring: &DacWiring, bus: &SimI2c) {
        let plant = self.plant();
        let frees: Vec<_> = wiring.channels.iter().flatten().map(|c| c.free).collect();
        let inputs: Vec<_> = frees.into_iter().filter_map(|free| Some((free, Self::analogue(bench, free)?))).collect();
        let sink = move |time, volts: [f64; 4]| {
            let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
            for (free, input) in &inputs {
                let code = volts.get(input.channel).copied().unwrap_or(0.0) * CODES_PER_VOLT;
                let pascals = ((code - input.zero_code) * input.pascals_per_code).max(0.0);
                plant.set_setpoint(*free, pascals, time);
            }
        };
        let mischief = bus.attach(wiring.address, Mcp4728Chip::programmed(wiring.address, Box::new(sink)));
        for channel in wiring.channels.iter().flatten() {
            self.regulators.insert(channel.free, mischief.clone());
        }
    }

    fn attach_adc(&mut self, wiring: &AdcWiring, bus: &SimI2c) {
        let (plant, channels) = (self.plant(), wiring.channels);
        let cut = channels.map(|channel| channel.map(|_| Arc::new(AtomicBool::new(false))));
        for (channel, cut) in channels.iter().flatten().zip(cut.iter().flatten()) {
            self.cut.insert(channel.free, Arc::clone(cut));
        }
        let source = move |index: usize, time| match (channels[index], &cut[index]) {
            (Some(map), Some(cut)) if !cut.load(Ordering::Relaxed) => {
                let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
                map.zero_volts + plant.reading(map.free, time) / map.pascals_per_volt
            }
            _ => 0.0,
        };
        let mischief = bus.attach(wiring.address, Ads1115Chip::new(Box::new(source)));
        for channel in wiring.channels.iter().flatten() {
            self.sensors.insert(channel.free, mischief.clone());
        }
    }

    fn line_of(&mut self, bench: &BenchConfig, wiring: &SerialWiring, seed: u64) -> Arc<Mutex<SerialLine>> {
        let mut line = SerialLine::new(wiring.baud, seed);
        for unit in &wiring.units {
            let mischief = line.attach(AlicatChip::new(*unit, self.plant()));
            let devices = if unit.gauge { &mut self.sensors } else { &mut self.regulators };
            devices.insert(unit.free, mischief);
        }
        for pwm in &wiring.pwms {
            let free = pwm.channel.free;
            if let Some(input) = Self::analogue(bench, free) {
                let mischief = line.attach(PwmChip::new(pwm.id, free, input, self.plant()));
                self.regulators.insert(free, mischief);
            }
        }
        Arc::new(Mutex::new(line))
    }

    /// The plant.
    pub fn plant(&self) -> Arc<Mutex<Plant>> {
        Arc::clone(&self.plant)
    }

    /// The I2C bus of that index in the wiring, with the clock of its owner, which its transfers move.
    pub fn i2c(&self, index: usize) -> Option<(SimI2c, Clock)> {
        self.buses.get(index).cloned()
    }

    /// The serial line of that index in the wiring: to look at its units, and to pull its plug.
    pub fn line(&self, index: usize) -> Option<&Arc<Mutex<SerialLine>>> {
        self.lines.get(index)
    }

    /// The true input of a FREE's analogue regulator on the rig of `bench`; none where it has none.
    pub fn analogue(bench: &BenchConfig, free: usize) -> Option<AnalogueSim> {
        let plant = bench.plants.get(free)?;
        let nominal = plant.analogue?;
        let mut rng = Pcg64::seed_from_u64(bench.seed.wrapping_mul(1009).wrapping_add(free as u64));
        let mut off = || {
            let x: f64 = StandardNormal.sample(&mut rng);
            plant.scatter * x.clamp(-SCATTER_CUT, SCATTER_CUT)
        };
        Some(AnalogueSim {
            zero_code: (nominal.zero_code + AnalogueSim::ZERO_SPREAD * off()).max(0.0),
            pascals_per_code: nominal.pascals_per_code * (1.0 + off()),
            ..nominal
        })
    }

    /// The computer's end of a serial line in memory.
    ///
    /// # Errors
    /// If there is no such line, or it is not plugged in.
    pub fn open_line(line: &Arc<Mutex<SerialLine>>, clock: &Clock) -> Result<MemoryStream, HardwareError> {
        MemoryStream::open(line, clock.clone()).map_err(|error| HardwareError::Open {
            device: "simulated serial line".into(),
            reason: error.to_string(),
            remedy: "Plug the simulated line in".into(),
        })
    }

    /// A serial line as a pseudo-terminal, under the path `link`, served by a thread that calls `promote` first.
    ///
    /// # Errors
    /// If the system gives none, or there is no such line.
    pub fn pty(&self, index: usize, link: &Path, promote: Promote) -> io::Result<Pty> {
        let line = self.lines.get(index).ok_or(io::ErrorKind::NotFound)?;
        Pty::new(Arc::clone(line), link, promote)
    }

    /// Makes the IMU of a FREE misbehave.
    pub fn imu(&self, free: usize) -> Option<&Mischief> {
        self.imus.get(&free)
    }

    /// Makes the regulator of a FREE misbehave.
    pub fn regulator(&self, free: usize) -> Option<&Mischief> {
        self.regulators.get(&free)
    }

    /// Makes the sensor of a FREE's pressure misbehave, where it has one of its own.
    pub fn sensor(&self, free: usize) -> Option<&Mischief> {
        self.sensors.get(&free)
    }

    /// Cuts the wire between the pressure sensor of a FREE and its ADC, or mends it.
    pub fn cut_sensor(&self, free: usize, cut: bool) {
        if let Some(wire) = self.cut.get(&free) {
            wire.store(cut, Ordering::Relaxed);
        }
    }

    /// The dump valve on its simulated lines, moved on `clock`.
    pub fn dump_valve(&self, clock: Clock) -> GpioValve<SimOutput> {
        let output = |drives, stuck: &Arc<AtomicBool>| {
            let (plant, clock, stuck) = (self.plant(), clock.clone(), Arc::clone(stuck));
            let open: OpenPin<SimOutput> = Box::new(move || {
                Ok(SimOutput { plant: Arc::clone(&plant), clock: clock.clone(), drives, stuck: Arc::clone(&stuck) })
            });
            open
        };
        let heartbeat = self.one_shot.then(|| output(Drives::Heartbeat, &Arc::default()));
        GpioValve::new(output(Drives::Coil, &self.coil_stuck), heartbeat, &clock)
    }

    /// Has the output stage behind the dump valve's coil keep its level whatever it is told, or repairs it.
    pub fn stick_coil(&self, stuck: bool) {
        self.coil_stuck.store(stuck, Ordering::Relaxed);
    }

    /// The reset line of the IMU at `address` of the bus of that index.
    pub fn reset_line(&self, index: usize, address: u8) -> Option<OpenPin<SimReset>> {
        let (bus, _) = self.i2c(index)?;
        Some(Box::new(move || Ok(SimReset { bus: bus.clone(), address })))
    }

    /// The emergency stop.
    pub fn button(&self) -> Button {
        self.button.clone()
    }

    /// The line of `contact`, looked at on `clock`.
    pub fn contact(&self, contact: Contact, clock: Clock) -> OpenPin<SimInput> {
        let (plant, button) = (self.plant(), self.button());
        Box::new(move || {
            let (plant, button, clock) = (Arc::clone(&plant), button.clone(), clock.clone());
            Ok(SimInput(match contact {
                Contact::Stop => Box::new(move || !button.0.load(Ordering::Relaxed)),
                Contact::Supply => {
                    Box::new(move || plant.lock().unwrap_or_else(PoisonError::into_inner).supply_suffices(clock.now()))
                }
            }))
        })
    }
}

/// What a simulated output drives.
#[derive(Clone, Copy, Debug)]
enum Drives {
    Coil,
    Heartbeat,
}

/// A simulated output line.
pub struct SimOutput {
    plant: Arc<Mutex<Plant>>,
    clock: Clock,
    drives: Drives,
    stuck: Arc<AtomicBool>,
}

impl SimOutput {
    fn set(&mut self, high: bool) {
        if self.stuck.load(Ordering::Relaxed) {
            return;
        }
        let mut plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        match self.drives {
            Drives::Coil => plant.set_dump(!high, self.clock.now()),
            Drives::Heartbeat => plant.beat(self.clock.now()),
        }
    }
}

impl digital::ErrorType for SimOutput {
    type Error = Infallible;
}

impl digital::OutputPin for SimOutput {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}

/// The simulated reset line of a chip.
pub struct SimReset {
    bus: SimI2c,
    address: u8,
}

impl digital::ErrorType for SimReset {
    type Error = Infallible;
}

impl digital::OutputPin for SimReset {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.bus.pull_reset(self.address);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The simulated emergency stop: a contact that is closed until somebody presses it, or cuts its wire.
#[derive(Clone, Debug, Default)]
pub struct Button(Arc<AtomicBool>);

impl Button {
    /// Presses the stop, or releases it.
    pub fn press(&self, pressed: bool) {
        self.0.store(pressed, Ordering::Relaxed);
    }
}

/// A simulated input line, by what it looks at.
pub struct SimInput(Box<dyn FnMut() -> bool + Send>);

impl digital::ErrorType for SimInput {
    type Error = Infallible;
}

impl digital::InputPin for SimInput {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok((self.0)())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!(self.0)())
    }
}
