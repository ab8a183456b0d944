//! Inextensible fibres: winding angle and radius from extension and rotation.

use std::f64::consts::PI;

use super::{DomainError, Free};

/// Part of the winding that must be left. The radius grows as its inverse: a FREE blown up a hundredfold is none, and
/// closer to the pole a run-away's accelerations exceed what can be integrated.
const UNWOUND: f64 = 0.01;

/// How the fibre radius follows from the motion:
///
/// ```text
/// cos g = (1 + s/L) cos G        r = l tan g / (L tan G / R + phi)
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kinematics {
    /// l = L + s: the radius on which a fibre of constant length lies. The pressure terms are P dV/dq.
    #[default]
    Exact,
    /// l = L, as in Eq. 2 of the paper and the authors' published simulation; the moment differs by up to 3.2 %.
    Published,
}

/// Fibre geometry of one configuration, and what one pascal does in it. Derivatives are by (s, phi).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Actuation {
    /// Fibre radius r, m.
    pub radius: f64,
    /// Winding angle g, rad, with the sign of G.
    pub winding: f64,
    /// Axial force per pressure, pi r^2 (1 - 2 cot^2 g), N/Pa.
    pub force: f64,
    /// Moment per pressure, -2 pi r^3 cot g, N m/Pa.
    pub moment: f64,
    /// Derivative of `force`, N/Pa per m and per rad.
    pub force_by: [f64; 2],
    /// Derivative of `moment`, N m/Pa per m and per rad.
    pub moment_by: [f64; 2],
}

impl Kinematics {
    /// The configuration of extension `s` (m) and rotation `phi` (rad) of a valid FREE.
    pub fn actuation(self, free: &Free, s: f64, phi: f64) -> Result<Actuation, DomainError> {
        if !(s.is_finite() && phi.is_finite()) {
            return Err(DomainError::NotFinite { extension: s, rotation: phi });
        }
        let Free { gamma, length, radius, .. } = *free;
        let cos = (1.0 + s / length) * gamma.cos();
        if cos >= 1.0 {
            return Err(DomainError::Straightened { extension: s, limit: length * (1.0 / gamma.cos() - 1.0) });
        }
        if cos <= 0.0 {
            return Err(DomainError::Flattened { extension: s, length });
        }
        let wound = length * gamma.tan() / radius;
        let winding = wound + phi;
        if winding / wound <= UNWOUND {
            return Err(DomainError::Unwound { rotation: phi, limit: -wound });
        }
        // (1 - c)(1 + c) keeps its digits where 1 - c^2 would lose them, near cos g = 1.
        let sin = ((1.0 - cos) * (1.0 + cos)).sqrt().copysign(gamma);
        let cot = cos / sin;
        let cos_by_s = gamma.cos() / length;
        let cot_by_s = cos_by_s / (sin * sin * sin);
        // d ln tan g / ds = -cos'(s) / (cos sin^2).
        let log_tan_by_s = -cos_by_s / (cos * sin * sin);
        let (fibre_length, log_length_by_s) = match self {
            Self::Exact => (length + s, 1.0 / (length + s)),
            Self::Published => (length, 0.0),
        };
        let r = fibre_length / (cot * winding);
        let r_by = [r * (log_tan_by_s + log_length_by_s), -r / winding];
        let outward = 1.0 - 2.0 * cot * cot;
        Ok(Actuation {
            radius: r,
            winding: sin.atan2(cos),
            force: PI * r * r * outward,
            moment: -2.0 * PI * r * r * r * cot,
            force_by: [2.0 * PI * r * (r_by[0] * outward - 2.0 * r * cot * cot_by_s), 2.0 * PI * r * r_by[1] * outward],
            moment_by: [-2.0 * PI * r * r * (3.0 * r_by[0] * cot + r * cot_by_s), -6.0 * PI * r * r * r_by[1] * cot],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Configurations of several FREEs, well inside the domain.
    fn configurations() -> impl Iterator<Item = (Free, f64, f64)> {
        let gammas = [-70f64, -40.0, -20.0, 30.0, 54.7356, 80.0];
        gammas.into_iter().flat_map(|degrees| {
            let free = Free { gamma: degrees.to_radians(), ..Free::paper() };
            [-0.01, 0.0, 0.003]
                .into_iter()
                .flat_map(move |s| [-0.3, 0.0, 1.2].into_iter().map(move |turn| (free, s, turn * free.direction())))
        })
    }

    /// V = pi r^2 (L + s): what the fibres' cylinder encloses.
    fn volume(free: &Free, s: f64, phi: f64) -> f64 {
        let r = Kinematics::Exact.actuation(free, s, phi).unwrap().radius;
        PI * r * r * (free.length + s)
    }

    #[test]
    fn with_the_exact_radius_the_pressure_terms_are_the_volumes_derivatives() {
        let (ds, dphi) = (1e-7, 1e-5);
        for (free, s, phi) in configurations() {
            let a = Kinematics::Exact.actuation(&free, s, phi).unwrap();
            let by_s = (volume(&free, s + ds, phi) - volume(&free, s - ds, phi)) / (2.0 * ds);
            let by_phi = (volume(&free, s, phi + dphi) - volume(&free, s, phi - dphi)) / (2.0 * dphi);
            // Central differences; rounding of V over the step leaves 1e-16/1e-6 relative, truncation less.
            let scale = PI * a.radius * a.radius;
            assert!((a.force - by_s).abs() < 1e-7 * (scale + a.force.abs()), "{a:?} {by_s}");
            assert!((a.moment - by_phi).abs() < 1e-7 * a.moment.abs(), "{a:?} {by_phi}");
            // Second derivatives of one potential commute; to rounding.
            let scale = a.force_by[1].abs().max(scale * a.radius / free.length);
            assert!((a.force_by[1] - a.moment_by[0]).abs() < 1e-12 * scale, "{a:?}");
        }
        let a = Kinematics::Published.actuation(&Free::paper(), -1e-3, 1.0).unwrap();
        assert!((a.force_by[1] / a.moment_by[0] - 1.0).abs() > 1e-3, "the published radius has no potential");
    }

    #[test]
    fn a_fibre_keeps_its_length() {
        for (free, s, phi) in configurations() {
            let a = Kinematics::Exact.actuation(&free, s, phi).unwrap();
            let turned = free.length * free.gamma.tan() / free.radius + phi;
            let length = (free.length + s).hypot(a.radius * turned);
            assert!((length * free.gamma.cos() / free.length - 1.0).abs() < 1e-13);
        }
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let (ds, dphi) = (1e-7, 1e-5);
        for kinematics in [Kinematics::Exact, Kinematics::Published] {
            for (free, s, phi) in configurations() {
                let at = |s, phi| kinematics.actuation(&free, s, phi).unwrap();
                let a = at(s, phi);
                let (s1, s0, p1, p0) = (at(s + ds, phi), at(s - ds, phi), at(s, phi + dphi), at(s, phi - dphi));
                let pairs = [
                    (a.force_by[0], (s1.force - s0.force) / (2.0 * ds), a.radius * a.radius / free.length),
                    (a.force_by[1], (p1.force - p0.force) / (2.0 * dphi), a.radius * a.radius),
                    (a.moment_by[0], (s1.moment - s0.moment) / (2.0 * ds), a.radius.powi(3) / free.length),
                    (a.moment_by[1], (p1.moment - p0.moment) / (2.0 * dphi), a.radius.powi(3)),
                ];
                for (exact, difference, scale) in pairs {
                    assert!((exact - difference).abs() < 2e-6 * (exact.abs() + scale), "{kinematics:?} {a:?}");
                }
            }
        }
    }

    #[test]
    fn at_rest_nothing_has_moved_and_handedness_only_turns_the_sign() {
        for kinematics in [Kinematics::Exact, Kinematics::Published] {
            let left = Free::paper();
            let a = kinematics.actuation(&left, 0.0, 0.0).unwrap();
            assert!((a.radius / left.radius - 1.0).abs() < 1e-15 && (a.winding - left.gamma).abs() < 1e-15);
            assert!(a.moment > 0.0, "an L FREE turns positive");
            let right = Free { gamma: -left.gamma, ..left };
            let (a, b) = (kinematics.actuation(&left, 1e-3, 0.5).unwrap(), kinematics.actuation(&right, 1e-3, -0.5));
            let b = b.unwrap();
            assert_eq!((a.force, a.moment, a.radius), (b.force, -b.moment, b.radius));
        }
    }

    #[test]
    fn the_radii_differ_by_the_known_amount() {
        // Published against exact, at the paper's largest angle and its contraction there: up to 3.2 % in moment.
        let free = Free::paper();
        let (s, phi) = (-1.0e-3, 80f64.to_radians());
        let moment = |k: Kinematics| k.actuation(&free, s, phi).unwrap().moment;
        let difference = moment(Kinematics::Published) / moment(Kinematics::Exact) - 1.0;
        assert!(difference > 0.02 && difference < 0.032, "{difference}");
    }

    #[test]
    fn outside_the_domain_the_limit_is_named() {
        let free = Free::paper();
        let at = |s, phi| Kinematics::Exact.actuation(&free, s, phi).unwrap_err();
        let limit = free.length * (1.0 / free.gamma.cos() - 1.0);
        assert!(Kinematics::Exact.actuation(&free, limit - 1e-12, 0.0).unwrap().moment.is_finite());
        assert_eq!(at(limit + 1e-12, 0.0), DomainError::Straightened { extension: limit + 1e-12, limit });
        assert!(matches!(at(-free.length, 0.0), DomainError::Flattened { .. }));
        let limit = free.length * free.gamma.tan().abs() / free.radius;
        assert_eq!(at(0.0, 0.9901 * limit), DomainError::Unwound { rotation: 0.9901 * limit, limit });
        assert!(matches!(at(0.0, 2.0 * limit), DomainError::Unwound { .. }));
        assert!(Kinematics::Exact.actuation(&free, 0.0, 0.9899 * limit).is_ok());
        assert!(at(0.0, 20.0).to_string().contains("755.5 deg"), "{}", at(0.0, 20.0));
        assert!(matches!(at(f64::NAN, 0.0), DomainError::NotFinite { .. }));
        assert!(matches!(at(0.0, f64::NEG_INFINITY), DomainError::NotFinite { .. }));
    }
}
