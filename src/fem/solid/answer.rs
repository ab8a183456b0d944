//! What a solid answers, in SI units.

use nalgebra::Vector3;

use super::cap::{AXIAL, COORDINATES, LATERAL, TILT, TURN};
use super::mesh::Part;
use super::path::Solid;
use super::system::Control;

/// One cross-section along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Where it was at rest, m from the base.
    pub reference: f64,
    /// Where it is on average, m along z.
    pub position: f64,
    /// Its turn about z, rad, right-handed and counted on beyond a whole turn.
    pub turn: f64,
    /// Outer radius averaged over the reference circumference, m; in x and y, about the section's middle.
    pub outer_radius_mean: f64,
    /// Outer radius in the middle of a fibre, m; in x and y, about the section's middle.
    pub outer_radius_at_fiber: f64,
}

/// An equilibrium of a finite tube with a rigid cap.
#[derive(Clone, Debug, PartialEq)]
pub struct SolidEquilibrium {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// Rotation of the tip about z, rad, right-handed.
    pub rotation: f64,
    /// Length over length at rest.
    pub stretch: f64,
    /// Twist at mid-length, rad per reference metre.
    pub middle_twist: f64,
    /// Axial stretch at mid-length.
    pub middle_stretch: f64,
    /// Outer radius at mid-length, averaged over the reference circumference, m.
    pub middle_radius: f64,
    /// Outer radius in the middle of a fibre at mid-length, m.
    pub middle_radius_at_fiber: f64,
    /// Displacement of the cap's centre in x and y, m.
    pub lateral: [f64; 2],
    /// Tilt of the cap (rotation vector's x and y, in space), rad.
    pub tilt: [f64; 2],
    /// Force on the distal support along z, N, outwards positive: it contains the thrust on the cap.
    pub force: f64,
    /// Moment on the distal support about z, N m, positive in +theta.
    pub moment: f64,
    /// Force on the distal support in x and y, N.
    pub lateral_force: [f64; 2],
    /// Moment on the distal support conjugate to the tilt, N m.
    pub bending_moment: [f64; 2],
    /// Volume of the cavity, m3.
    pub volume: f64,
    /// dV/dP along equilibria, m3/Pa: negative beyond a pressure maximum.
    pub compliance: f64,
    /// Negative pivots of the saddle-point matrix.
    pub negative_pivots: usize,
    /// Those that a stable state has: one for each pressure unknown of the rubber.
    pub expected_negative_pivots: usize,
    /// The sections along the tube, from base to tip.
    pub profile: Vec<Station>,
}

impl SolidEquilibrium {
    /// Whether the energy is at a minimum at this pressure, among the motions that the mesh can make.
    pub fn stable(&self) -> bool {
        self.negative_pivots == self.expected_negative_pivots
    }
}

/// Where a path has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathEnd {
    /// At the last pressure asked for.
    Reached,
    /// At a pressure maximum, Pa: beyond it there is no equilibrium on this branch at a higher pressure.
    Limit(f64),
    /// Steps have become too small at this pressure, Pa, without a pressure maximum.
    Stuck(f64),
}

/// Equilibria at the pressures asked for, as far as they exist.
#[derive(Clone, Debug, PartialEq)]
pub struct SolidPath {
    /// One for each pressure reached, in the order asked for.
    pub states: Vec<SolidEquilibrium>,
    /// How it ended.
    pub end: PathEnd,
    /// Newton iterations in all.
    pub iterations: usize,
}

impl Solid {
    /// The last equilibrium in SI units.
    pub(super) fn answer(&self) -> SolidEquilibrium {
        let body = &self.system.body;
        let (radius, cap) = (self.radius, &self.state.cap);
        let profile: Vec<Station> = (self.planes.iter().zip(self.outer.iter().zip(&self.fiber)))
            .map(|(&z, (nodes, &fiber))| {
                let mut middle = Vector3::zeros();
                for &(n, weight) in nodes {
                    middle += self.state.positions[n] * weight;
                }
                if self.part == Part::Sector {
                    // Its positions are polar components.
                    (middle.x, middle.y) = (0.0, 0.0);
                }
                let (mut turn, mut mean) = (cap[TURN] * z / body.length, 0.0);
                for &(n, weight) in nodes {
                    let (rest, here) = (&body.reference[n], self.state.positions[n] - middle);
                    mean += weight * here.x.hypot(here.y);
                    turn += weight * (rest.x * here.y - rest.y * here.x).atan2(rest.x * here.x + rest.y * here.y);
                }
                let at_fiber = self.state.positions[fiber] - middle;
                Station {
                    reference: z * radius,
                    position: middle.z * radius,
                    turn,
                    outer_radius_mean: mean * radius,
                    outer_radius_at_fiber: at_fiber.x.hypot(at_fiber.y) * radius,
                }
            })
            .collect();
        // Slope of the quadratic interpolation in the middle, the mean of both sides.
        let m = profile.len() / 2;
        let step = profile[m + 2].reference - profile[m].reference;
        let slope = |of: fn(&Station) -> f64| {
            let at = |k: usize| of(&profile[k]);
            (4.0 * (at(m + 1) - at(m - 1)) - (at(m + 2) - at(m - 2))) / (2.0 * step)
        };
        let (force, moment) = self.units();
        let held: [f64; COORDINATES] = std::array::from_fn(|q| -(self.system.cap_residual()[q] + self.system_load(q)));
        let (sine, cosine) = cap[TURN].sin_cos();
        let space = |[x, y]: [f64; 2]| [cosine * x - sine * y, sine * x + cosine * y];
        let of = |v: &[f64; COORDINATES], [x, y]: [usize; 2], unit: f64| space([v[x] * unit, v[y] * unit]);
        let compliance = self.system.direction(false, &Control::pressure(1.0)).map_or(f64::NAN, |d| d.volume);
        let cubic = radius.powi(3) * self.copies;
        SolidEquilibrium {
            pressure: self.state.gas * self.modulus,
            rotation: cap[TURN],
            stretch: 1.0 + cap[AXIAL] / body.length,
            middle_twist: slope(|s| s.turn),
            middle_stretch: slope(|s| s.position),
            middle_radius: profile[m].outer_radius_mean,
            middle_radius_at_fiber: profile[m].outer_radius_at_fiber,
            lateral: of(cap, LATERAL, radius),
            tilt: of(cap, TILT, 1.0),
            force: held[AXIAL] * force,
            moment: held[TURN] * moment,
            lateral_force: of(&held, LATERAL, force),
            bending_moment: of(&held, TILT, moment),
            volume: self.system.volume() * cubic,
            compliance: compliance * cubic / self.modulus,
            negative_pivots: body.pressures() + self.system.negative(),
            expected_negative_pivots: body.pressures(),
            profile,
        }
    }

    /// The external load along coordinate `q` of the cap, in the frame of the tip.
    fn system_load(&self, q: usize) -> f64 {
        let loads = &self.system.loads;
        let (sine, cosine) = self.state.cap[TURN].sin_cos();
        for [x, y] in [LATERAL, TILT] {
            if q == x {
                return cosine * loads[x] + sine * loads[y];
            }
            if q == y {
                return cosine * loads[y] - sine * loads[x];
            }
        }
        loads[q]
    }
}
