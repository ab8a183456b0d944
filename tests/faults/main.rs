//! What the whole rig does when something goes wrong: every row of the fault matrix that this part can provoke is
//! provoked through the simulated hardware (chips, lines, plant, valves) or the loop's own timing and switches,
//! and judged by the record and by the true pressure in the FREE.

mod adversary;
mod analogue;
mod drill;
mod killed;
mod ladder;
mod lines;
mod live;
mod matrix;
mod pairs;
mod pwm;
mod stage;
