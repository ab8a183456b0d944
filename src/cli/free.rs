//! Which FREE of the rig a command is about.

use anyhow::anyhow;

use super::Failure;
use crate::config::Rig;

/// Index of the FREE called `name`; of the only one where none is named.
pub fn subject(rig: &Rig, name: Option<&str>) -> Result<usize, Failure> {
    let names = rig.free_names().collect::<Vec<_>>().join(", ");
    match name {
        Some(name) => rig.free(name).ok_or_else(|| {
            Failure::usage(anyhow!("the rig has no FREE `{name}`")).remedy(format!("name one of: {names}"))
        }),
        None if rig.control.frees.len() == 1 => Ok(0),
        None => {
            let error = anyhow!("the rig has several FREEs: {names}");
            Err(Failure::usage(error).remedy("name one with `--free NAME`"))
        }
    }
}
