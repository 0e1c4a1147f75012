//! The native trainer: runs and files, statistics, figures, reports, the paper's experiments, exports, the page in one
//! file, measurements, Reacher in MuJoCo, forecasts on graphics cards, and the command `mcvl`.

pub mod bench;
pub mod export;
pub mod gpu;
pub mod mujoco;
pub mod page;
pub mod report;
pub mod reproduce;
pub mod runs;
pub mod worlds;
