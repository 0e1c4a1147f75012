//! Forecasts on the processor: the reference, and the production back end of the gridworlds.

use alloc::vec::Vec;
use core::task::Poll;

use super::{ForecastError, ForecastJob, Forecaster};
use crate::agent::Agent;
use crate::replay::{Forced, Minibatch, draw_slots};
use crate::rng::{Purpose, Rng};
use crate::run::Budget;

/// Trains the futures of a batch of jobs one after the other, in slices.
#[derive(Clone, Debug)]
pub struct CpuForecaster<A: Agent> {
    finished: Vec<A>,
    current: Option<Future<A>>,
    jobs: usize,
    batch: Minibatch<A::Action>,
    slots: Vec<u32>,
}

/// A copy in training.
#[derive(Clone, Debug)]
struct Future<A: Agent> {
    agent: A,
    forced: Forced<A::Action>,
    draws: Rng,
    noise: Rng,
    done: u32,
    updates: u32,
}

impl<A: Agent> Default for CpuForecaster<A> {
    fn default() -> Self {
        Self { finished: Vec::new(), current: None, jobs: 0, batch: Minibatch::default(), slots: Vec::new() }
    }
}

impl<A: Agent> Future<A> {
    fn new(job: &ForecastJob<'_, A>) -> Self {
        Self {
            agent: job.agent.clone(),
            forced: Forced::new(job.forced, job.replay),
            draws: Rng::stream(job.seed, Purpose::ForecastBatch, job.version),
            noise: Rng::stream(job.seed, Purpose::ForecastUpdate, job.version),
            done: 0,
            // Without a full mini-batch the learner itself would not learn either.
            updates: if job.replay.len() < job.batch { 0 } else { job.updates },
        }
    }
}

impl<A: Agent> Forecaster<A> for CpuForecaster<A> {
    fn poll(&mut self, jobs: &[ForecastJob<'_, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>> {
        self.jobs = jobs.len();
        while let Some(job) = jobs.get(self.finished.len()) {
            let future = self.current.get_or_insert_with(|| Future::new(job));
            while future.done < future.updates {
                if budget.0 == 0 {
                    return Poll::Pending;
                }
                draw_slots(job.replay.len(), job.batch, &mut future.draws, &mut self.slots);
                self.batch.gather(job.replay, &self.slots, &future.forced);
                let loss = future.agent.update(&self.batch, &mut future.noise);
                future.done += 1;
                budget.spend(1);
                if !loss.is_finite() {
                    let update = future.done;
                    self.cancel();
                    return Poll::Ready(Err(ForecastError::NotFinite { update }));
                }
            }
            self.finished.extend(self.current.take().map(|future| future.agent));
        }
        Poll::Ready(Ok(core::mem::take(&mut self.finished)))
    }

    fn progress(&self) -> f32 {
        let part = self.current.as_ref().map_or(0.0, |f| f.done as f32 / f.updates.max(1) as f32);
        (self.finished.len() as f32 + part) / self.jobs.max(1) as f32
    }

    fn cancel(&mut self) {
        self.finished.clear();
        self.current = None;
    }
}
