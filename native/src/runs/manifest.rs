//! `manifest.json`: by what and on what a run was made, and the digest of every finished file.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use std::{env, thread};

use mcvl_core::config::Simulator;
use serde::{Deserialize, Serialize};
use sha2::Digest as _;

use super::chain::{hex, sha256, sha256_of};
use super::layout::{is_temporary, is_there};
use super::write::write_atomic;
use super::{RunDir, RunsError, SeedDir};
use crate::mujoco;

/// Version of the format.
const FORMAT: u32 = 1;

/// What is wrong with a file whose digest is another one.
pub const ALTERED: &str = "altered: its digest is not the one in manifest.json";

/// How a run stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Training began; if nobody holds the lock, it was killed.
    Running,
    /// Stopped with its state saved.
    Interrupted,
    /// Every leg of every seed is finished.
    Finished,
    /// Training of some seed diverged; the others are finished.
    Diverged,
}

/// Length and digest of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileDigest {
    /// Length.
    pub bytes: u64,
    /// SHA-256, hexadecimal.
    pub sha256: String,
}

impl FileDigest {
    /// Reads a file.
    ///
    /// # Errors
    /// If that fails.
    pub fn of(path: &Path) -> Result<Self, RunsError> {
        let (bytes, digest) = File::open(path).and_then(sha256_of).map_err(RunsError::io("read", path))?;
        Ok(Self { bytes, sha256: hex(&digest.finalize()) })
    }

    /// What is wrong with a file that should have this digest, in words; none where it has.
    ///
    /// # Errors
    /// If it is there and cannot be read.
    pub fn mismatch(&self, path: &Path) -> Result<Option<String>, RunsError> {
        if !is_there(path)? {
            return Ok(Some("missing".to_owned()));
        }
        let found = Self::of(path)?;
        Ok(if found.bytes < self.bytes {
            // The digest of the whole does not tell whether this is its beginning.
            Some(format!("cut off or altered: {} bytes of {}", found.bytes, self.bytes))
        } else if found != *self {
            Some(ALTERED.to_owned())
        } else {
            None
        })
    }
}

/// What made a run, and what it made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of this file's format.
    pub format: u32,
    /// Version of mcvl.
    pub version: String,
    /// Commit it was built from, where known.
    pub commit: Option<String>,
    /// Compiler that built it.
    pub compiler: String,
    /// Platform it was built for.
    pub target: String,
    /// Vector unit that core chose: it changes speed, never a bit.
    pub vector: String,
    /// Processor.
    pub cpu: String,
    /// Cores that were there.
    pub cores: usize,
    /// Version of MuJoCo, where it moves the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mujoco: Option<String>,
    /// Where forecasts were made besides the processor, in every session so far: adapters, or why not there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forecasts: Vec<String>,
    /// When training began (UTC).
    pub started: String,
    /// When it ended last (UTC).
    pub ended: Option<String>,
    /// Wall time of training so far, milliseconds, without the pauses between sessions. Runs of before this was counted
    /// have none, nor those that were trained beside others or of which a session was killed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trained_ms: Option<u64>,
    /// Whether no clock tells what the training took: other runs were trained at the same time, or a session was killed
    /// or failed, whose time nobody counted.
    #[serde(default, skip_serializing_if = "is_false")]
    pub beside: bool,
    /// How the run stands.
    pub state: State,
    /// Finished files, by path in the run directory with `/` between folders.
    pub files: BTreeMap<String, FileDigest>,
    /// Digest of this file without this field.
    #[serde(default)]
    pub seal: String,
}

impl Manifest {
    /// The manifest of a run that begins now on this machine.
    pub fn begin() -> Self {
        Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: Some(env!("MCVL_BUILD_COMMIT").to_owned()).filter(|commit| !commit.is_empty()),
            compiler: env!("MCVL_BUILD_COMPILER").to_owned(),
            target: env!("MCVL_BUILD_TARGET").to_owned(),
            vector: mcvl_core::nn::isa::Isa::active().name().to_owned(),
            cpu: cpu(),
            cores: thread::available_parallelism().map_or(1, usize::from),
            mujoco: None,
            forecasts: Vec::new(),
            started: now(),
            ended: None,
            trained_ms: Some(0),
            beside: false,
            state: State::Running,
            files: BTreeMap::new(),
            seal: String::new(),
        }
    }

    /// Notes what moves the world of a run.
    pub fn moved_by(&mut self, physics: Simulator) {
        let library = (physics == Simulator::Mujoco).then(mujoco::library);
        self.mujoco = library.and_then(Result::ok).map(|library| library.version);
    }

    /// Notes where forecasts are made, or why not there.
    pub fn forecasts_on(&mut self, place: String) {
        if !self.forecasts.contains(&place) {
            self.forecasts.push(place);
        }
    }

    /// Names this program and machine, too, where others trained before.
    pub fn continued(&mut self) {
        let Self { version, commit, compiler, target, vector, cpu, .. } = Self::begin();
        let fields = [
            (&mut self.version, version),
            (&mut self.compiler, compiler),
            (&mut self.target, target),
            (&mut self.vector, vector),
            (&mut self.cpu, cpu),
        ];
        for (all, own) in fields {
            join(all, &own);
        }
        if let Some(own) = commit {
            join(self.commit.get_or_insert_default(), &own);
        }
    }

    /// Counts time in which training went on; not in a manifest that never counted any.
    pub fn add_time(&mut self, time: Duration) {
        let more = u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        self.trained_ms = self.trained_ms.map(|before| before.saturating_add(more));
    }

    /// Gives up counting: other runs are trained at the same time, or a session ended without saying what it took.
    pub fn forget_time(&mut self) {
        (self.trained_ms, self.beside) = (None, true);
    }

    /// Wall time of training: counted, or in runs of before it was, from begin to end with the pauses. None where other
    /// runs were trained at the same time.
    pub fn training_time(&self) -> Option<Duration> {
        let span = || {
            let parse = |text: &str| humantime::parse_rfc3339(text).ok();
            parse(self.ended.as_deref()?)?.duration_since(parse(&self.started)?).ok()
        };
        self.trained_ms.map(Duration::from_millis).or_else(|| span().filter(|_| !self.beside))
    }

    fn sealed(&self) -> String {
        let bare = Self { seal: String::new(), ..self.clone() };
        sha256(&serde_json::to_vec(&bare).expect("a manifest is plain data"))
    }

    /// Reads the manifest of a run.
    ///
    /// # Errors
    /// If it cannot be read, is none, or is of another version.
    pub fn read(run: &RunDir) -> Result<Self, RunsError> {
        let path = run.manifest();
        #[derive(Deserialize)]
        struct Head {
            format: u32,
            version: String,
        }
        let bytes = fs::read(&path).map_err(RunsError::io("read", &path))?;
        let damaged = |error: serde_json::Error| RunsError::damaged(&path, format!("is no manifest: {error}"));
        let head: Head = serde_json::from_slice(&bytes).map_err(damaged)?;
        if head.format != FORMAT {
            let Head { format, version } = head;
            return Err(RunsError::damaged(
                &path,
                format!(
                    "has format version {format}, this program reads version {FORMAT}: use mcvl {version}, which wrote it"
                ),
            ));
        }
        serde_json::from_slice(&bytes).map_err(damaged)
    }

    /// Reads the manifest of a run that is to be relied on.
    ///
    /// # Errors
    /// As [`read`](Self::read), and if it is not as it was written.
    pub fn read_intact(run: &RunDir) -> Result<Self, RunsError> {
        let manifest = Self::read(run)?;
        if !manifest.is_intact() {
            return Err(RunsError::damaged(&run.manifest(), "was altered: its seal does not fit"));
        }
        Ok(manifest)
    }

    /// Whether it knows a seed as finished.
    pub fn knows(&self, run: &RunDir, seed: &SeedDir) -> bool {
        self.digest(run, &seed.metrics()).is_some()
    }

    /// Reads the manifest that a run is relied on by; none where the run was killed between its first two files, when
    /// nothing was trained yet.
    ///
    /// # Errors
    /// As [`read_intact`](Self::read_intact).
    pub fn of_run(run: &RunDir) -> Result<Option<Self>, RunsError> {
        match Self::read_intact(run) {
            Err(RunsError::Io { source, .. }) if source.kind() == ErrorKind::NotFound && !run.has_seeds()? => Ok(None),
            other => other.map(Some),
        }
    }

    /// Compares run.toml with its digest.
    ///
    /// # Errors
    /// If it was altered since the run began, or cannot be read.
    pub fn check_plan(&self, run: &RunDir) -> Result<(), RunsError> {
        match self.files.get("run.toml") {
            Some(expected) if *expected != FileDigest::of(&run.plan())? => {
                let why = "was altered since the run began: its digest is not the one in manifest.json";
                Err(RunsError::damaged(&run.plan(), why))
            }
            _ => Ok(()),
        }
    }

    /// The digest of a file, where the manifest knows it.
    pub fn digest(&self, run: &RunDir, path: &Path) -> Option<&FileDigest> {
        self.files.get(&name(run, path))
    }

    /// Whether the manifest is as it was written.
    pub fn is_intact(&self) -> bool {
        self.seal == self.sealed()
    }

    /// Writes the manifest, with the digests of the files at the top of the run and of `seeds`.
    ///
    /// # Errors
    /// If a file cannot be read or the manifest not be written.
    pub fn write(&mut self, run: &RunDir, state: State, seeds: &[u64]) -> Result<(), RunsError> {
        self.state = state;
        self.ended = (state != State::Running).then(now);
        let dirs = seeds.iter().map(|seed| run.seed(*seed));
        let (known, new): (Vec<SeedDir>, Vec<SeedDir>) = dirs.partition(|dir| self.knows(run, dir));
        // A seed that was finished before keeps its digests: made anew they would vouch for what was altered since.
        let known: Vec<String> = known.iter().map(|dir| name(run, dir.path()) + "/").collect();
        self.files.retain(|file, _| known.iter().any(|folder| file.starts_with(folder)));
        let top = [run.plan(), run.summary(), run.curves("svg"), run.curves("png")];
        let mut files: Vec<PathBuf> = top.into_iter().filter(|path| path.exists()).collect();
        new.iter().try_for_each(|dir| list(dir.path(), &mut files))?;
        for path in files {
            self.files.insert(name(run, &path), FileDigest::of(&path)?);
        }
        self.seal = self.sealed();
        let text = serde_json::to_string_pretty(self).expect("a manifest is plain data") + "\n";
        write_atomic(&run.manifest(), text.as_bytes())
    }
}

/// Between the names of several machines or programs.
pub const SEPARATOR: &str = "; ";

/// Adds a name to those in a text, if it is not among them.
fn join(all: &mut String, own: &str) {
    if !all.split(SEPARATOR).any(|known| known == own) {
        let separator = if all.is_empty() { "" } else { SEPARATOR };
        *all += &format!("{separator}{own}");
    }
}

fn is_false(value: &bool) -> bool {
    !value
}

/// Path inside the run directory, the same on every platform.
pub fn name(run: &RunDir, path: &Path) -> String {
    let inside = path.strip_prefix(run.path()).unwrap_or(path);
    inside.iter().map(|part| part.to_string_lossy()).collect::<Vec<_>>().join("/")
}

/// Adds every file under `folder`.
pub fn list(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), RunsError> {
    for entry in fs::read_dir(folder).map_err(RunsError::io("read the folder", folder))? {
        let path = entry.map_err(RunsError::io("read the folder", folder))?.path();
        if path.is_dir() {
            list(&path, files)?;
        } else if !is_temporary(&path.to_string_lossy()) {
            files.push(path);
        }
    }
    Ok(())
}

fn now() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string()
}

/// Name of the processor, as far as the system tells.
pub fn cpu() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    model.map_or_else(|| env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_names_everything_that_trained_it() {
        let mut manifest = Manifest::begin();
        let fresh = manifest.clone();
        manifest.continued();
        assert_eq!(manifest, fresh);
        (manifest.version, manifest.cpu, manifest.commit) = ("0.0.1".to_owned(), "Other".to_owned(), None);
        manifest.continued();
        manifest.continued();
        assert_eq!(manifest.version, format!("0.0.1; {}", fresh.version));
        assert_eq!(manifest.cpu, format!("Other; {}", fresh.cpu));
        assert_eq!(manifest.commit.unwrap_or_default(), fresh.commit.unwrap_or_default());
    }
}
