//! Comparing planners and solvers fairly: protocols, runs, the table, the brute-force study.

pub mod plot;
pub mod protocol;
pub mod statistics;
pub mod study;
pub mod table;

pub use protocol::Protocol;
pub use table::{Report, Row, Run, RunSpec, Score, Settings, Subject};
