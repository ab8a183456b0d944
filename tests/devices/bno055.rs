//! The BNO055's driver against the simulated chip, through the real bus trait on the stepped clock.

use std::time::Duration;

use embedded_hal::i2c::I2c;
use freerig::clock::{Clock, Stepper, Time};
use freerig::hardware::bno055::Bno055;
use freerig::hardware::wiring::ImuProfile;
use freerig::hardware::{HardwareError, Implausible, Imu, Reading};
use freerig::signal::{ImuHealth, ImuSample};
use freerig::sim::ImuSim;
use freerig::sim::chips::{Bno055Chip, Bno055Sim, Misbehaviour, Mischief, Orientation, SimI2c};

const ADDRESS: u8 = 0x28;
/// Turn about z at this rate, rad/s: a fast FREE.
const RATE: f64 = 3.0;
const PERIOD: Duration = Duration::from_millis(10);

/// A steady turn about z, with a steady acceleration.
fn turning(time: Time) -> Orientation {
    let angle = RATE * time.seconds_since(Time::ZERO);
    Orientation {
        quaternion: [(angle / 2.0).cos(), 0.0, 0.0, (angle / 2.0).sin()],
        rate: [0.0, 0.0, RATE],
        acceleration: [0.5, -0.25, 0.125],
    }
}

fn resting(_: Time) -> Orientation {
    Orientation { quaternion: [0.5, -0.5, 0.5, -0.5], rate: [0.0; 3], acceleration: [0.0; 3] }
}

struct Bench {
    bus: SimI2c,
    clock: Clock,
    mischief: Mischief,
    unique_id: [u8; 16],
}

impl Bench {
    /// A sensor without delay and noise.
    fn new(motion: fn(Time) -> Orientation) -> Self {
        Self::with(ImuSim { delay: Duration::ZERO, noise: 0.0, rate_noise: 0.0 }, motion)
    }

    fn with(imu: ImuSim, motion: fn(Time) -> Orientation) -> Self {
        let clock = Stepper::new().clock();
        let bus = SimI2c::new(clock.clone(), 400_000);
        let sim = Bno055Sim::new(imu, 7);
        let unique_id = sim.unique_id;
        let mischief = bus.attach(ADDRESS, Bno055Chip::new(sim, Box::new(motion)));
        Self { bus, clock, mischief, unique_id }
    }

    fn driver(&self) -> Bno055<SimI2c> {
        Bno055::new(self.bus.clone(), self.clock.clone(), "sim", ADDRESS, None)
    }

    fn connected(&self) -> Bno055<SimI2c> {
        let mut imu = self.driver();
        imu.connect().expect("connects");
        imu
    }

    fn pause(&self, duration: Duration) {
        self.clock.block_until(self.clock.now() + duration);
    }

    fn raw(&self, register: u8) -> u8 {
        let mut byte = [0];
        self.bus.clone().write_read(ADDRESS, &[register], &mut byte).expect("answers");
        byte[0]
    }

    /// Reads every period until something else than a repeat comes.
    fn next(&self, imu: &mut Bno055<SimI2c>) -> Result<Reading, HardwareError> {
        loop {
            self.pause(PERIOD);
            match imu.read() {
                Ok(Reading::Repeated) => {}
                other => return other,
            }
        }
    }

    fn fresh(&self, imu: &mut Bno055<SimI2c>) -> ImuSample {
        match self.next(imu) {
            Ok(Reading::Fresh(sample)) => sample,
            other => panic!("no fresh reading: {other:?}"),
        }
    }
}

fn angle_about_z(sample: &ImuSample) -> f64 {
    2.0 * sample.quaternion[3].atan2(sample.quaternion[0])
}

/// `a - b`, wrapped into half a turn either way.
fn difference(a: f64, b: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    (a - b + turn / 2.0).rem_euclid(turn) - turn / 2.0
}

#[test]
fn set_up_leaves_imu_mode_si_like_units_and_the_unmapped_axes() {
    let bench = Bench::new(resting);
    let begun = bench.clock.now();
    let identity = bench.driver().connect().expect("connects");
    // The reset of this slow chip 690 ms, a look every 10 ms whether it is over, mode change and first frame 49 ms,
    // transfers.
    let took = bench.clock.now().since(begun).as_secs_f64();
    assert!((0.739..0.76).contains(&took), "{took} s");
    assert_eq!(bench.raw(0x3D) & 0x0F, 0x08);
    assert_eq!([0x3B, 0x41, 0x42, 0x07].map(|r| bench.raw(r)), [0x00, 0x24, 0x00, 0x00]);
    assert_eq!(identity.firmware, "3.11");
    assert_eq!(identity.serial.len(), 32);
    assert!(identity.device.contains("0x28 on sim"), "{identity}");
}

#[test]
fn readings_follow_the_motion_within_the_quantisation() {
    let delay = Duration::from_millis(4);
    let bench = Bench::with(ImuSim { delay, noise: 0.0, rate_noise: 0.0 }, turning);
    let mut imu = bench.connected();
    let mut before = 0;
    for _ in 0..300 {
        let sample = bench.fresh(&mut imu);
        assert_eq!(sample.health, ImuHealth::Good);
        assert!(sample.sequence > before);
        before = sample.sequence;
        // The frame is up to one period (at most 10.05 ms) old when it is read, its motion 4 ms older still; the time
        // stamp is that of the transfer's start, three bytes (73 us) before the chip looks.
        let lag = difference(RATE * sample.time.seconds_since(Time::ZERO), angle_about_z(&sample)) / RATE;
        // Half a count in both components of the half angle, at worst 2 * 2^-15 * sqrt 2, as a lag.
        let quantum = 2f64.powi(-14) * 1.5 / RATE;
        assert!((0.004 - 73e-6 - quantum..0.01405 + quantum).contains(&lag), "lag {lag} s");
        assert_eq!(sample.quaternion[1..3], [0.0; 2]);
        let norm = sample.quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 1e-12);
        // Half a count of 1/16 deg/s.
        assert!((sample.rate[2] - RATE).abs() <= (1.0f64 / 32.0).to_radians() + 1e-12, "{:?}", sample.rate);
        for (a, expected) in sample.acceleration.into_iter().zip([0.5, -0.25, 0.125]) {
            // Half a count and six standard deviations of the accelerometer's own noise.
            assert!((a - expected).abs() < 0.005 + 6.0 * 0.0116, "{:?}", sample.acceleration);
        }
    }
}

#[test]
fn a_frame_is_told_once() {
    let bench = Bench::new(resting);
    let mut imu = bench.connected();
    let (mut fresh, mut repeated) = (0, 0);
    let begun = bench.clock.now();
    while bench.clock.now().since(begun) < Duration::from_secs(2) {
        bench.pause(Duration::from_millis(2));
        match imu.read().expect("answers") {
            Reading::Fresh(_) => fresh += 1,
            Reading::Repeated => repeated += 1,
            other => panic!("{other:?}"),
        }
    }
    // 2 s of 10 ms frames, the oscillator off by up to 0.5 %, one frame more or less at the ends.
    assert!((198..=202).contains(&fresh), "{fresh} fresh, {repeated} repeated");
    assert!(repeated > 2 * fresh, "{fresh} fresh, {repeated} repeated");
}

#[test]
fn the_noise_is_what_was_asked_for_and_the_same_for_the_same_seed() {
    let imu = ImuSim { delay: Duration::ZERO, noise: 0.002, rate_noise: 0.01 };
    let run = || {
        let bench = Bench::with(imu, resting);
        let mut driver = bench.connected();
        (0..500).map(|_| bench.fresh(&mut driver)).collect::<Vec<_>>()
    };
    let samples = run();
    assert_eq!(samples, run());
    // Per axis, 1500 values: the standard error of the deviation is 1.8 %; five of them and the quantisation
    // (3.5e-5 rad and 3.1e-4 rad/s, which adds in squares less than 0.1 %).
    let [w, x, y, z] = resting(Time::ZERO).quaternion;
    let rest = nalgebra::Quaternion::new(w, x, y, z);
    let mut sums = [0.0; 2];
    for sample in &samples {
        let [w, x, y, z] = sample.quaternion;
        let off = rest.conjugate() * nalgebra::Quaternion::new(w, x, y, z);
        sums[0] += (off.imag() * 2.0).norm_squared();
        sums[1] += sample.rate.iter().map(|r| r * r).sum::<f64>();
    }
    let [noise, rate] = sums.map(|s| (s / 1500.0).sqrt());
    assert!((noise / 0.002 - 1.0).abs() < 0.1, "{noise}");
    assert!((rate / 0.01 - 1.0).abs() < 0.1, "{rate}");
}

#[test]
fn a_reset_in_the_middle_is_found_and_cured() {
    let bench = Bench::new(resting);
    let mut imu = bench.connected();
    for _ in 0..50 {
        bench.fresh(&mut imu);
    }
    bench.mischief.next(1, Misbehaviour::Reset);
    assert!(matches!(bench.next(&mut imu), Err(HardwareError::NoAnswer { .. })), "no answer while it starts");
    bench.pause(Duration::from_millis(700));
    // It answers again: zeros, which is no reading.
    assert_eq!(bench.next(&mut imu), Ok(Reading::Reset));
    assert_eq!(imu.read(), Ok(Reading::Reset), "until it has been set up again");
    assert_eq!([bench.raw(0x3D) & 0x0F, bench.raw(0x3B)], [0x00, 0x80]);
    imu.connect().expect("connects");
    assert_eq!([bench.raw(0x3D) & 0x0F, bench.raw(0x3B), bench.raw(0x41), bench.raw(0x42)], [0x08, 0x00, 0x24, 0x00]);
    bench.fresh(&mut imu);
}

#[test]
fn a_mode_units_or_axis_map_that_changed_are_found_within_a_second() {
    // Leave the fusion mode, or change units or axes behind the driver's back and return to it.
    for writes in [&[(0x3D, 0x05)][..], &[(0x3D, 0), (0x3B, 0x02), (0x3D, 8)], &[(0x3D, 0), (0x41, 0x21), (0x3D, 8)]] {
        let bench = Bench::new(resting);
        let mut imu = bench.connected();
        bench.fresh(&mut imu);
        for (register, value) in writes {
            bench.bus.clone().write(ADDRESS, &[*register, *value]).expect("acknowledged");
        }
        let begun = bench.clock.now();
        let mut found = false;
        while bench.clock.now().since(begun) < Duration::from_millis(1100) && !found {
            bench.pause(PERIOD);
            found = imu.read() == Ok(Reading::Reset);
        }
        assert!(found, "{writes:x?}");
    }
}

#[test]
fn outside_config_mode_the_chip_ignores_what_the_driver_must_not_rely_on() {
    let bench = Bench::new(resting);
    bench.connected();
    for register in [0x3B, 0x3E, 0x41, 0x42, 0x55] {
        let before = bench.raw(register);
        bench.bus.clone().write(ADDRESS, &[register, !before]).expect("acknowledged all the same");
        assert_eq!(bench.raw(register), before, "{register:#04x}");
    }
}

#[test]
fn the_wrong_chip_is_named() {
    use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
    let mut mock = Mock::new(&[
        Transaction::write(ADDRESS, vec![0x07, 0x00]),
        Transaction::write_read(ADDRESS, vec![0x00], vec![0x68]),
    ]);
    let error = Bno055::new(mock.clone(), Clock::Live, "mock", ADDRESS, None).connect().expect_err("refuses");
    mock.done();
    let text = error.to_string();
    assert!(matches!(error, HardwareError::WrongIdentity { .. }), "{text}");
    assert!(text.contains("0xa0") && text.contains("0x68") && text.contains("rig.toml"), "{text}");
}

#[test]
fn no_chip_is_no_answer() {
    let clock = Stepper::new().clock();
    let bus = SimI2c::new(clock.clone(), 100_000);
    let error = Bno055::new(bus, clock, "sim", 0x29, None).connect().expect_err("nothing there");
    assert!(matches!(error, HardwareError::NoAnswer { .. }) && error.to_string().contains("0x29"), "{error}");
}

#[test]
fn a_profile_survives_the_power_but_not_another_sensor() {
    let bench = Bench::new(resting);
    let profile = ImuProfile { unique_id: bench.unique_id, registers: std::array::from_fn(|i| i as u8 + 1) };
    let restored = |profile| {
        let mut imu = Bno055::new(bench.bus.clone(), bench.clock.clone(), "sim", ADDRESS, Some(profile));
        imu.connect().map(|_| imu)
    };
    let mut imu = restored(profile).expect("connects");
    assert_eq!(imu.save_profile().expect("reads"), profile);
    bench.fresh(&mut imu);

    bench.mischief.next(1, Misbehaviour::Silent);
    assert!(imu.read().is_err());
    let mut imu = bench.connected();
    assert_eq!(imu.save_profile().expect("reads").registers, [0; 22], "lost with the power");
    let mut imu = restored(profile).expect("connects");
    assert_eq!(imu.save_profile().expect("reads"), profile);

    let stranger = ImuProfile { unique_id: [9; 16], ..profile };
    let error = restored(stranger).err().expect("refuses").to_string();
    assert!(error.contains("09090909") && error.contains("calibrate imu"), "{error}");
}

#[test]
fn the_calibration_status_rises_at_rest_and_sooner_with_a_profile() {
    let seconds_to_gyro = |with_profile: bool| {
        let bench = Bench::new(resting);
        let profile = ImuProfile { unique_id: bench.unique_id, registers: [1; 22] };
        let mut imu =
            Bno055::new(bench.bus.clone(), bench.clock.clone(), "sim", ADDRESS, with_profile.then_some(profile));
        imu.connect().expect("connects");
        let begun = bench.clock.now();
        while bench.fresh(&mut imu).calibration >> 4 & 3 < 3 {
            assert!(bench.clock.now().since(begun) < Duration::from_secs(10));
        }
        bench.clock.now().since(begun).as_secs_f64()
    };
    // 300 frames and 10 frames, seen by the look that is taken every second.
    assert!((3.0..4.1).contains(&seconds_to_gyro(false)));
    assert!((0.0..1.1).contains(&seconds_to_gyro(true)));
}

#[test]
fn flipped_bits_never_pass_for_a_motion() {
    let bench = Bench::new(turning);
    let mut imu = bench.connected();
    let mut seen = 0;
    for _ in 0..400 {
        bench.fresh(&mut imu);
        bench.mischief.next(1, Misbehaviour::BitFlip);
        match bench.next(&mut imu).expect("answers") {
            // A flip in the Euler angles or the acceleration harms nobody; one in the gyro's upper byte makes it
            // impossibly fast, which only loosens the check of the next turn; one in a lower byte of the quaternion
            // is 2^-7 at most, 0.9 degrees.
            Reading::Fresh(sample) => {
                let expected = RATE * (sample.time.seconds_since(Time::ZERO) - 0.005);
                let off = difference(angle_about_z(&sample), expected);
                assert!(off.abs() < 0.02 + RATE * 0.006, "{off} rad passed");
            }
            Reading::Implausible(sample, why) => {
                assert_eq!(sample.health, ImuHealth::Implausible);
                assert!(matches!(why, Implausible::Norm { .. } | Implausible::Jump { .. }));
                seen += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    // Four of 26 bytes are the quaternion's upper ones: 62 of 400 expected, standard deviation 7.
    assert!((30..=95).contains(&seen), "{seen} seen");
}

#[test]
fn garbage_is_implausible() {
    let bench = Bench::new(resting);
    let mut imu = bench.connected();
    bench.fresh(&mut imu);
    bench.mischief.next(100, Misbehaviour::Garbage);
    for _ in 0..50 {
        match bench.next(&mut imu).expect("answers") {
            Reading::Implausible(..) | Reading::Reset => {}
            other => panic!("{other:?} out of random bytes"),
        }
    }
}

#[test]
fn a_jump_that_the_gyro_does_not_know_of_is_refused_until_it_has_lasted() {
    fn jumping(time: Time) -> Orientation {
        let mut motion = resting(time);
        if time >= Time::from_nanos(3_000_000_000) {
            motion.quaternion = [1.0, 0.0, 0.0, 0.0];
        }
        motion
    }
    let bench = Bench::new(jumping);
    let mut imu = bench.connected();
    let mut refused = 0;
    while bench.clock.now() < Time::from_nanos(4_000_000_000) {
        match bench.next(&mut imu).expect("answers") {
            Reading::Fresh(_) => {}
            Reading::Implausible(_, Implausible::Jump { angle, .. }) => {
                // From (1, -1, 1, -1)/2 to none: 120 degrees.
                assert!((angle.to_degrees() - 120.0).abs() < 0.1, "{angle}");
                refused += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    // 0.5 s of readings every 10.7 ms (pause and transfer), then the new orientation is believed.
    assert!((45..=48).contains(&refused), "{refused}");
}

#[test]
fn a_stuck_chip_brings_nothing_new() {
    let bench = Bench::new(turning);
    let mut imu = bench.connected();
    bench.fresh(&mut imu);
    bench.mischief.always(Misbehaviour::Stuck);
    for _ in 0..2 {
        bench.pause(PERIOD);
        let _ = imu.read().expect("answers");
    }
    for _ in 0..50 {
        bench.pause(PERIOD);
        assert_eq!(imu.read(), Ok(Reading::Repeated));
    }
    bench.mischief.stop();
    bench.pause(Duration::from_millis(200));
    bench.fresh(&mut imu);
}

#[test]
fn refusals_and_stretched_clocks_cost_time_but_no_truth() {
    let bench = Bench::new(turning);
    let mut imu = bench.connected();
    bench.fresh(&mut imu);
    bench.mischief.next(2, Misbehaviour::Nak);
    for _ in 0..2 {
        assert!(matches!(imu.read(), Err(HardwareError::NoAnswer { .. })));
    }
    bench.fresh(&mut imu);
    let late = Duration::from_millis(5);
    bench.mischief.next(1, Misbehaviour::Late(late));
    bench.pause(PERIOD);
    let begun = bench.clock.now();
    assert!(matches!(imu.read(), Ok(Reading::Fresh(_))));
    assert!(bench.clock.now().since(begun) >= late);
    assert_eq!(imu.probe_errors(100), 0);
    bench.mischief.next(3, Misbehaviour::Nak);
    assert_eq!(imu.probe_errors(100), 3);
}

#[test]
fn one_burst_takes_the_time_of_its_bits() {
    for (frequency, expected) in [(400_000, 0.66e-3), (100_000, 2.65e-3)] {
        let clock = Stepper::new().clock();
        let bus = SimI2c::new(clock.clone(), frequency);
        let sim = Bno055Sim::new(ImuSim { delay: Duration::ZERO, noise: 0.0, rate_noise: 0.0 }, 1);
        bus.attach(ADDRESS, Bno055Chip::new(sim, Box::new(resting)));
        let mut imu = Bno055::new(bus, clock.clone(), "sim", ADDRESS, None);
        imu.connect().expect("connects");
        clock.block_until(clock.now() + PERIOD);
        let begun = clock.now();
        imu.read().expect("answers");
        let took = clock.now().since(begun).as_secs_f64();
        // 29 bytes of 9 bits, start and stop: within 1 % of what the datasheet's arithmetic gives.
        assert!((took / expected - 1.0).abs() < 0.01, "{took} s at {frequency} Hz");
    }
}
