//! The native trainer: runs and files, statistics, figures, reports and exports, and the command
//! `mcvl`.

pub mod export;
pub mod report;
pub mod runs;
