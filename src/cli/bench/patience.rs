//! Waiting for another program, but not for ever.

use std::io;
use std::process::Child;
use std::time::{Duration, Instant};

/// Time between two looks at it.
const LOOK: Duration = Duration::from_millis(20);

/// Whether `child` ended within `patience`; if not, it is stopped. `look` is called meanwhile.
pub(super) fn wait(child: &mut Child, patience: Duration, look: &mut dyn FnMut()) -> io::Result<bool> {
    let begun = Instant::now();
    while child.try_wait()?.is_none() {
        if begun.elapsed() > patience {
            child.kill()?;
            child.wait()?;
            return Ok(false);
        }
        look();
        std::thread::sleep(LOOK);
    }
    Ok(true)
}
