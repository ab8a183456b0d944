//! The knob on a simulated FREE's free end: friction that holds it where it stands, two stops, and what returns it to
//! off.
//!
//! Coulomb friction has two branches, and which one is decided at the beginning of every part of a step: a knob at rest
//! is *held* as long as the moment on it is not above the friction, and then neither turns nor gains a rate; any other
//! one *slides* under the constant moment against its motion, up to the very time at which it comes to rest. A friction
//! that follows the sign of the rate would chatter about zero, and creep.

/// A knob.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnobSim {
    /// From off, where the vented FREE rests, to its other stop, rad, in the FREE's own direction.
    pub travel: f64,
    /// Moment that turns it, against any motion, N m, not negative.
    pub friction: f64,
    /// Moment that presses it towards off: the FREE was wound on by so much when it was mounted, N m, not negative.
    pub preload: f64,
}

/// What friction does to the end for a while.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Rubbing {
    /// It holds the end.
    Held,
    /// It bears against the motion with this moment, N m; zero without a knob.
    Slides(f64),
}

impl KnobSim {
    /// What friction does to an end with this `rate`, rad/s, under `moment`, N m, of everything else.
    pub(super) fn rubbing(&self, rate: f64, moment: f64) -> Rubbing {
        if rate == 0.0 && moment.abs() <= self.friction {
            return Rubbing::Held;
        }
        let way = if rate == 0.0 { moment } else { rate };
        Rubbing::Slides(-self.friction * way.signum())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MaxwellSlip, Tip};
    use super::*;
    use crate::model::{Free, Kinematics};

    const DT: f64 = 2.5e-4;

    /// A left-handed FREE whose torsion is all spring.
    fn free() -> Free {
        Free {
            gamma: -50f64.to_radians(),
            length: 0.13,
            radius: 5.56e-3,
            mass: 0.01,
            inertia: 3.5e-6,
            axial_stiffness: 252.0,
            torsional_stiffness: 0.0117,
            axial_damping: 0.5,
            torsional_damping: 0.0,
        }
    }

    fn tip(free: Free, knob: KnobSim) -> Tip {
        let mut tip = Tip::new(free, MaxwellSlip::new(0.0, 1.0), 0.0);
        tip.settle();
        tip.mount(knob);
        tip
    }

    #[test]
    fn it_stands_still_until_the_pressure_turns_it_and_a_vent_turns_it_off() {
        for gamma in [-50f64, 50.0] {
            let free = Free { gamma: gamma.to_radians(), torsional_damping: 1e-4, ..free() };
            let (own, knob) = (free.direction(), KnobSim { travel: 3.0, friction: 2.5e-3, preload: 3e-3 });
            let mut tip = tip(free, knob);
            let needed = |tip: &Tip, moment: f64| {
                moment / (own * Kinematics::Exact.actuation(&free, tip.extension(), tip.angle()).unwrap().moment)
            };
            let run = |tip: &mut Tip, pressure: f64, seconds: f64| {
                (0..(seconds / DT) as usize).for_each(|_| tip.step(pressure, DT));
            };
            let break_away = needed(&tip, knob.friction + knob.preload);
            run(&mut tip, 0.99 * break_away, 0.5);
            assert_eq!((tip.angle(), tip.rate()), (0.0, 0.0), "off, and not a hair away");
            // Quasi-static, up and down through the same angle: apart by twice the friction.
            let mut at = [0.0; 2];
            let (mut pressure, mut moment) = (break_away, [0.0; 2]);
            for (leg, slope) in [(0, 800.0), (1, -800.0)] {
                let mut turned = false;
                for _ in 0..400_000 {
                    pressure += slope * DT;
                    tip.step(pressure, DT);
                    let past = own * tip.angle() - 0.4;
                    if !turned && (past > 0.0) == (slope > 0.0) {
                        at[leg] = tip.angle();
                        moment[leg] = pressure
                            * own
                            * Kinematics::Exact.actuation(&free, tip.extension(), tip.angle()).unwrap().moment;
                        turned = true;
                    }
                    if own * tip.angle() * slope.signum() > slope.signum() * (0.4 + 0.3 * slope.signum()) {
                        break;
                    }
                }
                assert!(turned, "leg {leg}");
            }
            let spring = free.torsional_stiffness * own * (at[0] - at[1]);
            let apart = moment[0] - moment[1] - spring;
            // 800 Pa/s are some 0.07 rad/s, whose damping is 7 uN m, up as well as down: 0.3 % of it.
            assert!((apart / (2.0 * knob.friction) - 1.0).abs() < 0.005, "{apart}");
            // It stands where it is left, after it has swung out: by ct v / kt and v / omega, 0.6 and 1.2 mrad.
            let here = tip.angle();
            run(&mut tip, pressure, 0.2);
            assert!((tip.angle() - here).abs() < 1.8e-3 && tip.rate() == 0.0, "{} {}", tip.rate(), tip.angle() - here);
            let (held, here) = (pressure + needed(&tip, 1.5 * knob.friction), tip.angle());
            run(&mut tip, held, 0.2);
            assert_eq!((tip.angle(), tip.rate()), (here, 0.0));
            // Far too much pressure: the other stop; none: off.
            run(&mut tip, 60e3, 3.0);
            assert_eq!(own * tip.angle(), knob.travel);
            run(&mut tip, 0.0, 3.0);
            assert_eq!((tip.angle(), tip.rate()), (0.0, 0.0));
        }
    }

    #[test]
    fn a_swing_loses_twice_the_friction_over_the_stiffness_from_one_side_to_the_other() {
        // The textbook's: with k x about a centre, Coulomb friction T takes 2 T / k from every half swing.
        let (free, knob) = (free(), KnobSim { travel: 4.0, friction: 1e-3, preload: 0.0 });
        let k = free.torsional_stiffness;
        let mut tip = tip(free, knob);
        tip.load = 2.0 * k;
        tip.grip = Some(1.2 * k);
        (0..8000).for_each(|_| tip.step(0.0, DT));
        tip.grip = None;
        let (mut turns, mut before) = (vec![tip.angle() - 2.0], 0.0);
        for _ in 0..20_000 {
            tip.step(0.0, DT);
            if tip.rate() * before < 0.0 || (tip.rate() == 0.0 && before != 0.0) {
                turns.push(tip.angle() - 2.0);
            }
            before = tip.rate();
        }
        assert!(turns.len() > 5, "{turns:?}");
        for pair in turns.windows(2).take_while(|pair| pair[0].abs() > 2.0 * knob.friction / k) {
            let lost = pair[0].abs() - pair[1].abs();
            assert!(pair[0] * pair[1] < 0.0, "{turns:?}");
            // A turn is found on the plant's grid: within a swing of 9 Hz the angle near its end is off by at most
            // x w^2 dt^2 / 2, 1e-4 of 1 rad.
            assert!((lost / (2.0 * knob.friction / k) - 1.0).abs() < 1e-3, "{lost}: {turns:?}");
        }
        // In the end it stands, off its centre by no more than the friction holds.
        let rest = tip.angle();
        tip.step(0.0, DT);
        assert_eq!((tip.angle(), tip.rate()), (rest, 0.0));
        assert!((rest - 2.0).abs() <= knob.friction / k);
    }
}
