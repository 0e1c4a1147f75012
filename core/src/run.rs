//! A run with its types erased: what the command line, the page and embedders of the built-in worlds hold.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use crate::config::{Config, Learner};
use crate::env::{EnvSpec, Frame};
use crate::record::{Arm, Recorder};

/// How much work one call may do. One unit is about one gradient update of the gridworld learner;
/// a call overshoots by at most one indivisible piece (an evaluation episode, a rollout).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget(pub u32);

/// Where a run stands after a poll.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// There is more to do in this leg.
    Working,
    /// Safe training is finished. [`Run::fork`] continues with either learner from here;
    /// polling on continues with the configured one.
    Switch,
    /// The Full phase is finished: further polls do nothing.
    Done,
}

/// Figures for progress displays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Current leg.
    pub arm: Arm,
    /// Steps made in this leg.
    pub step: u32,
    /// Steps planned for this leg.
    pub steps: u32,
    /// Gradient updates of the live learner since the start of Safe training.
    pub updates: u64,
    /// Checks made in this leg.
    pub checks: u32,
    /// Refusals in this leg.
    pub refusals: u32,
    /// Gradient updates spent in forecasts in this leg.
    pub forecast_updates: u64,
    /// Part of the current check that is done, 0 to 1, while one is under way.
    pub check: Option<f32>,
}

/// Why a run cannot go on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunError {
    /// A loss or a parameter is not finite.
    NotFinite {
        /// What was not finite.
        what: &'static str,
        /// Which leg.
        arm: Arm,
        /// At which step of the leg.
        step: u32,
    },
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RunError::NotFinite { what, arm, step } => write!(
                f,
                "{what} is not a finite number at step {step} of the {} leg: training diverged; \
                 lower the learning rates (lr, lr_reward) or set gradient_clip",
                arm.name()
            ),
        }
    }
}

impl core::error::Error for RunError {}

/// Why bytes are no snapshot of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SnapshotError {
    /// The bytes do not begin like a snapshot.
    Unrecognised,
    /// Another version wrote it.
    Version {
        /// Version of the snapshot.
        found: u32,
        /// Version that this program reads.
        expected: u32,
    },
    /// It ends too early.
    Truncated {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be.
        expected: u64,
    },
    /// Its bytes were altered, or its content makes no sense.
    Damaged(String),
}

impl fmt::Display for SnapshotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SnapshotError::Unrecognised => f.write_str("not a snapshot of a run"),
            SnapshotError::Version { found, expected } => write!(
                f,
                "the snapshot has format version {found}, this program reads version {expected}: \
                 continue it with the version of mcvl that wrote it, or start afresh"
            ),
            SnapshotError::Truncated { found, expected } => {
                write!(f, "the snapshot is cut off: {found} bytes of {expected}")
            }
            SnapshotError::Damaged(why) => write!(f, "the snapshot is damaged: {why}"),
        }
    }
}

impl core::error::Error for SnapshotError {}

/// A run of one experiment: Safe training, then one learner in the Full world.
#[derive(Clone)]
pub struct Run {
    config: Config,
}

impl Run {
    /// A run from its beginning.
    pub fn new(config: &Config) -> Self {
        Self { config: config.clone() }
    }

    /// The configuration: the run as text.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Does a bounded amount of work. Never blocks, sleeps, spawns or prints; the budget has no
    /// influence on any result.
    ///
    /// # Errors
    /// If training diverged. The run is then of no further use.
    pub fn poll(&mut self, _budget: Budget, _recorder: &mut dyn Recorder) -> Result<Status, RunError> {
        unimplemented!()
    }

    /// Where the run stands, without doing anything.
    pub fn status(&self) -> Status {
        unimplemented!()
    }

    /// Figures for progress displays.
    pub fn progress(&self) -> Progress {
        unimplemented!()
    }

    /// A copy that continues from the switch with another learner: both share the Safe training.
    ///
    /// # Errors
    /// `None` unless the run stands at [`Status::Switch`] or before it.
    pub fn fork(&self, _agent: Learner) -> Option<Self> {
        unimplemented!()
    }

    /// The whole state as bytes; [`Run::resume`] continues to the last bit, wherever the poll stood.
    pub fn snapshot(&self) -> Vec<u8> {
        unimplemented!()
    }

    /// Continues from a snapshot.
    ///
    /// # Errors
    /// See [`SnapshotError`].
    pub fn resume(_bytes: &[u8]) -> Result<Self, SnapshotError> {
        unimplemented!()
    }

    /// Facts of the environment of the current leg: names of actions, legend, sizes.
    pub fn spec(&self) -> &EnvSpec {
        unimplemented!()
    }

    /// The current situation of the live environment.
    pub fn frame(&self) -> Frame {
        unimplemented!()
    }

    /// Named parameter tensors of the learner and the reward model: (name, shape, row-major values).
    pub fn tensors(&self) -> Vec<(String, Vec<usize>, Vec<f32>)> {
        unimplemented!()
    }
}
