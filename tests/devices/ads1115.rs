//! The ADS1115 driver against the simulated chip, at register level.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use embedded_hal::i2c::I2c;
use freerig::clock::{Clock, Stepper};
use freerig::hardware::HardwareError;
use freerig::hardware::ads1115::{Ads1115, CONVERSION_TIME, VOLTS_PER_COUNT};
use freerig::sim::chips::{Ads1115Chip, Misbehaviour, Mischief, SimI2c};

struct Bench {
    _stepper: Stepper,
    clock: Clock,
    bus: SimI2c,
    chip: Mischief,
    driver: Ads1115<SimI2c>,
    volts: Arc<Mutex<[f64; 4]>>,
}

fn bench() -> Bench {
    let stepper = Stepper::new();
    let clock = stepper.clock().fork();
    let bus = SimI2c::new(clock.clone(), 400_000);
    let volts = Arc::new(Mutex::new([0.5, 1.0, 2.0, 4.5]));
    let source = volts.clone();
    let chip = bus.attach(0x48, Ads1115Chip::new(Box::new(move |channel, _| source.lock().unwrap()[channel])));
    let driver = Ads1115::new(bus.clone(), "bench", 0x48);
    Bench { _stepper: stepper, clock, bus, chip, driver, volts }
}

impl Bench {
    fn wait(&self) {
        self.clock.block_until(self.clock.now() + CONVERSION_TIME);
    }

    fn read(&mut self, channel: usize) -> Result<f64, HardwareError> {
        self.driver.start(channel)?;
        self.wait();
        self.driver.finish(channel)
    }
}

#[test]
fn every_channel_reads_its_own_voltage_to_half_a_count() {
    let mut b = bench();
    b.driver.connect().unwrap();
    for (channel, volts) in [0.5, 1.0, 2.0, 4.5].into_iter().enumerate() {
        let read = b.read(channel).unwrap();
        assert!((read - volts).abs() <= 0.5 * VOLTS_PER_COUNT + 1e-12, "{channel}: {read}");
    }
    b.volts.lock().unwrap()[0] = 20.0;
    assert!((b.read(0).unwrap() - 5.3).abs() < 1e-3, "the supply is the end");
}

#[test]
fn another_chip_at_the_address_is_named() {
    let mut b = bench();
    b.bus.write(0x48, &[3, 0x12, 0x34]).unwrap();
    let error = b.driver.connect().unwrap_err();
    assert!(matches!(&error, HardwareError::WrongIdentity { found, .. } if found == "0x1234"), "{error}");
    let error = Ads1115::new(b.bus.clone(), "bench", 0x49).connect().unwrap_err();
    assert!(matches!(error, HardwareError::NoAnswer { .. }), "{error}");
}

#[test]
fn what_is_not_ready_not_asked_for_or_garbled_is_no_reading() {
    let mut b = bench();
    b.driver.connect().unwrap();
    b.driver.start(1).unwrap();
    let early = b.driver.finish(1).unwrap_err();
    assert!(matches!(early, HardwareError::NoAnswer { .. }), "{early}");
    b.wait();
    let other = b.driver.finish(2).unwrap_err();
    assert!(matches!(other, HardwareError::Malformed { .. }), "{other}");
    assert!(b.driver.finish(1).is_ok());
    // A reset between the beginning and the end.
    b.driver.start(1).unwrap();
    b.wait();
    b.chip.next(1, Misbehaviour::Reset);
    let reset = b.driver.finish(1).unwrap_err();
    assert!(matches!(reset, HardwareError::Malformed { .. }), "{reset}");
    b.read(1).unwrap();
    // Random bytes pass with a chance of 2^-16.
    b.chip.always(Misbehaviour::Garbage);
    for _ in 0..100 {
        let garbled = b.read(1).unwrap_err();
        assert!(matches!(garbled, HardwareError::Malformed { .. } | HardwareError::NoAnswer { .. }), "{garbled}");
    }
    b.chip.always(Misbehaviour::Nak);
    assert!(matches!(b.read(1), Err(HardwareError::NoAnswer { .. })));
    b.chip.stop();
    b.read(1).unwrap();
}

#[test]
fn a_conversion_and_its_transfers_fit_into_a_turn() {
    let mut b = bench();
    b.driver.connect().unwrap();
    let before = b.clock.now();
    b.driver.start(0).unwrap();
    let started = b.clock.now();
    b.wait();
    let waited = b.clock.now();
    b.driver.finish(0).unwrap();
    let bus = started.since(before) + b.clock.now().since(waited);
    assert!(bus < Duration::from_micros(400), "four and twice five bytes at 400 kHz: {bus:?}");
}
