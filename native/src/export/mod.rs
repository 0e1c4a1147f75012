//! Runs in the formats that other tools read.
//!
//! Nothing here chooses a place or writes: an export is a list of [`File`]s, made from what a run directory
//! holds. An unfinished run gives what it has so far.

mod csv;
mod tensorboard;

use std::fs;
use std::path::PathBuf;

use safetensors::SafeTensors;

use crate::runs::{Reader, RunsError, SeedRun, run_tape};

pub use csv::csv;
pub use tensorboard::tensorboard;

/// A file of an export.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Where it goes, in the folder of the export.
    pub path: PathBuf,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl File {
    fn new(path: impl Into<PathBuf>, bytes: impl Into<Vec<u8>>) -> Self {
        Self { path: path.into(), bytes: bytes.into() }
    }
}

/// Tapes: one file per seed, whole enough to be played, with the checks of which `wanted` says so.
///
/// # Errors
/// If a file of a seed cannot be read, or is not what was written.
pub fn tapes(run: &Reader, seeds: &[&SeedRun], wanted: &dyn Fn(u32) -> bool) -> Result<Vec<File>, RunsError> {
    let tape = |seed: &&SeedRun| {
        let text = run_tape(run, seed.seed, wanted)?;
        Ok(File::new(format!("seed-{}.json", seed.seed), text))
    };
    seeds.iter().map(tape).collect()
}

/// The weights at the end of every finished leg. Of a finished seed the manifest vouches for them; of one under way
/// nothing does yet, except that they are tensors.
///
/// # Errors
/// If a file is missing, or is not what was written.
pub fn weights(run: &Reader, seeds: &[&SeedRun]) -> Result<Vec<File>, RunsError> {
    let mut files = Vec::new();
    for seed in seeds {
        for end in &seed.ends {
            let path = seed.dir().weights(end.arm);
            run.check_file(&path)?;
            let bytes = fs::read(&path).map_err(RunsError::io("read", &path))?;
            SafeTensors::deserialize(&bytes)
                .map_err(|error| RunsError::damaged(&path, format!("holds no tensors: {error}")))?;
            files.push(File::new(format!("seed-{}/{}.safetensors", seed.seed, end.arm.name()), bytes));
        }
    }
    Ok(files)
}
