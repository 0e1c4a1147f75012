//! Whether a run directory is what training wrote.

use std::fs;
use std::path::{Path, PathBuf};

use super::checkpoint::Checkpoint;
use super::job::MISSING_STATE;
use super::manifest::{self, FileDigest, Manifest, State};
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
    for (name, expected) in &manifest.files {
        compare(run, &run.path().join(name), expected, &mut seen)?;
    }
    // A run.toml that cannot be read was found by its digest already; without it there is no chain.
    let Ok(plan) = Plan::read(run) else { return Ok(seen) };
    for dir in plan.seeds.iter().map(|seed| run.seed(*seed)) {
        let known = manifest.knows(run, &dir);
        if known {
            chain(run, &plan, &dir, &mut seen);
        } else if dir.path().exists() {
            unfinished(run, &plan, &dir, &mut seen);
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

fn compare(run: &RunDir, path: &Path, expected: &FileDigest, seen: &mut Verification) -> Result<(), RunsError> {
    seen.files += 1;
    if let Some(what) = expected.mismatch(path)? {
        seen.find(run, path, what);
    }
    Ok(())
}

/// Follows the chain of a seed's ledger.
fn chain(run: &RunDir, plan: &Plan, dir: &SeedDir, seen: &mut Verification) {
    let path = dir.ledger();
    // A missing ledger was found by its digest already.
    if !path.exists() {
        return;
    }
    match read::ledger(dir) {
        Ok(lines) => match read::check_chain(plan, dir, &lines) {
            Ok(links) => seen.links += links,
            Err(line) => {
                seen.links += line - 1;
                seen.find(run, &path, format!("its chain breaks at line {line}"));
            }
        },
        Err(RunsError::Damaged { why, .. }) => seen.find(run, &path, why),
        Err(other) => seen.find(run, &path, other.to_string()),
    }
}

/// Compares what an unfinished seed has with its checkpoint.
fn unfinished(run: &RunDir, plan: &Plan, dir: &SeedDir, seen: &mut Verification) {
    chain(run, plan, dir, seen);
    if fs::exists(dir.state()).is_ok_and(|there| !there) {
        if dir.has_logs() {
            seen.find(run, &dir.state(), MISSING_STATE);
        }
        return;
    }
    let checked = Checkpoint::read(&dir.state()).and_then(|checkpoint| {
        check_logs(dir, &checkpoint.logs)?;
        read::check_tapes(dir, checkpoint.logs.checks)
    });
    match checked {
        Ok(()) => {}
        Err(RunsError::Damaged { path, why }) => seen.find(run, &path, why),
        Err(other) => seen.find(run, &dir.state(), other.to_string()),
    }
}
