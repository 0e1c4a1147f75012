//! Writing a seed's files: logs that only grow, and whole files that appear at once.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU64, Ordering};

use mcvl_core::config::Config;
use mcvl_core::env::{ActionSpec, EnvSpec, EpisodeEnd};
use mcvl_core::record::{Arm, CheckRecord, Event, Recorder, StepRecord};
use mcvl_core::run::Run;
use sha2::{Digest as _, Sha256};

use super::chain::{Chain, LedgerLine, hex, sha256, sha256_of};
use super::checkpoint::{LogMarks, Mark};
use super::layout::{SeedDir, TEMPORARY, folder_of, is_temporary};
use super::{RunDir, RunsError};
use crate::worlds::{actions, observation};

/// Columns of `steps.csv`.
pub const STEP_COLUMNS: &str = "arm,step,action,reward_raw,performance,reward,predicted,checked,stored,end";

/// Writes a file so that readers see the old content or the new, never a part; it has reached the disk
/// when this returns.
///
/// # Errors
/// If the file cannot be written; what was there is then untouched.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), RunsError> {
    // Of its own for each write: two that write the same file must not meet in one.
    static WRITES: AtomicU64 = AtomicU64::new(0);
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}-{}{TEMPORARY}", process::id(), WRITES.fetch_add(1, Ordering::Relaxed)));
    let temporary = path.with_file_name(name);
    let written = File::create(&temporary)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| fs::rename(&temporary, path));
    if written.is_err() {
        // What is left of it would only take up room on a full disk. That it is gone is not essential.
        let _ = fs::remove_file(&temporary);
    }
    written.map_err(RunsError::io("write", path))?;
    sync_folder(folder_of(path))
}

/// Makes renames and new names in a folder durable.
fn sync_folder(path: &Path) -> Result<(), RunsError> {
    // Only Unix opens folders as files; elsewhere the rename itself has to do.
    if cfg!(unix) {
        File::open(path).and_then(|folder| folder.sync_all()).map_err(RunsError::io("sync the folder", path))?;
    }
    Ok(())
}

/// Deletes what a process that is gone was writing in a folder, of the files that are this process's to write.
pub(super) fn clear_temporaries(folder: &Path, own: impl Fn(&str) -> bool) -> Result<(), RunsError> {
    for entry in fs::read_dir(folder).map_err(RunsError::io("read the folder", folder))? {
        let path = entry.map_err(RunsError::io("read the folder", folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if is_temporary(&name) && own(&name) {
            fs::remove_file(&path).map_err(RunsError::io("delete", &path))?;
        }
    }
    Ok(())
}

/// The right to write to a run directory; given up when dropped, also by a kill.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "held for its lock")] File);

impl Lock {
    /// Takes the lock of a run directory, which must exist.
    ///
    /// # Errors
    /// If another process holds it, or the folder cannot be written to.
    pub fn take(run: &RunDir) -> Result<Self, RunsError> {
        let (path, file) = Self::open(run)?;
        match file.try_lock() {
            Ok(()) => Ok(Self(file)),
            Err(TryLockError::WouldBlock) => Err(RunsError::Request(format!(
                "another mcvl is training in {}: wait for it, stop it (it saves its state), or choose another \
                 directory with -o",
                run.path().display()
            ))),
            Err(TryLockError::Error(source)) => Err(RunsError::Io { doing: "lock", path, source }),
        }
    }

    /// Takes the lock of a folder, which must exist, as soon as nobody else holds it.
    ///
    /// # Errors
    /// If the folder cannot be written to.
    pub fn wait(folder: &RunDir) -> Result<Self, RunsError> {
        let (path, file) = Self::open(folder)?;
        file.lock().map_err(RunsError::io("lock", &path))?;
        Ok(Self(file))
    }

    fn open(folder: &RunDir) -> Result<(PathBuf, File), RunsError> {
        let path = folder.lock();
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(&path);
        let file = file.map_err(RunsError::io("create", &path))?;
        Ok((path, file))
    }
}

/// A file that only grows, with the digest of what it holds.
struct Log {
    path: PathBuf,
    file: BufWriter<File>,
    bytes: u64,
    digest: Sha256,
}

impl Log {
    fn create(path: PathBuf) -> Result<Self, RunsError> {
        let file = File::create(&path).map_err(RunsError::io("create", &path))?;
        Ok(Self { path, file: BufWriter::new(file), bytes: 0, digest: Sha256::new() })
    }

    /// Continues behind the marked part; what a killed process wrote after it is cut off.
    fn reopen(path: PathBuf, mark: &Mark) -> Result<Self, RunsError> {
        let digest = check_mark(&path, mark)?;
        let mut file = OpenOptions::new().write(true).open(&path).map_err(RunsError::io("open", &path))?;
        file.set_len(mark.bytes)
            .and_then(|()| file.seek(SeekFrom::End(0)))
            .map_err(RunsError::io("continue", &path))?;
        Ok(Self { path, file: BufWriter::new(file), bytes: mark.bytes, digest })
    }

    fn line(&mut self, line: &str) -> Result<(), RunsError> {
        for part in [line.as_bytes(), b"\n"] {
            self.file.write_all(part).map_err(RunsError::io("write", &self.path))?;
            self.bytes += part.len() as u64;
            self.digest.update(part);
        }
        Ok(())
    }

    /// Brings everything to the disk and says how far the file reaches.
    fn sync(&mut self) -> Result<Mark, RunsError> {
        self.file.flush().and_then(|()| self.file.get_ref().sync_data()).map_err(RunsError::io("write", &self.path))?;
        Ok(Mark { bytes: self.bytes, sha256: hex(&self.digest.clone().finalize()) })
    }
}

/// Compares the beginning of a log with its mark; gives the digest to go on with.
pub fn check_mark(path: &Path, mark: &Mark) -> Result<Sha256, RunsError> {
    let file = File::open(path).map_err(RunsError::io("open", path))?;
    let length = file.metadata().map_err(RunsError::io("read", path))?.len();
    if length < mark.bytes {
        let why = format!(
            "is cut off: {length} bytes, the checkpoint counts {}; restore the file, or start over with --overwrite",
            mark.bytes
        );
        return Err(RunsError::damaged(path, why));
    }
    let (_, digest) = sha256_of(file.take(mark.bytes)).map_err(RunsError::io("read", path))?;
    if hex(&digest.clone().finalize()) != mark.sha256 {
        let why = "was altered since the checkpoint was written; restore the file, or start over with --overwrite";
        return Err(RunsError::damaged(path, why));
    }
    Ok(digest)
}

/// Checks every log of a seed against its marks, without changing anything.
///
/// # Errors
/// If one is cut off, altered or cannot be read.
pub fn check_logs(dir: &SeedDir, marks: &LogMarks) -> Result<(), RunsError> {
    check_mark(&dir.metrics(), &marks.metrics)?;
    check_mark(&dir.steps(), &marks.steps)?;
    check_mark(&dir.ledger(), &marks.ledger)?;
    Ok(())
}

/// How an episode ended, in a table.
pub fn end_name(end: Option<EpisodeEnd>) -> &'static str {
    match end {
        None => "",
        Some(EpisodeEnd::Terminated) => "terminated",
        Some(EpisodeEnd::Truncated) => "truncated",
    }
}

/// The row of a step in `steps.csv`. Numbers are printed with the fewest digits that read back exactly.
pub fn step_row(step: &StepRecord) -> String {
    let end = end_name(step.end);
    format!(
        "{},{},{},{},{},{},{},{},{},{end}",
        step.arm.name(),
        step.step,
        step.action,
        step.reward_raw,
        step.performance,
        step.reward,
        step.predicted,
        step.checked,
        step.stored,
    )
}

/// Writes the events of one seed to its files.
pub struct SeedWriter {
    dir: SeedDir,
    metrics: Log,
    steps: Log,
    ledger: Log,
    chain: Chain,
    checks: u32,
    failure: Option<RunsError>,
}

impl SeedWriter {
    /// Empty files for a new seed; `config` is the text to which its ledger is chained.
    ///
    /// # Errors
    /// If they cannot be made.
    pub fn create(dir: &SeedDir, config: &Config) -> Result<Self, RunsError> {
        for folder in [dir.tapes(), dir.checkpoints()] {
            fs::create_dir_all(&folder).map_err(RunsError::io("create the folder", &folder))?;
            clear_temporaries(&folder, |_| true)?;
        }
        let mut steps = Log::create(dir.steps())?;
        steps.line(STEP_COLUMNS)?;
        let (metrics, ledger) = (Log::create(dir.metrics())?, Log::create(dir.ledger())?);
        // A checkpoint counts on the names of its logs, too.
        [dir.path(), folder_of(dir.path())].into_iter().try_for_each(sync_folder)?;
        Ok(Self {
            metrics,
            steps,
            ledger,
            chain: Chain::start(&config.to_string()),
            checks: 0,
            failure: None,
            dir: dir.clone(),
        })
    }

    /// Continues where a checkpoint stood.
    ///
    /// # Errors
    /// As [`check_logs`].
    pub fn reopen(dir: &SeedDir, marks: &LogMarks) -> Result<Self, RunsError> {
        // What a killed process left half written nobody else clears away.
        [dir.tapes(), dir.checkpoints()].iter().try_for_each(|folder| clear_temporaries(folder, |_| true))?;
        Ok(Self {
            metrics: Log::reopen(dir.metrics(), &marks.metrics)?,
            steps: Log::reopen(dir.steps(), &marks.steps)?,
            ledger: Log::reopen(dir.ledger(), &marks.ledger)?,
            chain: Chain::from_value(&marks.chain),
            checks: marks.checks,
            failure: None,
            dir: dir.clone(),
        })
    }

    /// Brings everything to the disk; the marks of where it ends.
    ///
    /// # Errors
    /// The first failure since the last call: recorders have nobody to tell.
    pub fn sync(&mut self) -> Result<LogMarks, RunsError> {
        self.healthy()?;
        // The end of a leg, which stands in the metrics, is the last to reach the disk: what is told of a finished leg
        // is all there.
        let (ledger, steps) = (self.ledger.sync()?, self.steps.sync()?);
        let metrics = self.metrics.sync()?;
        Ok(LogMarks { metrics, steps, ledger, chain: self.chain.value().to_owned(), checks: self.checks })
    }

    /// The first failure while recording, if there was one.
    ///
    /// # Errors
    /// That failure.
    pub fn healthy(&mut self) -> Result<(), RunsError> {
        self.failure.take().map_or(Ok(()), Err)
    }

    fn write(&mut self, event: &Event) -> Result<(), RunsError> {
        match event {
            Event::Step(step) => self.steps.line(&step_row(step)),
            Event::Check(check) => self.check(check),
            _ => self.metrics.line(&serde_json::to_string(event).expect("an event is plain data")),
        }
    }

    fn check(&mut self, check: &CheckRecord) -> Result<(), RunsError> {
        // The tape comes first: a line of the ledger never names a tape that is not there.
        let tape = serde_json::to_vec(check).expect("a check is plain data");
        write_atomic(&self.dir.tape(check.number), &tape)?;
        self.checks = check.number;
        self.ledger.line(&LedgerLine::seal(check, &sha256(&tape), &mut self.chain).text())
    }
}

impl Recorder for SeedWriter {
    fn record(&mut self, event: &Event) {
        if self.failure.is_none() {
            self.failure = self.write(event).err();
        }
    }
}

/// Saves the weights of a run in the format that other programs read.
///
/// # Errors
/// If the file cannot be written.
pub fn write_weights(path: &Path, run: &Run, leg: Arm) -> Result<(), RunsError> {
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = run
        .tensors()
        .into_iter()
        .map(|(name, shape, values)| (name, shape, values.iter().flat_map(|value| value.to_le_bytes()).collect()))
        .collect();
    let views = tensors.iter().map(|(name, shape, bytes)| {
        let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes);
        (name, view.expect("a tensor has as many values as its shape says"))
    });
    // One entry only: the crate's map has no stable order, and the file is promised byte for byte.
    let about = [("config".to_owned(), run.config().to_string())].into();
    let bytes = safetensors::serialize(views, Some(about)).expect("names of tensors are distinct");
    let bytes = with_entry(&bytes, "layout", &layout(run.spec()));
    write_atomic(path, &with_entry(&bytes, "leg", leg.name()))
}

/// What the numbers mean, for whoever reads them without this program.
fn layout(spec: &EnvSpec) -> String {
    let networks = match spec.actions {
        ActionSpec::Discrete(_) => {
            "value: observation to one value per action. reward: observation, then the action as one-hot, to a reward."
        }
        ActionSpec::Continuous { .. } => {
            "actor: observation to numbers whose tanh, from -1 to 1, spans the range of the action. critic_0, critic_1: \
             observation, then the action, to its value. reward: observation, then the action, to a reward."
        }
    };
    let (actions, scale, observation) = (actions(spec).join(", "), spec.reward_scale, observation(spec));
    format!(
        "Weights are [inputs, outputs]: y = x W + b, with ReLU between layers and none after the last. {networks} \
         NETWORK_target is its target network. Actions: {actions}. Rewards and values are raw ones times {scale}. \
         Observation: {observation}."
    )
}

/// A file of tensors with one more entry, the first, in what it says of itself.
fn with_entry(file: &[u8], key: &str, value: &str) -> Vec<u8> {
    const HEAD: &[u8] = b"{\"__metadata__\":{";
    let (length, rest) = file.split_first_chunk().expect("a file of tensors begins with the length of its header");
    let (header, tensors) = rest.split_at(u64::from_le_bytes(*length) as usize);
    let others = header.strip_prefix(HEAD).expect("the header begins with what the file says of itself");
    let entry = format!("{}:{},", serde_json::json!(key), serde_json::json!(value));
    let mut header = [HEAD, entry.as_bytes(), others.trim_ascii_end()].concat();
    // The tensors stay aligned.
    header.resize(header.len().next_multiple_of(8), b' ');
    [&(header.len() as u64).to_le_bytes(), &header[..], tensors].concat()
}

#[cfg(test)]
mod tests {
    use super::super::chain::tests::check;
    use super::*;
    use mcvl_core::config::Preset;
    use mcvl_core::record::{Arm, EndRecord};

    fn step(number: u32, predicted: f32) -> StepRecord {
        StepRecord {
            arm: Arm::Safe,
            step: number,
            action: mcvl_core::env::Discrete(1).into(),
            reward_raw: -0.0,
            performance: 5.0,
            reward: 1e-30,
            predicted,
            checked: true,
            stored: false,
            end: Some(EpisodeEnd::Truncated),
        }
    }

    /// An empty folder of this test.
    fn folder(name: &str) -> SeedDir {
        let path = std::env::temp_dir().join(format!("mcvl-write-{name}-{}", process::id()));
        let _ = fs::remove_dir_all(&path);
        RunDir::new(path).seed(0)
    }

    #[test]
    fn who_write_one_file_at_a_time_never_meet() {
        let folder = mcvl_tests::scratch();
        let path = folder.path().join("table");
        let whole = |size: usize| vec![b'a' + size as u8; 1000 * size];
        std::thread::scope(|scope| {
            let writers: Vec<_> = (1..5)
                .map(|size| {
                    let (path, bytes) = (&path, whole(size));
                    scope.spawn(move || (0..50).try_for_each(|_| write_atomic(path, &bytes)))
                })
                .collect();
            while writers.iter().any(|writer| !writer.is_finished()) {
                let seen = fs::read(&path).unwrap_or_default();
                assert!((0..5).any(|size| seen == whole(size)), "{} bytes", seen.len());
            }
            writers.into_iter().for_each(|writer| writer.join().unwrap().unwrap());
        });
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_end_of_a_leg_is_the_last_to_be_written() {
        let folder = mcvl_tests::scratch();
        let dir = RunDir::new(folder.path()).seed(0);
        let config = Config::new("box-moving", Preset::Paper).unwrap();
        for full in [dir.ledger(), dir.steps()] {
            let mut writer = SeedWriter::create(&dir, &config).unwrap();
            // A disk that is full for one of the logs.
            let log = if full == dir.ledger() { &mut writer.ledger } else { &mut writer.steps };
            log.file = BufWriter::new(OpenOptions::new().write(true).open("/dev/full").unwrap());
            log.line("a decision").unwrap();
            writer.record(&Event::End(EndRecord { arm: Arm::Mc, steps: 1, updates: 1, digest: String::new() }));
            assert!(writer.sync().is_err());
            assert_eq!(dir.metrics().metadata().unwrap().len(), 0, "{}", full.display());
        }
    }

    #[test]
    fn rows_read_back_to_the_last_bit() {
        for predicted in [0.1f32, 1.0 / 3.0, f32::MIN_POSITIVE, -1.17e-38, 16_777_217.0, f32::MAX] {
            let row = step_row(&step(7, predicted));
            let cells: Vec<&str> = row.split(',').collect();
            assert_eq!(cells.len(), STEP_COLUMNS.split(',').count());
            assert_eq!(cells[6].parse::<f32>().unwrap().to_bits(), predicted.to_bits());
            assert_eq!(cells[3].parse::<f32>().unwrap().to_bits(), (-0.0f32).to_bits());
            assert_eq!((cells[0], cells[1], cells[7], cells[9]), ("safe", "7", "true", "truncated"));
        }
    }

    #[test]
    fn a_writer_that_is_cut_and_reopened_leaves_the_same_bytes() {
        let config = Config::new("box-moving", Preset::Paper).unwrap();
        let (straight, cut) = (folder("straight"), folder("cut"));
        let end = EndRecord { arm: Arm::Safe, steps: 4, updates: 0, digest: "00".to_owned() };
        let events: Vec<Event> = (1..5)
            .flat_map(|n| [Event::Step(step(n, 0.1)), Event::Check(Box::new(check(n)))])
            .chain([Event::End(end)])
            .collect();
        let mut writer = SeedWriter::create(&straight, &config).unwrap();
        events.iter().for_each(|event| writer.record(event));
        let marks = writer.sync().unwrap();

        let mut writer = SeedWriter::create(&cut, &config).unwrap();
        events[..3].iter().for_each(|event| writer.record(event));
        let early = writer.sync().unwrap();
        // Work after the checkpoint, then a kill: some of it reached the disk.
        events[3..6].iter().for_each(|event| writer.record(event));
        writer.sync().unwrap();
        drop(writer);
        let mut writer = SeedWriter::reopen(&cut, &early).unwrap();
        events[3..].iter().for_each(|event| writer.record(event));
        assert_eq!(writer.sync().unwrap(), marks);
        for file in [SeedDir::metrics, SeedDir::steps, SeedDir::ledger] {
            assert_eq!(fs::read(file(&cut)).unwrap(), fs::read(file(&straight)).unwrap());
        }

        // Shorter or altered logs are refused and stay as they are.
        let length = fs::metadata(cut.ledger()).unwrap().len();
        OpenOptions::new().write(true).open(cut.ledger()).unwrap().set_len(length - 1).unwrap();
        let error = SeedWriter::reopen(&cut, &marks).err().unwrap().to_string();
        assert!(error.contains("ledger.jsonl: is cut off"), "{error}");
        let mut bytes = fs::read(cut.metrics()).unwrap();
        bytes[5] ^= 1;
        fs::write(cut.metrics(), &bytes).unwrap();
        let error = check_logs(&cut, &marks).unwrap_err().to_string();
        assert!(error.contains("metrics.jsonl: was altered"), "{error}");
        assert_eq!(fs::read(cut.metrics()).unwrap(), bytes);
        for dir in [straight, cut] {
            fs::remove_dir_all(dir.path().parent().unwrap()).unwrap();
        }
    }

    #[test]
    fn a_write_that_fails_leaves_what_was_there() {
        let folder = mcvl_tests::scratch();
        let path = folder.path().join("file");
        write_atomic(&path, b"old").unwrap();
        write_atomic(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        // The name is that of a folder.
        fs::create_dir(folder.path().join("other")).unwrap();
        let error = write_atomic(&folder.path().join("other"), b"new").unwrap_err();
        assert!(error.to_string().starts_with("cannot write"), "{error}");
        let mut left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["file", "other"]);
    }
}
