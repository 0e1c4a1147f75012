//! Several seeds at once. Seeds share nothing, so neither their number nor that of the threads can
//! change a result.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use mcvl_core::record::{CheckRecord, EvaluationRecord, Event};
use mcvl_core::run::Progress;

use super::RunsError;
use super::job::{Ending, OpenJob, Pause, ReadyJob, Watcher};
use super::side_by_side::Idle;
use crate::gpu::Gpu;

/// How often the caller is told how things stand.
const TICK: Duration = Duration::from_millis(100);
/// How long a thread waits for a device before it looks for itself.
const PATIENCE: Duration = Duration::from_millis(10);

/// Says when to save and when to stop.
#[derive(Debug)]
pub struct Control {
    /// A kill loses at most about this much work.
    pub checkpoint_every: Duration,
    /// Set from outside, by a signal.
    stop: &'static AtomicBool,
    /// Stop at this moment.
    deadline: Option<Instant>,
    /// The machine failed one seed: the others save what they have.
    failed: AtomicBool,
}

impl Control {
    /// Stops when `stop` is set or `deadline` is over.
    pub fn new(checkpoint_every: Duration, stop: &'static AtomicBool, deadline: Option<Instant>) -> Self {
        Self { checkpoint_every, stop, deadline, failed: AtomicBool::new(false) }
    }

    /// Whether to stop now.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
            || self.failed.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }
}

/// A device to which forecasts go.
#[derive(Clone, Debug)]
pub struct Remote {
    gpu: Gpu,
    fall_back: bool,
    fallen: Arc<Mutex<Vec<String>>>,
}

impl Remote {
    /// Forecasts on `gpu`. If it fails, runs go on on the processor where `fall_back` says so, and stop otherwise.
    pub fn new(gpu: Gpu, fall_back: bool) -> Self {
        Self { gpu, fall_back, fallen: Arc::default() }
    }

    /// The same device for other runs, which count for themselves.
    pub fn apart(&self) -> Self {
        Self { fallen: Arc::default(), ..self.clone() }
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Why runs went on on the processor, once for each.
    pub fn fallen(&self) -> Vec<String> {
        lock(&self.fallen).clone()
    }

    /// Whether a run goes on on the processor after the device failed.
    pub(super) fn falls_back(&self, why: &str) -> bool {
        if self.fall_back {
            lock(&self.fallen).push(why.to_owned());
        }
        self.fall_back
    }
}

/// How one seed stands, for displays.
#[derive(Clone, Debug)]
pub struct SeedView {
    /// The seed.
    pub seed: u64,
    /// Finished legs.
    pub finished: usize,
    /// Figures of the leg under way; `None` before the first piece of work.
    pub progress: Option<Progress>,
    /// The latest evaluation.
    pub evaluation: Option<EvaluationRecord>,
    /// Decisions since the last look.
    pub decisions: Vec<CheckRecord>,
    /// True once nobody works on it any more.
    pub over: bool,
}

/// What became of one seed.
#[derive(Debug)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// How it ended.
    pub result: Result<Ending, RunsError>,
}

/// A job that nobody works on at the moment.
struct Entry {
    index: usize,
    job: Stage,
}

/// How far a job in the queue is.
enum Stage {
    Ready(Box<ReadyJob>),
    Open(Box<OpenJob>),
}

/// Files of an open job: its logs, a lock, and what is written of a checkpoint.
const FILES_OF_A_JOB: u64 = 6;
/// Files of the program besides.
const FILES: u64 = 100;

/// Works on `jobs` with `threads` threads; `tick` is called with the state of all of them every tenth of
/// a second and once at the end. Outcomes are in the order of the jobs.
///
/// Without a remote, threads that find no job train futures of the jobs under way.
///
/// With a `remote` all jobs are open at once: a thread whose job waits for the device goes on with another one, so the
/// device has the forecasts of all of them together.
pub fn train(
    jobs: Vec<ReadyJob>,
    threads: usize,
    remote: Option<&Remote>,
    control: &Control,
    tick: impl FnMut(&[SeedView]),
) -> Vec<Outcome> {
    work(jobs, threads, remote, control, &Arc::default(), tick)
}

/// The same, with the place where `idle` threads are found.
fn work(
    jobs: Vec<ReadyJob>,
    threads: usize,
    remote: Option<&Remote>,
    control: &Control,
    idle: &Arc<Idle>,
    mut tick: impl FnMut(&[SeedView]),
) -> Vec<Outcome> {
    // Where it cannot be raised, the first file that cannot be opened says so.
    let _ = rlimit::increase_nofile_limit(FILES + jobs.len() as u64 * FILES_OF_A_JOB);
    let views: Vec<Mutex<SeedView>> = jobs.iter().map(|job| Mutex::new(SeedView::new(job))).collect();
    let seeds: Vec<u64> = jobs.iter().map(ReadyJob::seed).collect();
    let workers = threads.clamp(1, jobs.len().max(1));
    (workers..threads).for_each(|_| idle.add());
    let results: Vec<Mutex<Option<Result<Ending, RunsError>>>> = jobs.iter().map(|_| Mutex::new(None)).collect();
    let unfinished = AtomicUsize::new(jobs.len());
    let entries = jobs.into_iter().enumerate().map(|(index, job)| Entry { index, job: Stage::Ready(Box::new(job)) });
    let queue: Mutex<VecDeque<Entry>> = Mutex::new(entries.collect());
    let (alive, all_gone) = mpsc::channel::<()>();
    let look = |views: &[Mutex<SeedView>]| -> Vec<SeedView> { views.iter().map(SeedView::take).collect() };
    thread::scope(|scope| {
        for _ in 0..workers {
            let (queue, results, views, alive) = (&queue, &results, &views, alive.clone());
            let unfinished = &unfinished;
            scope.spawn(move || {
                let _alarm = Alarm(unfinished);
                // Jobs in a row that had to wait.
                let mut waiting = 0;
                while unfinished.load(Ordering::Relaxed) > 0 {
                    let entry = lock(queue).pop_front();
                    let others = lock(queue).len();
                    let Some(Entry { index, job }) = entry else {
                        // Whoever works on the rest may bring one back, but only where there is a device to wait for.
                        let Some(remote) = remote else { break };
                        remote.gpu.wait(PATIENCE);
                        continue;
                    };
                    let result = match step(job, remote, idle, control, &mut &views[index]) {
                        Ok(Left::Waiting(open)) => {
                            lock(queue).push_back(Entry { index, job: Stage::Open(open) });
                            waiting += 1;
                            if waiting > others
                                && let Some(remote) = remote
                            {
                                remote.gpu.wait(PATIENCE);
                                waiting = 0;
                            }
                            continue;
                        }
                        Ok(Left::Ended(ending)) => Ok(ending),
                        Err(error) => Err(error),
                    };
                    waiting = 0;
                    if matches!(
                        result,
                        Err(RunsError::Io { .. } | RunsError::Damaged { .. } | RunsError::BackEnd { .. })
                    ) {
                        control.failed.store(true, Ordering::Relaxed);
                    }
                    lock(&views[index]).over = true;
                    *lock(&results[index]) = Some(result);
                    // Not below the zero of an alarm.
                    let _ = unfinished.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
                }
                idle.add();
                drop(alive);
            });
        }
        drop(alive);
        while all_gone.recv_timeout(TICK) == Err(mpsc::RecvTimeoutError::Timeout) {
            tick(&look(&views));
        }
    });
    tick(&look(&views));
    let result = |slot: Mutex<Option<_>>| lock(&slot).take().expect("every job was taken from the queue");
    seeds.into_iter().zip(results).map(|(seed, slot)| Outcome { seed, result: result(slot) }).collect()
}

/// Lets the other threads go when the one that holds it panics: its job will never be finished.
struct Alarm<'a>(&'a AtomicUsize);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.store(0, Ordering::Relaxed);
        }
    }
}

/// What became of a job that was worked on.
enum Left {
    Waiting(Box<OpenJob>),
    Ended(Ending),
}

/// Works on a job until it ends or has to wait.
fn step(
    job: Stage,
    remote: Option<&Remote>,
    idle: &Arc<Idle>,
    control: &Control,
    watcher: &mut dyn Watcher,
) -> Result<Left, RunsError> {
    let mut open = match job {
        Stage::Ready(job) if job.is_finished() || control.stopped() => return Ok(Left::Ended(job.untouched())),
        Stage::Ready(job) => Box::new((*job).open(remote.cloned(), idle.clone())?),
        Stage::Open(open) => open,
    };
    Ok(match open.work(control, watcher)? {
        Pause::Waiting => Left::Waiting(open),
        Pause::Ended(ending) => Left::Ended(ending),
    })
}

/// A panic in a worker ends the program through its scope, so no lock is ever poisoned and read.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().expect("no thread panicked")
}

impl SeedView {
    fn new(job: &ReadyJob) -> Self {
        Self {
            seed: job.seed(),
            finished: 0,
            progress: None,
            evaluation: None,
            decisions: Vec::new(),
            over: job.is_finished(),
        }
    }

    /// A copy; the decisions move to it.
    fn take(view: &Mutex<Self>) -> Self {
        let mut view = lock(view);
        let decisions = std::mem::take(&mut view.decisions);
        Self { decisions, ..view.clone() }
    }
}

impl Watcher for &Mutex<SeedView> {
    fn progress(&mut self, finished: usize, progress: Progress) {
        let mut view = lock(self);
        view.finished = finished;
        view.progress = Some(progress);
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::Evaluation(evaluation) => lock(self).evaluation = Some(evaluation.clone()),
            Event::Check(check) => lock(self).decisions.push(check.without_films()),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::{Job, RunDir};
    use mcvl_core::config::Learner;

    #[test]
    fn threads_without_a_job_train_futures() {
        static STOP: AtomicBool = AtomicBool::new(false);
        let folder = mcvl_tests::scratch();
        let given = |jobs: &[u32], threads| {
            let text =
                "env=box-moving safe_steps=60 hidden=8 forecast=10 exploration=40 rollouts=1 scheme=all evaluations=1";
            let ready = jobs.iter().zip(0..).map(|(steps, seed)| {
                let config = format!("{text} full_steps={steps} seed={seed}").parse().unwrap();
                let dir = RunDir::new(folder.path().join(format!("{jobs:?}-{threads}"))).seed(seed);
                Job { config, learners: vec![Learner::Mc], dir }.ready()
            });
            let (control, idle) = (Control::new(Duration::from_secs(60), &STOP, None), Arc::default());
            let outcomes = work(ready.collect(), threads, None, &control, &idle, |_| {});
            assert!(outcomes.iter().all(|outcome| matches!(outcome.result, Ok(Ending::Finished))), "{outcomes:?}");
            idle.given()
        };
        assert_eq!(given(&[40], 1), 0);
        assert!(given(&[40], 2) >= 40, "from the beginning");
        assert!(given(&[10, 400], 2) >= 100, "from the end of the other job on");
    }
}
