//! A module's converged equilibrium and what follows from it.

use std::sync::Arc;

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use super::{Loads, Module, quaternion};
use crate::fem::rod::{Condensed, DualMatrix, DualVector};

/// A force and a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// N.
    pub force: Vector3<f64>,
    /// N m.
    pub moment: Vector3<f64>,
}

/// The unknowns: the plate's pose, and each rod's strains and the wrench that its tip bears.
#[derive(Clone, Debug)]
pub(super) struct Unknowns {
    pub plate: DualMatrix,
    pub rods: Vec<(Vec<f64>, DualVector)>,
}

/// An equilibrium. SI units.
#[derive(Clone, Debug)]
pub struct State {
    pub(super) loads: Loads,
    pub(super) unknowns: Unknowns,
    /// K of the plate's twist (angular, linear) about its centre.
    pub(super) stiffness: Matrix6<f64>,
    /// Change of the rods' summed wrench (moment, force) about the plate's centre by each pressure at a held plate.
    pub(super) by_pressure: Vec<Vector6<f64>>,
    /// Every rod's eliminated equations: how it goes on from here.
    pub(super) tangent: Arc<[Condensed]>,
    pub(super) unstable_rods: i32,
    pub(super) unstable_plate: i32,
    pub(super) energy: f64,
    pub(super) clearance: Option<([usize; 2], f64)>,
    pub(super) iterations: usize,
}

impl State {
    /// The loads that it balances.
    pub fn loads(&self) -> &Loads {
        &self.loads
    }

    /// Plate's centre, m.
    pub fn position(&self) -> Vector3<f64> {
        self.unknowns.plate.position()
    }

    /// Plate's rotation from rest.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        quaternion(&self.unknowns.plate)
    }

    /// What rod `index` does to the plate, about its own tip, in the fixed frame; none for a rod that does not exist.
    pub fn on_plate(&self, module: &Module, index: usize) -> Option<Wrench> {
        let (_, w) = self.unknowns.rods.get(index)?;
        let tip = module.target(&self.unknowns.plate, index).position();
        Some(Wrench { force: -w.re, moment: -(w.du - tip.cross(&w.re)) })
    }

    /// Energy of the rods (strain energy less P V) and of the dead force and gravity, J. A dead moment has none.
    pub fn energy(&self) -> f64 {
        self.energy
    }

    /// Negative pivots of the whole tangent beyond those of its constraints; 0 is stable.
    pub fn negative_pivots(&self) -> i32 {
        self.unstable_rods + self.unstable_plate
    }

    /// No small motion lowers the energy.
    pub fn stable(&self) -> bool {
        self.negative_pivots() == 0
    }

    /// Smallest distance between the surfaces of two rods, m, and which; none with fewer than two that have a radius.
    pub fn least_clearance(&self) -> Option<([usize; 2], f64)> {
        self.clearance
    }

    /// Newton iterations spent on it.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Stiffness of the plate under dead loads: (moment, force) about its centre by its twist (rotation, translation)
    /// in the fixed frame. Symmetric but for a dead moment's half bracket.
    pub fn stiffness(&self) -> Matrix6<f64> {
        self.stiffness
    }

    /// Its inverse; none at a critical point.
    pub fn compliance(&self) -> Option<Matrix6<f64>> {
        self.stiffness.try_inverse()
    }

    /// The plate's twist (rotation rad, translation m of the centre, fixed frame) per pressure (Pa) of each rod; none
    /// at a critical point.
    pub fn by_pressure(&self) -> Option<Vec<Vector6<f64>>> {
        let lu = self.stiffness.lu();
        self.by_pressure.iter().map(|w| lu.solve(&-w)).collect()
    }
}
