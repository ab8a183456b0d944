//! What goes over the control socket: one JSON object each, SI units, units in the key names, `null` where there
//! is no value. The same types serve the server, the client and `--json`.
//!
//! | route | body | answer |
//! | --- | --- | --- |
//! | `GET /v1/status` | | [`Status`] |
//! | `GET /v1/status/stream` | | [`Status`], a line each time it changes |
//! | `GET /v1/events` | | [`Event`], a line each |
//! | `POST /v1/arm` | [`Arm`] | [`Response`] |
//! | `POST /v1/disarm`, `/v1/clear`, `/v1/stop`, `/v1/estop` | | [`Response`] |
//! | `POST /v1/set` | [`Set`] | [`Response`] |
//! | `POST /v1/start` | [`Start`] | [`Response`] with the run |
//! | `POST /v1/profile` | [`ProfileOf`] | [`Response`] with the profile |
//! | `POST /v1/heartbeat` | [`Heartbeat`] | [`Response`] |
//! | `POST /v1/pose` | [`Pose`] | [`Response`] |
//!
//! The answer of a request that was not done is a [`Problem`], with a status of 400 or above.

mod request;
mod status;

pub use request::{Arm, Heartbeat, Pose, Problem, ProblemKind, Profile, ProfileOf, Request, Response, Set, Start};
pub use status::{
    DeviceStatus, Durations, Event, Fault, FreeResult, FreeStatus, Happening, LineStatus, LoopStatus, Run, RunResult,
    Status, TipResult,
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::FaultCode;

    #[test]
    fn status_and_events_survive_the_wire() {
        let status = Status {
            state: "hold".into(),
            faults: vec![Fault::new(FaultCode::ImuStale, Some("paper"), true, false, "check the cable")],
            frees: vec![FreeStatus { name: "paper".into(), angle_rad: Some(f64::NAN), ..Default::default() }],
            ..Default::default()
        };
        let text = serde_json::to_string(&status).unwrap();
        assert!(text.contains(r#""loop":{"#) && text.contains(r#""name":"imu_stale""#), "{text}");
        let back: Status = serde_json::from_str(&text).unwrap();
        assert_eq!(back.frees[0].angle_rad, None, "what is not a number arrives as no value");
        assert!(back.is_faulted());

        let event = Event::now(Happening::Fault(status.faults[0].clone()));
        let text = serde_json::to_string(&event).unwrap();
        assert!(text.contains(r#""event":"fault""#) && text.contains(r#""code":7"#), "{text}");
        assert_eq!(serde_json::from_str::<Event>(&text).unwrap(), event);
    }

    #[test]
    fn unknown_keys_are_refused() {
        assert!(serde_json::from_str::<Arm>(r#"{"accept_margins": true}"#).is_err());
        assert!(serde_json::from_str::<Set>(r#"{"free": "paper", "pressure_psi": 7}"#).is_err());
        assert_eq!(serde_json::from_str::<Arm>("{}").unwrap(), Arm::default());
    }
}
