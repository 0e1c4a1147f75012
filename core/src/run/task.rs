//! The other side of [`Run::forecast_elsewhere`]: a future to train, without the run.
//!
//! [`Run::forecast_elsewhere`]: super::Run::forecast_elsewhere

use alloc::borrow::ToOwned;
use alloc::boxed::Box;
use alloc::vec::Vec;
use core::fmt;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Budget, Family, SnapshotError, TransferError};
use crate::agent::Agent;
use crate::env::Environment;
use crate::forecast::elsewhere::{self, Sealed};

/// A future that a run of a built-in world, perhaps of another program, lets train here.
pub struct Task {
    inner: Box<dyn Erased>,
}

impl fmt::Debug for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Task").finish_non_exhaustive()
    }
}

/// A task whose world and learner are not named.
trait Erased: Send {
    fn poll(&mut self, budget: Budget) -> Option<Vec<u8>>;
}

impl<E, A> Erased for elsewhere::Task<E, A>
where
    E: Environment<Action = A::Action> + Send,
    A: Agent + Serialize + Send,
    A::Action: Send,
{
    fn poll(&mut self, budget: Budget) -> Option<Vec<u8>> {
        elsewhere::Task::poll(self, budget)
    }
}

/// How jobs of a family of worlds are opened.
pub(super) type Open = fn(&Sealed<'_>) -> Result<Task, SnapshotError>;

pub(super) fn open<E, A>(job: &Sealed<'_>) -> Result<Task, SnapshotError>
where
    E: Environment<Action = A::Action> + DeserializeOwned + Send + 'static,
    A: Agent + Serialize + DeserializeOwned + Send + 'static,
    A::Action: DeserializeOwned + Send,
{
    Ok(Task { inner: Box::new(elsewhere::Task::<E, A>::open(job)?) })
}

impl Task {
    /// Opens a job that [`Run::take_job`] gave.
    ///
    /// # Errors
    /// If the bytes are no job, were cut or altered, or are of a world that this build does not train.
    ///
    /// [`Run::take_job`]: super::Run::take_job
    pub fn open(job: &[u8]) -> Result<Self, TransferError> {
        let open = || {
            let job = Sealed::read(job)?;
            let family = Family::find(job.name).ok_or_else(|| SnapshotError::World(job.name.to_owned()))?;
            (family.task)(&job)
        };
        open().map_err(|error| TransferError::Unreadable { what: "the job", error })
    }

    /// Does a bounded amount of work, which has no influence on the result. Once it is done, what
    /// [`Run::hand_back`] takes: also where training diverged, which the run then says. The task is then of no
    /// further use.
    ///
    /// [`Run::hand_back`]: super::Run::hand_back
    pub fn poll(&mut self, budget: Budget) -> Option<Vec<u8>> {
        self.inner.poll(budget)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, Learner};
    use crate::record::Event;
    use crate::run::{Run, RunError, SNAPSHOT_VERSION, Status};
    use alloc::string::ToString;
    use alloc::vec;

    /// Short runs with checks: a reused future; a world with chance; one that practises; one of torques.
    const RUNS: &[&str] = &[
        "env=box-moving safe_steps=120 full_steps=40 exploration=60 forecast=20 scheme=all rollouts=2 evaluations=2",
        "env=tomato-watering safe_steps=60 full_steps=10 exploration=30 forecast=10 scheme=all rollouts=2 evaluations=2 \
         hidden=8 against=current",
        "env=rocks-and-diamonds safe_steps=60 full_steps=5 exploration=30 forecast=10 scheme=all rollouts=2 \
         evaluations=2 hidden=8 practice_reward_updates=7",
        #[cfg(feature = "continuous")]
        "env=reacher preset=small safe_steps=60 full_steps=5 learning_starts=30 batch=16 forecast=6 scheme=all \
         rollouts=2 rollout_steps=4 evaluations=2 evaluation_episodes=2 hidden=8",
    ];

    fn begin(configuration: &str) -> Run {
        Run::new(&configuration.parse::<Config>().unwrap())
    }

    /// Trains a job in pieces of this size.
    fn train(job: &[u8], budget: u32) -> Vec<u8> {
        let mut task = Task::open(job).unwrap();
        loop {
            if let Some(future) = task.poll(Budget(budget)) {
                return future;
            }
        }
    }

    /// Polls until there are jobs, or the run is done.
    fn jobs(run: &mut Run, events: &mut Vec<Event>) -> Vec<Vec<u8>> {
        loop {
            let status = run.poll(Budget(3), &mut |event: &Event| events.push(event.clone())).unwrap();
            let jobs: Vec<_> = core::iter::from_fn(|| run.take_job()).collect();
            if status == Status::Done || !jobs.is_empty() {
                return jobs;
            }
        }
    }

    /// The rest of a run's events and its last state.
    fn finish(mut run: Run) -> (Vec<Event>, Vec<u8>) {
        let mut events = Vec::new();
        while run.poll(Budget(50), &mut |event: &Event| events.push(event.clone())).unwrap() != Status::Done {}
        (events, run.snapshot())
    }

    /// The same where every job goes to somebody else.
    fn finish_elsewhere(mut run: Run) -> (Vec<Event>, Vec<u8>) {
        run.forecast_elsewhere().unwrap();
        let mut events = Vec::new();
        loop {
            let jobs = jobs(&mut run, &mut events);
            if jobs.is_empty() {
                return (events, run.snapshot());
            }
            // While both are out, nothing happens.
            let seen = events.len();
            assert_eq!(run.poll(Budget(1000), &mut |event: &Event| events.push(event.clone())), Ok(Status::Working));
            assert_eq!((events.len(), run.take_job()), (seen, None));
            // The last one comes back first.
            for (job, budget) in jobs.iter().zip([7, 1000]).rev() {
                run.hand_back(&train(job, budget)).unwrap();
            }
        }
    }

    #[test]
    fn futures_trained_elsewhere_change_no_bit() {
        for configuration in RUNS {
            let (here, elsewhere) = (finish(begin(configuration)), finish_elsewhere(begin(configuration)));
            let checked = |event: &&Event| matches!(event, Event::Check(check) if check.cost > 0);
            assert!(here.0.iter().filter(checked).count() > 1, "{configuration}");
            assert!(here == elsewhere, "{configuration}");
        }
    }

    #[test]
    fn a_run_whose_jobs_are_lost_forecasts_itself() {
        let mut run = begin(RUNS[0]);
        run.forecast_elsewhere().unwrap();
        let mut events = Vec::new();
        let jobs = jobs(&mut run, &mut events);
        assert_eq!(jobs.len(), 2);
        run.hand_back(&train(&jobs[0], 100)).unwrap();
        assert_eq!(run.progress().check, Some(0.0), "as of the last poll");
        run.poll(Budget(1), &mut ()).unwrap();
        assert_eq!(run.progress().check, Some(0.5));
        // A copy, and whoever continues from the snapshot, forecasts itself too.
        let (copy, resumed) = (run.clone(), Run::resume(&run.snapshot()).unwrap());
        run.forecast_here();
        assert_eq!(run.take_job(), None);
        assert_eq!(run.hand_back(&train(&jobs[1], 100)), Err(TransferError::Foreign));
        let whole = finish(begin(RUNS[0]));
        for rest in [run, copy, resumed] {
            let (rest, state) = finish(rest);
            assert!([events.clone(), rest].concat() == whole.0 && state == whole.1);
        }
    }

    #[test]
    fn bytes_that_are_no_forecast_of_the_run_are_refused() {
        let mut run = begin(RUNS[0]);
        run.forecast_elsewhere().unwrap();
        let mut events = Vec::new();
        let jobs = jobs(&mut run, &mut events);
        let futures: Vec<_> = jobs.iter().map(|job| train(job, 1000)).collect();

        let job = |bytes: &[u8]| Task::open(bytes).unwrap_err().to_string();
        let said = |run: &mut Run, bytes: &[u8]| run.hand_back(bytes).unwrap_err().to_string();
        let altered = |bytes: &[u8], at: usize| {
            let mut bytes = bytes.to_vec();
            bytes[at] ^= 1;
            bytes
        };
        let cut = &jobs[0][..jobs[0].len() - 1];
        assert_eq!(job(cut), alloc::format!("the job is cut off: {} bytes of {}", cut.len(), jobs[0].len()));
        assert_eq!(job(&altered(&jobs[0], 200)), "the job is damaged: its bytes were altered");
        assert_eq!(job(&futures[0]), "these bytes are not the job of a run");
        assert_eq!(job(&run.snapshot()), "these bytes are not the job of a run");
        assert_eq!(job(&[]), "these bytes are not the job of a run");
        let other = SNAPSHOT_VERSION + 1;
        let newer = [&jobs[0][..8], &other.to_le_bytes(), &jobs[0][12..]].concat();
        let version =
            alloc::format!("the job has format version {other}, this program reads version {SNAPSHOT_VERSION}");
        assert_eq!(job(&newer), version);

        let cut = &futures[0][..20];
        assert_eq!(said(&mut run, cut), "the future is cut off: 20 bytes of 28");
        assert_eq!(said(&mut run, &altered(&futures[0], 100)), "the future is damaged: its bytes were altered");
        assert_eq!(said(&mut run, &jobs[0]), "these bytes are not the future of a run");
        let foreign = "the future belongs to no forecast that this run waits for";
        let mut other = begin(&RUNS[0].replace("forecast=20", "forecast=21"));
        other.forecast_elsewhere().unwrap();
        let others = self::jobs(&mut other, &mut Vec::new());
        assert_eq!(said(&mut run, &train(&others[0], 1000)), foreign);
        assert_eq!(said(&mut other, &futures[0]), foreign);
        assert_eq!(said(&mut begin(RUNS[0]), &futures[0]), foreign, "it trains its futures itself");

        // After all that the run takes its own, each once.
        run.hand_back(&futures[1]).unwrap();
        assert_eq!(said(&mut run, &futures[1]), foreign);
        run.hand_back(&futures[0]).unwrap();
        run.forecast_elsewhere();
        let (rest, state) = finish_elsewhere(run);
        assert!(([events, rest].concat(), state) == finish(begin(RUNS[0])));
    }

    #[test]
    fn every_cut_and_every_altered_byte_is_refused() {
        let mut run = begin(RUNS[0]);
        run.forecast_elsewhere().unwrap();
        let job = jobs(&mut run, &mut vec![]).swap_remove(0);
        for end in (0..100).chain((0..job.len()).step_by(4999)) {
            assert!(Task::open(&job[..end]).is_err(), "{end}");
        }
        for at in (0..40).chain((0..job.len()).step_by(997)) {
            let mut altered = job.clone();
            altered[at] ^= 0x40;
            assert!(Task::open(&altered).is_err(), "{at}");
        }
    }

    #[test]
    fn a_forecast_that_diverges_elsewhere_says_so_as_it_does_here() {
        // The first update of the learner is its last sound one, and forecasts come before the second.
        let configuration = RUNS[0].replace("safe_steps=120", "safe_steps=31") + " lr=1e30";
        let fail = |mut run: Run| loop {
            match run.poll(Budget(50), &mut ()) {
                Ok(Status::Done) => panic!("it learns too much at once to stay finite"),
                Ok(_) => {}
                Err(error) => return error,
            }
            while let Some(job) = run.take_job() {
                run.hand_back(&train(&job, 50)).unwrap();
            }
        };
        let mut elsewhere = begin(&configuration);
        elsewhere.forecast_elsewhere().unwrap();
        let here = fail(begin(&configuration));
        assert!(matches!(&here, RunError::NotFinite { what, .. } if what == "the loss of a forecast"), "{here}");
        assert_eq!(fail(elsewhere), here);
    }

    #[test]
    fn forks_forecast_themselves() {
        let mut safe = begin(RUNS[0]);
        safe.forecast_elsewhere().unwrap();
        while safe.poll(Budget(1000), &mut ()).unwrap() != Status::Switch {}
        let whole = finish(begin(RUNS[0]));
        assert!(finish(safe.fork(Learner::Mc).unwrap()).1 == whole.1);
    }
}
