//! The MCP4728's driver against byte-exact transcripts, and against the simulated chip on the stepped clock.

use std::future::Future;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use embedded_hal::i2c::{ErrorKind, NoAcknowledgeSource};
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use freerig::clock::{Clock, Stepper};
use freerig::hardware::mcp4728::{Mcp4728, code_of, pressure_of};
use freerig::hardware::wiring::DacChannel;
use freerig::hardware::{HardwareError, PressureRegulator};
use freerig::signal::RegulatorHealth;
use freerig::sim::chips::{DacRegister, Mcp4728Chip, Misbehaviour, SimI2c};

const ADDRESS: u8 = 0x60;
const ZERO: [u8; 12] = [0x40, 0x90, 0, 0x42, 0x90, 0, 0x44, 0x90, 0, 0x46, 0x90, 0];

/// The status of a chip whose registers and EEPROM hold these codes (internal reference, gain two).
fn status(codes: [u16; 4], eeprom: [u16; 4]) -> Vec<u8> {
    (0u8..4)
        .flat_map(|channel| {
            [codes, eeprom].into_iter().flat_map(move |set| {
                let [high, low] = set[usize::from(channel)].to_be_bytes();
                [0xC0 | channel << 4, 0x90 | high, low]
            })
        })
        .collect()
}

fn connection(eeprom: [u16; 4]) -> Vec<Transaction> {
    vec![
        Transaction::read(ADDRESS, status([0; 4], eeprom)),
        Transaction::write(ADDRESS, ZERO.to_vec()),
        Transaction::read(ADDRESS, status([0; 4], eeprom)),
    ]
}

fn with_mock<R>(transactions: &[Transaction], test: impl FnOnce(&mut Mcp4728<Mock>) -> R) -> R {
    let mut mock = Mock::new(transactions);
    let result = test(&mut Mcp4728::new(mock.clone(), Clock::Live, "mock", ADDRESS));
    mock.done();
    result
}

#[test]
fn connecting_reads_first_and_its_first_frame_is_zero() {
    with_mock(&connection([0; 4]), |dac| dac.connect().expect("connects"));
}

#[test]
fn codes_go_out_as_multi_write_which_leaves_the_eeprom_alone() {
    let write = |udac: u8| {
        vec![0x40 | udac, 0x91, 0x23, 0x42 | udac, 0x90, 0x00, 0x44 | udac, 0x9F, 0xFF, 0x46 | udac, 0x90, 0x01]
    };
    let transactions = [
        Transaction::write(ADDRESS, write(0)),
        Transaction::write(ADDRESS, write(1)),
        Transaction::write(0x00, vec![0x08]),
    ];
    with_mock(&transactions, |dac| {
        // 5000 is cut to the highest code instead of running into the gain bit.
        dac.write([0x123, 0, 5000, 1]).expect("writes");
        dac.write_together([0x123, 0, 5000, 1]).expect("writes");
    });
}

#[test]
fn an_eeprom_that_starts_with_pressure_is_refused_with_its_remedy() {
    let error = with_mock(&connection([0, 0x800, 0, 1]), |dac| dac.connect().expect_err("refuses"));
    let text = error.to_string();
    assert!(matches!(error, HardwareError::Unsafe { .. }), "{text}");
    assert!(text.contains("B at code 2048, D at code 1") && text.contains("EEPROM to zero"), "{text}");
}

#[test]
fn a_channel_that_starts_powered_down_is_safe_whatever_its_code() {
    let mut bytes = status([0; 4], [0, 0x800, 0, 0]);
    bytes[10] |= 0x60; // channel B's EEPROM: 500 kOhm to ground
    let transactions = [
        Transaction::read(ADDRESS, bytes.clone()),
        Transaction::write(ADDRESS, ZERO.to_vec()),
        Transaction::read(ADDRESS, bytes),
    ];
    with_mock(&transactions, |dac| dac.connect().expect("connects"));
}

#[test]
fn an_mcp4725_at_the_same_address_is_not_written_to() {
    // Its five bytes, over and over: it would take the zero frame for code 0x900.
    let answer: Vec<u8> = [0xC0, 0x80, 0x00, 0x08, 0x00].into_iter().cycle().take(24).collect();
    let error = with_mock(&[Transaction::read(ADDRESS, answer)], |dac| dac.connect().expect_err("refuses"));
    assert!(matches!(error, HardwareError::WrongIdentity { .. }), "{error}");
    assert!(error.to_string().contains("MCP4725"), "{error}");
}

#[test]
fn a_missing_acknowledge_and_a_broken_bus_are_told_apart() {
    let missing = ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address);
    for (kind, answers) in [(missing, false), (ErrorKind::Bus, true)] {
        let transactions = [Transaction::read(ADDRESS, vec![0; 24]).with_error(kind)];
        let error = with_mock(&transactions, |dac| dac.connect().expect_err("fails"));
        assert_eq!(matches!(error, HardwareError::Transfer { .. }), answers, "{error}");
        assert!(error.to_string().contains("0x60 on mock"), "{error}");
    }
}

/// A chip on a stepped bus, its voltages, its driver and the handle that makes it misbehave.
struct Bench {
    bus: SimI2c,
    clock: Clock,
    volts: Arc<Mutex<[f64; 4]>>,
}

impl Bench {
    fn new() -> Self {
        let clock = Stepper::new().clock();
        Self { bus: SimI2c::new(clock.clone(), 400_000), clock, volts: Arc::default() }
    }

    fn sink(&self) -> Box<dyn FnMut(freerig::clock::Time, [f64; 4]) + Send> {
        let volts = self.volts.clone();
        Box::new(move |_, v| *volts.lock().expect("not poisoned") = v)
    }

    fn volts(&self) -> [f64; 4] {
        *self.volts.lock().expect("not poisoned")
    }

    fn driver(&self) -> Mcp4728<SimI2c> {
        Mcp4728::new(self.bus.clone(), self.clock.clone(), "sim", ADDRESS)
    }
}

#[test]
fn a_factory_chip_drives_half_its_range_until_it_is_programmed_once() {
    let bench = Bench::new();
    let chip = Mcp4728Chip::new(ADDRESS, bench.sink());
    let wear = chip.wear();
    let mischief = bench.bus.attach(ADDRESS, chip);
    assert_eq!(bench.volts(), [1.024; 4]);
    let mut dac = bench.driver();
    assert!(matches!(dac.connect(), Err(HardwareError::Unsafe { .. })));
    assert_eq!(bench.volts(), [0.0; 4], "a refused chip is at zero all the same");
    let begun = bench.clock.now();
    dac.program_safe_eeprom().expect("programs");
    let took = bench.clock.now().since(begun);
    assert!(took >= Duration::from_millis(25), "the write cycle is waited for: {took:?}");
    mischief.next(1, Misbehaviour::Reset);
    dac.connect().expect("connects");
    assert_eq!(bench.volts(), [0.0; 4]);
    for code in 0..100 {
        dac.write([code; 4]).expect("writes");
    }
    assert_eq!(wear.load(Ordering::Relaxed), 1, "steady writing must not wear the EEPROM");
}

#[test]
fn one_code_is_one_millivolt() {
    let bench = Bench::new();
    bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
    let mut dac = bench.driver();
    dac.connect().expect("connects");
    dac.write([1, 1000, 4095, 0]).expect("writes");
    for (volts, expected) in bench.volts().into_iter().zip([0.001, 1.0, 4.095, 0.0]) {
        assert!((volts - expected).abs() < 1e-12, "{volts} V, not {expected} V");
    }
    dac.write_together([7, 7, 7, 7]).expect("writes");
    for volts in bench.volts() {
        assert!((volts - 0.007).abs() < 1e-12, "{volts} V");
    }
    dac.zero().expect("writes");
    assert_eq!(bench.volts(), [0.0; 4]);
}

#[test]
fn a_lost_code_is_found_by_reading_back() {
    let bench = Bench::new();
    let mischief = bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
    let mut dac = bench.driver();
    dac.connect().expect("connects");
    dac.write([2000; 4]).expect("writes");
    dac.verify().expect("as written");
    mischief.next(1, Misbehaviour::Reset);
    let error = dac.verify().expect_err("the chip has started anew");
    assert!(matches!(error, HardwareError::NotTaken { what: "its codes", .. }), "{error}");
    dac.write([2000; 4]).expect("writes");
    dac.verify().expect("as written");
}

#[test]
fn every_misbehaviour_is_reported_as_what_it_is() {
    type Expected = fn(&Result<(), HardwareError>) -> bool;
    let cases: [(Misbehaviour, Expected); 6] = [
        (Misbehaviour::Nak, |r| matches!(r, Err(HardwareError::NoAnswer { .. }))),
        (Misbehaviour::Silent, |r| matches!(r, Err(HardwareError::NoAnswer { .. }))),
        (Misbehaviour::Reset, |r| matches!(r, Err(HardwareError::NotTaken { .. }))),
        (Misbehaviour::Garbage, |r| matches!(r, Err(HardwareError::WrongIdentity { .. }))),
        (Misbehaviour::Late(Duration::from_millis(3)), |r| r.is_ok()),
        (Misbehaviour::None, |r| r.is_ok()),
    ];
    for (how, expected) in cases {
        let bench = Bench::new();
        let mischief = bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
        let mut dac = bench.driver();
        dac.connect().expect("connects");
        dac.write([100; 4]).expect("writes");
        mischief.next(1, how);
        let result = dac.verify();
        assert!(expected(&result), "{how:?}: {result:?}");
    }
}

#[test]
fn a_stuck_status_does_not_pass_for_a_verified_write() {
    let bench = Bench::new();
    let mischief = bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
    let mut dac = bench.driver();
    dac.connect().expect("connects");
    mischief.always(Misbehaviour::Stuck);
    dac.verify().expect("stuck at what was written");
    dac.write([100; 4]).expect("writes");
    assert!(matches!(dac.verify(), Err(HardwareError::NotTaken { .. })));
}

#[test]
fn the_map_is_clipped_at_both_ends_and_zero_is_code_zero() {
    let map = DacChannel { free: 0, zero_code: 120.0, pascals_per_code: 25.0 };
    assert_eq!([0.0, -5.0, f64::NAN].map(|p| code_of(map, p)), [0; 3]);
    assert_eq!(code_of(map, 25_000.0), 1120);
    assert_eq!([1e9, f64::INFINITY].map(|p| code_of(map, p)), [4095; 2]);
    assert_eq!(pressure_of(map, 1120), 25_000.0);
    assert_eq!(pressure_of(map, 0), 0.0);
}

#[test]
fn as_a_regulator_it_answers_at_once_and_says_that_it_measures_nothing() {
    let bench = Bench::new();
    bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
    let mut dac = bench.driver();
    let map = DacChannel { free: 0, zero_code: 100.0, pascals_per_code: 20.0 };
    let mut regulator = dac.regulator(2, map);
    let mut context = Context::from_waker(Waker::noop());
    let connected = std::pin::pin!(regulator.connect()).poll(&mut context);
    assert!(matches!(connected, Poll::Ready(Ok(_))), "{connected:?}");
    let Poll::Ready(Ok(sample)) = std::pin::pin!(regulator.exchange(30_007.0)).poll(&mut context) else {
        panic!("a blocking bus leaves nothing to wait for");
    };
    assert_eq!((sample.health, sample.setpoint), (RegulatorHealth::Unmeasured, 30_000.0));
    assert!(sample.pressure.is_nan());
    assert_eq!(bench.volts()[2], 2.048 * 2.0 * 1600.0 / 4096.0);
    assert_eq!(bench.volts()[0], 0.0);
}

#[test]
fn registers_are_not_what_power_brings() {
    let bench = Bench::new();
    let mid = DacRegister { internal: true, power_down: 0, gain_two: true, code: 1500 };
    let chip = Mcp4728Chip::new(ADDRESS, bench.sink()).with_eeprom([mid, DacRegister::default(), mid, mid]);
    bench.bus.attach(ADDRESS, chip);
    assert_eq!(bench.volts(), [1.5, 0.0, 1.5, 1.5]);
}

#[test]
fn the_general_call_takes_every_chip_to_its_eeprom_by_one_frame() {
    with_mock(&[Transaction::write(0x00, vec![0x06])], |dac| dac.reset_all().expect("acknowledged"));
    let bench = Bench::new();
    let mischief = bench.bus.attach(ADDRESS, Mcp4728Chip::programmed(ADDRESS, bench.sink()));
    let mut dac = bench.driver();
    dac.connect().expect("connects");
    dac.write([2000; 4]).expect("writes");
    // Its own address is not acknowledged any more.
    mischief.always(Misbehaviour::Nak);
    dac.zero().expect_err("not acknowledged");
    assert!(bench.volts().iter().all(|&v| v > 1.9));
    dac.reset_all().expect("heard");
    assert_eq!(bench.volts(), [0.0; 4]);
}
