//! One rod's discrete energy and its derivatives.
//!
//! The strains at the Gauss points of each Magnus step (fourth order, `g' = g xi`) give the step's screw
//!
//! ```text
//!     t = h (x1 + x2) / 2 + sqrt(3) h^2 / 12 x1 x x2,      g <- g exp(t)
//! ```
//!
//! and the same two points integrate the energy. All that follows are the exact derivatives of these discrete
//! quantities. With the wrench W that the tip bears, in the fixed frame about its origin (it is the same all along the
//! rod, for nothing else loads it), the residual by the strains' unknowns q is `dU/dq - J^T W`, with J the tip's
//! spatial twist by q, a sum over steps. Its derivative is the symmetric `H` below less half of the bracket of W with
//! the tip's own twists, which the solver folds into the change of W.

use nalgebra::{Matrix3, Vector3};

use super::basis::Basis;
use super::dual::{DualMatrix, DualVector, Exponential, MAX_ANGLE};
use super::{Rod, RodError};

/// Unknowns of one mode: bending 2, twist, shear 2, stretch (as a dual vector's components).
pub(crate) const STRAINS: usize = 6;

/// sqrt(3) / 12.
const COMMUTATOR: f64 = 0.144_337_567_297_406_43;

/// A rod's energy at given strains, and its derivatives. Vectors of the rod's n unknowns.
#[derive(Clone, Debug, Default)]
pub(crate) struct Assembly {
    pub n: usize,
    /// U less P V, J.
    pub energy: f64,
    /// -V of the whole rod, m3.
    pub energy_by_pressure: f64,
    /// dU/dq.
    pub internal: Vec<f64>,
    /// d2U/dq dP.
    pub by_pressure: Vec<f64>,
    /// Symmetric derivative of `dU/dq - J^T W`, n x n by rows, upper triangle.
    pub hessian: Vec<f64>,
    /// The tip's spatial twist by q, by mode.
    pub jacobian: Vec<DualMatrix>,
    /// Poses at the ends of the steps, from the base to the tip.
    pub nodes: Vec<DualMatrix>,
    /// Volume of the cavity per reference length, m2, and stretch at the Gauss points.
    pub cavity: Vec<[f64; 2]>,
    geometric: Vec<DualMatrix>,
    pulled: Vec<[DualMatrix; 2]>,
}

/// The strain at a Gauss point.
fn strain(modes: &[f64], q: &[f64]) -> DualVector {
    let mut x = [0.0; STRAINS];
    for (p, q) in modes.iter().zip(q.chunks_exact(STRAINS)) {
        for (x, q) in x.iter_mut().zip(q) {
            *x += p * q;
        }
    }
    DualVector { re: Vector3::new(x[0], x[1], x[2]), du: Vector3::new(x[3], x[4], 1.0 + x[5]) }
}

/// The screw of a step of length `h` with the strains `x` at its Gauss points.
fn screw(x: &[DualVector; 2], h: f64) -> DualVector {
    (x[0] + x[1]).scaled(0.5 * h) + x[0].cross(&x[1]).scaled(COMMUTATOR * h * h)
}

impl Assembly {
    /// Fills everything at the strains `q` of `rod` standing at `base` under `pressure` Pa with `wrench` at its tip.
    pub fn fill(
        &mut self,
        rod: &Rod,
        basis: &Basis,
        base: &DualMatrix,
        pressure: f64,
        q: &[f64],
        wrench: &DualVector,
    ) -> Result<(), RodError> {
        let (modes, steps) = (basis.modes, basis.steps);
        self.clear(modes);
        self.constitutive(rod, basis, pressure, q)?;
        let h = rod.length / steps as f64;
        let commutator = COMMUTATOR * h * h;
        let wrench_skew = wrench.skew();
        let mut g = *base;
        self.nodes.push(g);
        for step in 0..steps {
            let phi = [basis.at(2 * step), basis.at(2 * step + 1)];
            let x = phi.map(|p| strain(p, q));
            let t = screw(&x, h);
            let angle = t.re.norm();
            if angle.is_nan() || angle > MAX_ANGLE {
                return Err(RodError::TooCoarse { angle, steps });
            }
            let exponential = Exponential::new(t);
            // dt = L1 dx1 + L2 dx2.
            let mut by = [x[1].skew().scaled(-commutator), x[0].skew().scaled(commutator)];
            for l in &mut by {
                l.re += Matrix3::from_diagonal_element(0.5 * h);
            }
            let turn = g * exponential.derivative();
            let local = exponential.second_derivative(&g.transpose_apply(wrench));
            let local_by = [local * by[0], local * by[1]];
            let bracket = turn.transpose_apply(wrench).skew();
            let pairs = || phi[0].iter().zip(phi[1]).enumerate();
            for (m, (p, q)) in pairs() {
                // What all the steps before have turned, and this step's own second derivative.
                let mut z = turn.transpose_mul(&(wrench_skew * self.jacobian[m]));
                z.add_scaled(*p, &local_by[0]);
                z.add_scaled(*q, &local_by[1]);
                let mut pulled = [by[0].transpose_mul(&z), by[1].transpose_mul(&z)];
                pulled[0].add_scaled(-commutator * q, &bracket);
                pulled[1].add_scaled(commutator * p, &bracket);
                self.pulled[m] = pulled;
            }
            for (m, (p, q)) in pairs() {
                let mut u = by[0].scaled(*p);
                u.add_scaled(*q, &by[1]);
                self.jacobian[m] = self.jacobian[m] + turn * u;
                for (entry, pulled) in self.geometric[m * modes..][..modes].iter_mut().zip(&self.pulled) {
                    entry.add_scaled(*p, &pulled[0]);
                    entry.add_scaled(*q, &pulled[1]);
                }
            }
            g = g * exponential.pose();
            self.nodes.push(g);
        }
        self.geometric_stiffness(modes);
        Ok(())
    }

    /// By how much dU/dq would change if the rod at the strains `q` were `other`, whose energy alone is assembled here.
    pub fn change_by(
        &self,
        other: &Rod,
        basis: &Basis,
        pressure: f64,
        q: &[f64],
        room: &mut Assembly,
    ) -> Result<Vec<f64>, RodError> {
        room.clear(basis.modes);
        room.constitutive(other, basis, pressure, q)?;
        Ok(room.internal.iter().zip(&self.internal).map(|(b, a)| b - a).collect())
    }

    /// Moves the energy alone by the changes `dq` and `dp` (Pa): to first order.
    pub fn move_energy(&mut self, dq: &[f64], dp: f64) {
        self.energy += self.internal.iter().zip(dq).map(|(g, d)| g * d).sum::<f64>() + self.energy_by_pressure * dp;
    }

    /// Moves the poses of the nodes alone to the strains `q`, near those of [`Assembly::fill`].
    pub fn move_nodes(&mut self, rod: &Rod, basis: &Basis, q: &[f64]) {
        let h = rod.length / basis.steps as f64;
        for step in 0..basis.steps {
            let x = [0, 1].map(|point| strain(basis.at(2 * step + point), q));
            self.nodes[step + 1] = self.nodes[step] * Exponential::new(screw(&x, h)).pose();
        }
    }

    /// The tip's pose.
    pub fn tip(&self) -> DualMatrix {
        self.nodes.last().copied().unwrap_or_else(DualMatrix::identity)
    }

    fn clear(&mut self, modes: usize) {
        let n = STRAINS * modes;
        self.n = n;
        (self.energy, self.energy_by_pressure) = (0.0, 0.0);
        for (vector, length) in [(&mut self.internal, n), (&mut self.by_pressure, n), (&mut self.hessian, n * n)] {
            vector.clear();
            vector.resize(length, 0.0);
        }
        for (vector, length) in [(&mut self.jacobian, modes), (&mut self.geometric, modes * modes)] {
            vector.clear();
            vector.resize(length, DualMatrix::ZERO);
        }
        self.pulled.resize(modes, [DualMatrix::ZERO; 2]);
        self.nodes.clear();
        self.cavity.clear();
    }

    /// The law's part: energy, dU/dq, d2U/dq2, d2U/dq dP.
    fn constitutive(&mut self, rod: &Rod, basis: &Basis, pressure: f64, q: &[f64]) -> Result<(), RodError> {
        let Rod { length, ref law, rest_curvature, .. } = *rod;
        let mut isobar = law.at(pressure);
        let (n, weight) = (self.n, length / (2 * basis.steps) as f64);
        for point in 0..2 * basis.steps {
            let phi = basis.at(point);
            let x = strain(phi, q);
            let density = isobar.density(&(x.re.xy() - rest_curvature), &x.du.xy(), x.du.z, x.re.z)?;
            self.energy += weight * density.value;
            self.energy_by_pressure += weight * density.by_pressure;
            self.cavity.push([-density.by_pressure, x.du.z]);
            let (stress, slope) = (density.stress * weight, density.stress_by_pressure * weight);
            let tangent: [[f64; STRAINS]; STRAINS] = (density.tangent * weight).into();
            for (m, p) in phi.iter().enumerate() {
                for i in 0..STRAINS {
                    self.internal[STRAINS * m + i] += p * stress[i];
                    self.by_pressure[STRAINS * m + i] += p * slope[i];
                }
                for (o, other) in phi.iter().enumerate().skip(m) {
                    let share = p * other;
                    for (i, column) in tangent.iter().enumerate() {
                        let row = &mut self.hessian[(STRAINS * m + i) * n + STRAINS * o..][..STRAINS];
                        for (entry, t) in row.iter_mut().zip(column) {
                            *entry += share * t;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Takes the symmetric part of the wrench's second-order work off the Hessian.
    fn geometric_stiffness(&mut self, modes: usize) {
        let n = self.n;
        for m in 0..modes {
            for o in m..modes {
                let (a, b) = (&self.geometric[m * modes + o], &self.geometric[o * modes + m]);
                let re = (a.re + b.re.transpose()) * 0.5;
                let du = (a.du + b.du.transpose()) * 0.5;
                for i in 0..3 {
                    let row = (STRAINS * m + i) * n + STRAINS * o;
                    let shear_row = row + 3 * n;
                    for j in 0..3 {
                        self.hessian[row + j] -= du[(i, j)];
                        self.hessian[row + 3 + j] -= re[(i, j)];
                        self.hessian[shear_row + j] -= re[(i, j)];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2, Vector6};

    use super::super::basis::{Basis, Resolution};
    use super::super::condensed::{Condensed, moment_force, twist, vector6};
    use super::super::law::{Law, Straight};
    use super::super::profile::Profile;
    use super::*;

    const PRESSURE: f64 = 0.7;

    /// A coupled law of numbers of order one.
    fn rod() -> Rod {
        let stiffness = Matrix2::new(3.0, 0.4, 0.4, 0.7);
        let actuation = Vector2::new(0.2, -0.3);
        let law = Law {
            straight: Straight::Linear { stiffness, actuation, volume: 0.2, compliance: 0.1 },
            bending: Profile::through([(0.0, 1.0), (1.0, 1.5), (2.0, 2.2)]),
            shear: Profile::through([(0.0, 2.0), (1.0, 2.1), (2.0, 2.0)]),
            coupling: Profile::through([(0.0, 0.2), (1.0, 0.3), (2.0, 0.5)]),
            mirrored: true,
        };
        Rod { length: 1.3, law, rest_curvature: Vector2::new(0.1, -0.2), outer_radius: 0.0 }
    }

    fn basis() -> Basis {
        Basis::new(Resolution { degree: 2, steps: 3 })
    }

    fn base() -> DualMatrix {
        let screw = DualVector { re: Vector3::new(0.3, -0.2, 0.5), du: Vector3::new(0.4, 0.1, -0.6) };
        Exponential::new(screw).pose()
    }

    /// Numbers without a pattern, within +-size.
    fn vector(seed: f64, size: f64, n: usize) -> Vec<f64> {
        (0..n).map(|i| size * (seed + 1.7 * i as f64 + 0.3 * (i * i) as f64).sin()).collect()
    }

    fn wrench() -> DualVector {
        DualVector { re: Vector3::new(0.3, -0.5, 0.4), du: Vector3::new(-0.2, 0.6, 0.1) }
    }

    fn at(q: &[f64], w: &DualVector, pressure: f64) -> Assembly {
        let mut a = Assembly::default();
        a.fill(&rod(), &basis(), &base(), pressure, q, w).unwrap();
        a
    }

    fn along(q: &[f64], d: &[f64], s: f64) -> Vec<f64> {
        q.iter().zip(d).map(|(q, d)| q + s * d).collect()
    }

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    /// `J d`.
    fn turned(a: &Assembly, d: &[f64]) -> DualVector {
        let mut sum = DualVector::ZERO;
        for (j, d) in a.jacobian.iter().zip(d.chunks_exact(STRAINS)) {
            sum += j.apply(&DualVector { re: Vector3::new(d[0], d[1], d[2]), du: Vector3::new(d[3], d[4], d[5]) });
        }
        sum
    }

    fn hessian_times(a: &Assembly, d: &[f64]) -> Vec<f64> {
        let entry = |i: usize, j: usize| a.hessian[i.min(j) * a.n + i.max(j)];
        (0..a.n).map(|i| (0..a.n).map(|j| entry(i, j) * d[j]).sum()).collect()
    }

    /// `dU/dq - J^T W` along `d`.
    fn residual(a: &Assembly, w: &DualVector, d: &[f64]) -> f64 {
        dot(&a.internal, d) - w.work(&turned(a, d))
    }

    /// Asserts that the remainders after halving the step fall by 2^order.
    #[track_caller]
    fn slope(order: i32, remainder: impl Fn(f64) -> f64) {
        let ratio = remainder(2e-3) / remainder(1e-3);
        assert!((ratio.abs().log2() - f64::from(order)).abs() < 0.05, "{ratio}");
    }

    #[test]
    fn the_energys_gradient_and_hessian_leave_taylors_remainders() {
        let (q, d) = (vector(0.2, 0.4, 18), vector(1.1, 1.0, 18));
        let a = at(&q, &DualVector::ZERO, PRESSURE);
        let energy = |s: f64| at(&along(&q, &d, s), &DualVector::ZERO, PRESSURE).energy;
        // This law is quadratic in q: its second-order expansion is exact.
        let expanded = |s: f64| a.energy + s * dot(&a.internal, &d) + 0.5 * s * s * dot(&d, &hessian_times(&a, &d));
        assert!((energy(0.1) - expanded(0.1)).abs() < 1e-13);
        // By pressure, and mixed.
        let e = 1e-4;
        let [low, high] = [-e, e].map(|s| at(&q, &DualVector::ZERO, PRESSURE + s));
        assert!(((high.energy - low.energy) / (2.0 * e) - a.energy_by_pressure).abs() < 1e-8);
        for i in 0..a.n {
            assert!(((high.internal[i] - low.internal[i]) / (2.0 * e) - a.by_pressure[i]).abs() < 1e-8);
        }
    }

    #[test]
    fn the_tips_jacobian_leaves_a_remainder_of_second_order() {
        let (q, d) = (vector(0.2, 0.4, 18), vector(1.1, 1.0, 18));
        let a = at(&q, &DualVector::ZERO, PRESSURE);
        slope(2, |s| {
            let moved = at(&along(&q, &d, s), &DualVector::ZERO, PRESSURE).tip();
            let twist = super::super::dual::small_twist(&a.tip(), &moved) - turned(&a, &d).scaled(s);
            twist.re.norm() + twist.du.norm()
        });
    }

    #[test]
    fn the_hessian_less_half_the_bracket_leaves_a_remainder_of_second_order() {
        let (q, d, other) = (vector(0.2, 0.4, 18), vector(1.1, 1.0, 18), vector(2.3, 1.0, 18));
        let w = wrench();
        let a = at(&q, &w, PRESSURE);
        // test direction `other`: other^T (H - 1/2 J^T [W . [J d, J other]]) d
        let tangent = dot(&other, &hessian_times(&a, &d)) - 0.5 * w.work(&turned(&a, &d).cross(&turned(&a, &other)));
        slope(2, |s| {
            let moved = residual(&at(&along(&q, &d, s), &w, PRESSURE), &w, &other);
            moved - residual(&a, &w, &other) - s * tangent
        });
    }

    #[test]
    fn the_condensed_tip_follows_its_twist_and_pressure() {
        // From a balanced, closed state, the change by a small twist and pressure is that of the full equations.
        let (q, w) = (vector(0.2, 0.4, 18), wrench());
        let a = at(&q, &w, PRESSURE);
        let mut condensed = Condensed::default();
        assert!(condensed.eliminate(&a, &w, 1.0, 1.3));
        let (eta, gap) = (Vector6::new(0.1, -0.3, 0.2, 0.4, 0.1, -0.2), Vector6::new(0.0, 0.2, 0.1, -0.1, 0.3, 0.2));
        let (dp, mut dq) = (0.3, Vec::new());
        let dw = condensed.expand(&eta, &gap, dp, 1.0, &mut dq);
        assert!((vector6(&turned(&a, &dq)) - eta - gap).norm() < 1e-10);
        let change = super::super::condensed::wrench(&dw);
        for i in 0..18 {
            let mut unit = vec![0.0; 18];
            unit[i] = 1.0;
            let bracket = 0.5 * w.work(&turned(&a, &dq).cross(&turned(&a, &unit)));
            let left = hessian_times(&a, &dq)[i] - bracket + a.by_pressure[i] * dp - change.work(&turned(&a, &unit));
            assert!((left + residual(&a, &w, &unit)).abs() < 1e-9, "{i}");
        }
        // The plate's equation gets the same wrench from the condensed form.
        let from_tip = condensed.tip_stiffness() * eta - super::super::condensed::half_bracket(&w) * eta
            + condensed.wrench_offset(&gap)
            + condensed.wrench_by_pressure() * dp;
        assert!((from_tip - dw).norm() < 1e-9 && (moment_force(&change) - dw).norm() == 0.0);
        assert!((condensed.tip_stiffness() - condensed.tip_stiffness().transpose()).amax() < 1e-9);
        // A residual that changes as by pressure, by another way.
        let by = condensed.wrench_by(a.by_pressure.clone()) - condensed.wrench_by_pressure();
        assert!(by.norm() < 1e-9 * condensed.wrench_by_pressure().norm());
        assert_eq!(vector6(&twist(&eta)), eta);
    }

    #[test]
    fn a_rigid_motion_changes_nothing_but_the_frame() {
        let q = vector(0.2, 0.4, 18);
        let (mut still, mut moved) = (Assembly::default(), Assembly::default());
        let w = wrench();
        // The wrench of the moved rod, and the moved frame's tip.
        let turned = base().re * w.re;
        let carried = DualVector { re: turned, du: base().re * w.du + base().position().cross(&turned) };
        still.fill(&rod(), &basis(), &DualMatrix::identity(), PRESSURE, &q, &w).unwrap();
        moved.fill(&rod(), &basis(), &base(), PRESSURE, &q, &carried).unwrap();
        assert_eq!(still.energy, moved.energy);
        let apart = (base() * still.tip()).re - moved.tip().re;
        assert!(apart.norm() < 1e-14);
        assert!(still.hessian.iter().zip(&moved.hessian).all(|(a, b)| (a - b).abs() < 1e-13));
    }

    #[test]
    fn too_coarse_a_step_is_refused_by_name() {
        let mut q = vec![0.0; 18];
        q[2] = 10.0;
        let mut a = Assembly::default();
        let refused = a.fill(&rod(), &basis(), &base(), PRESSURE, &q, &wrench()).unwrap_err();
        assert!(matches!(refused, RodError::TooCoarse { steps: 3, .. }));
    }
}
