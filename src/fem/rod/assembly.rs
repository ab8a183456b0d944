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
use super::dual::{DualMatrix, DualVector, Exponential, MAX_SQUARED_ANGLE};
use super::{Rod, RodError};

/// Unknowns of one mode: bending 2, twist, shear 2, stretch (as a dual vector's components).
pub(crate) const STRAINS: usize = 6;

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
    geometric: Vec<DualMatrix>,
    pulled: Vec<[DualMatrix; 2]>,
    axial: Vec<[f64; 3]>,
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
        let commutator = 3f64.sqrt() / 12.0 * h * h;
        let wrench_skew = wrench.skew();
        let mut g = *base;
        self.nodes.push(g);
        for step in 0..steps {
            let phi = [basis.at(2 * step), basis.at(2 * step + 1)];
            let x = phi.map(|p| strain(p, q));
            let t = (x[0] + x[1]).scaled(0.5 * h) + x[0].cross(&x[1]).scaled(commutator);
            if !(t.re.norm_squared() <= MAX_SQUARED_ANGLE) {
                return Err(RodError::TooCoarse { angle: t.re.norm(), steps });
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
            for m in 0..modes {
                let p = [phi[0][m], phi[1][m]];
                // What all the steps before have turned, and this step's own second derivative.
                let mut z = turn.transpose_mul(&(wrench_skew * self.jacobian[m]));
                z.add_scaled(p[0], &local_by[0]);
                z.add_scaled(p[1], &local_by[1]);
                let mut pulled = [by[0].transpose_mul(&z), by[1].transpose_mul(&z)];
                pulled[0].add_scaled(-commutator * p[1], &bracket);
                pulled[1].add_scaled(commutator * p[0], &bracket);
                self.pulled[m] = pulled;
            }
            for m in 0..modes {
                let mut u = by[0].scaled(phi[0][m]);
                u.add_scaled(phi[1][m], &by[1]);
                self.jacobian[m] = self.jacobian[m] + turn * u;
                for (entry, pulled) in self.geometric[m * modes..][..modes].iter_mut().zip(&self.pulled) {
                    entry.add_scaled(phi[0][m], &pulled[0]);
                    entry.add_scaled(phi[1][m], &pulled[1]);
                }
            }
            g = g * exponential.pose();
            self.nodes.push(g);
        }
        self.geometric_stiffness(modes);
        Ok(())
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
        self.axial.clear();
        self.axial.resize(modes * modes, [0.0; 3]);
        self.nodes.clear();
    }

    /// The law's part: energy, dU/dq, d2U/dq2, d2U/dq dP.
    fn constitutive(&mut self, rod: &Rod, basis: &Basis, pressure: f64, q: &[f64]) -> Result<(), RodError> {
        let Rod { length, ref law, rest_curvature, .. } = *rod;
        let isobar = law.at(pressure)?;
        let modes = basis.modes;
        let weight = length / (2 * basis.steps) as f64;
        let ([ei, ga, c], [ei_p, ga_p, c_p]) = (isobar.lateral, isobar.lateral_slope);
        for point in 0..2 * basis.steps {
            let phi = basis.at(point);
            let x = strain(phi, q);
            let (k, g) = (x.re.xy() - rest_curvature, x.du.xy());
            let jet = isobar.jet(x.du.z, x.re.z)?;
            self.energy +=
                weight * (jet.value + 0.5 * ei * k.norm_squared() + 0.5 * ga * g.norm_squared() + c * k.dot(&g));
            self.energy_by_pressure += weight
                * (jet.gradient.z + 0.5 * ei_p * k.norm_squared() + 0.5 * ga_p * g.norm_squared() + c_p * k.dot(&g));
            let (bend, shear) = (k * ei + g * c, g * ga + k * c);
            let stress = [bend.x, bend.y, jet.gradient.y, shear.x, shear.y, jet.gradient.x];
            let (bend, shear) = (k * ei_p + g * c_p, g * ga_p + k * c_p);
            let slope = [bend.x, bend.y, jet.hessian.m23, shear.x, shear.y, jet.hessian.m13];
            for (m, p) in phi.iter().enumerate() {
                for i in 0..STRAINS {
                    self.internal[STRAINS * m + i] += weight * p * stress[i];
                    self.by_pressure[STRAINS * m + i] += weight * p * slope[i];
                }
                for (entry, o) in self.axial[m * modes..][..modes].iter_mut().zip(phi) {
                    let w = weight * p * o;
                    entry[0] += w * jet.hessian.m22;
                    entry[1] += w * jet.hessian.m12;
                    entry[2] += w * jet.hessian.m11;
                }
            }
        }
        let n = self.n;
        for m in 0..modes {
            for o in m..modes {
                let mass = length * basis.mass[m * modes + o];
                let [twist, cross, stretch] = self.axial[m * modes + o];
                let (row, column) = (STRAINS * m, STRAINS * o);
                for (i, j, value) in [
                    (0, 0, ei * mass),
                    (1, 1, ei * mass),
                    (3, 3, ga * mass),
                    (4, 4, ga * mass),
                    (0, 3, c * mass),
                    (1, 4, c * mass),
                    (3, 0, c * mass),
                    (4, 1, c * mass),
                    (2, 2, twist),
                    (5, 5, stretch),
                    (2, 5, cross),
                    (5, 2, cross),
                ] {
                    self.hessian[(row + i) * n + column + j] = value;
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
