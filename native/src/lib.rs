//! The native trainer: runs and files, statistics, figures, reports, exports, measurements, and the
//! command `mcvl`.

pub mod bench;
pub mod export;
pub mod report;
pub mod runs;
