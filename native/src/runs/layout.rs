//! Where everything lies in a run directory, and how the command line names parts of it.

use std::borrow::Cow;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use mcvl_core::record::Arm;

use super::RunsError;
use super::write::clear_temporaries;

/// A run directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunDir(PathBuf);

/// Folder of exports. Nothing vouches for what lies there: it can be made again.
const EXPORTS: &str = "export";

/// Files that training writes at the top of a run directory.
const TRAINED: &[&str] = &["run.toml", "manifest.json", "summary.json", "curves.svg", "curves.png", ".lock"];

/// Files that reports write there.
const REPORTED: &[&str] = &["report.html", "page.html"];

fn is_own(name: &str) -> bool {
    TRAINED.contains(&name) || REPORTED.contains(&name)
}

impl RunDir {
    /// The directory at `path`, which need not exist.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Settings, seeds and learners.
    pub fn plan(&self) -> PathBuf {
        self.0.join("run.toml")
    }

    /// Machine, versions and digests.
    pub fn manifest(&self) -> PathBuf {
        self.0.join("manifest.json")
    }

    /// Claims and statistics.
    pub fn summary(&self) -> PathBuf {
        self.0.join("summary.json")
    }

    /// Learning curves: as SVG with `svg`, as PNG with `png`.
    pub fn curves(&self, extension: &str) -> PathBuf {
        self.0.join("curves").with_extension(extension)
    }

    /// The page with this run on it, as one file.
    pub fn page(&self) -> PathBuf {
        self.0.join("page.html")
    }

    /// Folder of an export that names no other place.
    pub fn export(&self, format: &str) -> PathBuf {
        self.0.join(EXPORTS).join(format)
    }

    /// Held by the process that trains here.
    pub fn lock(&self) -> PathBuf {
        self.0.join(".lock")
    }

    /// The folder of a seed.
    pub fn seed(&self, seed: u64) -> SeedDir {
        SeedDir { path: self.0.join(format!("seed-{seed}")), seed }
    }

    /// The report of this run alone.
    pub fn report(&self) -> PathBuf {
        self.0.join("report.html")
    }

    /// The seed whose ledger lies at `path`.
    pub fn seed_with_ledger(&self, path: &Path) -> Option<SeedDir> {
        let seed = seed_of(&path.parent()?.file_name()?.to_string_lossy())?;
        Some(self.seed(seed)).filter(|dir| dir.ledger() == path)
    }

    /// Whether a run is seen to be begun here.
    pub fn exists(&self) -> bool {
        self.plan().exists()
    }

    /// Whether a run was begun here.
    ///
    /// # Errors
    /// If the machine does not tell, for want of rights or for another reason.
    pub fn is_begun(&self) -> Result<bool, RunsError> {
        is_there(&self.plan())
    }

    /// Whether the folder of any seed is here.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn has_seeds(&self) -> Result<bool, RunsError> {
        let mut entries = fs::read_dir(&self.0).map_err(RunsError::io("read the folder", &self.0))?;
        Ok(entries.any(|entry| entry.is_ok_and(|entry| seed_of(&entry.file_name().to_string_lossy()).is_some())))
    }

    /// Whether nothing is here that would be in the way of a new run.
    ///
    /// # Errors
    /// If the folder cannot be read, or is none.
    pub fn is_free(&self) -> Result<bool, RunsError> {
        if !self.0.exists() {
            return Ok(true);
        }
        let mut entries = fs::read_dir(&self.0).map_err(RunsError::io("read the folder", &self.0))?;
        // A process that was killed before its first file leaves these.
        let idle = |name: &str| name == ".lock" || is_temporary(name);
        Ok(entries.all(|entry| entry.is_ok_and(|entry| idle(&entry.file_name().to_string_lossy()))))
    }

    /// The first of `DIR-2`, `DIR-3`, … that is free.
    ///
    /// # Errors
    /// If one of them cannot be read.
    pub fn next_free(&self) -> Result<Self, RunsError> {
        let mut number = 2u32;
        loop {
            let mut name = self.0.file_name().unwrap_or_default().to_owned();
            name.push(format!("-{number}"));
            let candidate = Self(self.0.with_file_name(name));
            if candidate.is_free()? {
                return Ok(candidate);
            }
            number += 1;
        }
    }

    /// Deletes what a killed process left half written of the files that training writes at the top. A report may be
    /// under way beside.
    ///
    /// # Errors
    /// If something cannot be deleted.
    pub fn clear_unfinished_writes(&self) -> Result<(), RunsError> {
        let own =
            |name: &str| TRAINED.iter().any(|file| name.strip_prefix(file).is_some_and(|rest| rest.starts_with('.')));
        clear_temporaries(&self.0, own)
    }

    /// Deletes what training, reports and exports wrote here, and nothing else; the lock stays.
    ///
    /// # Errors
    /// If something cannot be deleted.
    pub fn clear(&self) -> Result<(), RunsError> {
        let entries = fs::read_dir(&self.0).map_err(RunsError::io("read the folder", &self.0))?;
        let paths: Result<Vec<PathBuf>, _> = entries.map(|entry| entry.map(|entry| entry.path())).collect();
        let mut paths = paths.map_err(RunsError::io("read the folder", &self.0))?;
        // What says that this is a run goes last: whoever is killed over it can begin again.
        paths.sort_by_key(|path| *path == self.plan());
        for path in paths {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if seed_of(&name).is_some() || name == EXPORTS {
                fs::remove_dir_all(&path).map_err(RunsError::io("delete", &path))?;
            } else if name != ".lock" && (is_own(&name) || is_temporary(&name)) {
                fs::remove_file(&path).map_err(RunsError::io("delete", &path))?;
            }
        }
        Ok(())
    }
}

/// Ending of the names under which files are written before they are renamed.
pub const TEMPORARY: &str = ".tmp";

/// Whether a file is one that a killed process may have left half written.
pub fn is_temporary(name: &str) -> bool {
    name.ends_with(TEMPORARY)
}

/// The folder in which a path lies: that of a bare name is the current one.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether something is there. A path through a file leads nowhere.
///
/// # Errors
/// If the machine does not tell, for want of rights or for another reason.
pub fn is_there(path: &Path) -> Result<bool, RunsError> {
    match fs::exists(path) {
        Err(error) if error.kind() == ErrorKind::NotADirectory => Ok(false),
        other => other.map_err(RunsError::io("look for", path)),
    }
}

/// Fails where `path` names a file of a run that training writes: its logs, states and settings are made by nothing
/// else.
///
/// # Errors
/// If it does.
pub fn check_target(path: &Path) -> Result<(), RunsError> {
    // Whatever links lead there.
    let folder = fs::canonicalize(folder_of(path)).unwrap_or_else(|_| folder_of(path).to_owned());
    let plain = || folder.join(path.file_name().unwrap_or_default());
    let target = fs::canonicalize(path).unwrap_or_else(|_| plain());
    let belongs = |run: &&Path| {
        let first = target.strip_prefix(run).ok().and_then(|inside| inside.iter().next()).unwrap_or_default();
        let first = first.to_string_lossy();
        RunDir::new(*run).exists() && (seed_of(&first).is_some() || TRAINED.contains(&&*first))
    };
    match target.ancestors().skip(1).find(belongs) {
        Some(run) => Err(RunsError::Request(format!(
            "{} is a place of the files that training wrote in {}: name another file",
            path.display(),
            run.display()
        ))),
        None => Ok(()),
    }
}

/// A path as one word of a command that is shown to be copied.
pub fn shell_word(path: &Path) -> String {
    let text = path.to_string_lossy();
    shlex::try_quote(&text).map_or_else(|_| text.to_string(), Cow::into_owned)
}

fn seed_of(name: &str) -> Option<u64> {
    name.strip_prefix("seed-")?.parse().ok()
}

/// The folder of one seed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeedDir {
    path: PathBuf,
    seed: u64,
}

impl SeedDir {
    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Every event but steps and checks.
    pub fn metrics(&self) -> PathBuf {
        self.path.join("metrics.jsonl")
    }

    /// One row per environment step.
    pub fn steps(&self) -> PathBuf {
        self.path.join("steps.csv")
    }

    /// One line per check.
    pub fn ledger(&self) -> PathBuf {
        self.path.join("ledger.jsonl")
    }

    /// Folder of the tapes.
    pub fn tapes(&self) -> PathBuf {
        self.path.join("tapes")
    }

    /// A check with its films.
    pub fn tape(&self, number: u32) -> PathBuf {
        self.tapes().join(format!("check-{number}.json"))
    }

    /// Folder of checkpoints and weights.
    pub fn checkpoints(&self) -> PathBuf {
        self.path.join("checkpoints")
    }

    /// Whether something was logged, beyond the heads of tables.
    pub fn has_logs(&self) -> bool {
        [self.metrics(), self.ledger()].iter().any(|path| path.metadata().is_ok_and(|file| file.len() > 0))
    }

    /// The latest exact state.
    pub fn state(&self) -> PathBuf {
        self.checkpoints().join("state.snapshot")
    }

    /// The exact state at the switch, from which each learner continues.
    pub fn switch(&self) -> PathBuf {
        self.checkpoints().join("switch.snapshot")
    }

    /// Weights at the end of a leg.
    pub fn weights(&self, arm: Arm) -> PathBuf {
        self.checkpoints().join(format!("{}.safetensors", arm.name()))
    }
}

/// A run directory, or one seed of it, as named on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The run directory.
    pub run: RunDir,
    /// The seed whose folder was named.
    pub seed: Option<u64>,
}

impl Place {
    /// Finds the run that `path` names: its directory or the folder of a seed in it.
    ///
    /// # Errors
    /// If there is none.
    pub fn find(path: &Path) -> Result<Self, RunsError> {
        let run = RunDir::new(path);
        if run.is_begun()? {
            return Ok(Self { run, seed: None });
        }
        let seed = path.file_name().and_then(|name| seed_of(&name.to_string_lossy()));
        let parent = RunDir::new(folder_of(path));
        match seed {
            Some(seed) if parent.is_begun()? => Ok(Self { run: parent, seed: Some(seed) }),
            _ if is_there(path)? => Err(RunsError::Request(format!(
                "{} is no run directory: it has no run.toml (a run is made by `mcvl train`)",
                path.display()
            ))),
            _ => {
                let near = siblings(path);
                Err(RunsError::Request(format!("there is no run at {}{near}", path.display())))
            }
        }
    }
}

/// «; there are a, b»: runs beside a path that does not exist.
fn siblings(path: &Path) -> String {
    let mut names: Vec<String> = fs::read_dir(folder_of(path))
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| RunDir::new(entry.path()).exists())
        .map(|entry| path.with_file_name(entry.file_name()).display().to_string())
        .collect();
    names.sort();
    if names.is_empty() {
        "; `mcvl train ENV` makes one".to_owned()
    } else {
        format!("; there are {}", names.join(", "))
    }
}

/// `RUN#17`: a check of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reference {
    /// The run or seed.
    pub place: PathBuf,
    /// Number of the check, from 1.
    pub number: u32,
}

impl std::str::FromStr for Reference {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = "a check is named like runs/box-moving#17 or runs/box-moving/seed-3#17";
        let (place, number) = text.rsplit_once('#').ok_or_else(|| format!("`{text}` names no check: {wanted}"))?;
        match number.parse() {
            Ok(number) if number > 0 && !place.is_empty() => Ok(Self { place: place.into(), number }),
            _ => Err(format!("`{text}` names no check: {wanted}, counted from 1")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_says_that_there_is_a_run_is_deleted_last() {
        let folder = mcvl_tests::scratch();
        let run = RunDir::new(folder.path());
        for path in [run.plan(), run.manifest(), run.summary()] {
            fs::write(path, "").unwrap();
        }
        // A seed whose folder cannot be deleted, as it is none.
        fs::write(run.seed(3).path(), "").unwrap();
        assert!(run.clear().is_err() && run.exists());
        fs::remove_file(run.seed(3).path()).unwrap();
        run.clear().unwrap();
        assert!(run.is_free().unwrap());
    }

    #[test]
    fn references() {
        let reference: Reference = "runs/a#b/seed-3#17".parse().unwrap();
        assert_eq!(reference, Reference { place: "runs/a#b/seed-3".into(), number: 17 });
        for bad in ["runs/box", "runs/box#", "runs/box#0", "#4", "runs/box#-1", "runs/box#x"] {
            assert!(bad.parse::<Reference>().unwrap_err().contains("#17"), "{bad}");
        }
    }

    #[test]
    fn paths_in_commands_are_one_word() {
        assert_eq!(shell_word(Path::new("runs/box-moving")), "runs/box-moving");
        for path in ["my runs/box", "~/it's", "$HOME", "a;b"] {
            assert_eq!(shlex::split(&shell_word(Path::new(path))), Some(vec![path.to_owned()]));
            assert_ne!(shell_word(Path::new(path)), path, "the shell would take it apart or replace it");
        }
    }

    #[test]
    fn seed_folders() {
        assert_eq!(
            (seed_of("seed-7"), seed_of("seed-x"), seed_of("seed"), seed_of("seed--1")),
            (Some(7), None, None, None)
        );
    }
}
