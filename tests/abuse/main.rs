//! Load and abuse, and what keeps others out: the program itself in real time, the stepped rig over long times, and
//! everything that reads what comes from outside, fed with what nobody would send.

#[path = "../daemon/place.rs"]
mod place;

mod crowd;
mod disk;
mod endurance;
mod fuzz;
mod journal;
mod load;
mod memory;
mod security;
mod stop;
mod wall_clock;

use std::time::{Duration, Instant};

use freerig::daemon::api::{Event, Happening, RunResult, Start};
use freerig::daemon::client::Lines;

/// An experiment that holds a little pressure for as long as a test may need it.
const HOLD: &str = "kind = \"sweep\"\npressures_psi = [2]\nmove_s = 0.5\nhold_s = 600\nand_back = false\n";

/// [`place::attempt`] on the [`analogue`] rig.
fn attempt(scenario: impl Fn(&place::Place)) {
    place::attempt(|place| {
        analogue(place);
        scenario(place);
    });
}

/// Puts an analogue regulator in the place of the serial one: nothing here is about the devices, and the simulated
/// serial line is carried by the kernel's own work, which waits where every core is busy.
fn analogue(place: &place::Place) {
    let without = |text: String, from: &str, to: &str, instead: &str| {
        let (begin, end) = (text.find(from).unwrap(), text.find(to).unwrap());
        format!("{}{instead}{}", &text[..begin], &text[end..])
    };
    place.rewrite(|text| {
        let text = without(text, "[serial.line]", "# One table per FREE", "");
        without(text, "[free.regulator]", "[free.limits]", ANALOGUE)
    });
    let path = place.path("calibration/paper.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let measured = "[regulator]\nzero_code = { value = 60.0, method = \"test\" }\n\
                    span_pa_per_code = { value = 26.0, method = \"test\" }\n";
    std::fs::write(&path, text.replace("[regulator]\n", measured)).unwrap();
}

/// A regulator behind a DAC on the bus of the IMU.
const ANALOGUE: &str = "[free.regulator]\nkind = \"mcp4728\"\nbus = \"main\"\naddress = 0x60\nchannel = \"A\"\n\
                        full_scale_psi = 15\n\n";

/// Starts [`HOLD`], to go on without its client.
fn hold() -> Start {
    Start { kind: "sweep".into(), experiment: HOLD.into(), detach: true, ..Start::default() }
}

/// Waits for the end of a run.
async fn finished(events: &mut Lines<Event>) -> (String, RunResult) {
    loop {
        let event = events.next().await.unwrap().expect("the daemon has ended");
        if let Happening::RunFinished(result) = event.what {
            return (event.time, result);
        }
    }
}

/// Waits until `condition` holds, for as long as a busy machine may need.
#[track_caller]
fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let end = Instant::now() + 2 * place::LONG;
    while !condition() {
        assert!(Instant::now() < end, "not {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
