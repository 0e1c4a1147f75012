//! Checkpoints of a seed: the exact state of the run together with how far its logs reached.
//!
//! ```text
//! "mcvl checkpoint\n"  u32 format version  u32 length of header  header (JSON)
//! u64 length of state  state (`Run::snapshot`)  32 bytes SHA-256 over everything before
//! ```
//! Numbers are little-endian.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::Path;

use mcvl_core::run::Run;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::RunsError;
use super::layout::is_there;
use super::write::write_atomic;
use crate::worlds::{self, WorldError};

const MAGIC: &[u8] = b"mcvl checkpoint\n";
const VERSION: u32 = 1;
const SEAL: usize = 32;

/// How far a log reached.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mark {
    /// Length of the file.
    pub bytes: u64,
    /// Digest of that part of it.
    pub sha256: String,
}

/// How far the logs of a seed reached.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogMarks {
    /// `metrics.jsonl`.
    pub metrics: Mark,
    /// `steps.csv`.
    pub steps: Mark,
    /// `ledger.jsonl`.
    pub ledger: Mark,
    /// Value of the ledger's chain.
    pub chain: String,
    /// Checks recorded, each with a tape.
    pub checks: u32,
}

/// A checkpoint: where the job stood and the state of the run.
#[derive(Clone)]
pub struct Checkpoint {
    /// Legs that are finished; the next one is under way.
    pub finished: usize,
    /// How far the logs reached.
    pub logs: LogMarks,
    /// The run.
    pub run: Run,
}

/// What a checkpoint says before its state.
#[derive(Serialize, Deserialize)]
pub struct Header {
    config: String,
    /// Legs that are finished.
    pub finished: usize,
    /// How far the logs reached.
    pub logs: LogMarks,
}

impl Checkpoint {
    /// Writes a checkpoint, at once or not at all.
    ///
    /// # Errors
    /// If it cannot be written; the one before is then untouched.
    pub fn write(path: &Path, finished: usize, logs: &LogMarks, run: &Run) -> Result<(), RunsError> {
        let header = Header { config: run.config().to_string(), finished, logs: logs.clone() };
        write_atomic(path, &encode(&header, &run.snapshot()))
    }

    /// Reads a checkpoint back.
    ///
    /// # Errors
    /// If it cannot be read, was cut or altered, or another version wrote it.
    pub fn read(path: &Path) -> Result<Self, RunsError> {
        let bytes = fs::read(path).map_err(RunsError::io("read", path))?;
        let (header, state) = decode(&bytes).map_err(|why| RunsError::damaged(path, why))?;
        let run = worlds::resume(state).map_err(|error| match error {
            WorldError::Mujoco(_) => RunsError::Request(format!("{}: {error}", path.display())),
            WorldError::Snapshot(error) => RunsError::damaged(path, error.to_string()),
        })?;
        if run.config().to_string() != header.config {
            return Err(RunsError::damaged(path, "its header and its state are of different runs"));
        }
        Ok(Self { finished: header.finished, logs: header.logs, run })
    }

    /// What a checkpoint says, without its state and unchecked; none where there is no checkpoint.
    ///
    /// # Errors
    /// If there is one that cannot be read.
    pub fn header(path: &Path) -> Result<Option<Header>, RunsError> {
        if !is_there(path)? {
            return Ok(None);
        }
        let mut file = File::open(path).map_err(RunsError::io("read", path))?;
        let mut head = Vec::new();
        let start = file.by_ref().take(MAGIC.len() as u64 + 8).read_to_end(&mut head);
        start.map_err(RunsError::io("read", path))?;
        let length = length_of_header(&head).map_err(|why| RunsError::damaged(path, why))?;
        let mut header = Vec::new();
        file.take(length as u64).read_to_end(&mut header).map_err(RunsError::io("read", path))?;
        parse_header(&header).map(Some).map_err(|why| RunsError::damaged(path, why))
    }
}

fn encode(header: &Header, state: &[u8]) -> Vec<u8> {
    let header = serde_json::to_vec(header).expect("a header is plain data");
    let length = u32::try_from(header.len()).expect("a header is short");
    let mut bytes = [MAGIC, &VERSION.to_le_bytes(), &length.to_le_bytes(), &header].concat();
    bytes.extend_from_slice(&(state.len() as u64).to_le_bytes());
    bytes.extend_from_slice(state);
    let seal = Sha256::digest(&bytes);
    bytes.extend_from_slice(&seal);
    bytes
}

const ADVICE: &str = "restore the file, or start over with --overwrite";

/// The length of the header by what stands before it.
fn length_of_header(bytes: &[u8]) -> Result<usize, String> {
    let Some(rest) = bytes.strip_prefix(MAGIC) else {
        return Err(format!("is no checkpoint of mcvl; {ADVICE}"));
    };
    let cut = || format!("is cut off at {} bytes; {ADVICE}", bytes.len());
    let (version, rest) = rest.split_first_chunk().ok_or_else(cut)?;
    let version = u32::from_le_bytes(*version);
    if version != VERSION {
        return Err(format!(
            "has format version {version}, this program reads version {VERSION}: continue with the version of mcvl \
             that wrote it, or start over with --overwrite"
        ));
    }
    let length = rest.first_chunk().ok_or_else(cut)?;
    Ok(u32::from_le_bytes(*length) as usize)
}

fn parse_header(text: &[u8]) -> Result<Header, String> {
    serde_json::from_slice(text).map_err(|error| format!("has a header that makes no sense: {error}; {ADVICE}"))
}

fn decode(bytes: &[u8]) -> Result<(Header, &[u8]), String> {
    let length = length_of_header(bytes)?;
    let cut = || format!("is cut off at {} bytes; {ADVICE}", bytes.len());
    let (header, rest) = bytes[MAGIC.len() + 8..].split_at_checked(length).ok_or_else(cut)?;
    let (length, rest) = rest.split_first_chunk().ok_or_else(cut)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| cut())?;
    let (state, seal) = rest.split_at_checked(length).ok_or_else(cut)?;
    if seal.len() < SEAL {
        return Err(cut());
    }
    if Sha256::digest(&bytes[..bytes.len() - seal.len()]).as_slice() != seal {
        return Err(format!("was altered: its digest does not fit; {ADVICE}"));
    }
    Ok((parse_header(header)?, state))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        let mark = || Mark { bytes: 3, sha256: "00".to_owned() };
        let logs = LogMarks { metrics: mark(), steps: mark(), ledger: mark(), chain: "11".to_owned(), checks: 2 };
        Header { config: "env=box-moving".to_owned(), finished: 1, logs }
    }

    #[test]
    fn envelope_reads_back() {
        let bytes = encode(&header(), b"state");
        let (back, state) = decode(&bytes).unwrap();
        assert_eq!((back.finished, back.logs.checks, state), (1, 2, &b"state"[..]));
    }

    #[test]
    fn every_cut_and_every_flipped_bit_is_found() {
        let bytes = encode(&header(), b"state");
        for length in 0..bytes.len() {
            let why = decode(&bytes[..length]).err().unwrap();
            assert!(why.contains("cut off") || why.contains("no checkpoint"), "{length}: {why}");
        }
        for bit in 0..8 * bytes.len() {
            let mut altered = bytes.clone();
            altered[bit / 8] ^= 1 << (bit % 8);
            assert!(decode(&altered).is_err(), "bit {bit}");
        }
        let longer = [&bytes[..], b"x"].concat();
        assert!(decode(&longer).is_err());
    }

    #[test]
    fn a_state_of_another_version_is_named() {
        let config = "env=box-moving".parse().unwrap();
        let path = std::env::temp_dir().join(format!("mcvl-checkpoint-{}", std::process::id()));
        let run = Run::new(&config);
        Checkpoint::write(&path, 1, &header().logs, &run).unwrap();
        let back = Checkpoint::read(&path).unwrap();
        assert_eq!((back.finished, back.run.snapshot()), (1, run.snapshot()));
        // Core's version follows the 8 bytes that say what a snapshot is.
        let mut state = run.snapshot();
        state[8] += 1;
        fs::write(&path, encode(&header(), &state)).unwrap();
        let error = Checkpoint::read(&path).err().unwrap();
        fs::remove_file(&path).unwrap();
        assert!(matches!(error, RunsError::Damaged { .. }));
        assert!(error.to_string().contains("the snapshot has format version"), "{error}");
    }

    #[test]
    fn a_header_belongs_to_its_state() {
        let folder = mcvl_tests::scratch();
        let path = folder.path().join("state.snapshot");
        let run = Run::new(&"env=box-moving seed=7".parse().unwrap());
        let header = |seed| Header { config: run.config().with_seed(seed).to_string(), ..header() };
        fs::write(&path, encode(&header(7), &run.snapshot())).unwrap();
        assert!(Checkpoint::read(&path).is_ok());
        fs::write(&path, encode(&header(4), &run.snapshot())).unwrap();
        let error = Checkpoint::read(&path).err().unwrap().to_string();
        assert!(error.contains("its header and its state are of different runs"), "{error}");
    }

    #[test]
    fn another_version_is_named() {
        let mut bytes = encode(&header(), b"state");
        bytes[MAGIC.len()] = 9;
        assert!(decode(&bytes).err().unwrap().contains("format version 9, this program reads version 1"));
    }
}
