//! The pressure on the inner face of an element, through the volume that it encloses.
//!
//! The cavity's volume is `1/3 int x . n da` over its boundary. The inner face (i = 0) of an element contributes
//! `V = 1/3 int y . (g_s x g_t) ds dt` with the tangents `g_s = y_s + (psi_s + omega Z_s) e_z x y` of the turning
//! frame. The energy of the gas is -P V, so load and tangent are exact derivatives, hence symmetric; the base lies in
//! the plane z = 0 and contributes nothing.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::element::{Contribution, Place, SIZE, TWIST, across, across_back};
use super::shapes::{GAUSS, line};

/// Node of the inner face at (j, k).
fn node(j: usize, k: usize) -> usize {
    3 * j + 9 * k
}

/// v x as a matrix.
fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Adds the inner face's share of the cavity to `out`, and of the energy `-pressure V`.
pub fn add(place: &Place, pressure: f64, tangent: bool, out: &mut Contribution) {
    let mut slope = [0.0; SIZE];
    for (s, ws) in GAUSS {
        for (t, wt) in GAUSS {
            let weight = ws * wt / 3.0;
            let ((a, da), (b, db)) = (line(s), line(t));
            let shapes: [(usize, f64, f64, f64); 9] = std::array::from_fn(|c| {
                let (j, k) = (c % 3, c / 3);
                (node(j, k), a[j] * b[k], da[j] * b[k], a[j] * db[k])
            });
            let (mut y, mut gs, mut gt) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
            let (mut zs, mut zt, mut turn_s, mut turn_t) = (0.0, 0.0, 0.0, 0.0);
            for &(n, value, ds, dt) in &shapes {
                let at = place.current[n];
                y += at * value;
                gs += at * ds;
                gt += at * dt;
                zs += place.reference[n].z * ds;
                zt += place.reference[n].z * dt;
                turn_s += place.phases[n] * ds;
                turn_t += place.phases[n] * dt;
            }
            let turn = across(&y);
            turn_s += place.rate * zs;
            turn_t += place.rate * zt;
            gs += turn * turn_s;
            gt += turn * turn_t;
            // Derivatives by y, g_s, g_t.
            let (of_y, of_s, of_t) = (gs.cross(&gt), gt.cross(&y), y.cross(&gs));
            out.volume += weight * y.dot(&of_y);
            let by_rate = (of_s * zs + of_t * zt) * weight;
            let at_value = (of_y + across_back(&(of_s * turn_s + of_t * turn_t))) * weight;
            for &(n, value, ds, dt) in &shapes {
                let force = at_value * value + (of_s * ds + of_t * dt) * weight;
                for i in 0..3 {
                    slope[3 * n + i] += force[i];
                }
            }
            slope[TWIST] += by_rate.dot(&turn);
            if !tangent {
                continue;
            }
            // Second derivatives in (y, g_s, g_t), each a spin matrix.
            let mut second = SMatrix::<f64, 9, 9>::zeros();
            for (r, c, spin) in [(0, 3, -cross(&gt)), (0, 6, cross(&gs)), (3, 6, -cross(&y))] {
                second.fixed_view_mut::<3, 3>(r, c).copy_from(&(spin * weight));
                second.fixed_view_mut::<3, 3>(c, r).copy_from(&(spin.transpose() * weight));
            }
            let column = |value: f64, ds: f64, dt: f64, i: usize| -> SVector<f64, 9> {
                let mut unit = Vector3::zeros();
                unit[i] = 1.0;
                let turned = across(&unit) * value;
                let mut column = SVector::<f64, 9>::zeros();
                column.fixed_rows_mut::<3>(0).copy_from(&(unit * value));
                column.fixed_rows_mut::<3>(3).copy_from(&(unit * ds + turned * turn_s));
                column.fixed_rows_mut::<3>(6).copy_from(&(unit * dt + turned * turn_t));
                column
            };
            let mut columns = [SVector::<f64, 9>::zeros(); 28];
            let mut rows = [TWIST; 28];
            for (c, &(n, value, ds, dt)) in shapes.iter().enumerate() {
                for i in 0..3 {
                    columns[3 * c + i] = column(value, ds, dt, i);
                    rows[3 * c + i] = 3 * n + i;
                }
            }
            columns[27].fixed_rows_mut::<3>(3).copy_from(&(turn * zs));
            columns[27].fixed_rows_mut::<3>(6).copy_from(&(turn * zt));
            for c in 0..28 {
                let product = second * columns[c] * -pressure;
                for r in 0..=c {
                    out.add_symmetric(rows[r], rows[c], columns[r].dot(&product));
                }
            }
            let mixed = across_back(&by_rate) * -pressure;
            for &(n, value, ..) in &shapes {
                for i in 0..2 {
                    out.add_symmetric(3 * n + i, TWIST, mixed[i] * value);
                }
            }
        }
    }
    out.energy -= pressure * out.volume;
    for (r, slope) in slope.iter().enumerate() {
        out.force[r] -= pressure * slope;
        out.volume_slope[r] += slope;
    }
}
