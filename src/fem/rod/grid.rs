//! The points of a table: an evenly spaced grid over (stretch, twist, pressure).
//!
//! The grid is skewed: its first coordinate is the stretch less a multiple of the twist and of the pressure. A tube of
//! stiff fibres that is twisted changes its length, so that the states it can reach lie about a slanted plane.

/// One axis of the grid, evenly spaced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// First value.
    pub from: f64,
    /// Last value.
    pub to: f64,
    /// Points, at least 5.
    pub points: usize,
}

/// The points of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// `stretch - skew[0] twist - skew[1] pressure`.
    pub stretch: Axis,
    /// Twist, rad per reference metre.
    pub twist: Axis,
    /// Gauge pressure, Pa.
    pub pressure: Axis,
    /// Change of the stretch with twist (m) and pressure (1/Pa) along the grid's first plane.
    pub skew: [f64; 2],
}

impl Axis {
    pub(super) fn spacing(&self) -> f64 {
        (self.to - self.from) / (self.points - 1) as f64
    }

    fn value(&self, index: usize) -> f64 {
        self.from + index as f64 * self.spacing()
    }

    /// The cell of `x` and the place in it, 0 to 1; none outside.
    pub(super) fn cell(&self, x: f64) -> Option<(usize, f64)> {
        let place = (x - self.from) / self.spacing();
        let last = (self.points - 2) as f64;
        // The ends belong to the table, up to rounding.
        if !(place >= -1e-9 && place <= last + 1.0 + 1e-9) {
            return None;
        }
        let cell = place.floor().clamp(0.0, last);
        Some((cell as usize, place - cell))
    }
}

impl Grid {
    /// A grid without skew.
    pub fn straight(stretch: Axis, twist: Axis, pressure: Axis) -> Grid {
        Grid { stretch, twist, pressure, skew: [0.0; 2] }
    }

    /// The three axes.
    pub fn axes(&self) -> [Axis; 3] {
        [self.stretch, self.twist, self.pressure]
    }

    /// Number of points.
    pub fn points(&self) -> usize {
        self.axes().iter().map(|a| a.points).product()
    }

    /// Where a point's state stands in the list of them: the pressure runs fastest, the stretch slowest.
    pub fn index(&self, [stretch, twist, pressure]: [usize; 3]) -> usize {
        (stretch * self.twist.points + twist) * self.pressure.points + pressure
    }

    /// (stretch, twist rad/m, pressure Pa) of a point.
    pub fn at(&self, [stretch, twist, pressure]: [usize; 3]) -> [f64; 3] {
        self.unskewed([self.stretch.value(stretch), self.twist.value(twist), self.pressure.value(pressure)])
    }

    /// (stretch, twist, pressure) in the middle of the cell whose lowest corner is `at`.
    pub fn middle(&self, at: [usize; 3]) -> [f64; 3] {
        let middle = |axis: Axis, i: usize| axis.value(i) + 0.5 * axis.spacing();
        let axes = self.axes();
        self.unskewed([middle(axes[0], at[0]), middle(axes[1], at[1]), middle(axes[2], at[2])])
    }

    fn unskewed(&self, [x, twist, pressure]: [f64; 3]) -> [f64; 3] {
        [x + self.skew[0] * twist + self.skew[1] * pressure, twist, pressure]
    }

    pub(super) fn skewed(&self, [stretch, twist, pressure]: [f64; 3]) -> [f64; 3] {
        [stretch - self.skew[0] * twist - self.skew[1] * pressure, twist, pressure]
    }

    /// Every point, in the order of its index.
    pub(super) fn all(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [_, m, l] = self.axes().map(|a| a.points);
        (0..self.points()).map(move |i| [i / (m * l), i / l % m, i % l])
    }
}
