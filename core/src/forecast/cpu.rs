//! Forecasts on the processor: the reference, and the production back end of the gridworlds.

use alloc::vec::Vec;
use core::task::Poll;

use super::practice::Practising;
use super::{ForecastError, ForecastJob, Forecaster, Identity};
use crate::agent::Agent;
use crate::env::Environment;
use crate::replay::{Forced, Minibatch, draw_slots};
use crate::rng::{Purpose, Rng};
use crate::run::Budget;

/// Trains the futures of a batch of jobs one after the other, in slices.
#[derive(Clone, Debug)]
pub struct CpuForecaster<E, A: Agent> {
    jobs: Vec<Identity<A::Action>>,
    finished: Vec<A>,
    current: Option<Future<E, A>>,
    batch: Minibatch<A::Action>,
    slots: Vec<u32>,
}

/// A copy in training.
#[derive(Clone, Debug)]
struct Future<E, A: Agent> {
    agent: A,
    forced: Forced<A::Action>,
    draws: Rng,
    /// Updates made and to be made, those of the reward model included.
    done: u32,
    total: u32,
    practising: Option<Practising<E, A::Action>>,
}

impl<E, A: Agent> Default for CpuForecaster<E, A> {
    fn default() -> Self {
        Self { jobs: Vec::new(), finished: Vec::new(), current: None, batch: Minibatch::default(), slots: Vec::new() }
    }
}

impl<E: Environment<Action = A::Action>, A: Agent> Future<E, A> {
    fn new(job: &ForecastJob<'_, E, A>) -> Self {
        Self {
            agent: job.agent.for_forecast(job.carry),
            forced: Forced::new(job.forced, job.replay),
            draws: Rng::stream(job.seed, Purpose::ForecastBatch, job.version),
            done: 0,
            total: job.value_updates() + job.reward_updates(),
            practising: job.practice.as_ref().map(|practice| Practising::new(practice, job)),
        }
    }

    /// One update, of the reward model's copy first, then of the learner with a step of practice; its loss.
    fn update(&mut self, job: &ForecastJob<'_, E, A>, batch: &mut Minibatch<A::Action>, slots: &mut Vec<u32>) -> f32 {
        self.done += 1;
        let mut stream = job.update_stream(self.done);
        let Some(practising) = &mut self.practising else {
            draw_slots(job.replay.len(), job.batch, &mut self.draws, slots);
            batch.gather(job.replay, slots, &self.forced);
            return self.agent.update(batch, &mut stream);
        };
        if self.done <= job.reward_updates() {
            return practising.train(job.batch, &self.forced, batch, slots);
        }
        draw_slots(practising.replay().len(), job.batch, &mut self.draws, slots);
        batch.gather(practising.replay(), slots, &self.forced);
        let loss = self.agent.update(batch, &mut stream);
        practising.step(&self.agent);
        // Numbers of observations are those of the buffer as it is now.
        self.forced = Forced::new(job.forced, practising.replay());
        loss
    }
}

impl<E: Environment<Action = A::Action>, A: Agent> Forecaster<E, A> for CpuForecaster<E, A> {
    fn poll(&mut self, jobs: &[ForecastJob<'_, E, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>> {
        if self.jobs.len() != jobs.len() || !self.jobs.iter().zip(jobs).all(|(known, job)| known.is(job)) {
            self.cancel();
            self.jobs = jobs.iter().map(Identity::new).collect();
        }
        while let Some(job) = jobs.get(self.finished.len()) {
            let future = self.current.get_or_insert_with(|| Future::new(job));
            while future.done < future.total {
                if budget.0 == 0 {
                    return Poll::Pending;
                }
                let loss = future.update(job, &mut self.batch, &mut self.slots);
                budget.spend(1);
                if !loss.is_finite() {
                    let update = future.done;
                    self.cancel();
                    return Poll::Ready(Err(ForecastError::NotFinite { update }));
                }
            }
            self.finished.extend(self.current.take().map(|future| future.agent));
        }
        self.jobs.clear();
        Poll::Ready(Ok(core::mem::take(&mut self.finished)))
    }

    fn progress(&self) -> f32 {
        let part = self.current.as_ref().map_or(0.0, |f| f.done as f32 / f.total.max(1) as f32);
        (self.finished.len() as f32 + part) / self.jobs.len().max(1) as f32
    }

    fn cancel(&mut self) {
        self.jobs.clear();
        self.finished.clear();
        self.current = None;
    }
}

#[cfg(test)]
mod tests {
    use super::super::Carry;
    use super::*;
    use crate::env::box_moving::BoxMoving;
    use crate::env::{Discrete, ObservationSpec};
    use crate::nn::mlp::{Mlp, Scratch};
    use crate::nn::rows::Rows;
    use crate::replay::{ReplayBuffer, Transition};
    use alloc::vec;

    const SPEC: ObservationSpec = ObservationSpec { width: 3, binary: true };

    /// A learner that only remembers the rewards of the batches it was given, each with a number that it drew.
    #[derive(Clone, Debug, PartialEq)]
    struct Diary(Vec<Vec<(f32, u64)>>);

    impl Agent for Diary {
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
        fn update(&mut self, batch: &Minibatch<Discrete>, rng: &mut Rng) -> f32 {
            self.0.push(batch.rewards.iter().map(|&reward| (reward, rng.next_u64())).collect());
            0.0
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
            self.0.len() as u64
        }
    }

    /// A transition that its reward names.
    fn transition(reward: f32) -> Transition<Discrete> {
        let observation = vec![1.0, 0.0, 0.0];
        Transition {
            next_observation: observation.clone(),
            observation,
            action: Discrete(0),
            reward,
            terminated: false,
        }
    }

    fn replay() -> ReplayBuffer<Discrete> {
        let mut replay = ReplayBuffer::new(SPEC, 100);
        (0..60).for_each(|i| replay.push(&transition(i as f32)));
        replay
    }

    fn job<'a>(
        agent: &'a Diary,
        replay: &'a ReplayBuffer<Discrete>,
        forced: &'a [Transition<Discrete>],
        seed: u64,
    ) -> ForecastJob<'a, BoxMoving, Diary> {
        ForecastJob {
            agent,
            replay,
            forced,
            updates: 50,
            batch: 32,
            seed,
            carry: Carry::ALL,
            version: 3,
            practice: None,
        }
    }

    fn ready(poll: Poll<Result<Vec<Diary>, ForecastError>>) -> Vec<Diary> {
        let Poll::Ready(Ok(futures)) = poll else { panic!("the budget suffices") };
        futures
    }

    /// docs/method.md R14 and R17. What TD3 draws for each sample, noise of its target action, is the same too.
    #[test]
    fn both_futures_draw_the_same_batches_and_one_contains_the_transition_in_each() {
        let (fresh, replay, forced) = (Diary(Vec::new()), replay(), [transition(-7.0)]);
        let jobs = [job(&fresh, &replay, &forced, 1), job(&fresh, &replay, &[], 1)];
        let futures = ready(CpuForecaster::default().poll(&jobs, &mut Budget(u32::MAX)));
        assert_eq!((futures[0].0.len(), futures[1].0.len()), (50, 50));
        for (with, without) in futures[0].0.iter().zip(&futures[1].0) {
            assert_eq!(without.len(), 32);
            assert_eq!(with[..32], without[..]);
            let [(reward, _)] = with[32..] else { panic!("one transition is forced: {with:?}") };
            assert_eq!(reward, -7.0);
        }
        assert!(futures[1].0.windows(2).all(|pair| pair[0] != pair[1]), "every update draws anew");
    }

    #[test]
    fn other_jobs_start_from_their_beginning() {
        let (fresh, replay) = (Diary(Vec::new()), replay());
        let alone =
            |seed| ready(CpuForecaster::default().poll(&[job(&fresh, &replay, &[], seed)], &mut Budget(u32::MAX)));
        let mut shared = CpuForecaster::default();
        assert!(shared.poll(&[job(&fresh, &replay, &[], 1)], &mut Budget(20)).is_pending());
        assert_eq!(ready(shared.poll(&[job(&fresh, &replay, &[], 2)], &mut Budget(u32::MAX))), alone(2));
        assert_eq!(ready(shared.poll(&[job(&fresh, &replay, &[], 1)], &mut Budget(u32::MAX))), alone(1));
    }

    #[test]
    fn without_a_full_batch_nothing_is_trained() {
        let (fresh, mut few) = (Diary(Vec::new()), ReplayBuffer::new(SPEC, 100));
        (0..31).for_each(|i| few.push(&transition(i as f32)));
        let futures = ready(CpuForecaster::default().poll(&[job(&fresh, &few, &[], 1)], &mut Budget(1)));
        assert_eq!(futures, [fresh]);
    }
}
