//! What the commands that talk to the daemon have in common.

use std::time::Duration;

use super::{Context, Failure};
use crate::config::Rig;
use crate::daemon::api::{Response, Status};
use crate::daemon::client::{Client, ClientError};

/// The daemon of the rig that the command is about. A mistake elsewhere in rig.toml does not stand in the way.
pub fn client(context: &Context) -> Result<Client, Failure> {
    Ok(Client::new(&Rig::socket_path(&context.rig)?))
}

/// Runs `ask` to its end.
pub fn wait<T>(ask: impl Future<Output = Result<T, ClientError>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(ask).map_err(Failure::client)
}

/// Prints what the daemon answered.
pub fn tell(response: &Response, context: &Context) -> Result<(), Failure> {
    if context.json { context.print_json(response) } else { context.print(&response.message) }
}

/// Asks for the status until it is as `wanted`, `longest` at most; the last one in any case.
pub async fn until(
    client: &Client,
    longest: Duration,
    wanted: impl Fn(&Status) -> bool,
) -> Result<Status, ClientError> {
    const LOOK: Duration = Duration::from_millis(100);
    let end = tokio::time::Instant::now() + longest;
    loop {
        let status = client.status().await?;
        if wanted(&status) || tokio::time::Instant::now() >= end {
            return Ok(status);
        }
        tokio::time::sleep(LOOK).await;
    }
}
