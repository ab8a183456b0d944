//! The strains' shape functions: Legendre polynomials along a rod, at the Gauss points of its Magnus steps.

/// How finely a rod is resolved.
///
/// The error falls exponentially with the degree and with the fourth power of the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Degree of the strains' polynomials over the rod, 0 to 15.
    pub degree: usize,
    /// Magnus steps (two Gauss points each) over the rod, 1 to 256.
    pub steps: usize,
}

impl Resolution {
    /// 0.01 % of the length for moderate bends, 0.15 % for turns beyond a radian ([`refined`](Resolution::refined) ones
    /// tell which), critical loads of a plate that is free to move to 1 %. Rods between clamped ends buckle in shapes
    /// that wind more: degree 5 or more, and twice the steps.
    pub const DEFAULT: Resolution = Resolution { degree: 4, steps: 4 };

    /// Two degrees and twice the steps: what the error is estimated with.
    pub fn refined(self) -> Resolution {
        Resolution { degree: self.degree + 2, steps: 2 * self.steps }
    }

    pub(crate) fn valid(self) -> bool {
        (0..=17).contains(&self.degree) && (1..=512).contains(&self.steps) && self.degree < 2 * self.steps
    }
}

/// Where in a unit step the two Gauss points are.
const GAUSS: [f64; 2] = [0.211_324_865_405_187_13, 0.788_675_134_594_812_9];

/// The shape functions' values. Strain component c at Gauss point a is `sum_m values[a][m] q[6 m + c]`.
#[derive(Clone, Debug)]
pub(crate) struct Basis {
    pub modes: usize,
    pub steps: usize,
    /// By Gauss point, then mode.
    values: Vec<f64>,
    /// The same at the ends of the steps.
    nodes: Vec<f64>,
}

impl Basis {
    pub fn new(resolution: Resolution) -> Basis {
        let (modes, steps) = (resolution.degree + 1, resolution.steps);
        let mut values = Vec::with_capacity(2 * steps * modes);
        for step in 0..steps {
            for gauss in GAUSS {
                values.extend(legendre((step as f64 + gauss) / steps as f64, modes));
            }
        }
        let nodes = (0..=steps).flat_map(|k| legendre(k as f64 / steps as f64, modes)).collect();
        Basis { modes, steps, values, nodes }
    }

    /// The modes at Gauss point `point` of 2 x steps.
    pub fn at(&self, point: usize) -> &[f64] {
        &self.values[point * self.modes..(point + 1) * self.modes]
    }

    /// The modes at the end `node` of a step, 0 to the number of steps.
    pub fn at_node(&self, node: usize) -> &[f64] {
        &self.nodes[node * self.modes..(node + 1) * self.modes]
    }
}

/// The Legendre polynomials of [0, 1] at `s`.
fn legendre(s: f64, modes: usize) -> impl Iterator<Item = f64> {
    let x = 2.0 * s - 1.0;
    let (mut before, mut now) = (0.0, 1.0);
    (0..modes).map(move |k| {
        let value = now;
        let n = k as f64;
        // (n + 1) P_{n+1} = (2 n + 1) x P_n - n P_{n-1}
        (before, now) = (now, ((2.0 * n + 1.0) * x * now - n * before) / (n + 1.0));
        value
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modes_are_legendres_and_nearly_orthogonal_in_the_quadrature() {
        let at: Vec<f64> = legendre(0.7, 4).collect();
        let x = 0.4f64;
        for (got, want) in at.iter().zip([1.0, x, 1.5 * x * x - 0.5, 2.5 * x.powi(3) - 1.5 * x]) {
            assert!((got - want).abs() < 1e-15);
        }
        let basis = Basis::new(Resolution { degree: 3, steps: 64 });
        for (i, j) in (0..16).map(|k| (k / 4, k % 4)) {
            let mean = (0..128).map(|point| basis.at(point)[i] * basis.at(point)[j]).sum::<f64>() / 128.0;
            let want = if i == j { 1.0 / (2 * i + 1) as f64 } else { 0.0 };
            assert!((mean - want).abs() < 1e-5, "{i} {j} {mean}");
        }
    }
}
