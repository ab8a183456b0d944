//! Hyperelastic laws: energy, stress and tangent of the deformation gradient F.
//!
//! One law covers the first-order Ogden, the neo-Hookean and the Hencky solid: with the isochoric logarithmic
//! stretches `h_i = ln l_i - (ln J) / 3`, which sum to zero,
//!
//! ```text
//!     Psi = 2 mu / alpha^2 sum( exp(alpha h_i) - 1 )        (Eq. 10 of the paper, l_i^alpha = exp(alpha h_i))
//! ```
//!
//! mu is the shear modulus at rest for every alpha; alpha = 2 is neo-Hookean and alpha -> 0 is Hencky's
//! `mu sum(h_i^2)`. All terms are written through functions that stay exact in that limit and for coincident
//! stretches: what looks like a quotient of differences of principal stresses is
//!
//! ```text
//!     (t_i - t_j) / (l_i^2 - l_j^2) = mu exp(alpha h_m) sinhc(alpha d / 2) / (l_i l_j sinhc(d))
//!     d = ln l_i - ln l_j,  h_m = (h_i + h_j) / 2,  sinhc(x) = sinh(x) / x
//! ```
//!
//! with t_i the principal Kirchhoff stresses. No eigenvalue is ever perturbed.
//!
//! The volumetric part belongs to the formulation (a pressure field), which gets the volume ratio and its
//! derivatives from the same [`Law`], since the linear law's volume measure is the trace of the strain.

use nalgebra::{Matrix3, SMatrix};
use thiserror::Error;

use super::spectral::{eigen, expc, expc2, sinhc};

/// Derivative of the first Piola-Kirchhoff stress by F: row `3 i + J`, column `3 k + L` is dP_iJ / dF_kL.
pub type Tangent = SMatrix<f64, 9, 9>;

/// Largest |alpha| accepted: beyond it a stretch of 2 already costs 1e6 mu and nothing is rubber any more.
pub const MAX_ALPHA: f64 = 20.0;

/// What a law refuses.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum MaterialError {
    /// The shear modulus is not a positive, finite number.
    #[error("shear modulus {0} Pa: must be positive and finite")]
    ShearModulus(f64),
    /// The Ogden exponent is not a finite number within +-[`MAX_ALPHA`].
    #[error("Ogden exponent {0}: must be finite and within +-{MAX_ALPHA} (0 is Hencky's law, negative is allowed)")]
    Alpha(f64),
    /// The deformation gradient turns the material inside out, or is not finite.
    #[error("deformation gradient with determinant {0}: the material is turned inside out")]
    Inverted(f64),
}

/// Energy, stress and tangent at one deformation gradient, in the units of the shear modulus.
#[derive(Clone, Copy, Debug)]
pub struct Response {
    /// Energy per reference volume.
    pub energy: f64,
    /// First Piola-Kirchhoff stress dPsi/dF, rows current, columns reference.
    pub stress: Matrix3<f64>,
    /// dP/dF, symmetric.
    pub tangent: Tangent,
}

/// The isochoric part of a material law. Moduli in Pa, or in any one unit that the caller keeps to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Law {
    /// First-order Ogden, exponent within +-[`MAX_ALPHA`]; alpha = 0 is Hencky's law.
    Ogden {
        /// Shear modulus at rest.
        mu: f64,
        /// Exponent of the stretches.
        alpha: f64,
    },
    /// Neo-Hookean, `mu/2 (J^(-2/3) tr C - 3)`: Ogden with alpha = 2 in closed form.
    NeoHookean {
        /// Shear modulus.
        mu: f64,
    },
    /// Linear elastic in the small strain `sym(F) - 1`: `mu |dev eps|^2`.
    Linear {
        /// Shear modulus.
        mu: f64,
    },
}

impl Law {
    /// First-order Ogden law; alpha = 2 is taken in its closed form.
    pub fn ogden(mu: f64, alpha: f64) -> Result<Law, MaterialError> {
        if !(alpha.is_finite() && alpha.abs() <= MAX_ALPHA) {
            return Err(MaterialError::Alpha(alpha));
        }
        let mu = positive(mu)?;
        Ok(if alpha == 2.0 { Law::NeoHookean { mu } } else { Law::Ogden { mu, alpha } })
    }

    /// Neo-Hookean law.
    pub fn neo_hookean(mu: f64) -> Result<Law, MaterialError> {
        Ok(Law::NeoHookean { mu: positive(mu)? })
    }

    /// Linear elastic law.
    pub fn linear(mu: f64) -> Result<Law, MaterialError> {
        Ok(Law::Linear { mu: positive(mu)? })
    }

    /// The shear modulus at rest.
    pub fn shear_modulus(&self) -> f64 {
        match *self {
            Law::Ogden { mu, .. } | Law::NeoHookean { mu } | Law::Linear { mu } => mu,
        }
    }

    /// Exponent alpha of its Ogden law: 2 of a neo-Hookean one, none of a linear one.
    pub fn exponent(&self) -> Option<f64> {
        match *self {
            Law::Ogden { alpha, .. } => Some(alpha),
            Law::NeoHookean { .. } => Some(2.0),
            Law::Linear { .. } => None,
        }
    }

    /// The same law with another shear modulus: how a solver makes it dimensionless.
    pub fn with_shear_modulus(self, mu: f64) -> Law {
        match self {
            Law::Ogden { alpha, .. } => Law::Ogden { mu, alpha },
            Law::NeoHookean { .. } => Law::NeoHookean { mu },
            Law::Linear { .. } => Law::Linear { mu },
        }
    }

    /// Energy, stress and tangent of the isochoric part at F.
    pub fn respond(&self, f: &Matrix3<f64>) -> Result<Response, MaterialError> {
        match *self {
            Law::Ogden { mu, alpha } => ogden(mu, alpha, f),
            Law::NeoHookean { mu } => neo_hookean(mu, f),
            Law::Linear { mu } => Ok(linear(mu, f)),
        }
    }

    /// The law's volume ratio (det F, or 1 + tr eps for the linear law) and its derivative by F.
    pub fn volume(&self, f: &Matrix3<f64>) -> (f64, Matrix3<f64>) {
        match self {
            Law::Linear { .. } => (f.trace() - 2.0, Matrix3::identity()),
            _ => (f.determinant(), cofactor(f)),
        }
    }

    /// Adds `pressure` times the second derivative of the volume ratio to `tangent`.
    pub fn add_volume_tangent(&self, pressure: f64, f: &Matrix3<f64>, tangent: &mut Tangent) {
        if matches!(self, Law::Linear { .. }) {
            return;
        }
        // d2 det / dF_iJ dF_kL is the entry of F that is in neither the rows i, k nor the columns J, L, signed.
        for i in 0..3 {
            let (k, m) = ((i + 1) % 3, (i + 2) % 3);
            for j in 0..3 {
                let (l, n) = ((j + 1) % 3, (j + 2) % 3);
                for (row, column, value) in [(3 * i + j, 3 * k + l, f[(m, n)]), (3 * i + j, 3 * k + n, -f[(m, l)])] {
                    tangent[(row, column)] += pressure * value;
                    tangent[(column, row)] += pressure * value;
                }
            }
        }
    }
}

fn positive(mu: f64) -> Result<f64, MaterialError> {
    if mu.is_finite() && mu > 0.0 { Ok(mu) } else { Err(MaterialError::ShearModulus(mu)) }
}

/// d det F / dF, exact for singular F too.
pub fn cofactor(f: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| {
        let (k, m, l, n) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        f[(k, l)] * f[(m, n)] - f[(k, n)] * f[(m, l)]
    })
}

fn ogden(mu: f64, alpha: f64, f: &Matrix3<f64>) -> Result<Response, MaterialError> {
    let j = f.determinant();
    if !(j.is_finite() && j > 0.0) {
        return Err(MaterialError::Inverted(j));
    }
    let (c, right) = eigen(&(f.transpose() * f));
    if c.iter().any(|&c| c <= 0.0) {
        return Err(MaterialError::Inverted(j));
    }
    let stretch = c.map(f64::sqrt);
    let log = c.map(|c| 0.5 * c.ln());
    let h = log.add_scalar(-log.sum() / 3.0);
    let power = h.map(|h| (alpha * h).exp());
    // phi = 2 mu (exp(alpha h) - 1 - alpha h) / alpha^2: the linear term sums to zero and takes the cancellation out.
    let energy = 2.0 * mu * h.map(|h| h * h * expc2(alpha * h)).sum();
    let slope = h.map(|h| 2.0 * mu * h * expc(alpha * h));
    let kirchhoff = slope.add_scalar(-slope.sum() / 3.0);
    let curvature = power * (2.0 * mu);
    let mean = curvature.sum() / 9.0;

    // dyads[3 a + b] = n_a (x) N_b, flattened.
    let left = Matrix3::from_columns(&[
        f * right.column(0) / stretch[0],
        f * right.column(1) / stretch[1],
        f * right.column(2) / stretch[2],
    ]);
    let dyad = |a: usize, b: usize| -> [f64; 9] { std::array::from_fn(|row| left[(row / 3, a)] * right[(row % 3, b)]) };

    // The tangent is the sum of nine products u v^T.
    let (mut u, mut v) = ([[0.0; 9]; 9], [[0.0; 9]; 9]);
    let normal = [dyad(0, 0), dyad(1, 1), dyad(2, 2)];
    let mut stress = Matrix3::zeros();
    for a in 0..3 {
        stress += left.column(a) * right.column(a).transpose() * (kirchhoff[a] / stretch[a]);
        u[a] = normal[a];
        for b in 0..3 {
            let mut second = mean - (curvature[a] + curvature[b]) / 3.0;
            if a == b {
                second += curvature[a] - kirchhoff[a];
            }
            let factor = second / (stretch[a] * stretch[b]);
            for (v, n) in v[a].iter_mut().zip(&normal[b]) {
                *v += factor * n;
            }
        }
    }
    for (k, (a, b)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
        let product = stretch[a] * stretch[b];
        let d = log[a] - log[b];
        let shear = mu * (power[a] * power[b]).sqrt() * sinhc(0.5 * alpha * d) / (product * sinhc(d));
        let cross = 0.5 * ((c[a] + c[b]) * shear - (kirchhoff[a] + kirchhoff[b])) / product;
        let (ab, ba) = (dyad(a, b), dyad(b, a));
        (u[3 + 2 * k], u[4 + 2 * k]) = (ab, ba);
        for i in 0..9 {
            v[3 + 2 * k][i] = shear * ab[i] + cross * ba[i];
            v[4 + 2 * k][i] = shear * ba[i] + cross * ab[i];
        }
    }
    let mut tangent = Tangent::zeros();
    for (u, v) in u.iter().zip(&v) {
        for (mut column, v) in tangent.column_iter_mut().zip(v) {
            for (entry, u) in column.iter_mut().zip(u) {
                *entry += u * v;
            }
        }
    }
    Ok(Response { energy, stress, tangent })
}

fn neo_hookean(mu: f64, f: &Matrix3<f64>) -> Result<Response, MaterialError> {
    let j = f.determinant();
    if !(j.is_finite() && j > 0.0) {
        return Err(MaterialError::Inverted(j));
    }
    let scale = mu * j.powf(-2.0 / 3.0);
    let inverse = cofactor(f) / j;
    let trace = f.norm_squared();
    let stress = (f - inverse * (trace / 3.0)) * scale;
    let flat = |m: &Matrix3<f64>| SMatrix::<f64, 9, 1>::from_fn(|row, _| m[(row / 3, row % 3)]);
    let (g, x) = (flat(&inverse), flat(f));
    let mut tangent = Tangent::from_diagonal_element(scale);
    tangent.ger(-2.0 / 3.0 * scale, &x, &g, 1.0);
    tangent.ger(-2.0 / 3.0 * scale, &g, &x, 1.0);
    tangent.ger(2.0 / 9.0 * scale * trace, &g, &g, 1.0);
    for row in 0..9 {
        for column in 0..9 {
            let (i, jj, k, l) = (row / 3, row % 3, column / 3, column % 3);
            tangent[(row, column)] += scale * trace / 3.0 * inverse[(i, l)] * inverse[(k, jj)];
        }
    }
    // tr C - 3 by the principal strains would cancel as well; 1e-16 mu absolute is what a test may ask for.
    Ok(Response { energy: 0.5 * (scale * trace - 3.0 * mu), stress, tangent })
}

fn linear(mu: f64, f: &Matrix3<f64>) -> Response {
    let displacement = f - Matrix3::identity();
    let strain = (displacement + displacement.transpose()) * 0.5;
    let deviator = strain - Matrix3::identity() * (strain.trace() / 3.0);
    let tangent = Tangent::from_fn(|row, column| {
        let (i, j, k, l) = (row / 3, row % 3, column / 3, column % 3);
        let delta = |a: usize, b: usize| if a == b { 1.0 } else { 0.0 };
        mu * (delta(i, k) * delta(j, l) + delta(i, l) * delta(j, k) - 2.0 / 3.0 * delta(i, j) * delta(k, l))
    });
    Response { energy: mu * deviator.norm_squared(), stress: deviator * (2.0 * mu), tangent }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// A rotation from three angles, uniform enough for tests.
    fn rotation(rng: &mut Pcg64Mcg) -> Matrix3<f64> {
        let axis = Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
        nalgebra::Rotation3::from_scaled_axis(axis).into_inner()
    }

    /// F with the given stretches, turned on both sides.
    fn with_stretches(rng: &mut Pcg64Mcg, stretches: [f64; 3]) -> Matrix3<f64> {
        rotation(rng) * Matrix3::from_diagonal(&Vector3::from(stretches)) * rotation(rng)
    }

    fn states(rng: &mut Pcg64Mcg) -> Vec<Matrix3<f64>> {
        let mut states = vec![
            Matrix3::identity(),
            with_stretches(rng, [1.3, 1.3, 0.6]),
            with_stretches(rng, [0.8, 1.4, 1.4]),
            with_stretches(rng, [1.2, 1.2, 1.2]),
            with_stretches(rng, [1.2, 1.2 * (1.0 + 1e-9), 0.7]),
            with_stretches(rng, [1.2, 1.2 * (1.0 + 1e-4), 0.7]),
        ];
        for _ in 0..20 {
            let stretches = [0; 3].map(|_| rng.random_range(0.5..1.8));
            states.push(with_stretches(rng, stretches));
        }
        states
    }

    fn laws() -> Vec<Law> {
        let mut laws: Vec<Law> = [0.5, 0.8, 1.2, 1.999, 3.0, 4.0, 8.0, -2.0, 1e-7, 0.0]
            .map(|alpha| Law::Ogden { mu: 0.393, alpha })
            .to_vec();
        laws.extend([Law::NeoHookean { mu: 0.393 }, Law::Linear { mu: 0.393 }]);
        laws
    }

    fn random_direction(rng: &mut Pcg64Mcg) -> Matrix3<f64> {
        Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0))
    }

    fn flatten(m: &Matrix3<f64>) -> SMatrix<f64, 9, 1> {
        SMatrix::from_fn(|row, _| m[(row / 3, row % 3)])
    }

    #[test]
    fn stress_and_tangent_are_the_derivatives_of_the_energy() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for law in laws() {
            for f in states(&mut rng) {
                let d = random_direction(&mut rng);
                // Central differences of order 4, step 1e-3: truncation about 1e-12 relative to the fifth
                // derivative (up to 1e4 at alpha 8), round-off about 1e-12.
                let h = 1e-3;
                let at = |s: f64| law.respond(&(f + d * s)).unwrap();
                let (m2, m1, p1, p2) = (at(-2.0 * h), at(-h), at(h), at(2.0 * h));
                let here = at(0.0);
                let slope = (m2.energy - 8.0 * m1.energy + 8.0 * p1.energy - p2.energy) / (12.0 * h);
                let scale = here.tangent.norm();
                assert!((slope - here.stress.dot(&d)).abs() < 3e-8 * scale, "{law:?} {f}");
                let difference = (m2.stress - m1.stress * 8.0 + p1.stress * 8.0 - p2.stress) / (12.0 * h);
                let product = here.tangent * flatten(&d);
                assert!((flatten(&difference) - product).norm() < 3e-8 * scale, "{law:?} {f}");
            }
        }
    }

    #[test]
    fn taylor_remainders_fall_with_slope_two() {
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        for law in laws().into_iter().filter(|l| !matches!(l, Law::Linear { .. })) {
            let f = with_stretches(&mut rng, [1.3, 1.3, 0.7]);
            let d = random_direction(&mut rng);
            let here = law.respond(&f).unwrap();
            let remainder = |h: f64| {
                let there = law.respond(&(f + d * h)).unwrap();
                (flatten(&(there.stress - here.stress)) - here.tangent * flatten(&d) * h).norm()
            };
            let slope = (remainder(1e-3) / remainder(1e-4)).log10();
            // The next term of the series moves the slope by up to h f'''/f'' (1e-3 times about 20).
            assert!((slope - 2.0).abs() < 0.02, "{law:?}: {slope}");
        }
    }

    #[test]
    fn tangents_are_symmetric() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        for law in laws() {
            for f in states(&mut rng) {
                let mut tangent = law.respond(&f).unwrap().tangent;
                law.add_volume_tangent(0.7, &f, &mut tangent);
                assert!((tangent - tangent.transpose()).norm() < 1e-13 * tangent.norm());
            }
        }
    }

    #[test]
    fn the_energy_is_objective_and_isotropic_and_ignores_volume() {
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        for law in laws().into_iter().filter(|l| !matches!(l, Law::Linear { .. })) {
            for f in states(&mut rng) {
                let (q, r) = (rotation(&mut rng), rotation(&mut rng));
                let here = law.respond(&f).unwrap();
                let there = law.respond(&(q * f * r * 1.1)).unwrap();
                // Round-off of F enters the energy through the stress.
                let scale = 1e-14 * (here.energy + here.stress.norm() * f.norm() + 1.0);
                assert!((here.energy - there.energy).abs() < scale, "{law:?}");
                assert!((q * here.stress * r / 1.1 - there.stress).norm() < 1e-12 * here.tangent.norm());
                // Isochoric: the Kirchhoff stress has no trace.
                assert!((here.stress * f.transpose()).trace().abs() < 1e-13 * here.tangent.norm());
            }
        }
    }

    #[test]
    fn ogden_is_neo_hookean_at_two_and_hencky_at_zero() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        for f in states(&mut rng) {
            let a = Law::Ogden { mu: 2.0, alpha: 2.0 }.respond(&f).unwrap();
            let b = Law::neo_hookean(2.0).unwrap().respond(&f).unwrap();
            assert!((a.energy - b.energy).abs() < 1e-13);
            assert!((a.stress - b.stress).norm() < 1e-13);
            assert!((a.tangent - b.tangent).norm() < 1e-12);
            let c = Law::ogden(2.0, 0.0).unwrap().respond(&f).unwrap();
            let d = Law::ogden(2.0, 1e-9).unwrap().respond(&f).unwrap();
            assert!((c.energy - d.energy).abs() < 1e-8);
            assert!((c.tangent - d.tangent).norm() < 1e-7);
        }
        let f = Matrix3::from_diagonal(&Vector3::new(1.5, 1.0 / 1.5, 1.0));
        let hencky = Law::ogden(2.0, 0.0).unwrap().respond(&f).unwrap().energy;
        assert!((hencky - 2.0 * 2.0 * 1.5_f64.ln().powi(2)).abs() < 1e-14);
    }

    #[test]
    fn uniaxial_stress_is_the_textbook_formula() {
        // Incompressible uniaxial tension: nominal stress 2 mu / alpha (l^(alpha-1) - l^(-alpha/2-1)).
        for alpha in [0.8, 1.2, 4.0] {
            for l in [0.7, 1.0, 1.5, 2.5_f64] {
                let t = l.powf(-0.5);
                let f = Matrix3::from_diagonal(&Vector3::new(l, t, t));
                let p = Law::ogden(3.0, alpha).unwrap().respond(&f).unwrap().stress;
                let nominal = p[(0, 0)] - p[(1, 1)] * t / l;
                let exact = 6.0 / alpha * (l.powf(alpha - 1.0) - l.powf(-0.5 * alpha - 1.0));
                assert!((nominal - exact).abs() < 1e-13 * (1.0 + exact.abs()));
            }
        }
    }

    #[test]
    fn the_volume_and_its_derivatives_agree() {
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        for law in [Law::NeoHookean { mu: 1.0 }, Law::Linear { mu: 1.0 }] {
            for f in states(&mut rng) {
                let d = random_direction(&mut rng);
                let (_, gradient) = law.volume(&f);
                let h = 1e-5;
                let (plus, gp) = law.volume(&(f + d * h));
                let (minus, gm) = law.volume(&(f - d * h));
                assert!(((plus - minus) / (2.0 * h) - gradient.dot(&d)).abs() < 1e-9);
                let mut second = Tangent::zeros();
                law.add_volume_tangent(1.0, &f, &mut second);
                assert!((flatten(&((gp - gm) / (2.0 * h))) - second * flatten(&d)).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn what_is_no_material_is_refused() {
        assert_eq!(Law::ogden(-1.0, 1.2), Err(MaterialError::ShearModulus(-1.0)));
        assert!(matches!(Law::ogden(1.0, f64::NAN), Err(MaterialError::Alpha(_))));
        assert_eq!(Law::ogden(1.0, 21.0), Err(MaterialError::Alpha(21.0)));
        assert_eq!(Law::ogden(1.0, 2.0), Ok(Law::NeoHookean { mu: 1.0 }));
        let inside_out = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
        for law in [Law::Ogden { mu: 1.0, alpha: 1.2 }, Law::NeoHookean { mu: 1.0 }] {
            assert!(matches!(law.respond(&inside_out), Err(MaterialError::Inverted(_))));
            assert!(matches!(law.respond(&(inside_out * f64::NAN)), Err(MaterialError::Inverted(_))));
        }
    }
}
