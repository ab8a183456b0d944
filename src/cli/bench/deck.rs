//! The deck of one FREE for CalculiX: a sector with cyclic symmetry, its fibre as springs, a rigid cap.
//!
//! Quadratic bricks with reduced integration (C3D20R), swept along the fibre. CalculiX has no hybrid elements: the
//! rubber is nearly incompressible, K = 1000 mu. The strip is springs between neighbouring nodes of its lines, which
//! share EA by Simpson's rule. The two faces of the sector are tied in cylindrical axes of their own, which holds for
//! turns of any size; the cap may move and turn along its axis only. All pressures are one step with time points, in
//! mm, N and MPa. A number may have 20 characters.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;

use crate::fem::fidelity::Scene;
use crate::fem::material::Law;

/// Bulk modulus over the shear modulus.
const BULK: f64 = 1000.0;
/// Ratio of neighbouring elements beside the strip, and along the tube from its ends.
const GROWTH: (f64, f64) = (2.2, 1.5);
/// First element along the tube, mm, and the largest one over the mean, before all are scaled to fill the length.
const ALONG: (f64, f64) = (0.5, 1.5);
/// Shares of EA of the strip's three lines of nodes.
const SIMPSON: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];
/// Corners and mid-points of a brick in CalculiX's order: half elements through the wall, round and along.
const BRICK: [[usize; 3]; 20] = [
    [0, 0, 0],
    [2, 0, 0],
    [2, 2, 0],
    [0, 2, 0],
    [0, 0, 2],
    [2, 0, 2],
    [2, 2, 2],
    [0, 2, 2],
    [1, 0, 0],
    [2, 1, 0],
    [1, 2, 0],
    [0, 1, 0],
    [1, 0, 2],
    [2, 1, 2],
    [1, 2, 2],
    [0, 1, 2],
    [0, 0, 1],
    [2, 0, 1],
    [2, 2, 1],
    [0, 2, 1],
];

/// How the sector is divided: elements through the wall, on either side of the strip, and along (even).
#[derive(Clone, Copy, Debug)]
pub(super) struct DeckMesh {
    pub(super) radial: usize,
    pub(super) side: usize,
    pub(super) along: usize,
}

/// Numbers of the nodes by their place in half elements.
struct Nodes {
    planes: [Vec<f64>; 3],
    ids: Vec<Option<usize>>,
    count: usize,
}

impl Nodes {
    fn new(planes: [Vec<f64>; 3]) -> Nodes {
        let [a, b, c] = [0, 1, 2].map(|k| planes[k].len());
        let (mut ids, mut count) = (vec![None; a * b * c], 0);
        for (place, id) in ids.iter_mut().enumerate() {
            // A quadratic brick has no nodes in the middle of itself and of its faces.
            if (place % a) % 2 + (place / a % b) % 2 + (place / (a * b)) % 2 <= 1 {
                count += 1;
                *id = Some(count);
            }
        }
        Nodes { planes, ids, count }
    }

    fn id(&self, [i, j, k]: [usize; 3]) -> usize {
        self.ids[(k * self.planes[1].len() + j) * self.planes[0].len() + i].unwrap_or_default()
    }

    /// Numbers and places, in their order.
    fn each(&self) -> impl Iterator<Item = (usize, [usize; 3])> + '_ {
        let [a, b, _] = [0, 1, 2].map(|k| self.planes[k].len());
        let place = move |at: usize| [at % a, at / a % b, at / (a * b)];
        self.ids.iter().enumerate().filter_map(move |(at, id)| Some(((*id)?, place(at))))
    }
}

/// Corners and mid-points from corners.
fn halved(corners: &[f64]) -> Vec<f64> {
    let mut points = vec![corners[0]];
    for pair in corners.windows(2) {
        points.extend([0.5 * (pair[0] + pair[1]), pair[1]]);
    }
    points
}

/// Corners from `start` on, from sizes that are scaled to fill `length`.
fn filled(start: f64, sizes: &[f64], length: f64) -> Vec<f64> {
    let scale = length / sizes.iter().sum::<f64>();
    let mut at = start;
    std::iter::once(start)
        .chain(sizes.iter().map(|size| {
            at += size * scale;
            at
        }))
        .collect()
}

fn set(deck: &mut String, keyword: &str, members: &[usize]) {
    let _ = writeln!(deck, "{keyword}");
    for line in members.chunks(8) {
        let _ = writeln!(deck, "{}", line.iter().map(usize::to_string).collect::<Vec<_>>().join(","));
    }
}

/// The deck of `scene`, free, whose pressures rise in equal steps, and its number of unknowns; none where the rubber
/// has no Ogden law. The cap's motion along the axis is that of the set REF, its turn that of the set ROT.
pub(super) fn write(scene: &Scene, mesh: DeckMesh) -> Option<(String, usize)> {
    let Law::Ogden { mu, alpha } = scene.tube.law else { return None };
    let tube = &scene.tube;
    let (inner, outer, length) = (1e3 * tube.inner_radius, 1e3 * tube.outer_radius(), 1e3 * scene.length);
    let winding = tube.gamma.tan() / outer;
    let share = TAU / tube.fibers as f64;
    let strip = 1e3 * tube.fiber_width / outer;

    let beside: Vec<f64> = (0..mesh.side).map(|k| GROWTH.0.powi(k as i32)).collect();
    let scale = 0.5 * (share - strip) / beside.iter().sum::<f64>();
    let mut around: Vec<f64> = beside.iter().rev().map(|size| size * scale).collect();
    around.extend([0.5 * strip; 2]);
    around.extend(beside.iter().map(|size| size * scale));
    let most = ALONG.1 * length / mesh.along as f64;
    let half: Vec<f64> = (0..mesh.along / 2).map(|k| (ALONG.0 * GROWTH.1.powi(k as i32)).min(most)).collect();
    let along: Vec<f64> = half.iter().chain(half.iter().rev()).copied().collect();
    let nodes = Nodes::new([
        halved(&filled(inner, &vec![1.0; mesh.radial], outer - inner)),
        halved(&filled(-0.5 * share, &around, share)),
        halved(&filled(0.0, &along, length)),
    ]);
    let [top_radial, top_around, top_along] = [0, 1, 2].map(|k| nodes.planes[k].len() - 1);

    let mut deck = String::from("*NODE,NSET=ALL\n");
    for (id, [i, j, k]) in nodes.each() {
        let (r, z) = (nodes.planes[0][i], nodes.planes[2][k]);
        let angle = nodes.planes[1][j] + winding * z;
        let _ = writeln!(deck, "{id},{:.12e},{:.12e},{z:.12e}", r * angle.cos(), r * angle.sin());
    }
    let (cap, turn) = (nodes.count + 1, nodes.count + 2);
    let _ = writeln!(deck, "{cap},0,0,{length}\n{turn},0,0,{length}\n*ELEMENT,TYPE=C3D20R,ELSET=RUBBER");
    let (mut element, mut wall) = (0, Vec::new());
    for k in (0..top_along).step_by(2) {
        for j in (0..top_around).step_by(2) {
            for i in (0..top_radial).step_by(2) {
                element += 1;
                if i == 0 {
                    wall.push(element);
                }
                let ids = BRICK.map(|[a, b, c]| nodes.id([i + a, j + b, k + c]).to_string());
                let _ = writeln!(deck, "{element},{},\n{}", ids[..10].join(","), ids[10..].join(","));
            }
        }
    }
    let _ = writeln!(
        deck,
        "*SOLID SECTION,ELSET=RUBBER,MATERIAL=RUBBER\n*MATERIAL,NAME=RUBBER\n*HYPERELASTIC,OGDEN,N=1\n{:.9e},{alpha},{:.9e}",
        1e-6 * mu,
        2.0 / (BULK * 1e-6 * mu)
    );
    for (line, part) in SIMPSON.into_iter().enumerate() {
        let j = 2 * mesh.side + 2 * line;
        for k in 0..top_along {
            element += 1;
            let rise = nodes.planes[2][k + 1] - nodes.planes[2][k];
            let chord = rise.hypot(2.0 * outer * (0.5 * winding * rise).sin());
            let (from, to) = (nodes.id([top_radial, j, k]), nodes.id([top_radial, j, k + 1]));
            let stiffness = part * tube.fiber_ea / chord;
            let _ = writeln!(
                deck,
                "*ELEMENT,TYPE=SPRINGA,ELSET=F{element}\n{element},{from},{to}\n*SPRING,ELSET=F{element}\n\n{stiffness:.9e}"
            );
        }
    }
    let at = |plane: usize| nodes.each().filter(|(_, at)| at[2] == plane).map(|(id, _)| id).collect::<Vec<_>>();
    set(&mut deck, "*NSET,NSET=BASE", &at(0));
    set(&mut deck, "*NSET,NSET=TOP", &at(top_along));
    let tied = nodes.each().filter(|(_, at)| at[1] == 0 && at[2] > 0 && at[2] < top_along);
    let tied: Vec<[usize; 2]> = tied.map(|(id, [i, _, k])| [nodes.id([i, top_around, k]), id]).collect();
    set(&mut deck, "*NSET,NSET=TIED", tied.as_flattened());
    deck.push_str("*TRANSFORM,NSET=TIED,TYPE=C\n0,0,0,0,0,1\n");
    for [one, other] in tied {
        for axis in 1..=3 {
            let _ = writeln!(deck, "*EQUATION\n2\n{one},{axis},1.,{other},{axis},-1.");
        }
    }
    set(&mut deck, "*ELSET,ELSET=WALL", &wall);
    let last = scene.pressures.last().copied().unwrap_or_default();
    let times = scene.pressures.iter().map(|p| format!("{:.8}", p / last)).collect::<Vec<_>>().join(",");
    let gas = 1e-6 * last;
    let thrust = gas * PI * inner * inner / tube.fibers as f64;
    let _ = write!(
        deck,
        "*RIGID BODY,NSET=TOP,REF NODE={cap},ROT NODE={turn}\n*NSET,NSET=REF\n{cap}\n*NSET,NSET=ROT\n{turn}\n\
         *BOUNDARY\nBASE,1,3\n{cap},1,2\n{turn},1,2\n*TIME POINTS,NAME=ASKED\n{times}\n\
         *STEP,NLGEOM,INC=2000\n*STATIC\n0.02,1.,1e-6,0.2\n*DLOAD\nWALL,P6,{gas:.9e}\n*CLOAD\n{cap},3,{thrust:.9e}\n\
         *NODE PRINT,NSET=REF,TIME POINTS=ASKED\nU\n*NODE PRINT,NSET=ROT,TIME POINTS=ASKED\nU\n*END STEP\n"
    );
    Some((deck, 3 * nodes.count))
}
