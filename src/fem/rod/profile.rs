//! A stiffness as a polynomial of the section's state.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::grid::{Axis, Grid};
use super::law::Jet;

/// Powers 0 to 4 of each variable.
const POWERS: usize = 5;
/// Highest power of all of them together.
const TOTAL: usize = 5;
/// Powers of stretch and twist that go together.
const PAIRS: [[usize; 2]; 19] = pairs();
/// Directions of the coefficients that the samples say less of than this share of the best known are left out.
const KNOWN: f64 = 1e-10;

/// A stiffness: a polynomial of stretch, twist and pressure, of degree 4 in each and 5 in all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    /// Coordinates run from -1 to 1 over the range that the samples come from: its middle, and half of it.
    middle: [f64; 3],
    half: [f64; 3],
    /// As [`Grid::skew`].
    skew: [f64; 2],
    /// By [`PAIRS`], then by the power of the pressure.
    coefficients: [[f64; POWERS]; PAIRS.len()],
}

/// A profile at one pressure: value and derivative by pressure, by [`PAIRS`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Isobaric<'a> {
    profile: &'a Profile,
    /// What the pressure takes off the stretch.
    shift: f64,
    coefficients: [[f64; PAIRS.len()]; 2],
}

const fn pairs() -> [[usize; 2]; 19] {
    let mut pairs = [[0; 2]; 19];
    let (mut next, mut a) = (0, 0);
    while a < POWERS {
        let mut b = 0;
        while b < POWERS && a + b <= TOTAL {
            pairs[next] = [a, b];
            next += 1;
            b += 1;
        }
        a += 1;
    }
    pairs
}

/// Powers of x, their first and second derivatives.
fn powers(x: f64) -> [[f64; POWERS]; 3] {
    let mut all = [[0.0; POWERS]; 3];
    all[0][0] = 1.0;
    for k in 1..POWERS {
        let n = k as f64;
        all[0][k] = all[0][k - 1] * x;
        all[1][k] = n * all[0][k - 1];
        all[2][k] = n * all[1][k - 1];
    }
    all
}

impl Profile {
    /// The same in every state.
    pub fn constant(value: f64) -> Profile {
        let mut profile = Profile::empty([1.0, 0.0, 0.0], [1.0; 3], [0.0; 2]);
        profile.coefficients[0][0] = value;
        profile
    }

    /// Of the pressure alone, through one to five (pressure Pa, value) of different pressures: of the least degree that
    /// does.
    pub fn through<const N: usize>(points: [(f64, f64); N]) -> Profile {
        const { assert!(1 <= N && N <= POWERS) };
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (pressure, _) in points {
            (low, high) = (low.min(pressure), high.max(pressure));
        }
        let half = if high > low { 0.5 * (high - low) } else { 1.0 };
        let mut profile = Profile::empty([1.0, 0.0, 0.5 * (low + high)], [1.0, 1.0, half], [0.0; 2]);
        // Newton's divided differences, and their products multiplied out.
        let at = points.map(|(pressure, _)| (pressure - profile.middle[2]) / half);
        let mut differences = points.map(|(_, value)| value);
        for order in 1..N {
            for i in (order..N).rev() {
                differences[i] = (differences[i] - differences[i - 1]) / (at[i] - at[i - order]);
            }
        }
        let sum = &mut profile.coefficients[0];
        for (difference, node) in differences.into_iter().zip(at).rev() {
            for k in (0..POWERS).rev() {
                sum[k] = if k > 0 { sum[k - 1] } else { 0.0 } - node * sum[k];
            }
            sum[0] += difference;
        }
        profile
    }

    /// Nearest to `samples` of (stretch, twist rad/m, pressure Pa) and N values over the range of `grid`, in the mean
    /// square: one for each of the values; none without samples.
    pub(crate) fn fitted<const N: usize>(grid: &Grid, samples: &[([f64; 3], [f64; N])]) -> Option<[Profile; N]> {
        let of = |axis: Axis, share: f64| 0.5 * (axis.to + share * axis.from);
        let axes = grid.axes();
        let (middle, half) = (axes.map(|a| of(a, 1.0)), axes.map(|a| of(a, -1.0)));
        let empty = Profile::empty(middle, half, grid.skew);
        let terms: Vec<(usize, usize)> = (PAIRS.iter().enumerate())
            .flat_map(|(pair, [a, b])| (0..POWERS.min(TOTAL + 1 - a - b)).map(move |c| (pair, c)))
            .collect();
        let matrix = DMatrix::from_fn(samples.len(), terms.len(), |row, term| {
            let [x, y, z] = empty.place(&samples[row].0).map(|x| powers(x)[0]);
            let (pair, c) = terms[term];
            let [a, b] = PAIRS[pair];
            x[a] * y[b] * z[c]
        });
        let right = DMatrix::from_fn(samples.len(), N, |row, value| samples[row].1[value]);
        let svd = matrix.svd(true, true);
        let least = KNOWN * svd.singular_values.max();
        let solution = svd.solve(&right, least).ok()?;
        Some(std::array::from_fn(|value| {
            let mut profile = empty;
            for ((pair, c), x) in terms.iter().zip(solution.column(value).iter()) {
                profile.coefficients[*pair][*c] = *x;
            }
            profile
        }))
    }

    fn empty(middle: [f64; 3], half: [f64; 3], skew: [f64; 2]) -> Profile {
        Profile { middle, half, skew, coefficients: [[0.0; POWERS]; PAIRS.len()] }
    }

    /// The same times `factor`.
    pub fn scaled(mut self, factor: f64) -> Profile {
        self.coefficients.iter_mut().flatten().for_each(|c| *c *= factor);
        self
    }

    /// The coordinates of (stretch, twist, pressure).
    fn place(&self, [stretch, twist, pressure]: &[f64; 3]) -> [f64; 3] {
        let along = [stretch - self.skew[0] * twist - self.skew[1] * pressure, *twist, *pressure];
        std::array::from_fn(|i| (along[i] - self.middle[i]) / self.half[i])
    }

    /// The value at (stretch, twist rad/m, pressure Pa).
    pub fn at(&self, [stretch, twist, pressure]: [f64; 3]) -> f64 {
        self.isobaric(pressure).jet(stretch, twist).value
    }

    /// The profile at `pressure` Pa.
    pub(super) fn isobaric(&self, pressure: f64) -> Isobaric<'_> {
        let [z, slope, _] = powers((pressure - self.middle[2]) / self.half[2]);
        let sum = |by: &[f64; POWERS]| self.coefficients.map(|c| c.iter().zip(by).map(|(c, z)| c * z).sum::<f64>());
        let by_pressure = sum(&slope).map(|c| c / self.half[2]);
        Isobaric { profile: self, shift: self.skew[1] * pressure, coefficients: [sum(&z), by_pressure] }
    }

    /// All its numbers.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let Profile { middle, half, skew, coefficients } = self;
        middle.iter().chain(half).chain(skew).chain(coefficients.iter().flatten()).copied()
    }

    /// How many [`Profile::numbers`] there are.
    pub(crate) const NUMBERS: usize = 8 + POWERS * PAIRS.len();

    /// The profile of these numbers.
    pub(crate) fn of_numbers(numbers: &[f64; Profile::NUMBERS]) -> Profile {
        let three = |from: usize| std::array::from_fn(|i| numbers[from + i]);
        let mut profile = Profile::empty(three(0), three(3), [numbers[6], numbers[7]]);
        for (c, number) in profile.coefficients.iter_mut().flatten().zip(&numbers[8..]) {
            *c = *number;
        }
        profile
    }
}

impl Isobaric<'_> {
    /// Value and derivatives by (stretch, twist, pressure) at (stretch, twist rad/m); the second one by pressure is not
    /// computed and 0.
    pub fn jet(&self, stretch: f64, twist: f64) -> Jet {
        let Profile { middle, half, skew, .. } = self.profile;
        let x = powers((stretch - skew[0] * twist - self.shift - middle[0]) / half[0]);
        let y = powers((twist - middle[1]) / half[1]);
        let [mut f, mut fx, mut fy, mut fxx, mut fxy, mut fyy, mut fz, mut fxz, mut fyz] = [0.0; 9];
        let mut next = 0;
        for (a, x) in (0..POWERS).map(|a| (a, [x[0][a], x[1][a], x[2][a]])) {
            // The polynomial of the twist that multiplies this power of the stretch: value and derivatives.
            let [mut c, mut cy, mut cyy, mut d, mut dy] = [0.0; 5];
            for y in (0..POWERS.min(TOTAL + 1 - a)).map(|b| [y[0][b], y[1][b], y[2][b]]) {
                let (value, slope) = (self.coefficients[0][next], self.coefficients[1][next]);
                c += value * y[0];
                cy += value * y[1];
                cyy += value * y[2];
                d += slope * y[0];
                dy += slope * y[1];
                next += 1;
            }
            f += x[0] * c;
            fx += x[1] * c;
            fxx += x[2] * c;
            fy += x[0] * cy;
            fxy += x[1] * cy;
            fyy += x[0] * cyy;
            fz += x[0] * d;
            fxz += x[1] * d;
            fyz += x[0] * dy;
        }
        let (h, k) = (1.0 / half[0], 1.0 / half[1]);
        let (fx, fy, fxx, fxy, fyy) = (fx * h, fy * k, fxx * h * h, fxy * h * k, fyy * k * k);
        let (fxz, fyz) = (fxz * h, fyz * k);
        // From the skewed coordinates.
        let [s, t] = *skew;
        let (lt, tt) = (fxy - s * fxx, fyy - s * (2.0 * fxy - s * fxx));
        let (lp, tp) = (fxz - t * fxx, fyz - t * fxy - s * (fxz - t * fxx));
        Jet {
            value: f,
            gradient: Vector3::new(fx, fy - s * fx, fz - t * fx),
            hessian: Matrix3::new(fxx, lt, lp, lt, tt, tp, lp, tp, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_through_its_points_with_the_least_degree() {
        let points = [(0.0, 673.0), (3.5, 909.0), (7.0, 1854.0), (8.0, 1900.0), (10.0, 1000.0)];
        let at = |profile: &Profile, pressure: f64| profile.at([1.3, -2.0, pressure]);
        let quartic = Profile::through(points);
        assert!(points.iter().all(|(p, value)| (at(&quartic, *p) - value).abs() < 1e-9));
        let quadratic = Profile::through([points[0], points[1], points[2]]);
        // Second differences of a quadratic are all alike.
        let second = |p: f64| at(&quadratic, p + 1.0) - 2.0 * at(&quadratic, p) + at(&quadratic, p - 1.0);
        assert!((second(2.0) - second(9.0)).abs() < 1e-9 && (at(&quadratic, 7.0) - 1854.0).abs() < 1e-9);
        assert_eq!(at(&Profile::constant(4.0), 2.0), 4.0);
        assert_eq!(at(&Profile::through([(3.0, 4.0)]), 2.0), 4.0);
    }

    /// Of degree 4 in each of the grid's coordinates and 5 in all.
    fn polynomial([x, y, z]: [f64; 3]) -> f64 {
        let (x, y) = (x + 0.02 * y - 0.05 * z - 0.97, 0.1 * y);
        2.0 + x - y * z + x.powi(4) * y - 3.0 * x.powi(2) * y.powi(2) * z + z.powi(4) + y.powi(3) * z.powi(2)
    }

    fn grid() -> Grid {
        let axis = |from: f64, to: f64, points: usize| Axis { from, to, points };
        Grid { skew: [-0.02, 0.05], ..Grid::straight(axis(0.9, 1.1, 5), axis(-12.0, 10.0, 5), axis(0.0, 1.5, 5)) }
    }

    fn fitted() -> Profile {
        let samples = (0..125).map(|k| grid().at([k / 25, k / 5 % 5, k % 5])).map(|at| (at, [polynomial(at)]));
        Profile::fitted(&grid(), &samples.collect::<Vec<_>>()).unwrap()[0]
    }

    #[test]
    fn a_polynomial_of_its_degree_is_found_and_comes_back_from_its_numbers() {
        let profile = fitted();
        for at in [[0.93, 3.0, 0.2], [1.04, -7.0, 1.1], [1.0, 0.0, 0.0]] {
            assert!((profile.at(at) - polynomial(at)).abs() < 1e-10, "{at:?}");
        }
        let numbers: Vec<f64> = profile.numbers().collect();
        assert_eq!(Profile::of_numbers(numbers.as_slice().try_into().unwrap()), profile);
    }

    #[test]
    fn every_derivative_is_that_of_the_value() {
        let (profile, at) = (fitted(), [1.03, -4.0, 0.7]);
        let jet = profile.isobaric(at[2]).jet(at[0], at[1]);
        for (i, h) in [1e-4, 1e-2, 1e-4].into_iter().enumerate() {
            let [low, high] = [-h, h].map(|h| {
                let mut at = at;
                at[i] += h;
                profile.isobaric(at[2]).jet(at[0], at[1])
            });
            assert!(((high.value - low.value) / (2.0 * h) - jet.gradient[i]).abs() < 1e-6, "{i}");
            let slope = (high.gradient - low.gradient) / (2.0 * h);
            for j in (0..3).filter(|j| i + j < 4) {
                assert!((slope[j] - jet.hessian[(i, j)]).abs() < 1e-5, "{i} {j}");
            }
        }
    }
}
