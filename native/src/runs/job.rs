//! One seed of a run directory, from its beginning or a checkpoint to its end: Safe training, then each
//! learner from the same switch.

use std::sync::Arc;
use std::time::Instant;

use mcvl_core::config::{Config, Learner};
use mcvl_core::record::{Arm, Event, Recorder};
use mcvl_core::run::{Budget, Progress, Run, RunError, Status};

use super::checkpoint::Checkpoint;
use super::pool::{Control, Remote};
use super::side_by_side::{self, Idle};
use super::write::{SeedWriter, check_logs, write_weights};
use super::{RunsError, SeedDir, read};
use crate::gpu::Seat;
use crate::worlds;

/// Work per poll: short enough that a signal is answered in the blink of an eye, long enough that the
/// rest costs nothing.
const BUDGET: Budget = Budget(16);

/// One seed: what to do.
#[derive(Clone, Debug)]
pub struct Job {
    /// Configuration, with this job's seed.
    pub config: Config,
    /// Learners of the Full phase, in order.
    pub learners: Vec<Learner>,
    /// Where its files lie.
    pub dir: SeedDir,
}

/// A job that is known to be able to start: reading and checking come before the first change.
pub struct ReadyJob {
    job: Job,
    start: Start,
}

enum Start {
    Beginning,
    Middle { checkpoint: Box<Checkpoint>, switch: Option<Box<Run>> },
    Finished,
}

/// What is wrong where a seed has logs and no state.
pub(super) const MISSING_STATE: &str =
    "is missing, and without it the seed cannot go on: put it back, or begin the run anew with --overwrite";

/// How a job ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Every leg is finished.
    Finished,
    /// Stopped on request, its state saved.
    Interrupted,
}

/// Watches a job. Influences nothing.
pub trait Watcher {
    /// Called after every piece of work.
    fn progress(&mut self, finished_legs: usize, progress: Progress);
    /// Called for every event.
    fn event(&mut self, event: &Event);
}

impl Job {
    /// A job that starts at its beginning.
    pub fn ready(self) -> ReadyJob {
        ReadyJob { job: self, start: Start::Beginning }
    }

    /// A job that continues from its last checkpoint, or starts if it was not begun. `finished` says that the manifest
    /// knows it as finished. Changes nothing.
    ///
    /// # Errors
    /// If the checkpoint or a file it counts on is damaged, missing or cannot be read.
    pub fn resume(self, finished: bool) -> Result<ReadyJob, RunsError> {
        let path = self.dir.state();
        if !path.exists() {
            // To begin anew would wipe what there is.
            return if finished || self.dir.has_logs() {
                Err(RunsError::damaged(&path, MISSING_STATE))
            } else {
                Ok(self.ready())
            };
        }
        let checkpoint = Checkpoint::read(&path)?;
        let legs = 1 + self.learners.len();
        let agent = checkpoint.run.config().agent;
        if checkpoint.finished > legs
            || self.config.with_agent(agent) != *checkpoint.run.config()
            || checkpoint.finished < legs && self.learners[checkpoint.finished.saturating_sub(1)] != agent
        {
            return Err(RunsError::damaged(&path, "is of another run than run.toml describes"));
        }
        check_logs(&self.dir, &checkpoint.logs)?;
        read::check_tapes(&self.dir, &checkpoint.logs)?;
        // Learners that have yet to begin fork from the switch.
        let switch = match checkpoint.finished {
            0 => None,
            finished if finished + 1 >= legs => None,
            _ => Some(Box::new(self.switch()?)),
        };
        let start = if checkpoint.finished == legs {
            Start::Finished
        } else {
            Start::Middle { checkpoint: Box::new(checkpoint), switch }
        };
        Ok(ReadyJob { job: self, start })
    }

    fn switch(&self) -> Result<Run, RunsError> {
        let run = Checkpoint::read(&self.dir.switch())?.run;
        if *run.config() != self.config.with_agent(run.config().agent) {
            return Err(RunsError::damaged(&self.dir.switch(), "is of another run than run.toml describes"));
        }
        Ok(run)
    }

    fn arm(&self, leg: usize) -> Arm {
        if leg == 0 { Arm::Safe } else { Arm::of(self.learners[leg - 1]) }
    }
}

impl ReadyJob {
    /// The seed.
    pub fn seed(&self) -> u64 {
        self.job.config.seed
    }

    /// Whether nothing is left to do.
    pub fn is_finished(&self) -> bool {
        matches!(self.start, Start::Finished)
    }

    /// How a job ends that is not even begun.
    pub fn untouched(&self) -> Ending {
        if self.is_finished() { Ending::Finished } else { Ending::Interrupted }
    }

    /// Opens its files and makes or takes up its run, whose forecasts go to `remote` where there is one that has them,
    /// and otherwise to `idle` threads, too.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn open(self, remote: Option<Remote>, idle: Arc<Idle>) -> Result<OpenJob, RunsError> {
        let job = self.job;
        let (run, finished, switch, writer) = match self.start {
            Start::Beginning => {
                let mut writer = SeedWriter::create(&job.dir, &job.config.with_agent(Learner::Mc))?;
                let run = worlds::begin(&job.config.with_agent(job.learners[0]));
                let run = run.map_err(|e| RunsError::Request(e.to_string()))?;
                // Before the first line of a log, so that logs without a state mean that the state was lost.
                Checkpoint::write(&job.dir.state(), 0, &writer.sync()?, &run)?;
                (run, 0, None, writer)
            }
            Start::Middle { checkpoint, switch } => {
                let writer = SeedWriter::reopen(&job.dir, &checkpoint.logs)?;
                (checkpoint.run, checkpoint.finished, switch.map(|run| *run), writer)
            }
            // Not asked for: there is nothing to do.
            Start::Finished => return Err(RunsError::Request(format!("seed {} is finished", job.config.seed))),
        };
        let mut open = OpenJob {
            job,
            run,
            finished,
            switch,
            writer,
            remote,
            seat: None,
            idle,
            saved: Instant::now(),
            polled: true,
        };
        open.equip();
        Ok(open)
    }
}

/// A job under way.
pub struct OpenJob {
    job: Job,
    run: Run,
    /// Finished legs.
    finished: usize,
    /// Learners that have yet to begin fork from here.
    switch: Option<Run>,
    writer: SeedWriter,
    remote: Option<Remote>,
    seat: Option<Seat>,
    idle: Arc<Idle>,
    saved: Instant,
    /// Whether the run has moved since: while it waits for a device, it is not saved again.
    polled: bool,
}

/// How far a job came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pause {
    /// Its forecasts are under way on a device: there is nothing to do for the processor.
    Waiting,
    /// It has ended.
    Ended(Ending),
}

impl OpenJob {
    /// Says who trains the futures: a device where there is one that can, and the threads of this program otherwise.
    fn equip(&mut self) {
        self.seat = self.remote.as_ref().and_then(|remote| remote.gpu().equip(&mut self.run));
        if self.seat.is_none() && !side_by_side::equip(&mut self.run, &self.idle) {
            self.run.forecast_here();
        }
    }

    /// Works until the job is finished, has to wait, or `control` says stop.
    ///
    /// # Errors
    /// If training diverges, a device fails or a file cannot be written; what was saved before stays.
    pub fn work(&mut self, control: &Control, watcher: &mut dyn Watcher) -> Result<Pause, RunsError> {
        while self.finished <= self.job.learners.len() {
            match self.leg(control, watcher)? {
                Pause::Ended(Ending::Finished) => self.finish_leg()?,
                pause => return Ok(pause),
            }
        }
        Ok(Pause::Ended(Ending::Finished))
    }

    /// Works on one leg until it is finished, has to wait, or `control` says stop; then its state is saved.
    fn leg(&mut self, control: &Control, watcher: &mut dyn Watcher) -> Result<Pause, RunsError> {
        loop {
            let stop = control.stopped();
            if stop || self.polled && self.saved.elapsed() >= control.checkpoint_every {
                let logs = self.writer.sync()?;
                Checkpoint::write(&self.job.dir.state(), self.finished, &logs, &self.run)?;
                (self.saved, self.polled) = (Instant::now(), false);
            }
            if stop {
                return Ok(Pause::Ended(Ending::Interrupted));
            }
            if self.seat.as_ref().is_some_and(Seat::waits) {
                watcher.progress(self.finished, self.run.progress());
                return Ok(Pause::Waiting);
            }
            self.polled = true;
            let status = match self.run.poll(BUDGET, &mut Tee { writer: &mut self.writer, watcher }) {
                Ok(status) => status,
                Err(RunError::Forecast(why)) if self.remote.as_ref().is_some_and(|remote| remote.falls_back(&why)) => {
                    self.remote = None;
                    self.equip();
                    continue;
                }
                Err(source) => {
                    // What led there is worth reading, so it goes to the disk; the checkpoint stays before it.
                    let logs = self.writer.sync()?;
                    let seed = self.job.config.seed;
                    return Err(match source {
                        RunError::Forecast(why) => {
                            // Nothing was learned from the forecast that failed.
                            Checkpoint::write(&self.job.dir.state(), self.finished, &logs, &self.run)?;
                            RunsError::BackEnd { seed, why }
                        }
                        source => RunsError::Diverged { seed, source },
                    });
                }
            };
            self.writer.healthy()?;
            watcher.progress(self.finished, self.run.progress());
            if matches!((self.finished, status), (0, Status::Switch) | (1.., Status::Done)) {
                return Ok(Pause::Ended(Ending::Finished));
            }
        }
    }

    /// Saves a finished leg and begins the next one.
    fn finish_leg(&mut self) -> Result<(), RunsError> {
        let Self { job, run, finished, switch, writer, .. } = self;
        let logs = writer.sync()?;
        let leg = job.arm(*finished);
        write_weights(&job.dir.weights(leg), run, leg)?;
        *finished += 1;
        if *finished == 1 {
            Checkpoint::write(&job.dir.switch(), *finished, &logs, run)?;
            *switch = Some(run.clone());
        }
        if let Some(&next) = job.learners.get(*finished - 1) {
            let fork = switch.as_ref().and_then(|switch| switch.fork(next));
            *run = fork.ok_or_else(|| RunsError::damaged(&job.dir.switch(), "does not stand at the switch"))?;
        }
        Checkpoint::write(&job.dir.state(), *finished, &logs, run)?;
        self.equip();
        Ok(())
    }
}

/// Files first, then whoever watches.
struct Tee<'a> {
    writer: &'a mut SeedWriter,
    watcher: &'a mut dyn Watcher,
}

impl Recorder for Tee<'_> {
    fn record(&mut self, event: &Event) {
        self.writer.record(event);
        self.watcher.event(event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::RunDir;
    use std::path::Path;

    #[test]
    fn a_state_of_another_run_is_not_gone_on_with() {
        let folder = mcvl_tests::scratch();
        let config: Config = "env=box-moving hidden=8 seed=7".parse().unwrap();
        let learners = vec![Learner::Baseline, Learner::Mc];
        let dir = RunDir::new(folder.path()).seed(7);
        let logs = SeedWriter::create(&dir, &config).and_then(|mut writer| writer.sync()).unwrap();
        // Why a seed cannot go on whose state and switch have these seeds; none where it can.
        let refused = |finished: usize, agent: Learner, state: u64, switch: u64| {
            let write = |path: &Path, seed| {
                let run = Run::new(&config.with_agent(agent).with_seed(seed));
                Checkpoint::write(path, finished, &logs, &run).unwrap();
            };
            write(&dir.state(), state);
            write(&dir.switch(), switch);
            let job = Job { config: config.clone(), learners: learners.clone(), dir: dir.clone() };
            job.resume(false).err().map(|error| error.to_string())
        };
        assert_eq!(refused(0, Learner::Baseline, 7, 7), None);
        assert_eq!(refused(1, Learner::Baseline, 7, 7), None);
        assert_eq!(refused(2, Learner::Mc, 7, 7), None);
        assert_eq!(refused(3, Learner::Mc, 7, 7), None);
        for (path, finished, agent, state, switch) in [
            (dir.state(), 1, Learner::Baseline, 4, 7),
            (dir.state(), 1, Learner::Mc, 7, 7),
            (dir.state(), 4, Learner::Mc, 7, 7),
            (dir.switch(), 1, Learner::Baseline, 7, 4),
        ] {
            let why = refused(finished, agent, state, switch).unwrap_or_default();
            let expected = format!("{}: is of another run than run.toml describes", path.display());
            assert_eq!(why, expected, "{finished} {agent:?} {state} {switch}");
        }
    }
}
