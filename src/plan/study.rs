//! Thousands of designs: each is computed whatever becomes of the others, and what has no answer says why.

use nalgebra::Vector3;

use super::design::{Design, design};
use super::workspace::{CasePath, cases};
use super::{PlanError, Rest};
use crate::fem::ends::Equilibrium;
use crate::fem::module::{Layout, ModuleScene};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::fem::section_law::SectionLaw;
use crate::fem::tube::Tube;

/// A FREE to build, and how far apart four of it stand in a module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The tube.
    pub tube: Tube,
    /// Distance of neighbouring axes of a module of four, RLRL, without weight, m; none where no module is asked for.
    pub spacing: Option<f64>,
}

/// What is asked of every candidate. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Length at rest of a module's FREEs, m.
    pub length: f64,
    /// Pa, increasing from 0; at least two.
    pub pressures: Vec<f64>,
    /// Relative discretisation error of the section's curves.
    pub tolerance: f64,
}

/// One candidate at one pressure. SI units; what has no answer is none, and `remark` says why.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Which.
    pub candidate: Candidate,
    /// Pa.
    pub pressure: f64,
    /// Of a free FREE, rad per reference length.
    pub twist: Option<f64>,
    /// Of a free FREE.
    pub stretch: Option<f64>,
    /// On the support of a blocked FREE, N.
    pub force: Option<f64>,
    /// On the support of a blocked FREE, N m.
    pub moment: Option<f64>,
    /// How far a module's plate moves sideways under two neighbours' pressure (the paper's Case 4), mean of the four,
    /// m.
    pub sideways: Option<f64>,
    /// How far it moves along z under all four's (Case 1), m.
    pub lift: Option<f64>,
    /// Estimated relative discretisation error of the section's curves.
    pub error: Option<f64>,
    /// Why something is missing, or less sure than was asked; empty where nothing is.
    pub remark: String,
}

/// How the remark on a blocked FREE begins whose rubber folds.
const FOLDS: &str = "blocked: as if the rubber did not fold";

impl Row {
    /// Whether the rubber of the blocked FREE may fold there.
    pub fn folds(&self) -> bool {
        self.remark.contains(FOLDS)
    }
}

/// `candidate` at every pressure of the question.
pub fn rows(candidate: &Candidate, question: &Question) -> Vec<Row> {
    let single = design(&candidate.tube, &question.pressures, question.tolerance).map_err(|error| error.to_string());
    let module = candidate.spacing.map(|spacing| travel(&candidate.tube, spacing, question));
    let row = |(i, &pressure): (usize, &f64)| {
        let mut remarks = Vec::new();
        let of = |points: fn(&Design) -> &Vec<Option<Equilibrium>>| {
            single.as_ref().ok().and_then(|design| points(design).get(i).copied().flatten())
        };
        let (free, blocked) = (of(|d| &d.free), of(|d| &d.blocked));
        match &single {
            Err(error) => remarks.push(error.clone()),
            Ok(design) => {
                for (what, found, limit) in
                    [("free", free, design.free_limit), ("blocked", blocked, design.blocked_limit)]
                {
                    if let (None, Some(limit)) = (found, limit) {
                        remarks.push(format!("{what}: {} at {:.0} Pa", limit.kind, limit.pressure));
                    }
                }
                if let Some(beyond) = design.folds_beyond.filter(|beyond| pressure > *beyond && blocked.is_some()) {
                    remarks.push(format!("{FOLDS}, which it may from {beyond:.0} Pa on"));
                }
                if design.error > question.tolerance {
                    let (error, wanted) = (100.0 * design.error, 100.0 * question.tolerance);
                    remarks.push(format!("the finest mesh leaves {error:.2} %, and {wanted} % was asked for"));
                }
            }
        }
        let (mut sideways, mut lift) = (None, None);
        match &module {
            None => {}
            Some(Err(error)) => remarks.push(format!("module: {error}")),
            Some(Ok(travel)) => {
                (sideways, lift) = (travel.sideways[i], travel.lift[i]);
                if sideways.is_none() || lift.is_none() {
                    remarks.push(format!("module: {}", travel.ended));
                }
            }
        }
        Row {
            candidate: *candidate,
            pressure,
            twist: free.map(|e| e.twist),
            stretch: free.map(|e| e.stretch),
            force: blocked.map(|e| e.force),
            moment: blocked.map(|e| e.moment),
            sideways,
            lift,
            error: single.as_ref().ok().map(|design| design.error),
            remark: remarks.join("; "),
        }
    };
    question.pressures.iter().enumerate().map(row).collect()
}

/// A module's plate by pressure.
struct Travel {
    sideways: Vec<Option<f64>>,
    lift: Vec<Option<f64>>,
    /// Why the first of its paths ends.
    ended: String,
}

fn travel(tube: &Tube, spacing: f64, question: &Question) -> Result<Travel, String> {
    let scene = ModuleScene::new(tube, question.length, Layout::RLRL, spacing);
    let highest = question.pressures.last().copied().unwrap_or(0.0);
    let law = |request: &_| SectionLaw::build(request);
    let module = scene.module(Mesh::default(), highest, Resolution::DEFAULT, law).map_err(|e| e.to_string())?;
    let told = |error: PlanError| error.to_string();
    let rest = Rest::new(&module, &scene.loads([0.0; 4])).map_err(told)?;
    let paths = cases(&rest, highest, question.pressures.len()).map_err(told)?;
    let home = rest.state().position();
    let shift = |path: &CasePath, i: usize| path.poses.get(i).map(|pose| Vector3::from(pose.position) - home);
    let mean = |number: u8, of: fn(Vector3<f64>) -> f64| -> Vec<Option<f64>> {
        let those: Vec<&CasePath> = paths.iter().filter(|path| path.case.number == number).collect();
        let at = |i: usize| {
            let all: Option<Vec<f64>> = those.iter().map(|path| shift(path, i).map(of)).collect();
            all.map(|all| all.iter().sum::<f64>() / all.len() as f64)
        };
        (0..question.pressures.len()).map(at).collect()
    };
    let first = paths.iter().filter(|path| path.ended.is_some()).min_by_key(|path| path.pressures.len());
    let ended = first.and_then(|path| path.ended.as_ref().map(|end| format!("{} {end}", path.case.letters())));
    Ok(Travel {
        sideways: mean(4, |shift| shift.xy().norm()),
        lift: mean(1, |shift| shift.z),
        ended: ended.unwrap_or_default(),
    })
}
