//! Several seeds at once. Seeds share nothing, so neither their number nor that of the threads can
//! change a result.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use mcvl_core::record::{CheckRecord, EvaluationRecord, Event};
use mcvl_core::run::Progress;

use super::RunsError;
use super::job::{Ending, ReadyJob, Watcher};

/// How often the caller is told how things stand.
const TICK: Duration = Duration::from_millis(100);

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

/// Works on `jobs` with `threads` threads; `tick` is called with the state of all of them every tenth of
/// a second and once at the end. Outcomes are in the order of the jobs.
pub fn train(
    jobs: Vec<ReadyJob>,
    threads: usize,
    control: &Control,
    mut tick: impl FnMut(&[SeedView]),
) -> Vec<Outcome> {
    let views: Vec<Mutex<SeedView>> = jobs.iter().map(|job| Mutex::new(SeedView::new(job))).collect();
    let seeds: Vec<u64> = jobs.iter().map(ReadyJob::seed).collect();
    let threads = threads.clamp(1, jobs.len().max(1));
    let queue: Vec<Mutex<Option<ReadyJob>>> = jobs.into_iter().map(|job| Mutex::new(Some(job))).collect();
    let results: Vec<Mutex<Option<Result<Ending, RunsError>>>> = queue.iter().map(|_| Mutex::new(None)).collect();
    let next = AtomicUsize::new(0);
    let (alive, all_gone) = mpsc::channel::<()>();
    let look = |views: &[Mutex<SeedView>]| -> Vec<SeedView> { views.iter().map(SeedView::take).collect() };
    thread::scope(|scope| {
        for _ in 0..threads {
            let (queue, results, views, next, alive) = (&queue, &results, &views, &next, alive.clone());
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = queue.get(index).and_then(|slot| lock(slot).take()) else { break };
                    let result =
                        if control.stopped() { Ok(job.untouched()) } else { job.run(control, &mut &views[index]) };
                    if matches!(result, Err(RunsError::Io { .. } | RunsError::Damaged { .. })) {
                        control.failed.store(true, Ordering::Relaxed);
                    }
                    lock(&views[index]).over = true;
                    *lock(&results[index]) = Some(result);
                }
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
            Event::Check(check) => lock(self).decisions.push(CheckRecord::clone(check)),
            _ => {}
        }
    }
}
