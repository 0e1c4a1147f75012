//! Forecasts made elsewhere: jobs as bytes, and the futures that came of them as bytes.
//!
//! A job travels whole, with its replay buffer and, where it practises, with its world, so whoever opens it needs
//! nothing else and trains it with the processor's back end: the bits are the same. What comes back names the job
//! by its digest; nothing else is taken.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;
use core::task::Poll;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::cpu::CpuForecaster;
use super::{Carry, ForecastError, ForecastJob, Forecaster, Identity, Practice};
use crate::agent::Agent;
use crate::agent::reward_model::RewardModel;
use crate::env::Environment;
use crate::replay::{ReplayBuffer, Transition};
use crate::run::sealed::{self, Magic};
use crate::run::{Budget, SnapshotError, TransferError};

const JOB: &Magic = b"mcvljob\n";
const FUTURE: &Magic = b"mcvlfut\n";

/// What came of a job: the digest of its bytes, and the trained learner or the update at which its loss was no
/// finite number.
#[derive(Serialize, Deserialize)]
struct Outcome<A> {
    job: u64,
    future: Result<A, u32>,
}

/// How the outcome of a job is read.
pub(crate) type Reader<A> = fn(&[u8]) -> Result<(u64, Result<A, u32>), SnapshotError>;

/// Reads the outcome of a job.
pub(crate) fn read<A: DeserializeOwned>(state: &[u8]) -> Result<(u64, Result<A, u32>), SnapshotError> {
    sealed::decode(state).map(|Outcome { job, future }| (job, future))
}

/// Hands its jobs out and waits for what comes of them.
pub(crate) struct Elsewhere<A: Agent> {
    /// The world's name on the jobs.
    name: String,
    read: Reader<A>,
    jobs: Vec<Identity<A::Action>>,
    orders: Vec<Order<A>>,
}

struct Order<A> {
    digest: u64,
    /// Sizes of the networks of the learner from which it starts.
    sizes: Vec<Vec<usize>>,
    /// Until somebody takes it.
    bytes: Option<Vec<u8>>,
    future: Option<Result<A, u32>>,
}

fn sizes<A: Agent>(agent: &A) -> Vec<Vec<usize>> {
    agent.networks().iter().map(|(_, network)| network.sizes().to_vec()).collect()
}

impl<A: Agent> Elsewhere<A> {
    pub(crate) fn new(name: &str, read: Reader<A>) -> Self {
        Self { name: name.to_owned(), read, jobs: Vec::new(), orders: Vec::new() }
    }

    /// The next job that nobody has taken.
    pub(crate) fn take_job(&mut self) -> Option<Vec<u8>> {
        self.orders.iter_mut().find_map(|order| order.bytes.take())
    }

    /// Takes what came of a job.
    pub(crate) fn hand_back(&mut self, bytes: &[u8]) -> Result<(), TransferError> {
        let unreadable = |error| TransferError::Unreadable { what: "the future", error };
        let (name, state) = sealed::open(FUTURE, bytes).map_err(unreadable)?;
        if name != self.name {
            return Err(TransferError::Foreign);
        }
        let (job, future) = (self.read)(state).map_err(unreadable)?;
        let order = self.orders.iter_mut().find(|order| order.digest == job && order.future.is_none());
        let order = order.ok_or(TransferError::Foreign)?;
        if future.as_ref().is_ok_and(|future| sizes(future) != order.sizes) {
            return Err(TransferError::Foreign);
        }
        order.future = Some(future);
        Ok(())
    }

    fn forget(&mut self) {
        self.jobs.clear();
        self.orders.clear();
    }
}

impl<E, A> Forecaster<E, A> for Elsewhere<A>
where
    E: Environment<Action = A::Action> + Serialize,
    A: Agent + Serialize,
    A::Action: Serialize,
{
    fn poll(&mut self, jobs: &[ForecastJob<'_, E, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>> {
        if self.jobs.len() != jobs.len() || !self.jobs.iter().zip(jobs).all(|(known, job)| known.is(job)) {
            self.jobs = jobs.iter().map(Identity::new).collect();
            let order = |job: &ForecastJob<'_, E, A>| {
                let bytes = sealed::seal(JOB, &self.name, &sealed::encode(job));
                Order { digest: sealed::digest(&bytes), sizes: sizes(job.agent), bytes: Some(bytes), future: None }
            };
            self.orders = jobs.iter().map(order).collect();
            budget.spend(1);
        }
        if self.orders.iter().any(|order| order.future.is_none()) {
            return Poll::Pending;
        }
        let futures = self.orders.drain(..).filter_map(|order| order.future).collect::<Result<Vec<A>, u32>>();
        self.forget();
        Poll::Ready(futures.map_err(|update| ForecastError::NotFinite { update }))
    }

    fn progress(&self) -> f32 {
        let done = self.orders.iter().filter(|order| order.future.is_some()).count();
        done as f32 / self.orders.len().max(1) as f32
    }

    fn cancel(&mut self) {
        self.forget();
    }
}

/// A job that was opened: its own copy of all that it needs, and how far it is.
pub(crate) struct Task<E, A: Agent> {
    name: String,
    digest: u64,
    job: Parts<E, A>,
    forecaster: CpuForecaster<E, A>,
}

/// What a [`ForecastJob`] refers to, in the order of its fields.
#[derive(Deserialize)]
#[serde(bound = "E: Deserialize<'de>, A: Deserialize<'de>, A::Action: Deserialize<'de>")]
struct Parts<E, A: Agent> {
    agent: A,
    replay: ReplayBuffer<A::Action>,
    forced: Vec<Transition<A::Action>>,
    updates: u32,
    batch: u32,
    seed: u64,
    carry: Carry,
    version: u64,
    practice: Option<PracticeParts<E>>,
}

/// What a [`Practice`] refers to, in the order of its fields.
#[derive(Deserialize)]
struct PracticeParts<E> {
    world: E,
    observation: Vec<f32>,
    ended: bool,
    reward_model: RewardModel,
    reward_updates: u32,
    epsilon: f32,
}

/// A job whose header was read.
pub(crate) struct Sealed<'a> {
    /// The world's name.
    pub(crate) name: &'a str,
    digest: u64,
    state: &'a [u8],
}

impl<'a> Sealed<'a> {
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, SnapshotError> {
        let (name, state) = sealed::open(JOB, bytes)?;
        Ok(Self { name, digest: sealed::digest(bytes), state })
    }
}

impl<E, A> Task<E, A>
where
    E: Environment<Action = A::Action> + DeserializeOwned,
    A: Agent + DeserializeOwned,
    A::Action: DeserializeOwned,
{
    /// Opens a job.
    pub(crate) fn open(sealed: &Sealed<'_>) -> Result<Self, SnapshotError> {
        let job: Parts<E, A> = sealed::decode(sealed.state)?;
        let width = job.replay.spec().width;
        let reads = sizes(&job.agent).first().and_then(|sizes| sizes.first()) == Some(&width);
        let fits = |observation: &[f32]| observation.len() == width;
        let forced = job.forced.iter().all(|forced| fits(&forced.observation) && fits(&forced.next_observation));
        let practises = |practice: &PracticeParts<E>| {
            fits(&practice.observation) && practice.world.spec().observation == job.replay.spec()
        };
        if !(reads && forced && job.practice.as_ref().is_none_or(practises)) {
            return Err(SnapshotError::Damaged("its parts do not belong together".to_owned()));
        }
        Ok(Self { name: sealed.name.to_owned(), digest: sealed.digest, job, forecaster: CpuForecaster::default() })
    }
}

impl<E, A> Task<E, A>
where
    E: Environment<Action = A::Action>,
    A: Agent + Serialize,
{
    /// Does a bounded amount of work; what came of the job, once it is done.
    pub(crate) fn poll(&mut self, budget: Budget) -> Option<Vec<u8>> {
        let Parts { agent, replay, forced, updates, batch, seed, carry, version, practice } = &self.job;
        let practice = practice.as_ref().map(|practice| {
            let PracticeParts { world, observation, ended, reward_model, reward_updates, epsilon } = practice;
            let (ended, reward_updates, epsilon) = (*ended, *reward_updates, *epsilon);
            Practice { world, observation, ended, reward_model, reward_updates, epsilon }
        });
        let (updates, batch, seed, carry, version) = (*updates, *batch, *seed, *carry, *version);
        let job = ForecastJob { agent, replay, forced, updates, batch, seed, carry, version, practice };
        let Poll::Ready(result) = self.forecaster.poll(&[job], &mut { budget }) else { return None };
        let future = match result {
            Ok(mut futures) => Ok(futures.pop()?),
            Err(ForecastError::NotFinite { update }) => Err(update),
            Err(ForecastError::BackEnd(_)) => unreachable!("the processor does not fail"),
        };
        Some(sealed::seal(FUTURE, &self.name, &sealed::encode(&Outcome { job: self.digest, future })))
    }
}
