//! The forecaster of one run: hands its jobs in and waits.

use std::fmt;
use std::sync::Arc;
use std::task::Poll;

use mcvl_core::agent::Agent;
use mcvl_core::agent::ddqn::Ddqn;
use mcvl_core::agent::td3::Td3;
use mcvl_core::forecast::{ForecastError, ForecastJob, Forecaster, Identity};
use mcvl_core::run::Budget;

use super::worker::{Desk, Ticket, Waiting, Work};
use super::{ddqn, td3};

/// A learner that a kernel trains.
pub trait OnDevice: Agent {
    /// A job, ready for the device.
    type Packed;
    /// Whether the kernel has such a job, besides what no kernel has.
    ///
    /// # Errors
    /// Why not.
    fn has<E>(_job: &ForecastJob<'_, E, Self>) -> Result<(), String> {
        Ok(())
    }
    /// Packs jobs whose replay buffer, seed and version are one and the same.
    fn pack<E>(jobs: &[ForecastJob<'_, E, Self>]) -> Vec<Self::Packed>;
    /// The order of a job.
    fn order(packed: Arc<Self::Packed>) -> Work;
    /// The copy from which a job started, with what came back.
    fn finished(self, packed: &Self::Packed, values: &[f32]) -> Self;
}

impl OnDevice for Ddqn {
    type Packed = ddqn::Packed;

    fn has<E>(job: &ForecastJob<'_, E, Self>) -> Result<(), String> {
        ddqn::has(job)
    }

    fn pack<E>(jobs: &[ForecastJob<'_, E, Self>]) -> Vec<ddqn::Packed> {
        ddqn::pack(jobs)
    }

    fn order(packed: Arc<ddqn::Packed>) -> Work {
        Work::Ddqn(packed)
    }

    fn finished(self, packed: &ddqn::Packed, values: &[f32]) -> Self {
        packed.finished(self, values)
    }
}

impl<const N: usize> OnDevice for Td3<N> {
    type Packed = td3::Packed;

    fn pack<E>(jobs: &[ForecastJob<'_, E, Self>]) -> Vec<td3::Packed> {
        td3::pack(jobs)
    }

    fn order(packed: Arc<td3::Packed>) -> Work {
        Work::Td3(packed)
    }

    fn finished(mut self, packed: &td3::Packed, values: &[f32]) -> Self {
        self.take_over(packed.updates(), values);
        self
    }
}

/// Whether a kernel has such a job.
///
/// # Errors
/// Why not.
fn on_device<E, A: OnDevice>(job: &ForecastJob<'_, E, A>) -> Result<(), String> {
    let layers = job.agent.networks().iter().map(|(_, network)| network.sizes().len() - 2).max().unwrap_or(0);
    if layers != 2 {
        return Err(format!("the kernels have networks of two hidden layers, and this learner's have {layers}"));
    }
    if job.practice.is_some() {
        return Err("the kernels do not practise in the world".to_owned());
    }
    A::has(job)
}

/// Trains the futures of one run at a desk.
pub struct GpuForecaster<A: OnDevice> {
    desk: Arc<Desk>,
    waiting: Arc<Waiting>,
    jobs: Vec<Identity<A::Action>>,
    orders: Vec<(Arc<A::Packed>, Arc<Ticket>)>,
}

impl<A: OnDevice> fmt::Debug for GpuForecaster<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuForecaster").field("jobs", &self.jobs.len()).finish_non_exhaustive()
    }
}

impl<A: OnDevice> GpuForecaster<A> {
    /// A forecaster whose waiting shows in `waiting`.
    pub fn new(desk: Arc<Desk>, waiting: Arc<Waiting>) -> Self {
        Self { desk, waiting, jobs: Vec::new(), orders: Vec::new() }
    }

    fn forget(&mut self) {
        self.orders.iter().for_each(|(_, ticket)| ticket.cancel());
        self.orders.clear();
        self.jobs.clear();
        self.waiting.set(Vec::new());
    }
}

impl<A: OnDevice> Drop for GpuForecaster<A> {
    fn drop(&mut self) {
        self.forget();
    }
}

impl<E, A: OnDevice> Forecaster<E, A> for GpuForecaster<A> {
    fn poll(&mut self, jobs: &[ForecastJob<'_, E, A>], budget: &mut Budget) -> Poll<Result<Vec<A>, ForecastError>> {
        if self.jobs.len() != jobs.len() || !self.jobs.iter().zip(jobs).all(|(known, job)| known.is(job)) {
            self.forget();
            // Whoever brings a trainer of their own has not asked what a run is asked.
            if let Some(why) = jobs.iter().find_map(|job| on_device(job).err()) {
                return Poll::Ready(Err(ForecastError::BackEnd(why)));
            }
            self.jobs = jobs.iter().map(Identity::new).collect();
            // The kernels draw the mini-batches of a batch of jobs once.
            let alike = |pair: &[ForecastJob<'_, E, A>]| {
                (pair[0].seed, pair[0].version, pair[0].batch) == (pair[1].seed, pair[1].version, pair[1].batch)
                    && std::ptr::eq(pair[0].replay, pair[1].replay)
            };
            let packed: Vec<Arc<A::Packed>> = if jobs.windows(2).all(alike) {
                A::pack(jobs).into_iter().map(Arc::new).collect()
            } else {
                jobs.chunks(1).flat_map(A::pack).map(Arc::new).collect()
            };
            let tickets = self.desk.order(packed.iter().cloned().map(A::order).collect());
            self.waiting.set(tickets.clone());
            self.orders = packed.into_iter().zip(tickets).collect();
            budget.spend(1);
        }
        if !self.orders.iter().all(|(_, ticket)| ticket.is_ready()) {
            return Poll::Pending;
        }
        let mut futures = Vec::new();
        let mut failure = None;
        for ((packed, ticket), job) in self.orders.iter().zip(jobs) {
            match ticket.take() {
                Some(Ok(values)) => futures.push(job.agent.for_forecast(job.carry).finished(packed, &values)),
                Some(Err(error)) => failure = failure.or(Some(error)),
                None => unreachable!("every ticket is ready"),
            }
        }
        self.forget();
        Poll::Ready(failure.map_or(Ok(futures), Err))
    }

    fn progress(&self) -> f32 {
        let done: f32 = self.orders.iter().map(|(_, ticket)| ticket.progress()).sum();
        done / self.orders.len().max(1) as f32
    }

    fn cancel(&mut self) {
        self.forget();
    }
}
