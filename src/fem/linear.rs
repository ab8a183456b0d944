//! The closed-form linear section law: small pressure, any winding angle.
//!
//! A thick incompressible tube whose fibres are smeared on its outer surface, at small strain. Unknowns: axial
//! strain e, twist per length tau, fibre strain ef. Incompressibility leaves the outer radial displacement u free
//! and `ef = e cos^2 G + (u / Ro) sin^2 G + tau Ro sin G cos G` eliminates it in favour of ef:
//! `Ro u + Ro^2 e / 2 = v . x` with `v = Ro^2 (1/2 - k, -Ro q, 1 / sin^2 G)`, `k = cot^2 G`, `q = cot G`. The
//! in-plane strain energy of the expansion `c = v . x` is `2 mu A c^2 / (Ri Ro)^2`, hence
//!
//! ```text
//!     K = 4 mu A / (Ri Ro)^2 v v^T + diag(3 mu A, mu J, n EA / cos G),   A = pi (Ro^2 - Ri^2), J = pi/2 (Ro^4 - Ri^4)
//!     f = P dV/dx = P pi Ro^2 (1 - 2 k, -2 Ro q, 2 / sin^2 G),           K x = f + (N, M, 0)
//! ```
//!
//! Condensing ef gives the 2 x 2 stiffness of the section and its actuation.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::ends::{End, Ends, Equilibrium};
use super::tube::{Tube, TubeError};

/// Linear law of a long tube: `stiffness (e, tau) = pressure actuation + (N, M)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearSection {
    tube: Tube,
    /// Section stiffness by (axial strain, twist): N, N m, N m2.
    pub stiffness: Matrix2<f64>,
    /// Force and moment per pressure that a blocked section exerts, m2 and m3.
    pub actuation: Vector2<f64>,
    /// The same with inextensible fibres.
    pub inextensible_actuation: Vector2<f64>,
    /// Fibre strain by (axial strain, twist, pressure).
    fiber_strain: Vector3<f64>,
}

impl LinearSection {
    /// The law of `tube`.
    pub fn new(tube: &Tube) -> Result<LinearSection, TubeError> {
        let tube = tube.validated()?;
        let (ri, ro, mu) = (tube.inner_radius, tube.outer_radius(), tube.law.shear_modulus());
        let area = PI * (ro * ro - ri * ri);
        let polar = PI / 2.0 * (ro.powi(4) - ri.powi(4));
        let (sine, cosine) = tube.gamma.sin_cos();
        let q = cosine / sine;
        let k = q * q;
        let v = Vector3::new(0.5 - k, -ro * q, 1.0 / (sine * sine)) * (ro * ro);
        let f = Vector3::new(1.0 - 2.0 * k, -2.0 * ro * q, 2.0 / (sine * sine)) * (PI * ro * ro);
        let hoop = 4.0 * mu * area / (ri * ro).powi(2);
        let fibers = tube.fibers as f64 * tube.fiber_ea / cosine;
        // With s = hoop v3^2 + fibers: K - K3 K3^T / s, where the v v^T part shrinks by fibers / s.
        let s = hoop * v.z * v.z + fibers;
        let v2 = v.xy();
        let diagonal = Matrix2::from_diagonal(&Vector2::new(3.0 * mu * area, mu * polar));
        let stiffness = diagonal + v2 * v2.transpose() * (hoop * fibers / s);
        // f = 2 pi v, so the actuation shrinks by the same factor.
        let actuation = f.xy() * (fibers / s);
        let slope = v2 * (-hoop * v.z / s);
        let fiber_strain = Vector3::new(slope.x, slope.y, f.z / s);
        Ok(LinearSection { tube, stiffness, actuation, inextensible_actuation: f.xy(), fiber_strain })
    }

    /// Actuation over that of inextensible fibres, 0 to 1.
    pub fn actuation_ratio(&self) -> f64 {
        self.actuation.norm() / self.inextensible_actuation.norm()
    }

    /// K12^2 / (K11 K22): how strongly stretch and twist are coupled, 0 to 1.
    pub fn coupling(&self) -> f64 {
        self.stiffness[(0, 1)].powi(2) / (self.stiffness[(0, 0)] * self.stiffness[(1, 1)])
    }

    /// Equilibrium at the gauge pressure `pressure`, Pa. Linear in everything.
    pub fn solve(&self, pressure: f64, ends: Ends) -> Equilibrium {
        let k = &self.stiffness;
        let push = self.actuation * pressure;
        let (strain, twist) = match (ends.axial, ends.torsion) {
            (End::Held(stretch), End::Held(twist)) => (stretch - 1.0, twist),
            (End::Held(stretch), End::Loaded(m)) => {
                let e = stretch - 1.0;
                (e, (push.y + m - k[(1, 0)] * e) / k[(1, 1)])
            }
            (End::Loaded(n), End::Held(twist)) => ((push.x + n - k[(0, 1)] * twist) / k[(0, 0)], twist),
            (End::Loaded(n), End::Loaded(m)) => {
                let right = push + Vector2::new(n, m);
                let det = k.determinant();
                ((k[(1, 1)] * right.x - k[(0, 1)] * right.y) / det, (k[(0, 0)] * right.y - k[(1, 0)] * right.x) / det)
            }
        };
        let support = push - k * Vector2::new(strain, twist);
        let ro = self.tube.outer_radius();
        let (sine, cosine) = self.tube.gamma.sin_cos();
        let ef = self.fiber_strain.dot(&Vector3::new(strain, twist, pressure));
        let hoop = (ef - strain * cosine * cosine - twist * ro * sine * cosine) / (sine * sine);
        let radius = ro * (1.0 + hoop);
        let ri2 = self.tube.inner_radius.powi(2);
        let compliance = PI * ro * ro * 2.0 / (sine * sine) * self.fiber_strain.z;
        Equilibrium {
            pressure,
            stretch: 1.0 + strain,
            twist,
            force: support.x,
            moment: support.y,
            volume: PI * ri2 + self.actuation.dot(&Vector2::new(strain, twist)) + compliance * pressure,
            outer_radius_mean: radius,
            outer_radius_at_fiber: radius,
            tangent: Matrix3::new(
                k[(0, 0)],
                k[(0, 1)],
                -self.actuation.x,
                k[(1, 0)],
                k[(1, 1)],
                -self.actuation.y,
                -self.actuation.x,
                -self.actuation.y,
                -compliance,
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::material::Law;

    fn law(degrees: f64) -> LinearSection {
        LinearSection::new(&Tube::reference(degrees.to_radians())).unwrap()
    }

    #[test]
    fn the_condensed_stiffness_is_the_listed_one() {
        // N, N mm, N mm2; the list is printed to 3 or 4 digits: half a unit of the last one.
        for (degrees, k11, k12, k22, ulp) in [
            (20.0, 1420.0, 3012.0, 6801.0, [0.5, 0.5, 0.5]),
            (30.0, 320.0, 1117.0, 4574.0, [0.5, 0.5, 0.5]),
            (40.0, 74.8, 318.6, 2567.0, [0.05, 0.05, 0.5]),
            (50.0, 32.8, 51.6, 1452.0, [0.05, 0.05, 0.5]),
            (60.0, 32.1, -29.4, 839.0, [0.05, 0.05, 0.5]),
            (80.0, 42.8, -25.5, 326.0, [0.05, 0.05, 0.5]),
        ] {
            let k = law(degrees).stiffness;
            let mm = [k[(0, 0)], k[(0, 1)] * 1e3, k[(1, 1)] * 1e6];
            for ((got, want), ulp) in mm.iter().zip([k11, k12, k22]).zip(ulp) {
                assert!((got - want).abs() <= 1.01 * ulp, "{degrees}: {got} {want}");
            }
        }
    }

    #[test]
    fn coupling_and_actuation_ratios_are_the_listed_ones() {
        for (degrees, coupling, actuation) in
            [(20.0, 0.94, 0.50), (30.0, 0.85, 0.83), (40.0, 0.53, 0.94), (50.0, 0.06, 0.974), (60.0, 0.03, 0.987)]
        {
            let law = law(degrees);
            assert!((law.coupling() - coupling).abs() < 0.0051, "{degrees}: {}", law.coupling());
            assert!((law.actuation_ratio() - actuation).abs() < 0.0051, "{degrees}: {}", law.actuation_ratio());
        }
    }

    #[test]
    fn the_free_twist_at_one_psi_is_the_listed_one() {
        for (degrees, want) in [(40.0, -2.81), (60.0, -4.98)] {
            let free = law(degrees).solve(crate::units::PASCAL_PER_PSI, Ends::FREE);
            assert!((free.twist - want).abs() < 0.0051, "{degrees}: {}", free.twist);
        }
    }

    #[test]
    fn force_and_moment_decouple_at_the_neutral_angle_only() {
        let neutral = 2.0_f64.sqrt().atan();
        assert!((neutral.to_degrees() - 54.7356).abs() < 1e-4);
        let law = law(neutral.to_degrees());
        assert!(law.coupling() < 1e-20);
        let free = law.solve(5e4, Ends::FREE);
        assert!((free.stretch - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_three_by_three_system_gives_the_same_condensation() {
        let tube = Tube::reference(-0.7);
        let law = LinearSection::new(&tube).unwrap();
        let (ri, ro, mu) = (tube.inner_radius, tube.outer_radius(), tube.law.shear_modulus());
        let (area, polar) = (PI * (ro * ro - ri * ri), PI / 2.0 * (ro.powi(4) - ri.powi(4)));
        let (sine, cosine) = tube.gamma.sin_cos();
        let q = cosine / sine;
        let v = Vector3::new(0.5 - q * q, -ro * q, 1.0 / (sine * sine)) * (ro * ro);
        let k = v * v.transpose() * (4.0 * mu * area / (ri * ro).powi(2))
            + Matrix3::from_diagonal(&Vector3::new(3.0 * mu * area, mu * polar, 6.0 * 644.0 / cosine));
        let load = v * (2.0 * PI * 3e4) + Vector3::new(0.3, -0.002, 0.0);
        let x = k.lu().solve(&load).unwrap();
        let ends = Ends { axial: End::Loaded(0.3), torsion: End::Loaded(-0.002) };
        let free = law.solve(3e4, ends);
        assert!((free.stretch - 1.0 - x.x).abs() < 1e-12 && (free.twist - x.y).abs() < 1e-9 * x.y.abs());
        assert!((free.force + 0.3).abs() < 1e-12 && (free.moment - 0.002).abs() < 1e-14);
        // The radius follows from the fibre strain: Ro u + Ro^2 e / 2 = v . x.
        let u = (v.dot(&x) - ro * ro * x.x / 2.0) / ro;
        assert!((free.outer_radius_mean - ro - u).abs() < 1e-15);
        // Virtual work: the volume grows by f . x per unit pressure.
        assert!((free.volume - PI * ri * ri - 2.0 * PI * v.dot(&x)).abs() < 1e-16);
    }

    #[test]
    fn handedness_mirrors_twist_and_moment() {
        let (right, left) = (law(40.0), law(-40.0));
        let (a, b) = (right.solve(1e4, Ends::FREE), left.solve(1e4, Ends::FREE));
        assert_eq!((a.stretch, a.twist), (b.stretch, -b.twist));
        assert!(a.twist < 0.0, "an R FREE turns negative");
        let (a, b) = (right.solve(1e4, Ends::BLOCKED), left.solve(1e4, Ends::BLOCKED));
        assert_eq!((a.force, a.moment), (b.force, -b.moment));
    }

    #[test]
    fn what_is_no_tube_is_refused() {
        let tube = Tube::reference(0.7);
        let refused = |t: Tube| LinearSection::new(&t).unwrap_err();
        assert!(matches!(refused(Tube { gamma: 0.0, ..tube }), TubeError::Gamma(_)));
        assert!(matches!(refused(Tube { gamma: f64::NAN, ..tube }), TubeError::Gamma(_)));
        assert!(matches!(refused(Tube { fibers: 1, ..tube }), TubeError::Fibers(1)));
        assert!(matches!(refused(Tube { wall: 0.0, ..tube }), TubeError::Wall { .. }));
        assert!(matches!(refused(Tube { fiber_width: 7e-3, ..tube }), TubeError::FiberWidth { .. }));
        assert!(matches!(refused(Tube { fiber_ea: f64::INFINITY, ..tube }), TubeError::FiberStiffness(_)));
        assert!(matches!(refused(Tube { inner_radius: -1.0, ..tube }), TubeError::InnerRadius(_)));
        assert!(matches!(refused(Tube { law: Law::Linear { mu: 0.0 }, ..tube }), TubeError::Material(_)));
    }
}
