//! Run directories: what lies in them, how it is written and read back.

use std::path::PathBuf;

use mcvl_core::config::Config;
use mcvl_core::record::{CheckRecord, EndRecord, EpisodeRecord, EvaluationRecord, LearnerRecord};

/// One seed of a run directory, read back: the Safe leg and every learner's Full leg.
#[derive(Clone, Debug)]
pub struct SeedRun {
    /// The seed.
    pub seed: u64,
    /// Folder of the seed.
    pub path: PathBuf,
    /// Evaluation points of all legs, in the order in which they were recorded.
    pub evaluations: Vec<EvaluationRecord>,
    /// State of the learner at those points.
    pub learner: Vec<LearnerRecord>,
    /// Episodes of all legs.
    pub episodes: Vec<EpisodeRecord>,
    /// Decisions of the checks, without films.
    pub checks: Vec<CheckRecord>,
    /// Finished legs.
    pub ends: Vec<EndRecord>,
    /// True if every planned leg is finished.
    pub complete: bool,
}

/// A run directory, read back.
#[derive(Clone, Debug)]
pub struct RunSet {
    /// The folder.
    pub path: PathBuf,
    /// Configuration that all seeds share (its `seed` is the first one).
    pub config: Config,
    /// Seeds in ascending order.
    pub seeds: Vec<SeedRun>,
}
