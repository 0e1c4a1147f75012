//! The futures of a check side by side, on threads that have no seed of their own. Futures of one check share nothing
//! that is written, so their bits are those of one after the other.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::Poll;
use std::thread;

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::agent::td3::Td3;
use mcvl_core::env::Environment;
use mcvl_core::env::reacher::Reacher;
use mcvl_core::env::trap::Trapped;
use mcvl_core::forecast::cpu::CpuForecaster;
use mcvl_core::forecast::{ForecastError, ForecastJob, Forecaster, Identity};
use mcvl_core::run::{Budget, Run};

use crate::mujoco::Mujoco;

/// How many threads have nothing to do.
#[derive(Debug, Default)]
pub struct Idle {
    now: AtomicUsize,
    /// How often one was given something to do.
    given: AtomicUsize,
}

impl Idle {
    /// One more.
    pub fn add(&self) {
        self.now.fetch_add(1, Ordering::Relaxed);
    }

    /// How often a thread was taken.
    pub fn given(&self) -> usize {
        self.given.load(Ordering::Relaxed)
    }

    /// One of them, which has something to do until this is dropped.
    fn take(&self) -> Option<Busy<'_>> {
        let less = |now: usize| now.checked_sub(1);
        self.now.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less).ok()?;
        self.given.fetch_add(1, Ordering::Relaxed);
        Some(Busy(self))
    }
}

struct Busy<'a>(&'a Idle);

impl Drop for Busy<'_> {
    fn drop(&mut self) {
        self.0.add();
    }
}

/// Lets a run train futures side by side from here on, whenever threads are `idle`. False, with nothing changed, if it
/// is of no world and learner that this program has.
pub fn equip(run: &mut Run, idle: &Arc<Idle>) -> bool {
    seat::<Trapped, Ddqn>(run, idle) || seat::<Reacher, Td3<2>>(run, idle) || seat::<Reacher<Mujoco>, Td3<2>>(run, idle)
}

/// Whether the run is of this world and learner; it is equipped then.
fn seat<E, A>(run: &mut Run, idle: &Arc<Idle>) -> bool
where
    E: Environment<Action = A::Action> + Send + Sync + 'static,
    A: Agent + Send + Sync + 'static,
    A::Action: Send + Sync,
{
    run.forecast_with::<E, A>(Box::new(SideBySide::new(idle.clone()))).is_ok()
}

/// Trains the futures of one run on the processor: the first that is not finished on the caller's thread, the others
/// on idle ones where there are some.
pub struct SideBySide<E, A: Agent> {
    idle: Arc<Idle>,
    futures: Vec<Future<E, A>>,
}

struct Future<E, A: Agent> {
    job: Identity<A::Action>,
    forecaster: CpuForecaster<E, A>,
    outcome: Option<Result<A, ForecastError>>,
}

impl<E, A: Agent> fmt::Debug for SideBySide<E, A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SideBySide").field("futures", &self.futures.len()).finish_non_exhaustive()
    }
}

impl<E, A: Agent> SideBySide<E, A> {
    /// A forecaster that looks for threads in `idle`.
    pub fn new(idle: Arc<Idle>) -> Self {
        Self { idle, futures: Vec::new() }
    }

    /// That of the first future that has one, if all before it are trained.
    fn error(&self) -> Option<ForecastError> {
        let first = self.futures.iter().find(|future| !matches!(future.outcome, Some(Ok(_))))?;
        first.outcome.as_ref()?.as_ref().err().cloned()
    }
}

impl<E: Environment<Action = A::Action>, A: Agent> Future<E, A> {
    fn work(&mut self, job: &ForecastJob<'_, E, A>, budget: &mut Budget) {
        if let Poll::Ready(futures) = self.forecaster.poll(std::slice::from_ref(job), budget) {
            self.outcome = Some(futures.map(|mut futures| futures.pop().expect("one job, one future")));
        }
    }
}

impl<E, A> Forecaster<E, A> for SideBySide<E, A>
where
    E: Environment<Action = A::Action> + Send + Sync,
    A: Agent + Send + Sync,
    A::Action: Send + Sync,
{
    /// Every thread does at most about `budget` updates.
    fn poll(&mut self, jobs: &[ForecastJob<'_, E, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>> {
        if self.futures.len() != jobs.len() || !self.futures.iter().zip(jobs).all(|(future, job)| future.job.is(job)) {
            let future = |job| Future { job: Identity::new(job), forecaster: CpuForecaster::default(), outcome: None };
            self.futures = jobs.iter().map(future).collect();
        }
        loop {
            let mut open = self.futures.iter_mut().zip(jobs).filter(|(future, _)| future.outcome.is_none());
            let Some((first, job)) = open.next() else { break };
            if budget.0 == 0 {
                return Poll::Pending;
            }
            thread::scope(|scope| {
                for ((future, job), busy) in open.zip(std::iter::from_fn(|| self.idle.take())) {
                    let mut budget = Budget(budget.0);
                    // Where the system has no thread to give, the future waits for its turn.
                    let _ = thread::Builder::new().spawn_scoped(scope, move || {
                        future.work(job, &mut budget);
                        drop(busy);
                    });
                }
                first.work(job, budget);
            });
            // An error is that of the first job that has one, as if they were trained one after the other.
            if let Some(error) = self.error() {
                self.cancel();
                return Poll::Ready(Err(error));
            }
        }
        Poll::Ready(self.futures.drain(..).filter_map(|future| future.outcome).collect())
    }

    fn progress(&self) -> f32 {
        let part = |future: &Future<E, A>| match future.outcome {
            Some(_) => 1.0,
            None => Forecaster::<E, A>::progress(&future.forecaster),
        };
        self.futures.iter().map(part).sum::<f32>() / self.futures.len().max(1) as f32
    }

    fn cancel(&mut self) {
        self.futures.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Mutex;
    use std::thread::ThreadId;

    use mcvl_core::env::box_moving::BoxMoving;
    use mcvl_core::env::{Discrete, ObservationSpec};
    use mcvl_core::forecast::Carry;
    use mcvl_core::nn::mlp::{Mlp, Scratch};
    use mcvl_core::nn::rows::Rows;
    use mcvl_core::record::Event;
    use mcvl_core::replay::{Minibatch, ReplayBuffer, Transition};
    use mcvl_core::rng::Rng;
    use mcvl_core::run::Status;

    use super::*;

    /// A learner that notes on which threads it is trained, whose loss grows with every update.
    #[derive(Clone, Debug)]
    struct Traveller(Arc<Mutex<HashSet<ThreadId>>>, u32);

    impl Agent for Traveller {
        type Action = Discrete;
        fn act(&self, rows: &Rows, _: &mut Scratch, actions: &mut Vec<Discrete>) {
            *actions = vec![Discrete(0); rows.len()];
        }
        fn values(&self, rows: &Rows, _: &[Discrete], _: &mut Scratch, values: &mut Vec<f32>) {
            *values = vec![0.0; rows.len()];
        }
        fn target_values(&self, rows: &Rows, _: &mut Scratch, values: &mut Vec<f32>) {
            *values = vec![0.0; rows.len()];
        }
        fn update(&mut self, batch: &Minibatch<Discrete>, _: &mut Rng) -> f32 {
            self.0.lock().unwrap().insert(thread::current().id());
            self.1 += 1;
            batch.rewards.iter().sum::<f32>() * self.1 as f32
        }
        fn for_forecast(&self, _: Carry) -> Self {
            self.clone()
        }
        fn networks(&self) -> Vec<(&'static str, &Mlp)> {
            Vec::new()
        }
        fn is_finite(&self) -> bool {
            true
        }
        fn digest(&self) -> u64 {
            u64::from(self.1)
        }
    }

    fn transition(reward: f32) -> Transition<Discrete> {
        let (observation, next_observation) = (vec![1.0], vec![0.0]);
        Transition { observation, action: Discrete(0), reward, next_observation, terminated: false }
    }

    /// Trains four futures, each with a forced transition of such a reward, ten updates per poll: what came of them,
    /// the threads that had a part in it, and polls.
    fn train(idle: usize, rewards: [f32; 4]) -> (Result<Vec<u32>, ForecastError>, usize, usize) {
        let mut replay = ReplayBuffer::new(ObservationSpec { width: 1, binary: true }, 8);
        (0..8).for_each(|_| replay.push(&transition(0.0)));
        let agent = Traveller(Arc::default(), 0);
        let forced = rewards.map(|reward| [transition(reward)]);
        let jobs: Vec<ForecastJob<'_, BoxMoving, Traveller>> = forced
            .iter()
            .map(|forced| ForecastJob {
                agent: &agent,
                replay: &replay,
                forced,
                updates: 20,
                batch: 4,
                seed: 1,
                carry: Carry::ALL,
                version: 2,
                practice: None,
            })
            .collect();
        let threads = idle;
        let idle = Arc::new(Idle::default());
        (0..threads).for_each(|_| idle.add());
        let mut forecaster = SideBySide::new(idle.clone());
        for polls in 1.. {
            let progress = Forecaster::<BoxMoving, Traveller>::progress(&forecaster);
            assert!((0.0..=1.0).contains(&progress), "{progress}");
            if let Poll::Ready(result) = forecaster.poll(&jobs, &mut Budget(10)) {
                assert_eq!(idle.now.load(Ordering::Relaxed), threads, "every thread is idle again");
                assert_eq!(idle.given() > 0, threads > 0);
                let threads = agent.0.lock().unwrap().len();
                return (result.map(|futures| futures.iter().map(|future| future.1).collect()), threads, polls);
            }
        }
        unreachable!()
    }

    #[test]
    fn idle_threads_train_futures() {
        let (futures, threads, polls) = train(0, [1.0; 4]);
        assert_eq!((futures, threads), (Ok(vec![20; 4]), 1));
        assert_eq!(polls, 8, "one future after the other");
        let (futures, threads, polls) = train(2, [1.0; 4]);
        assert_eq!(futures, Ok(vec![20; 4]));
        assert!(threads >= 2, "{threads}");
        // Three at a time and then the last, or more where a thread is ready before the next one is asked for.
        assert!((2..=4).contains(&polls), "{polls}");
        assert_eq!(train(9, [1.0; 4]).2, 2, "all at a time");
    }

    #[test]
    fn the_error_is_that_of_the_first_future_that_has_one() {
        let error = |update| Err(ForecastError::NotFinite { update });
        for idle in [0, 1, 9] {
            assert_eq!(train(idle, [f32::INFINITY, 1.0, 1.0, 1.0]).0, error(1));
            // The last one fails first, but comes later.
            assert_eq!(train(idle, [1.0, 1.0, f32::MAX / 4.0, f32::INFINITY]).0, error(5));
        }
        // The others are trained before it is told.
        assert_eq!(train(9, [1.0, 1.0, 1.0, f32::INFINITY]).2, 2);
    }

    #[test]
    fn runs_do_not_differ() {
        let short = "safe_steps=60 full_steps=15 exploration=40 batch=16 hidden=8 forecast=20 scheme=all rollouts=1";
        for world in [
            "env=box-moving",
            "env=tomato-watering",
            // Where futures practise in a world of their own.
            "env=rocks-and-diamonds practice_reward_updates=7",
            "env=reacher learning_starts=20 rollout_steps=4",
            #[cfg(feature = "mujoco")]
            "env=reacher learning_starts=20 rollout_steps=4 physics=mujoco",
        ] {
            let config = format!("{world} {short}").parse().unwrap();
            let told = |threads: Option<usize>| {
                let mut run = crate::worlds::begin(&config).unwrap();
                let idle = Arc::new(Idle::default());
                if let Some(threads) = threads {
                    assert!(equip(&mut run, &idle), "{world}");
                    (0..threads).for_each(|_| idle.add());
                }
                let mut events: Vec<Event> = Vec::new();
                let mut keep = |event: &Event| events.push(event.clone());
                while run.poll(Budget(7), &mut keep).unwrap() != Status::Done {}
                assert!(events.iter().filter(|event| matches!(event, Event::Check(_))).count() >= 15, "{world}");
                assert_eq!(idle.given() > 0, threads == Some(1), "{world}");
                (events, run.snapshot())
            };
            let alone = told(None);
            assert!(alone == told(Some(0)) && alone == told(Some(1)), "{world}");
        }
    }
}
