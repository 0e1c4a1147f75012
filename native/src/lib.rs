//! The native trainer: runs and files, statistics, figures, reports, the paper's experiments, exports,
//! measurements, Reacher in MuJoCo, forecasts on graphics cards, and the command `mcvl`.

pub mod bench;
pub mod export;
pub mod gpu;
pub mod mujoco;
pub mod report;
pub mod reproduce;
pub mod runs;
pub mod worlds;
