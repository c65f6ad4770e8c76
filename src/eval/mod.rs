//! Comparing planners and solvers fairly: protocols, runs, the table, the brute-force study.

pub mod plot;
pub mod protocol;
pub mod run;
pub mod settings;
pub mod statistics;
pub mod study;
pub mod table;

pub use protocol::Protocol;
pub use run::{Run, Score, Subject};
pub use settings::{RunSpec, Settings};
pub use table::{Report, Row};
