//! The native trainer: runs and files, statistics, figures and reports, and the command `mcvl`.

pub mod report;
pub mod runs;
