//! The one way to open a run for reading: nothing is shown that is not as training wrote it.
//!
//! The manifest comes first: its format, then its seal, then the digest of `run.toml`. The logs of a finished seed have
//! digests in it. A seed under way has none yet: its ledger holds together by its chain, and what its last checkpoint
//! counted is as it was then. What was logged after that, and a last line without its end, are what is being written.

use std::path::{Path, PathBuf};

use super::checkpoint::Checkpoint;
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
        let begun = |dir: &SeedDir| dir.path().exists() || self.is_finished(dir);
        let folders = planned.iter().map(|seed| self.run().seed(*seed)).filter(begun);
        let seeds = folders.map(|dir| self.seed(&dir)).collect::<Result<_, _>>()?;
        Ok(RunSet { path: self.path.clone(), config: self.plan.config.clone(), planned, seeds })
    }

    /// One seed.
    ///
    /// # Errors
    /// If a file of it cannot be read, or is not what was written.
    pub fn seed(&self, dir: &SeedDir) -> Result<SeedRun, RunsError> {
        self.ledger(dir)?;
        self.check(dir, dir.metrics())?;
        // Only a count is read of the steps; without them it is not known.
        if is_there(&dir.steps())? {
            self.check(dir, dir.steps())?;
        }
        SeedRun::read(dir, &self.plan)
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

    /// Compares a file of the run with its digest in the manifest, where that has one.
    ///
    /// # Errors
    /// If it is missing, cannot be read, or is not what was written.
    pub fn check_file(&self, path: &Path) -> Result<(), RunsError> {
        let expected = self.manifest.as_ref().and_then(|manifest| manifest.digest(self.run(), path));
        told(path, expected.map_or(Ok(None), |expected| expected.mismatch(path))?)
    }

    fn is_finished(&self, dir: &SeedDir) -> bool {
        self.manifest.as_ref().is_some_and(|manifest| manifest.knows(self.run(), dir))
    }

    /// Compares a log with its digest in the manifest, or with what the last checkpoint counted. That is read before
    /// the log is: logs only grow.
    fn check(&self, dir: &SeedDir, path: PathBuf) -> Result<(), RunsError> {
        let Some(expected) = self.manifest.as_ref().and_then(|manifest| manifest.digest(self.run(), &path)) else {
            let marks = Checkpoint::marks(&dir.state());
            return marks.map_or(Ok(()), |marks| {
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
