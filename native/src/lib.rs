//! The native trainer: runs and files, statistics, figures, reports, exports, measurements, Reacher in MuJoCo,
//! and the command `mcvl`.

pub mod bench;
pub mod export;
pub mod mujoco;
pub mod report;
pub mod runs;
pub mod worlds;
