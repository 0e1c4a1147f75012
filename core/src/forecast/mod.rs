//! Forecasts: what a learner becomes if it goes on training on what it has.
//!
//! The back ends meet at one trait, batch-first and polled. [`cpu::CpuForecaster`] is the reference. `elsewhere.rs` hands
//! jobs out as bytes, for other programs to train.

pub mod cpu;
pub(crate) mod elsewhere;
mod practice;

pub use practice::Practice;

use alloc::vec::Vec;
use core::fmt;
use core::task::Poll;
use serde::{Deserialize, Serialize};

use crate::agent::Agent;
use crate::env::Action;
use crate::replay::{ReplayBuffer, Transition};
use crate::rng::{Purpose, Rng};
use crate::run::Budget;

/// What a forecast takes along from the live learner besides its parameters (docs/method.md R15).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Carry {
    /// The target networks; without, they start equal to the live networks.
    pub target: bool,
    /// The moments of the optimisers; without, they start anew.
    pub optimizer: bool,
}

impl Carry {
    /// Everything: what would really happen.
    pub const ALL: Self = Self { target: true, optimizer: true };
}

/// One future to train: a copy of `agent` makes `updates` updates on mini-batches from `replay`, each
/// with the forced transitions appended (docs/method.md R13 to R17); where it practises, on those of a copy
/// of `replay` that grows by its practice. Nothing of the job is changed.
#[derive(Serialize)]
#[serde(bound = "E: Serialize, A: Serialize, A::Action: Serialize")]
pub struct ForecastJob<'a, E, A: Agent> {
    /// The learner that is copied.
    pub agent: &'a A,
    /// Where the mini-batches come from.
    pub replay: &'a ReplayBuffer<A::Action>,
    /// Appended to every mini-batch.
    pub forced: &'a [Transition<A::Action>],
    /// Gradient updates to make; none are made while `replay` holds fewer than `batch` transitions.
    pub updates: u32,
    /// Mini-batch size, besides the forced transitions.
    pub batch: u32,
    /// Seed of the run.
    pub seed: u64,
    /// What the copy takes along.
    pub carry: Carry,
    /// Learner version: jobs with equal seed and version draw the same mini-batches, and a forecaster takes their learner
    /// to be the same.
    pub version: u64,
    /// Where and how it practises, if it does.
    pub practice: Option<Practice<'a, E>>,
}

impl<E, A: Agent> ForecastJob<'_, E, A> {
    /// Updates of the value function that will be made.
    pub fn value_updates(&self) -> u32 {
        // Without a full mini-batch the learner itself would not learn either.
        if self.replay.len() < self.batch { 0 } else { self.updates }
    }

    /// Updates of a copy of the reward model that will be made, before those of the value function.
    pub fn reward_updates(&self) -> u32 {
        if self.value_updates() == 0 { 0 } else { self.practice.as_ref().map_or(0, |practice| practice.reward_updates) }
    }

    /// Random numbers of update `number`, counted from 1 with those of the reward model's copy: in TD3 the noise of
    /// target actions. Each update has a generator of its own, so that what a forced transition draws, last of its
    /// mini-batch, moves nothing in the updates after it.
    pub fn update_stream(&self, number: u32) -> Rng {
        Rng::stream(self.seed, Purpose::ForecastUpdate, self.version).child(u64::from(number))
    }
}

/// What tells a job from another one, for back ends that are asked for the same jobs again and again. The learner
/// itself is named by seed and version.
#[derive(Clone, Debug)]
pub struct Identity<A> {
    seed: u64,
    version: u64,
    pushed: u64,
    updates: u32,
    batch: u32,
    forced: Vec<Transition<A>>,
    carry: Carry,
    /// What practice begins with to see, the updates of the reward model before it, and its exploration.
    practice: Option<(Vec<f32>, bool, u32, f32)>,
}

impl<A: Action> Identity<A> {
    /// That of a job.
    pub fn new<E, G: Agent<Action = A>>(job: &ForecastJob<'_, E, G>) -> Self {
        let ForecastJob { seed, version, updates, batch, carry, .. } = *job;
        let practice = job.practice.as_ref().map(|p| (p.observation.to_vec(), p.ended, p.reward_updates, p.epsilon));
        let pushed = job.replay.pushed();
        Self { seed, version, pushed, updates, batch, forced: job.forced.to_vec(), carry, practice }
    }

    /// Whether `job` is the one.
    pub fn is<E, G: Agent<Action = A>>(&self, job: &ForecastJob<'_, E, G>) -> bool {
        let practice = self.practice.as_ref().map(|(seen, ended, updates, e)| (&seen[..], *ended, *updates, *e));
        (self.seed, self.version, self.updates, self.batch) == (job.seed, job.version, job.updates, job.batch)
            && self.pushed == job.replay.pushed()
            && self.forced == job.forced
            && self.carry == job.carry
            && practice == job.practice.as_ref().map(|p| (p.observation, p.ended, p.reward_updates, p.epsilon))
    }
}

/// Why a back end cannot finish a forecast.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ForecastError {
    /// A loss became NaN or infinite.
    NotFinite {
        /// At which update of the forecast.
        update: u32,
    },
    /// The back end failed; the run is intact and the forecast can be asked for again.
    BackEnd(alloc::string::String),
}

impl fmt::Display for ForecastError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ForecastError::NotFinite { update } => {
                write!(f, "the loss is not a finite number at update {update} of a forecast")
            }
            ForecastError::BackEnd(why) => write!(f, "the forecasting back end failed: {why}"),
        }
    }
}

impl core::error::Error for ForecastError {}

/// Trains copies of an agent forward. Call with the same jobs until `Ready`; results are in job order.
/// A forecaster serves one learner, which its jobs name by seed and version; asked for other jobs of it, it starts those
/// from their beginning. Who lends it to another learner has to [`cancel`](Self::cancel) first.
pub trait Forecaster<E, A: Agent> {
    /// Does at most about `budget` updates and reduces it by what was done.
    ///
    /// # Errors
    /// See [`ForecastError`]; the back end is then ready for other jobs.
    fn poll(&mut self, jobs: &[ForecastJob<'_, E, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>>;

    /// Part of the jobs under way that is done, 0 to 1.
    fn progress(&self) -> f32;

    /// Forgets the jobs under way.
    fn cancel(&mut self);
}
