//! The plate of a simulated module: it swings about the equilibrium of its FREEs.
//!
//! The rods ([`crate::fem::module`]) give the equilibrium at the present pressures, how it moves with them, and the
//! stiffness about it. The plate's mass and inertia make six modes of it, each with the same damping ratio, and each
//! is integrated exactly: whatever the step, none gains energy. The equilibrium is linearised anew when a pressure
//! has changed by [`REACH`]. What turns slowly against its modes is right so; gyroscopic moments are left out.
//!
//! Where the rods have no stable equilibrium any more (a limit point, buckling, tubes that touch), the equilibrium
//! stays where it was, and the plate says so.

use std::f64::consts::TAU;

use nalgebra::{Matrix6, SymmetricEigen, UnitQuaternion, Vector3, Vector6};

use super::chips::Orientation;
use crate::fem::module::{Loads, Module, ModuleError, State};
use crate::signal::Truth;

/// Change of a pressure after which the equilibrium is linearised anew, Pa (0.05 psi): what is left of the
/// equilibrium's curvature over that is some micrometres.
const REACH: f64 = 345.0;

/// What swings, and how it is damped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swing {
    /// Mass of the plate and what moves with it, kg.
    pub mass: f64,
    /// Side of the square plate, m: its inertia is that of a thin one.
    pub side: f64,
    /// Damping ratio of every mode, above 0 and below 1.
    pub damping: f64,
}

/// The plate.
#[derive(Clone, Debug)]
pub struct Plate {
    module: Module,
    loads: Loads,
    swing: Swing,
    equilibrium: State,
    by_pressure: Vec<Vector6<f64>>,
    modes: Modes,
    rotation: UnitQuaternion<f64>,
    position: Vector3<f64>,
    /// Angular and linear velocity in the fixed frame, rad/s and m/s.
    velocity: Vector6<f64>,
    /// Linear acceleration in the fixed frame, m/s2.
    acceleration: Vector3<f64>,
    stuck: bool,
    /// Pressures at which the equilibrium was last looked for, Pa.
    tried: Vec<f64>,
}

/// Modes about an equilibrium: displacements are `shapes` times modal coordinates.
#[derive(Clone, Debug)]
struct Modes {
    shapes: Matrix6<f64>,
    coordinates: Matrix6<f64>,
    /// rad/s.
    frequencies: Vector6<f64>,
}

impl Plate {
    /// The plate of `module` at rest under `loads`, whose pressures are those of the beginning.
    ///
    /// # Errors
    /// Where the module has no stable equilibrium there.
    pub fn new(module: Module, loads: Loads, swing: Swing) -> Result<Plate, ModuleError> {
        let equilibrium = module.equilibrium(&loads)?;
        let ends = || ModuleError::Ends { fraction: 0.0, cause: None };
        let by_pressure = equilibrium.by_pressure().ok_or_else(ends)?;
        let rotation = equilibrium.rotation();
        let modes = Modes::about(&equilibrium, &swing, &rotation).filter(|_| equilibrium.stable()).ok_or_else(ends)?;
        let position = equilibrium.position();
        let (velocity, acceleration) = (Vector6::zeros(), Vector3::zeros());
        let (stuck, tried) = (false, equilibrium.loads().pressures.clone());
        Ok(Plate {
            module,
            loads,
            swing,
            equilibrium,
            by_pressure,
            modes,
            rotation,
            position,
            velocity,
            acceleration,
            stuck,
            tried,
        })
    }

    /// Centre, m, from the middle of the bases; z towards the plate.
    pub fn position(&self) -> Vector3<f64> {
        self.position
    }

    /// Rotation from rest.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        self.rotation
    }

    /// Angular velocity in the fixed frame, rad/s.
    pub fn rate(&self) -> Vector3<f64> {
        self.velocity.fixed_rows::<3>(0).into_owned()
    }

    /// Linear acceleration in the fixed frame, m/s2.
    pub fn acceleration(&self) -> Vector3<f64> {
        self.acceleration
    }

    /// Whether the pressures ask for what has no stable equilibrium.
    pub fn stuck(&self) -> bool {
        self.stuck
    }

    /// `dt` s on, under `pressures`, Pa.
    pub fn step(&mut self, pressures: &[f64], dt: f64) {
        let far = |at: &[f64]| at.iter().zip(pressures).any(|(a, p)| (p - a).abs() > REACH);
        if far(&self.tried) {
            self.linearise(pressures);
        }
        let (rotation, position) = self.rest(pressures);
        let apart = (self.rotation * rotation.inverse()).scaled_axis();
        let shift = self.position - position;
        let apart = Vector6::new(apart.x, apart.y, apart.z, shift.x, shift.y, shift.z);
        let before = self.velocity;
        let (apart, velocity) = self.modes.step(&apart, &before, self.swing.damping, dt);
        self.rotation = UnitQuaternion::from_scaled_axis(apart.fixed_rows::<3>(0).into_owned()) * rotation;
        self.position = position + apart.fixed_rows::<3>(3);
        self.acceleration = (velocity - before).fixed_rows::<3>(3) / dt;
        self.velocity = velocity;
    }

    /// Where the plate would come to rest under `pressures`.
    fn rest(&self, pressures: &[f64]) -> (UnitQuaternion<f64>, Vector3<f64>) {
        let at = &self.equilibrium.loads().pressures;
        // Past the end of the equilibria the last one stays.
        let moved: Vector6<f64> = match self.stuck {
            true => Vector6::zeros(),
            false => self.by_pressure.iter().zip(at.iter().zip(pressures)).map(|(by, (a, p))| by * (p - a)).sum(),
        };
        let turn = UnitQuaternion::from_scaled_axis(moved.fixed_rows::<3>(0).into_owned());
        (turn * self.equilibrium.rotation(), self.equilibrium.position() + moved.fixed_rows::<3>(3))
    }

    /// Follows the equilibrium to `pressures`.
    fn linearise(&mut self, pressures: &[f64]) {
        let loads = Loads { pressures: pressures.to_vec(), ..self.loads.clone() };
        let found = self.module.equilibrium_from(&self.equilibrium, &loads).ok().filter(State::stable);
        let next = found.and_then(|state| {
            let modes = Modes::about(&state, &self.swing, &state.rotation())?;
            Some((state.by_pressure()?, modes, state))
        });
        self.stuck = next.is_none();
        self.tried.copy_from_slice(pressures);
        if let Some((by_pressure, modes, equilibrium)) = next {
            (self.by_pressure, self.modes, self.equilibrium) = (by_pressure, modes, equilibrium);
        }
    }
}

impl Modes {
    /// `K x = w^2 M x`, with M the plate's at its present rotation; none of a stiffness that is not positive.
    fn about(state: &State, swing: &Swing, rotation: &UnitQuaternion<f64>) -> Option<Modes> {
        let flat = swing.mass * swing.side * swing.side / 12.0;
        let turn = rotation.to_rotation_matrix();
        let mut root = Matrix6::identity() * swing.mass.sqrt();
        let about = turn.matrix()
            * nalgebra::Matrix3::from_diagonal(&Vector3::new(flat.sqrt(), flat.sqrt(), (2.0 * flat).sqrt()))
            * turn.matrix().transpose();
        root.fixed_view_mut::<3, 3>(0, 0).copy_from(&about);
        let inverse = root.try_inverse()?;
        let stiffness = state.stiffness();
        let eigen = SymmetricEigen::new(inverse * (stiffness + stiffness.transpose()) * 0.5 * inverse);
        if !eigen.eigenvalues.iter().all(|w| *w > 0.0 && w.is_finite()) {
            return None;
        }
        Some(Modes {
            shapes: inverse * eigen.eigenvectors,
            coordinates: eigen.eigenvectors.transpose() * root,
            frequencies: eigen.eigenvalues.map(f64::sqrt),
        })
    }

    /// Displacement and velocity `dt` later: free vibration of every mode, exactly.
    fn step(
        &self,
        apart: &Vector6<f64>,
        velocity: &Vector6<f64>,
        damping: f64,
        dt: f64,
    ) -> (Vector6<f64>, Vector6<f64>) {
        let (mut q, mut v) = (self.coordinates * apart, self.coordinates * velocity);
        for ((q, v), w) in q.iter_mut().zip(v.iter_mut()).zip(&self.frequencies) {
            let decay = damping * w;
            let ring = w * (1.0 - damping * damping).sqrt();
            let (sin, cos) = (ring * dt).sin_cos();
            let fall = (-decay * dt).exp();
            let slope = (*v + decay * *q) / ring;
            let next = fall * (*q * cos + slope * sin);
            *v = fall * (ring * (slope * cos - *q * sin)) - decay * next;
            *q = next;
        }
        (self.shapes * q, self.shapes * v)
    }
}

/// A plate on the ends of some FREEs, with a memory of its motion.
#[derive(Clone, Debug)]
pub(super) struct Swinging {
    frees: Vec<usize>,
    plate: Plate,
    pressures: Vec<f64>,
    memory: Vec<Motion>,
}

/// The plate at one instant.
#[derive(Clone, Copy, Debug)]
struct Motion {
    rotation: UnitQuaternion<f64>,
    position: Vector3<f64>,
    rate: Vector3<f64>,
    acceleration: Vector3<f64>,
    /// Turn about z, unwrapped, rad.
    turn: f64,
}

impl Swinging {
    /// `plate` on the ends of `frees`, at rest for as long as `states` are remembered.
    pub fn new(frees: Vec<usize>, plate: Plate, states: usize) -> Swinging {
        let rest = Motion::of(&plate, 0.0);
        Swinging { pressures: vec![0.0; frees.len()], frees, plate, memory: vec![rest; states] }
    }

    /// Whether the end of `free` is on it.
    pub fn holds(&self, free: usize) -> bool {
        self.frees.contains(&free)
    }

    /// The plate.
    pub fn plate(&self) -> &Plate {
        &self.plate
    }

    /// `dt` s on under the FREEs' `pressure`, Pa; remembered at `slot`, which follows the one before.
    pub fn advance(&mut self, pressure: impl Fn(usize) -> f64, dt: f64, slot: usize) {
        for (to, free) in self.pressures.iter_mut().zip(&self.frees) {
            *to = pressure(*free);
        }
        self.plate.step(&self.pressures, dt);
        let states = self.memory.len();
        let before = self.memory[(slot + states - 1) % states].turn;
        self.memory[slot] = Motion::of(&self.plate, before);
    }

    /// The motion that a sensor on the plate sees, its z along the plate's: `x` (0 to 1) of the way from the state
    /// remembered at `before` to that at `after`.
    pub fn orientation(&self, before: usize, after: usize, x: f64) -> Orientation {
        let motion = self.between(before, after, x);
        let back = motion.rotation.inverse();
        let q = motion.rotation.quaternion();
        Orientation {
            quaternion: [q.w, q.i, q.j, q.k],
            rate: (back * motion.rate).into(),
            acceleration: (back * motion.acceleration).into(),
        }
    }

    /// What the plate really does then; without a pressure.
    pub fn truth(&self, before: usize, after: usize, x: f64) -> Truth {
        let motion = self.between(before, after, x);
        let extension = motion.position.z - self.plate.module.rest().z;
        Truth { angle: motion.turn, extension, pressure: 0.0, position: motion.position.into() }
    }

    fn between(&self, before: usize, after: usize, x: f64) -> Motion {
        let (a, b) = (&self.memory[before], &self.memory[after]);
        Motion {
            rotation: a.rotation.nlerp(&b.rotation, x),
            position: a.position.lerp(&b.position, x),
            rate: a.rate.lerp(&b.rate, x),
            acceleration: a.acceleration.lerp(&b.acceleration, x),
            turn: a.turn + (b.turn - a.turn) * x,
        }
    }
}

impl Motion {
    fn of(plate: &Plate, turn: f64) -> Motion {
        // Swing and twist: the turn about z, on the sheet of the one before.
        let q = plate.rotation().into_inner();
        let now = 2.0 * q.k.atan2(q.w);
        let turn = now + TAU * ((turn - now) / TAU).round();
        Motion {
            rotation: plate.rotation(),
            position: plate.position(),
            rate: plate.rate(),
            acceleration: plate.acceleration(),
            turn,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::linear::LinearSection;
    use crate::fem::module::{Mount, square};
    use crate::fem::rod::{Law, Profile, Resolution, Rod, Straight};
    use crate::fem::tube::Tube;
    use crate::units::PASCAL_PER_PSI as PSI;

    const SWING: Swing = Swing { mass: 0.02, side: 0.03, damping: 0.1 };

    fn plate() -> Plate {
        let section = LinearSection::new(&Tube::reference(60f64.to_radians())).unwrap();
        let mounts = square(0.02).into_iter().enumerate().map(|(i, base)| {
            let law = Law {
                straight: Straight::closed_form(&section),
                bending: Profile::constant(450e-6),
                shear: Profile::constant(1e4),
                coupling: Profile::constant(0.0),
                mirrored: i % 2 == 1,
            };
            Mount { base, rod: Rod { outer_radius: 5.56e-3, ..Rod::straight(0.13, law) } }
        });
        let module = Module::new(mounts.collect(), SWING.mass, Resolution::DEFAULT).unwrap();
        Plate::new(module, Loads::pressures(vec![0.0; 4]), SWING).unwrap()
    }

    fn run(plate: &mut Plate, pressures: &[f64; 4], seconds: f64, dt: f64) {
        for _ in 0..(seconds / dt).round() as usize {
            plate.step(pressures, dt);
        }
    }

    #[test]
    fn it_comes_to_rest_where_the_rods_do() {
        let mut plate = plate();
        let pressures = [2.0 * PSI, 2.0 * PSI, 0.0, 0.0];
        run(&mut plate, &pressures, 10.0, 1e-3);
        let rest = plate.module.equilibrium(&Loads::pressures(pressures)).unwrap();
        assert!((plate.position() - rest.position()).norm() < 1e-7, "{}", plate.position() - rest.position());
        assert!(plate.rotation().angle_to(&rest.rotation()) < 1e-6);
        assert!(plate.rate().norm() < 1e-6 && !plate.stuck());
    }

    #[test]
    fn every_step_gives_the_same_motion_while_the_pressures_stand() {
        // Exact in time: the same swing by 1 ms and by 7 ms.
        let [mut a, mut b] = [plate(), plate()];
        let pressures = [0.3 * PSI, 0.0, 0.0, 0.0];
        run(&mut a, &pressures, 0.35, 1e-3);
        run(&mut b, &pressures, 0.35, 7e-3);
        let travel = (a.position() - plate().position()).norm();
        assert!(
            (a.position() - b.position()).norm() < 1e-9 * travel.max(1e-3) + 1e-12,
            "{}",
            a.position() - b.position()
        );
    }

    #[test]
    fn it_overshoots_as_its_damping_says() {
        let mut plate = plate();
        let start = plate.position();
        let goal = [0.01 * PSI, 0.01 * PSI, 0.01 * PSI, 0.01 * PSI];
        let (_, rest) = plate.rest(&goal);
        let mut highest = 0.0_f64;
        for _ in 0..20_000 {
            plate.step(&goal, 1e-5);
            highest = highest.max((plate.position().z - start.z) / (rest.z - start.z));
        }
        // One mode alone (along z, the layout's symmetry): overshoot exp(-pi zeta / sqrt(1 - zeta^2)).
        let want = 1.0 + (-std::f64::consts::PI * 0.1 / (1.0f64 - 0.01).sqrt()).exp();
        assert!((highest - want).abs() < 1e-3, "{highest} {want}");
    }

    #[test]
    fn past_the_end_of_the_equilibria_it_stays_and_says_so() {
        let mut plate = plate();
        let mut pressures = [0.0; 4];
        while !plate.stuck() && pressures[0] < 20.0 * PSI {
            pressures = pressures.map(|p| p + 0.2 * PSI);
            plate.step(&pressures, 1e-3);
        }
        assert!(plate.stuck(), "four FREEs of 60 deg buckle");
        let at = plate.equilibrium.position();
        run(&mut plate, &pressures, 5.0, 1e-3);
        assert!((plate.position() - at).norm() < 1e-6 && plate.position().iter().all(|x| x.is_finite()));
        // And down again it finds back.
        run(&mut plate, &[0.0; 4], 5.0, 1e-3);
        assert!(!plate.stuck() && (plate.position() - Vector3::new(0.0, 0.0, 0.13)).norm() < 1e-6);
    }
}
