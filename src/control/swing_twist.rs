//! The turn of a unit quaternion about an axis, apart from the axis' tilt.

/// Largest deviation of a quaternion's norm from one.
pub const NORM_TOLERANCE: f64 = 0.02;

/// `q` normalised, with q_w >= 0; `None` if its norm is off by more than [`NORM_TOLERANCE`] or not a number.
pub fn unit(q: [f64; 4]) -> Option<[f64; 4]> {
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let plausible = (norm - 1.0).abs() <= NORM_TOLERANCE;
    plausible.then(|| upright(q.map(|x| x / norm)))
}

pub(super) fn upright(q: [f64; 4]) -> [f64; 4] {
    if q[0] < 0.0 { q.map(|x| -x) } else { q }
}

/// a^-1 b for unit quaternions.
pub(super) fn difference(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let [aw, ax, ay, az] = [a[0], -a[1], -a[2], -a[3]];
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// Twist about `axis` in -pi..=pi and tilt of the axis in 0..=pi, both rad, of a unit quaternion.
pub fn swing_twist(q: [f64; 4], axis: [f64; 3]) -> (f64, f64) {
    let q = upright(q);
    let v = [q[1], q[2], q[3]];
    let along = dot(v, axis);
    let across = [v[0] - along * axis[0], v[1] - along * axis[1], v[2] - along * axis[2]];
    let twist = 2.0 * along.atan2(q[0]);
    let tilt = 2.0 * dot(across, across).sqrt().atan2(q[0].hypot(along));
    (twist, tilt)
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
