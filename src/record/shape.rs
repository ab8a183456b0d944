//! The FREE as a drawing in 3-D: tube, helical fibres and end cap, from the rotation and the extension of its
//! end. Twist and stretch are spread evenly over the length, as the lumped model has it.

use std::f32::consts::TAU;

use crate::model::{Free, GRAVITY, Kinematics};

/// Fibres drawn; the paper's FREEs have as many.
pub const FIBERS: usize = 6;
/// Points along a fibre.
const POINTS: usize = 25;
/// Sides of the tube.
const SIDES: usize = 32;

/// A FREE at one instant, m and rad, in its own frame: z from the base to the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// End rotation.
    pub angle: f64,
    /// Length now.
    pub length: f64,
    /// Fibre radius now.
    pub radius: f64,
}

impl Pose {
    /// The pose of `free` turned by `angle` (rad) and stretched by `extension` (m); where the extension is not
    /// known (not a number), that at which the lumped model's axial forces balance at `pressure` (Pa). Values
    /// outside the domain of the kinematics keep the radius at rest.
    pub fn of(free: &Free, angle: f64, extension: f64, pressure: f64) -> Self {
        let angle = if angle.is_finite() { angle } else { 0.0 };
        let extension = if extension.is_finite() {
            extension
        } else {
            let force = Kinematics::Exact.actuation(free, 0.0, angle).map_or(0.0, |a| a.force);
            let pressure = if pressure.is_finite() { pressure } else { 0.0 };
            (force * pressure + free.mass * GRAVITY) / free.axial_stiffness
        };
        let radius = Kinematics::Exact.actuation(free, extension, angle).map_or(free.radius, |a| a.radius);
        Self { angle, length: (free.length + extension).max(0.0), radius }
    }

    /// The fibres, each a line of points, in metres.
    pub fn fibers(&self, free: &Free) -> Vec<Vec<[f32; 3]>> {
        let winding = (free.length * free.gamma.tan() / free.radius + self.angle) as f32;
        // Outside the tube by more than the flatness of its sides, so that it does not hide them.
        let radius = self.radius as f32 * 1.035;
        (0..FIBERS)
            .map(|fiber| {
                let start = TAU * fiber as f32 / FIBERS as f32;
                (0..POINTS)
                    .map(|point| {
                        let u = point as f32 / (POINTS - 1) as f32;
                        let (sin, cos) = (start + winding * u).sin_cos();
                        [radius * cos, radius * sin, self.length as f32 * u]
                    })
                    .collect()
            })
            .collect()
    }
}

/// Points, normals and triangles.
pub struct Mesh {
    /// Points, m.
    pub points: Vec<[f32; 3]>,
    /// Unit normals, outwards.
    pub normals: Vec<[f32; 3]>,
    /// Indices of the corners.
    pub triangles: Vec<[u32; 3]>,
}

/// A tube of radius 1 and length 1, open at both ends, to be scaled.
pub fn tube() -> Mesh {
    let mut mesh = Mesh { points: Vec::new(), normals: Vec::new(), triangles: Vec::new() };
    let sides = SIDES as u32;
    for side in 0..SIDES {
        let (sin, cos) = (TAU * side as f32 / SIDES as f32).sin_cos();
        mesh.points.extend([[cos, sin, 0.0], [cos, sin, 1.0]]);
        mesh.normals.extend([[cos, sin, 0.0]; 2]);
        let (a, b) = (2 * side as u32, 2 * ((side as u32 + 1) % sides));
        mesh.triangles.extend([[a, b, a + 1], [b, b + 1, a + 1]]);
    }
    mesh
}

/// A disc of `radius` from z = 0 to `thickness`, m.
pub fn cap(radius: f32, thickness: f32) -> Mesh {
    let mut mesh = tube();
    for p in &mut mesh.points {
        *p = [p[0] * radius, p[1] * radius, p[2] * thickness];
    }
    for (z, normal) in [(0.0, -1.0), (thickness, 1.0)] {
        let centre = mesh.points.len() as u32;
        mesh.points.push([0.0, 0.0, z]);
        for side in 0..SIDES {
            let (sin, cos) = (TAU * side as f32 / SIDES as f32).sin_cos();
            mesh.points.push([radius * cos, radius * sin, z]);
            let (a, b) = (centre + 1 + side as u32, centre + 1 + (side as u32 + 1) % SIDES as u32);
            mesh.triangles.push(if normal > 0.0 { [centre, a, b] } else { [centre, b, a] });
        }
        mesh.normals.extend(std::iter::repeat_n([0.0, 0.0, normal], SIDES + 1));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_the_fibres_turn_with_the_end_and_keep_their_length() {
        let free = Free::paper();
        let (rest, turned) = (Pose::of(&free, 0.0, 0.0, 0.0), Pose::of(&free, 0.7, -1e-3, 0.0));
        assert!((rest.length - free.length).abs() < 1e-12 && (rest.radius - free.radius).abs() < 1e-12);
        let tip = |pose: &Pose| {
            let [x, y, z] = pose.fibers(&free)[0][POINTS - 1];
            assert!((f64::from(z) - pose.length).abs() < 1e-6);
            f64::from(y).atan2(x.into())
        };
        // Single precision.
        assert!(((tip(&turned) - tip(&rest)).rem_euclid(std::f64::consts::TAU) - 0.7).abs() < 1e-5);
        assert!(turned.radius > rest.radius);
    }

    #[test]
    fn without_an_extension_the_cap_hangs() {
        let free = Free::paper();
        let hanging = Pose::of(&free, 0.0, f64::NAN, f64::NAN);
        assert!((hanging.length - free.length - free.mass * GRAVITY / free.axial_stiffness).abs() < 1e-12);
    }
}
