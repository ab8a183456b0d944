//! Colours, 0xRRGGBB: apart from one another for most eyes (after Okabe and Ito), the same in the viewer, the
//! plots and the report.

/// What was asked.
pub const GREY: u32 = 0x7A828C;
/// What was measured or estimated.
pub const BLUE: u32 = 0x1F77B4;
/// The simulated truth, the integral term.
pub const GREEN: u32 = 0x009E73;
/// The model's prediction, the derivative term.
pub const ORANGE: u32 = 0xE07B00;
/// Errors and faults.
pub const RED: u32 = 0xD43D3D;
/// Feedforward, identification.
pub const PURPLE: u32 = 0x9B5FC0;
/// On the way from one state to another.
pub const YELLOW: u32 = 0xE0B400;
/// The FREE's rubber.
pub const RUBBER: u32 = 0xC9B79C;
/// Its fibres.
pub const FIBER: u32 = 0x33302C;
/// Its end pieces.
pub const METAL: u32 = 0xA9B0B8;
