//! The one way to open a run for reading: nothing is shown that is not as training wrote it.
//!
//! The manifest comes first: its format, then its seal, then the digest of `run.toml`. The logs of a finished seed have
//! digests in it. A seed under way has none yet: its ledger holds together by its chain, and what its last checkpoint
//! counted is as it was then. What was logged after that, and a last line without its end, are what is being written.

use std::path::{Path, PathBuf};

use super::checkpoint::{Checkpoint, Header};
use super::layout::is_there;
use super::manifest::Manifest;
use super::read;
use super::write::check_mark;
use super::{LedgerLine, Place, Plan, RunDir, RunSet, RunsError, SeedDir, SeedRun};

/// A run that is open for reading.
#[derive(Clone, Debug)]
pub struct Reader {
    path: PathBuf,
    place: Place,
    plan: Plan,
    manifest: Option<Manifest>,
}

impl Reader {
    /// Opens the run that `path` names: a run directory, or the folder of one seed in it.
    ///
    /// # Errors
    /// If there is no run, only its summary was kept, or what it is about is not as it was written.
    pub fn open(path: &Path) -> Result<Self, RunsError> {
        let place = Place::find(path)?;
        let manifest = Manifest::of_run(&place.run)?;
        manifest.iter().try_for_each(|manifest| manifest.check_plan(&place.run))?;
        let plan = Plan::of_logs(&place.run)?;
        Ok(Self { path: path.to_owned(), place, plan, manifest })
    }

    /// The directory.
    pub fn run(&self) -> &RunDir {
        &self.place.run
    }

    /// What was named: the run, or a seed of it.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// What the run is about.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// What made the run; none where it was killed before it could say so.
    pub fn manifest(&self) -> Option<&Manifest> {
        self.manifest.as_ref()
    }

    /// The seeds that were named and have begun. What an unfinished run has so far is read as it is.
    ///
    /// # Errors
    /// If a file of it cannot be read, or is not what was written.
    pub fn set(&self) -> Result<RunSet, RunsError> {
        let named = |seed: &u64| self.place.seed.is_none_or(|only| only == *seed);
        let planned: Vec<u64> = self.plan.seeds.iter().copied().filter(named).collect();
        // A folder alone is what a process was killed over before the first state.
        let begun = |dir: &SeedDir| self.is_finished(dir) || dir.state().exists() || dir.has_logs();
        let folders = planned.iter().map(|seed| self.run().seed(*seed)).filter(begun);
        let seeds = folders.map(|dir| self.seed(&dir)).collect::<Result<_, _>>()?;
        Ok(RunSet { path: self.path.clone(), config: self.plan.config.clone(), planned, seeds })
    }

    /// One seed.
    ///
    /// # Errors
    /// If a file of it cannot be read, or is not what was written.
    pub fn seed(&self, dir: &SeedDir) -> Result<SeedRun, RunsError> {
        // Before the logs, which only grow: of what it counts as finished everything is there.
        let header = if self.is_finished(dir) { None } else { Checkpoint::header(&dir.state())? };
        self.ledger(dir)?;
        self.check(dir, dir.metrics())?;
        // Only a count is read of the steps; without them it is not known.
        if is_there(&dir.steps())? {
            self.check(dir, dir.steps())?;
        }
        let mut seed = SeedRun::read(dir, &self.plan)?;
        seed.complete &= header.is_none_or(|header| header.finished > self.plan.learners.len());
        Ok(seed)
    }

    /// The ledger of a seed.
    ///
    /// # Errors
    /// As [`seed`](Self::seed).
    pub fn ledger(&self, dir: &SeedDir) -> Result<Vec<LedgerLine>, RunsError> {
        self.check(dir, dir.ledger())?;
        let lines = read::ledger(dir)?;
        if !self.is_finished(dir)
            && let Err(line) = read::check_chain(&self.plan, dir, &lines)
        {
            let why = format!("was altered: its chain breaks at line {line}; put it back, or train the run anew");
            return Err(RunsError::damaged(&dir.ledger(), why));
        }
        Ok(lines)
    }

    /// Compares the steps of a seed with what vouches for them: the manifest, or of a seed under way its checkpoint.
    ///
    /// # Errors
    /// If they are not as they were written, or cannot be read.
    pub fn steps(&self, dir: &SeedDir) -> Result<(), RunsError> {
        self.check(dir, dir.steps())
    }

    /// Compares a file of the run with its digest in the manifest, where that has one.
    ///
    /// # Errors
    /// If it is missing, cannot be read, or is not what was written.
    pub fn check_file(&self, path: &Path) -> Result<(), RunsError> {
        let expected = self.manifest.as_ref().and_then(|manifest| manifest.digest(self.run(), path));
        told(path, expected.map_or(Ok(None), |expected| expected.mismatch(path))?)
    }

    /// Whether the manifest knows a seed as finished.
    pub fn is_finished(&self, dir: &SeedDir) -> bool {
        self.manifest.as_ref().is_some_and(|manifest| manifest.knows(self.run(), dir))
    }

    /// Compares a log with its digest in the manifest, or with what the last checkpoint counted. That is read before
    /// the log is: logs only grow.
    fn check(&self, dir: &SeedDir, path: PathBuf) -> Result<(), RunsError> {
        let Some(expected) = self.manifest.as_ref().and_then(|manifest| manifest.digest(self.run(), &path)) else {
            let header = Checkpoint::header(&dir.state())?;
            return header.map_or(Ok(()), |Header { logs: marks, .. }| {
                let mark = match &path {
                    path if *path == dir.ledger() => marks.ledger,
                    path if *path == dir.steps() => marks.steps,
                    _ => marks.metrics,
                };
                check_mark(&path, &mark).map(drop)
            });
        };
        let what = match path == dir.ledger() {
            true => read::ledger_mismatch(expected, &self.plan, dir)?,
            false => expected.mismatch(&path)?,
        };
        told(&path, what)
    }
}

/// What is wrong with a file, and what to do.
fn told(path: &Path, what: Option<String>) -> Result<(), RunsError> {
    match what {
        Some(what) => Err(RunsError::damaged(path, format!("{what}; put it back, or train the run anew"))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use mcvl_core::config::Learner;
    use mcvl_core::record::{Arm, EndRecord, Event, Recorder as _};
    use mcvl_core::run::Run;

    use super::super::write::SeedWriter;
    use super::super::{Manifest, State};
    use super::*;

    /// A run of three seeds, whose first has logged the end of its one learner.
    fn begun(path: &Path) -> (RunDir, impl Fn(usize)) {
        let run = RunDir::new(path);
        let config: mcvl_core::config::Config = "env=box-moving hidden=8".parse().unwrap();
        let learners = vec![Learner::Mc];
        let plan = Plan { config: config.clone(), seeds: vec![0, 1, 2], learners, settings: Vec::new() };
        fs::write(run.plan(), plan.to_toml()).unwrap();
        Manifest::begin().write(&run, State::Running, &[]).unwrap();
        let dir = run.seed(0);
        let config = config.with_seed(0).with_agent(Learner::Mc);
        let mut writer = SeedWriter::create(&dir, &config).unwrap();
        for arm in [Arm::Safe, Arm::Mc] {
            writer.record(&Event::End(EndRecord { arm, steps: 1, updates: 1, digest: String::new() }));
        }
        let logs = writer.sync().unwrap();
        let save = move |finished| Checkpoint::write(&dir.state(), finished, &logs, &Run::new(&config)).unwrap();
        (run, save)
    }

    #[test]
    fn a_seed_is_complete_once_its_state_says_so() {
        let folder = mcvl_tests::scratch();
        let (run, save) = begun(folder.path());
        let seen = |finished| {
            save(finished);
            let set = Reader::open(run.path()).unwrap().set().unwrap();
            (set.seeds[0].ends.len(), set.seeds[0].complete, set.unfinished())
        };
        assert_eq!(seen(1), (2, false, vec![0, 1, 2]));
        assert_eq!(seen(2), (2, true, vec![1, 2]));
    }

    #[test]
    fn a_folder_without_a_state_is_no_seed_yet() {
        let folder = mcvl_tests::scratch();
        let (run, save) = begun(folder.path());
        save(2);
        fs::create_dir_all(run.seed(1).tapes()).unwrap();
        fs::write(run.seed(1).metrics(), "").unwrap();
        let set = Reader::open(run.path()).unwrap().set().unwrap();
        assert_eq!((set.seeds.len(), set.planned.len()), (1, 3));
    }

    #[test]
    fn logs_are_not_shown_without_a_state_that_vouches_for_them() {
        let folder = mcvl_tests::scratch();
        let (run, save) = begun(folder.path());
        save(2);
        let path = run.seed(0).state();
        let whole = fs::read(&path).unwrap();
        for (damage, why) in [(&b"x"[..], "is no checkpoint of mcvl"), (&whole[..20], "is cut off at 20 bytes")] {
            fs::write(&path, damage).unwrap();
            let error = Reader::open(run.path()).unwrap().set().unwrap_err().to_string();
            assert!(error.contains("state.snapshot") && error.contains(why), "{error}");
        }
    }
}
