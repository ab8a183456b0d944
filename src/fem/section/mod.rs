//! wip
mod assembly;
mod band;
mod fields;
mod mesh;
mod newton;
mod saddle;

pub use mesh::Mesh;
use thiserror::Error;
use crate::fem::tube::{Tube, TubeError};
use crate::fem::ends::*;

#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SectionError {
    #[error(transparent)]
    Tube(#[from] TubeError),
    #[error("mesh {0:?}")]
    Mesh(Mesh),
    #[error("inverted")]
    Inverted,
}

pub fn probe(tube: &Tube, mesh: Mesh, pressures: &[f64], ends: Ends) {
    use newton::*;
    let sector = fields::Sector::new(tube, mesh).unwrap();
    let (mu, ro) = (tube.law.shear_modulus(), tube.outer_radius());
    let mut ws = Workspace::new(&sector);
    let c = sector.copies;
    let at = |p: f64| {
        let a = match ends.axial { End::Held(v) => Condition::Held(v), End::Loaded(v) => Condition::Conjugate(v / (mu * ro * ro * c)) };
        let t = match ends.torsion { End::Held(v) => Condition::Held(v * ro), End::Loaded(v) => Condition::Conjugate(v / (mu * ro * ro * ro * c)) };
        [a, t, Condition::Held(p / mu)]
    };
    let mut s = ws.solve(&sector, sector.rest(), at(0.0)).expect("rest");
    for &p in pressures {
        let Some(step) = global_step(&s.hessian, &s.conjugate, &s.fields.globals, at(p)) else { println!("no step"); return };
        let t0 = std::time::Instant::now();
        let Some(n) = ws.solve(&sector, s.predicted(&step), at(p)) else { println!("{p}: fail"); return };
        let dt = t0.elapsed();
        s = n;
        let g = s.fields.globals;
        println!("p {:.3} tau {:.8e}/mm lam {:.8} F {:.6} M {:.6} rf {:.6} rm {:.6} neg {} stable {} {:?}", p / 6894.757293168, g[1] / ro * 1e-3, g[0],
          -s.conjugate[0] * c * mu * ro * ro, -s.conjugate[1] * c * mu * ro.powi(3) * 1e3, sector.radius_at(&s.fields, sector.rings()-1)*ro*1e3, sector.mean_outer_radius(&s.fields)*ro*1e3, s.negative, s.stable([true,true]), dt);
    }
}
