//! Run directories: what lies in them, how it is written and read back.
//!
//! ```text
//! runs/box-moving/            RunDir     one `mcvl train`
//!   run.toml                  Plan       every setting with its origin, seeds, learners
//!   manifest.json             Manifest   machine, versions, digests of finished files
//!   summary.json, curves.svg, curves.png
//!   export/                              what `mcvl export` made of it: tables, event files, weights, tapes
//!   seed-0/                   SeedDir    one job: Safe, then each learner from the same switch
//!     metrics.jsonl  steps.csv  ledger.jsonl  tapes/check-17.json
//!     checkpoints/state.snapshot  switch.snapshot  safe.safetensors  mc.safetensors
//! ```
//!
//! Event files for TensorBoard are not kept beside the logs that they would repeat; `mcvl export` makes them at any time,
//! also of a run under way.
//!
//! Two rules hold it together. Logs only grow, and are synced *before* the checkpoint that records
//! their lengths, so a kill at any moment leaves a checkpoint whose logs are there. Everything else is
//! written under a temporary name, synced, then renamed.

mod chain;
mod checkpoint;
mod job;
mod layout;
mod manifest;
mod plan;
mod pool;
mod read;
mod reader;
pub(crate) mod side_by_side;
mod tape;
mod verify;
mod write;

use std::fmt;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use mcvl_core::config::Config;
use mcvl_core::record::{CheckRecord, EndRecord, EpisodeRecord, EvaluationRecord, LearnerRecord};
use mcvl_core::run::RunError;

pub use chain::{Chain, LedgerLine, sha256};
pub use job::{Ending, Job, ReadyJob};
pub use layout::{Place, Reference, RunDir, SeedDir, check_target, shell_word};
pub use manifest::{FileDigest, Manifest, SEPARATOR, State};
pub use plan::{Origin, Plan, Setting, check_forecasts, expected_forecasts, train_command};
pub use pool::{Control, Outcome, Remote, SeedView, train};
pub use read::{Lines, ledger, tape};
pub use reader::Reader;
pub use tape::{TAPE_FORMAT, TAPE_VERSION, run_tape};
pub use verify::{Finding, Verification, verify};
pub use write::{Lock, STEP_COLUMNS, SeedWriter, end_name, step_row, write_atomic};

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
    /// Hacks of the checked learner that were learned without a check; none where no `steps.csv` tells.
    pub unchecked_hacks: Option<u64>,
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
    /// Seeds that are to be trained, begun or not, ascending; of the folder of a seed that one.
    pub planned: Vec<u64>,
    /// Those that were begun, ascending.
    pub seeds: Vec<SeedRun>,
}

impl RunSet {
    /// Planned seeds that lack a leg, ascending.
    pub fn unfinished(&self) -> Vec<u64> {
        let done = |seed: &u64| self.seeds.iter().any(|run| run.seed == *seed && run.complete);
        self.planned.iter().copied().filter(|seed| !done(seed)).collect()
    }
}

/// Why something cannot be done with a run directory. The kinds differ in what the caller can do.
#[derive(Debug)]
pub enum RunsError {
    /// The machine refused: disk, rights, devices.
    Io {
        /// What was being done, as it follows "cannot".
        doing: &'static str,
        /// With which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A file is not what was written.
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it, and what to do.
        why: String,
    },
    /// The request does not fit what is there: what, where, what to do.
    Request(String),
    /// The device that forecasts failed; the state before the forecast is saved.
    BackEnd {
        /// The seed.
        seed: u64,
        /// What happened, and what to do.
        why: String,
    },
    /// Training diverged.
    Diverged {
        /// The seed.
        seed: u64,
        /// What happened.
        source: RunError,
    },
}

impl RunsError {
    /// For `map_err`: names the operation and the file, and what is in its way.
    pub fn io(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |mut source| {
            let blocked = matches!(source.kind(), ErrorKind::NotADirectory | ErrorKind::AlreadyExists);
            if let Some(file) = path.ancestors().find(|part| blocked && part.is_file()) {
                let why = format!("{} is a file, not a folder: name another place", file.display());
                source = io::Error::new(source.kind(), why);
            }
            Self::Io { doing, path, source }
        }
    }

    /// A file that is not what was written.
    pub fn damaged(path: &Path, why: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), why: why.into() }
    }
}

impl fmt::Display for RunsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io { doing, path, source } => write!(f, "cannot {doing} {}: {source}", path.display()),
            Self::Damaged { path, why } => write!(f, "{}: {why}", path.display()),
            Self::Request(what) => f.write_str(what),
            Self::BackEnd { seed, why } => write!(f, "seed {seed}: {why}"),
            Self::Diverged { seed, source } => write!(f, "seed {seed}: {source}"),
        }
    }
}

impl std::error::Error for RunsError {}
