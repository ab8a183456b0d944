//! Newton's method for the whole module, one 6 x 6 system at a time, and load stepping about it.

use nalgebra::{Cholesky, Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};

use super::state::Unknowns;
use super::{Loads, Module, ModuleError, Mount, State};
use crate::fem::rod::{
    Assembly, Condensed, DualMatrix, DualVector, Exponential, Rod, RodError, STRAINS, blocks, half_bracket,
    moment_force, skew, small_twist, twist, vector6, wrench,
};

/// A correction below this (see [`Step::within`]) ends the iteration: Newton squares it, so what is left is 1e-10.
const CONVERGED: f64 = 1e-5;
/// So does a larger one that is below this share of the one before and leaves no more than that (see
/// [`Solver::settled`]).
const QUADRATIC: f64 = 0.1;
const LEFT: f64 = 1e-8;
/// How many times what the last correction is expected to change of the plate's stiffness its stability has to bear.
const SAFETY: f64 = 4.0;
/// The same for a stop on the way, which only has to be a good start for the next.
const NEARBY: f64 = 1e-3;
/// Each correction must be below this share of the one before.
const CONTRACTION: f64 = 0.5;
/// With that contraction as its slowest pace, an iteration that needs more is not in Newton's own region.
const ITERATIONS: usize = 12;
/// Rotations (rad) and relative strains beyond this in one correction are no correction.
const LONGEST: f64 = 6.0;
/// A way is cut down to this share before it counts as ended.
const SHORTEST: f64 = 1.0 / 4096.0;

/// The equations linearised at some unknowns: `stiffness eta = residual`.
pub(super) struct Linear {
    pub stiffness: Matrix6<f64>,
    pub residual: Vector6<f64>,
}

/// How large a correction was: motions (strains times length, radians, lengths per length) and wrenches (in EI / L).
/// Infinite where they are no numbers.
pub(super) struct Step {
    pub size: f64,
    pub load: f64,
}

impl Step {
    /// Motions below `tolerance`; wrenches, which are larger where rods are pulled and not bent, below 100 times that.
    pub fn within(&self, tolerance: f64) -> bool {
        self.measure() < tolerance
    }

    fn measure(&self) -> f64 {
        self.size.max(0.01 * self.load)
    }
}

/// Work space for one module.
pub(super) struct Solver<'a> {
    module: &'a Module,
    assemblies: Vec<Assembly>,
    condensed: Vec<Condensed>,
    /// From each tip to its place at the plate.
    gaps: Vec<Vector6<f64>>,
    step: Vec<f64>,
    /// The plate does not move.
    held: bool,
    /// Newton's last correction is below [`CONVERGED`] in any case, so that the stiffness is that of the equilibrium.
    thorough: bool,
}

impl Module {
    /// Unknowns without loads: every rod in its rest shape, the plate on the first one.
    fn unloaded(&self) -> (Loads, Unknowns) {
        let rods = self.mounts.iter().map(|Mount { rod, .. }| {
            let mut strains = vec![0.0; STRAINS * self.basis.modes];
            strains[..2].copy_from_slice(rod.rest_curvature.as_slice());
            (strains, DualVector::ZERO)
        });
        let Rod { length, rest_curvature, .. } = self.mounts[0].rod;
        let screw = DualVector { re: rest_curvature.push(0.0), du: Vector3::z() }.scaled(length);
        let plate = self.base(0) * Exponential::new(screw).pose() * self.offset(0).transpose();
        (Loads::pressures(vec![0.0; self.mounts.len()]), Unknowns { plate, rods: rods.collect() })
    }

    /// The equilibrium under `loads`, followed from rest. It may be unstable, and says so. Errors: see [`ModuleError`].
    pub fn equilibrium(&self, loads: &Loads) -> Result<State, ModuleError> {
        let (start, unknowns) = self.unloaded();
        Solver::new(self).follow(&start, unknowns, loads)
    }

    /// The equilibrium under `pressures` (Pa) with the plate held where it is at rest. Its negative pivots are those
    /// of the rods between clamped ends: a blocked FREE buckles like a strut. What starts from this state releases the
    /// plate.
    pub fn blocked(&self, pressures: &[f64]) -> Result<State, ModuleError> {
        let (start, mut unknowns) = self.unloaded();
        unknowns.plate = DualMatrix::pose(Matrix3::identity(), &self.rest);
        Solver { held: true, ..Solver::new(self) }.follow(&start, unknowns, &Loads::pressures(pressures))
    }

    /// The equilibrium under `loads`, followed from `start`, an equilibrium of this module.
    pub fn equilibrium_from(&self, start: &State, loads: &Loads) -> Result<State, ModuleError> {
        Solver::new(self).follow_from(start, loads)
    }

    /// The same, with the stiffness and the clearance at the equilibrium itself and not, as far as stability allows,
    /// where the last correction began: for whoever takes differences of them. A linearisation more.
    pub fn equilibrium_closely_from(&self, start: &State, loads: &Loads) -> Result<State, ModuleError> {
        Solver { thorough: true, ..Solver::new(self) }.follow_from(start, loads)
    }

    /// What the plate of `state`, an equilibrium of this module, would be pushed by, (moment, force) about its centre,
    /// if one rod (index, rod) were another: to first order in the difference of their laws, by one linearisation for
    /// all of `others`. The state's compliance times it is how the plate would move.
    ///
    /// # Errors
    /// A law that refuses the rod's strains.
    ///
    /// # Panics
    /// For an index that is none.
    pub fn pushed_by(&self, state: &State, others: &[(usize, Rod)]) -> Result<Vec<Vector6<f64>>, ModuleError> {
        let mut solver = Solver::new(self);
        let at = &state.unknowns;
        solver.linearise(at, &state.loads)?;
        let shift = about(&at.plate.position());
        let mut room = Assembly::default();
        let push = |(index, rod): &(usize, Rod)| {
            let (assembly, condensed) = (&solver.assemblies[*index], &solver.condensed[*index]);
            let (pressure, strains) = (state.loads.pressures[*index], &at.rods[*index].0);
            let change = assembly.change_by(rod, &self.basis, pressure, strains, &mut room);
            let change = change.map_err(|cause| ModuleError::Rod { index: *index, cause })?;
            Ok(-shift.tr_mul(&condensed.wrench_by(change)))
        };
        others.iter().map(push).collect()
    }

    /// The module with a finer resolution, and its equilibrium at `state`.
    pub fn refined(&self, state: &State) -> Result<(Module, State), ModuleError> {
        let fine = self.with_resolution(self.resolution.refined())?;
        let mut unknowns = state.unknowns.clone();
        for (strains, _) in &mut unknowns.rods {
            // The polynomials are a hierarchy: higher ones begin at zero.
            strains.resize(STRAINS * fine.basis.modes, 0.0);
        }
        // Near a limit point the finer solution may be too far for one step: then it is followed from rest.
        let finer = Solver::new(&fine)
            .follow(&state.loads, unknowns, &state.loads)
            .or_else(|_| fine.equilibrium(&state.loads))?;
        Ok((fine, finer))
    }

    /// How far the plate's centre is from where a finer resolution puts it, per length: the discretisation error, by
    /// one solution more.
    pub fn discretisation_error(&self, state: &State) -> Result<f64, ModuleError> {
        let (_, finer) = self.refined(state)?;
        Ok((finer.position() - state.position()).norm() / self.length())
    }
}

impl<'a> Solver<'a> {
    pub fn new(module: &'a Module) -> Solver<'a> {
        let n = module.mounts.len();
        Solver {
            module,
            assemblies: vec![Assembly::default(); n],
            condensed: vec![Condensed::default(); n],
            gaps: vec![Vector6::zeros(); n],
            step: Vec::new(),
            held: false,
            thorough: false,
        }
    }

    pub fn module(&self) -> &'a Module {
        self.module
    }

    /// The rods as last linearised.
    pub fn assemblies(&self) -> &[Assembly] {
        &self.assemblies
    }

    /// Moves the rods' nodes to `at`, near the last linearisation.
    fn move_nodes(&mut self, at: &Unknowns) {
        for ((assembly, mount), (strains, _)) in self.assemblies.iter_mut().zip(&self.module.mounts).zip(&at.rods) {
            assembly.move_nodes(&mount.rod, &self.module.basis, strains);
        }
    }

    /// The change of the residual by mu when the loads go from `from` (0) to `to` (1), after [`Solver::linearise`].
    pub fn by_load(&self, at: &Unknowns, from: &Loads, to: &Loads) -> Vector6<f64> {
        let force = to.force - from.force + (to.gravity - from.gravity) * self.module.plate_mass;
        let moment = to.moment - from.moment + at.plate.position().cross(&force);
        let mut sum = moment_force(&DualVector { re: force, du: moment });
        for (condensed, (a, b)) in self.condensed.iter().zip(from.pressures.iter().zip(&to.pressures)) {
            sum -= condensed.wrench_by_pressure() * (b - a);
        }
        sum
    }

    /// From the equilibrium `start` to that under `to`: along the tangent that it has kept, where that leads there,
    /// which saves a linearisation.
    fn follow_from(&mut self, start: &State, to: &Loads) -> Result<State, ModuleError> {
        let fits = start.tangent.len() == self.module.mounts.len() && to.pressures.len() == start.tangent.len();
        if fits && !self.held {
            let mut at = start.unknowns.clone();
            if let Some(first) = self.predict(&mut at, start, to) {
                let mut iterations = 0;
                if let Ok(found) = self.newton(at, to, CONVERGED, Some(first), &mut iterations) {
                    let clearance = self.clearance(&found)?;
                    return Ok(self.state(found, to.clone(), clearance, iterations));
                }
            }
        }
        self.follow(&start.loads, start.unknowns.clone(), to)
    }

    /// Newton's first correction from `start`, whose linearisation is known. None at a critical point.
    fn predict(&mut self, at: &mut Unknowns, start: &State, to: &Loads) -> Option<(Step, Matrix6<f64>)> {
        self.condensed.clone_from_slice(&start.tangent);
        let away = about(&-at.plate.position());
        let stiffness = away.tr_mul(&(start.stiffness * away));
        let eta = stiffness.lu().solve(&self.by_load(at, &start.loads, to))?;
        let dp: Vec<f64> = start.loads.pressures.iter().zip(&to.pressures).map(|(a, b)| b - a).collect();
        let step = self.advance(at, &eta, Some(&dp), 0.0);
        // A shorter one says nothing of the pace: what is left then is what the start has left.
        (CONVERGED..LONGEST).contains(&step.measure()).then_some((step, stiffness))
    }

    /// From the equilibrium `unknowns` under `from` to that under `to`.
    pub fn follow(&mut self, from: &Loads, unknowns: Unknowns, to: &Loads) -> Result<State, ModuleError> {
        let rods = self.module.mounts.len();
        if to.pressures.len() != rods {
            return Err(ModuleError::Pressures { pressures: to.pressures.len(), rods });
        }
        let values = to.pressures.iter().chain(&to.force).chain(&to.moment).chain(&to.gravity);
        if let Some(value) = values.copied().find(|x| !x.is_finite()) {
            return Err(ModuleError::Invalid { what: "a load", value, rule: "must be finite" });
        }
        let mut at = unknowns;
        let (mut done, mut piece, mut iterations) = (0.0, 1.0, 0);
        loop {
            let next = f64::min(done + piece, 1.0);
            let loads = if next == 1.0 { to.clone() } else { from.towards(to, next) };
            let tolerance = if next == 1.0 { CONVERGED } else { NEARBY };
            match self.newton(at.clone(), &loads, tolerance, None, &mut iterations) {
                Ok(found) => {
                    let clearance = self.clearance(&found)?;
                    if next == 1.0 {
                        return Ok(self.state(found, loads, clearance, iterations));
                    }
                    (at, done, piece) = (found, next, 2.0 * piece);
                }
                Err(cause) if piece <= SHORTEST => {
                    return Err(ModuleError::Ends { fraction: done, cause: cause.map(Box::new) });
                }
                Err(_) => piece *= 0.5,
            }
        }
    }

    /// Newton's method from nearby unknowns, with the correction that has led there and the stiffness it was made with,
    /// if one has; an error without a cause where it does not contract.
    fn newton(
        &mut self,
        mut at: Unknowns,
        loads: &Loads,
        tolerance: f64,
        mut before: Option<(Step, Matrix6<f64>)>,
        iterations: &mut usize,
    ) -> Result<Unknowns, Option<ModuleError>> {
        for _ in 0..ITERATIONS {
            *iterations += 1;
            let linear = self.linearise(&at, loads)?;
            let eta = match self.held {
                true => Vector6::zeros(),
                false => linear.stiffness.lu().solve(&linear.residual).ok_or(None)?,
            };
            let step = self.advance(&mut at, &eta, None, 1.0);
            if step.within(tolerance) {
                return Ok(at);
            }
            let most = before.as_ref().map_or(f64::INFINITY, |(before, _)| CONTRACTION * before.size);
            if step.size > most.clamp(CONVERGED, LONGEST) {
                return Err(None);
            }
            if before.is_some_and(|(before, first)| self.settled(&at, [&before, &step], [&first, &linear.stiffness])) {
                self.move_nodes(&at);
                return Ok(at);
            }
            before = Some((step, linear.stiffness));
        }
        Err(None)
    }

    /// Whether two successive corrections, made with these stiffnesses, and the stability at the second are enough.
    ///
    /// Newton's corrections of a smooth problem are `s, L s^2 / 2, ...` with one L that does not depend on the
    /// problem's units, so that with the ratio r of the two the second one leaves `r^2` of itself. It changes the
    /// linearisation by r of what the first has changed it by: where the rods are stable at their tips and the
    /// stiffness, less some times that, is positive, what is stable before the second correction is stable after it.
    /// What is not, or hardly, is iterated to the end.
    fn settled(&self, at: &Unknowns, [before, step]: [&Step; 2], [first, second]: [&Matrix6<f64>; 2]) -> bool {
        let ratio = step.measure() / before.measure();
        if self.held || self.thorough || ratio > QUADRATIC || ratio * ratio * step.measure() > LEFT {
            return false;
        }
        let scale = about(&at.plate.position()) * Matrix6::from_diagonal(&scale(self.module.length()));
        let of = |k: &Matrix6<f64>| scale.tr_mul(&((k + k.transpose()) * 0.5 * scale));
        let change = SAFETY * ratio * of(&(second - first)).norm();
        let stable = self.condensed.iter().all(|condensed| condensed.unstable == 0);
        stable && Cholesky::new(of(second) - Matrix6::identity() * change).is_some()
    }

    /// Assembles and condenses everything at `at`.
    pub fn linearise(&mut self, at: &Unknowns, loads: &Loads) -> Result<Linear, ModuleError> {
        let module = self.module;
        let (mut stiffness, mut residual) = (Matrix6::zeros(), Vector6::zeros());
        let mut sum = DualVector::ZERO;
        for (index, (strains, w)) in at.rods.iter().enumerate() {
            let error = |cause| ModuleError::Rod { index, cause };
            let rod = &module.mounts[index].rod;
            let (assembly, condensed) = (&mut self.assemblies[index], &mut self.condensed[index]);
            let pressure = loads.pressures[index];
            assembly.fill(rod, &module.basis, &module.base(index), pressure, strains, w).map_err(error)?;
            if !condensed.eliminate(assembly, w, rod.law.bending_at_rest(), rod.length) {
                return Err(error(RodError::Singular));
            }
            let gap = vector6(&small_twist(&assembly.tip(), &module.target(&at.plate, index)));
            self.gaps[index] = gap;
            stiffness += condensed.tip_stiffness();
            residual -= moment_force(w) + condensed.wrench_offset(&gap);
            sum += *w;
        }
        let force = loads.force + loads.gravity * module.plate_mass;
        let centre = at.plate.position();
        residual += moment_force(&DualVector { re: force, du: loads.moment + centre.cross(&force) });
        // The dead force's moment about the origin as the centre moves.
        let f = skew(&force);
        let dead = blocks(f * skew(&centre), -f, Matrix3::zeros(), Matrix3::zeros());
        stiffness -= half_bracket(&sum) + dead;
        Ok(Linear { stiffness, residual })
    }

    /// Moves everything by the plate's twist `eta`, the changes of pressure `dp` and, for `residual` 1, what removes
    /// the residual.
    pub fn advance(&mut self, at: &mut Unknowns, eta: &Vector6<f64>, dp: Option<&[f64]>, residual: f64) -> Step {
        let (mut size, mut load) = (0.0f64, 0.0f64);
        for (index, (strains, w)) in at.rods.iter_mut().enumerate() {
            let Rod { length, ref law, .. } = self.module.mounts[index].rod;
            let pressure = dp.map_or(0.0, |dp| dp[index]);
            let gap = self.gaps[index] * residual;
            let change = self.condensed[index].expand(eta, &gap, pressure, residual, &mut self.step);
            self.assemblies[index].move_energy(&self.step, pressure);
            let change = wrench(&change);
            *w += change;
            // What bends the rod, not what would squeeze it: moments, and forces on an arm of its length.
            load = load.max((change.du.amax() + length * change.re.amax()) * length / law.bending_at_rest());
            for (strain, step) in strains.chunks_exact_mut(6).zip(self.step.chunks_exact(6)) {
                for (s, d) in strain.iter_mut().zip(step) {
                    *s += d;
                }
                let rotation = step[0].abs().max(step[1].abs()).max(step[2].abs());
                size = size.max(rotation * length).max(step[3].abs().max(step[4].abs()).max(step[5].abs()));
            }
        }
        let eta = twist(eta);
        let shift = eta.du + eta.re.cross(&at.plate.position());
        size = size.max(eta.re.amax()).max(shift.amax() / self.module.length());
        // A correction of more than a turn will be refused; until then it stays a motion.
        let turn = eta.re.norm();
        let scale = if turn > 3.0 { 3.0 / turn } else { 1.0 };
        at.plate = Exponential::new(eta.scaled(scale)).pose() * at.plate;
        let finite = |x: f64| if x.is_finite() { x } else { f64::INFINITY };
        Step { size: finite(size), load: finite(load) }
    }

    /// Turns K and wrenches to the plate's centre, counts the inertia.
    pub fn state(
        &self,
        unknowns: Unknowns,
        loads: Loads,
        clearance: Option<([usize; 2], f64)>,
        iterations: usize,
    ) -> State {
        let centre = unknowns.plate.position();
        let (mut stiffness, mut sum, mut unstable_rods, mut energy) = (Matrix6::zeros(), DualVector::ZERO, 0, 0.0);
        let shift = about(&centre);
        let mut by_pressure = Vec::with_capacity(self.condensed.len());
        for ((condensed, assembly), (_, w)) in self.condensed.iter().zip(&self.assemblies).zip(&unknowns.rods) {
            stiffness += condensed.tip_stiffness();
            sum += *w;
            unstable_rods += condensed.unstable;
            energy += assembly.energy;
            by_pressure.push(shift.tr_mul(&condensed.wrench_by_pressure()));
        }
        let force = loads.force + loads.gravity * self.module.plate_mass;
        energy -= force.dot(&(centre - self.module.rest));
        let f = skew(&force);
        stiffness -= half_bracket(&sum) + blocks(f * skew(&centre), -f, Matrix3::zeros(), Matrix3::zeros());
        let stiffness = shift.tr_mul(&(stiffness * shift));
        let unstable_plate = match self.held {
            true => 0,
            false => negative_modes(&stiffness, self.module.length()),
        };
        let tangent = self.condensed.as_slice().into();
        State {
            loads,
            unknowns,
            stiffness,
            by_pressure,
            tangent,
            unstable_rods,
            unstable_plate,
            energy,
            clearance,
            iterations,
        }
    }
}

/// A twist about `centre` seen from the origin: v0 = v + p x w.
fn about(centre: &Vector3<f64>) -> Matrix6<f64> {
    let identity = Matrix3::identity();
    blocks(identity, Matrix3::zeros(), skew(centre), identity)
}

/// Makes the plate's motions in radians and lengths one of radians and m.
fn scale(length: f64) -> Vector6<f64> {
    Vector6::new(1.0, 1.0, 1.0, length, length, length)
}

/// Negative eigenvalues of the symmetric part of K; Cholesky's factorisation is the fast answer where there are none.
fn negative_modes(stiffness: &Matrix6<f64>, length: f64) -> i32 {
    if Cholesky::new((stiffness + stiffness.transpose()) * 0.5).is_some() {
        return 0;
    }
    modes(stiffness, length).filter(|(value, _)| *value < 0.0).count() as i32
}

/// Eigenvalues (N m) and modes (rotation, translation) of the symmetric part of K, translations measured in `length`.
pub(super) fn modes(stiffness: &Matrix6<f64>, length: f64) -> impl Iterator<Item = (f64, Vector6<f64>)> {
    let scale = scale(length);
    let scaled = Matrix6::from_fn(|i, j| 0.5 * (stiffness[(i, j)] + stiffness[(j, i)]) * scale[i] * scale[j]);
    let eigen = SymmetricEigen::new(scaled);
    (0..6).map(move |i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).component_mul(&scale)))
}
