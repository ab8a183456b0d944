//! The potential per length at one state of strain, and its derivatives.

use nalgebra::{SMatrix, SVector, Vector2};

use super::assembly::STRAINS;
use super::law::{Isobar, Jet, LawError};

/// Strains: curvature x, y, twist, shear x, y, stretch.
type Strain = SVector<f64, STRAINS>;
const TWIST: usize = 2;
const STRETCH: usize = 5;

/// The potential's value and derivatives at a state of strain.
pub(super) struct Density {
    /// J per reference metre.
    pub value: f64,
    /// By pressure.
    pub by_pressure: f64,
    /// By the strains.
    pub stress: Strain,
    /// That by pressure.
    pub stress_by_pressure: Strain,
    /// By the strains twice; symmetric.
    pub tangent: SMatrix<f64, STRAINS, STRAINS>,
}

impl Isobar<'_> {
    /// psi at the curvature `k` beyond that at rest, the shear `g`, stretch and twist.
    ///
    /// The lateral part is `EI |k|^2 / 2 + GA |s|^2 / 2` with `s = g + q k`, whose three coefficients follow stretch,
    /// twist and pressure.
    pub(super) fn density(
        &mut self,
        k: &Vector2<f64>,
        g: &Vector2<f64>,
        stretch: f64,
        twist: f64,
    ) -> Result<Density, LawError> {
        let straight = self.jet(stretch, twist)?;
        let [ei, ga, q] = self.lateral(stretch, twist)?;
        let s = g + k * q.value;
        let (kk, ss, ks) = (k.norm_squared(), s.norm_squared(), k.dot(&s));
        // By (stretch, twist, pressure) x: s_x = q_x k.
        let lateral = Jet {
            value: 0.5 * (ei.value * kk + ga.value * ss),
            gradient: ei.gradient * (0.5 * kk) + ga.gradient * (0.5 * ss) + q.gradient * (ga.value * ks),
            hessian: ei.hessian * (0.5 * kk)
                + ga.hessian * (0.5 * ss)
                + q.hessian * (ga.value * ks)
                + q.gradient * q.gradient.transpose() * (ga.value * kk)
                + (ga.gradient * q.gradient.transpose() + q.gradient * ga.gradient.transpose()) * ks,
        };
        let (gradient, hessian) = (straight.gradient + lateral.gradient, straight.hessian + lateral.hessian);
        let shear = s * ga.value;
        let bend = k * ei.value + shear * q.value;
        // Their derivatives by x.
        let moved = |x: usize| {
            let shear = s * ga.gradient[x] + k * (ga.value * q.gradient[x]);
            (k * ei.gradient[x] + shear * q.value + s * (ga.value * q.gradient[x]), shear)
        };
        let vector = |bend: Vector2<f64>, twist: f64, shear: Vector2<f64>, stretch: f64| {
            Strain::from([bend.x, bend.y, twist, shear.x, shear.y, stretch])
        };
        let mut tangent = SMatrix::<f64, STRAINS, STRAINS>::zeros();
        for (strain, x) in [(STRETCH, 0), (TWIST, 1)] {
            let (bend, shear) = moved(x);
            let column = vector(bend, hessian[(1, x)], shear, hessian[(0, x)]);
            tangent.set_column(strain, &column);
            tangent.set_row(strain, &column.transpose());
        }
        let coupling = ga.value * q.value;
        for i in 0..2 {
            tangent[(i, i)] = ei.value + coupling * q.value;
            tangent[(i + 3, i + 3)] = ga.value;
            tangent[(i, i + 3)] = coupling;
            tangent[(i + 3, i)] = coupling;
        }
        let (bend_by_pressure, shear_by_pressure) = moved(2);
        Ok(Density {
            value: straight.value + lateral.value,
            by_pressure: gradient.z,
            stress: vector(bend, gradient.y, shear, gradient.x),
            stress_by_pressure: vector(bend_by_pressure, hessian.m23, shear_by_pressure, hessian.m13),
            tangent,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::linear::LinearSection;
    use crate::fem::rod::{Axis, Grid, Law, Profile, Straight};
    use crate::fem::tube::Tube;

    /// Stiffness that follows stretch, twist and pressure.
    fn law(mirrored: bool) -> Law {
        let axis = |from: f64, to: f64| Axis { from, to, points: 5 };
        let grid = Grid { skew: [1e-3, 1e-6], ..Grid::straight(axis(0.9, 1.1), axis(-20.0, 20.0), axis(0.0, 5e4)) };
        let samples = (0..125).map(|k| grid.at([k / 25, k / 5 % 5, k % 5])).map(|at @ [l, t, p]| {
            let (l, t, p) = (l - 1.0, 0.02 * t, 1e-5 * p);
            (
                at,
                [
                    4e-4 * (1.0 + 5.0 * l - t * t + p - l * t),
                    9.0 * (1.0 + l + 0.3 * t + p * p),
                    1e-3 * (1.0 - t * p + 2.0 * l * p),
                ],
            )
        });
        let [bending, shear, coupling] = Profile::fitted(&grid, &samples.collect::<Vec<_>>()).unwrap();
        let straight = Straight::closed_form(&LinearSection::new(&Tube::reference(0.7)).unwrap());
        Law { straight, bending, shear, coupling, mirrored }
    }

    fn at(mirrored: bool, x: &Strain, pressure: f64) -> Density {
        let law = law(mirrored);
        law.at(pressure).density(&Vector2::new(x[0], x[1]), &Vector2::new(x[3], x[4]), x[5], x[2]).unwrap()
    }

    #[test]
    fn every_derivative_is_that_of_the_one_potential_of_either_hand() {
        let (x, pressure) = (Strain::from([6.0, -9.0, 4.0, 0.02, -0.03, 1.02]), 2e4);
        for mirrored in [false, true] {
            let density = at(mirrored, &x, pressure);
            for i in 0..STRAINS {
                let h = if i < 3 { 1e-3 } else { 1e-6 };
                let [low, high] = [-h, h].map(|h| at(mirrored, &(x + Strain::ith(i, h)), pressure));
                let slope = (high.value - low.value) / (2.0 * h);
                assert!((slope - density.stress[i]).abs() < 1e-6 * density.stress.norm(), "{i}: {slope}");
                let slope = (high.stress - low.stress) / (2.0 * h);
                let column = density.tangent.column(i);
                assert!((slope - column).norm() < 1e-6 * column.norm(), "{i}: {slope} {column}");
            }
            let [low, high] = [-1.0, 1.0].map(|h| at(mirrored, &x, pressure + h));
            let slope = (high.value - low.value) / 2.0;
            assert!((slope / density.by_pressure - 1.0).abs() < 1e-6, "{slope} {}", density.by_pressure);
            let slope = (high.stress - low.stress) / 2.0;
            assert!((slope - density.stress_by_pressure).norm() < 1e-6 * slope.norm(), "{slope}");
        }
    }

    #[test]
    fn a_mirror_image_bent_and_turned_the_other_way_bears_the_mirrored_load() {
        // Mirrored in the plane of y and z.
        let mirror = Strain::from([1.0, -1.0, -1.0, -1.0, 1.0, 1.0]);
        let x = Strain::from([6.0, -9.0, 4.0, 0.02, -0.03, 1.02]);
        let (right, left) = (at(false, &x, 2e4), at(true, &x.component_mul(&mirror), 2e4));
        assert!((right.value - left.value).abs() < 1e-14);
        assert!((right.stress.component_mul(&mirror) - left.stress).norm() < 1e-12);
    }
}
