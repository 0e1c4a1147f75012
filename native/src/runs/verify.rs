//! Whether a run directory is what training wrote.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::checkpoint::Checkpoint;
use super::job::MISSING_STATE;
use super::layout::is_there;
use super::manifest::{self, Manifest, State};
use super::write::check_logs;
use super::{Plan, RunDir, RunsError, SeedDir, read};

/// Something that is not as it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The file, in the run directory.
    pub file: String,
    /// What is wrong with it.
    pub what: String,
}

/// What was looked at and found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verification {
    /// Files whose digest was compared.
    pub files: usize,
    /// Links of ledgers that were followed.
    pub links: usize,
    /// How the run stands. Seeds that are not finished were compared with their checkpoints.
    pub state: State,
    /// What is wrong.
    pub findings: Vec<Finding>,
    /// Files that the manifest does not know: no harm, but nothing vouches for them.
    pub unknown: Vec<String>,
}

impl Verification {
    fn find(&mut self, run: &RunDir, path: &Path, what: impl Into<String>) {
        self.findings.push(Finding { file: manifest::name(run, path), what: what.into() });
    }

    /// Of a file of which its digest says the same already, nothing is said again.
    fn find_once(&mut self, run: &RunDir, path: &Path, what: String) {
        let name = manifest::name(run, path);
        if !self.findings.iter().any(|finding| finding.file == name) {
            self.find(run, path, what);
        }
    }
}

/// Compares a run directory with its manifest, its ledgers with their chains, and what is unfinished
/// with its checkpoints. Changes nothing.
///
/// # Errors
/// If the manifest, or a file that is there, cannot be read.
pub fn verify(run: &RunDir) -> Result<Verification, RunsError> {
    let manifest = Manifest::read(run)?;
    let mut seen =
        Verification { files: 0, links: 0, state: manifest.state, findings: Vec::new(), unknown: Vec::new() };
    if !manifest.is_intact() {
        seen.find(run, &run.manifest(), "altered: its seal does not fit");
    }
    let plan = Plan::read(run).ok();
    for (name, expected) in &manifest.files {
        seen.files += 1;
        let path = run.path().join(name);
        let what = match plan.as_ref().and_then(|plan| Some((plan, run.seed_with_ledger(&path)?))) {
            Some((plan, dir)) => read::ledger_mismatch(expected, plan, &dir)?,
            None => expected.mismatch(&path)?,
        };
        what.into_iter().for_each(|what| seen.find(run, &path, what));
    }
    // A run.toml that cannot be read was found by its digest already; without it there is no chain.
    let Some(plan) = plan else { return Ok(seen) };
    for dir in plan.seeds.iter().map(|seed| run.seed(*seed)) {
        let known = manifest.knows(run, &dir);
        if known {
            chain(run, &plan, &dir, &mut seen)?;
        } else if dir.path().exists() {
            unfinished(run, &plan, &dir, &mut seen)?;
        }
        if known && dir.path().exists() {
            let mut there: Vec<PathBuf> = Vec::new();
            manifest::list(dir.path(), &mut there)?;
            let names = there.iter().map(|path| manifest::name(run, path));
            seen.unknown.extend(names.filter(|name| !manifest.files.contains_key(name)));
        } else if manifest.state == State::Finished {
            seen.find(run, dir.path(), "not in the manifest, though the run is finished");
        }
    }
    seen.unknown.sort();
    Ok(seen)
}

/// Follows the chain of a seed's ledger.
fn chain(run: &RunDir, plan: &Plan, dir: &SeedDir, seen: &mut Verification) -> Result<(), RunsError> {
    let path = dir.ledger();
    // A missing ledger was found by its digest already.
    if !is_there(&path)? {
        return Ok(());
    }
    match read::ledger(dir) {
        Ok(lines) => match read::check_chain(plan, dir, &lines) {
            Ok(links) => seen.links += links,
            Err(line) => {
                seen.links += line - 1;
                seen.find_once(run, &path, format!("its chain breaks at line {line}"));
            }
        },
        Err(RunsError::Damaged { why, .. }) => seen.find_once(run, &path, why),
        Err(other) => return Err(other),
    }
    Ok(())
}

/// Compares what an unfinished seed has with its checkpoint.
fn unfinished(run: &RunDir, plan: &Plan, dir: &SeedDir, seen: &mut Verification) -> Result<(), RunsError> {
    chain(run, plan, dir, seen)?;
    if !is_there(&dir.state())? {
        if dir.has_logs() {
            seen.find(run, &dir.state(), MISSING_STATE);
        }
        return Ok(());
    }
    let checked = Checkpoint::read(&dir.state()).and_then(|checkpoint| {
        check_logs(dir, &checkpoint.logs)?;
        read::check_tapes(dir, &checkpoint.logs)
    });
    match checked {
        Ok(()) => {}
        Err(RunsError::Damaged { path, why }) => seen.find_once(run, &path, why),
        Err(RunsError::Io { path, source, .. }) if source.kind() == ErrorKind::NotFound => {
            seen.find(run, &path, "missing");
        }
        Err(other) => return Err(other),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvl_core::config::Learner;
    use mcvl_core::record::Arm;
    use std::fs;

    #[test]
    fn a_finished_run_knows_all_of_its_seeds() {
        let folder = mcvl_tests::scratch();
        let run = RunDir::new(folder.path());
        let config = "env=box-moving".parse().unwrap();
        let plan = Plan { config, seeds: vec![0, 3], learners: vec![Learner::Mc], settings: Vec::new() };
        fs::write(run.plan(), plan.to_toml()).unwrap();
        fs::create_dir(run.seed(0).path()).unwrap();
        fs::write(run.seed(0).metrics(), "").unwrap();
        let found = |state, seeds: &[u64]| {
            Manifest::begin().write(&run, state, seeds).unwrap();
            verify(&run).unwrap().findings
        };
        assert_eq!(found(State::Interrupted, &[0]), []);
        let what = "not in the manifest, though the run is finished".to_owned();
        assert_eq!(found(State::Finished, &[0]), [Finding { file: "seed-3".to_owned(), what }]);
    }

    #[test]
    fn what_was_finished_before_keeps_its_digests() {
        let folder = mcvl_tests::scratch();
        let run = RunDir::new(folder.path());
        let config = "env=box-moving".parse().unwrap();
        let plan = Plan { config, seeds: vec![0, 1, 10], learners: vec![Learner::Mc], settings: Vec::new() };
        fs::write(run.plan(), plan.to_toml()).unwrap();
        for dir in plan.seeds.iter().map(|seed| run.seed(*seed)) {
            fs::create_dir_all(dir.checkpoints()).unwrap();
            fs::write(dir.metrics(), "").unwrap();
            fs::write(dir.weights(Arm::Mc), "as trained").unwrap();
        }
        let mut manifest = Manifest::begin();
        manifest.write(&run, State::Interrupted, &[0, 1]).unwrap();
        // In every later session, when seed 10 joins them.
        fs::write(run.seed(0).weights(Arm::Mc), "altered").unwrap();
        fs::remove_file(run.seed(1).weights(Arm::Mc)).unwrap();
        manifest.write(&run, State::Finished, &[0, 1, 10]).unwrap();
        let findings = verify(&run).unwrap().findings;
        let files: Vec<&str> = findings.iter().map(|finding| finding.file.as_str()).collect();
        assert_eq!(files, ["seed-0/checkpoints/mc.safetensors", "seed-1/checkpoints/mc.safetensors"], "{findings:?}");
        assert!(manifest.files.contains_key("seed-10/checkpoints/mc.safetensors"));
    }
}
