//! The two-axis arm that carries the light: stock Grbl 1.1 behind a serial line.
//!
//! X is the azimuth and Y the slant, both in degrees. Everything here takes bytes, values and the time
//! and gives bytes and events: the page, the command line and the tests bring their own port and clock.
//!
//! - [`mod@line`]: what one line of the firmware means; [`codes`]: its numbers in words.
//! - [`grbl`]: the host's side of the link.
//! - [`kinematics`]: light direction ↔ joint angles, limits, travel; [`motion`]: how long Grbl takes.
//! - [`simulated`]: a Grbl 1.1h with an arm on it; [`fault`]: what can go wrong on the way.

pub mod codes;
pub mod fault;
pub mod grbl;
pub mod kinematics;
pub mod line;
pub mod motion;
pub mod simulated;

use std::time::Duration;

/// Joint angles in degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Joints {
    /// X axis: azimuth, from +x towards +y.
    pub azimuth: f64,
    /// Y axis: slant, 0 towards the camera.
    pub slant: f64,
}

/// Why a port gives no more bytes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TransportError {
    /// Another program holds the port.
    #[error(
        "{0} is busy: another program (Arduino IDE, another tab, a serial monitor) has it open; close that and try again"
    )]
    Busy(String),
    /// No such port, or not allowed to open it.
    #[error("{port} can't be opened: {reason}")]
    Open {
        /// Its name.
        port: String,
        /// What the system says, and what would help.
        reason: String,
    },
    /// The port went away.
    #[error("the cable was pulled or the board lost power ({0})")]
    Lost(String),
}

/// A serial port, real or simulated: bytes without any meaning.
pub trait Transport {
    /// Sends `bytes` at once.
    ///
    /// # Errors
    /// [`TransportError::Lost`] where the port is gone.
    fn write(&mut self, now: Duration, bytes: &[u8]) -> Result<(), TransportError>;

    /// Appends to `into` what has arrived; does not wait.
    ///
    /// # Errors
    /// [`TransportError::Lost`] where the port is gone.
    fn read(&mut self, now: Duration, into: &mut Vec<u8>) -> Result<(), TransportError>;

    /// When something may arrive without being asked; `None` where that can't be known.
    fn next_event(&self) -> Option<Duration> {
        None
    }
}
