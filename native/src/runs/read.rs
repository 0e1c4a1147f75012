//! Reading run directories back.

use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Read as _, Take};
use std::path::{Path, PathBuf};

use mcvl_core::config::Learner;
use mcvl_core::record::{Arm, CheckRecord, Event};

use super::chain::{Chain, LedgerLine, sha256};
use super::checkpoint::LogMarks;
use super::manifest::ALTERED;
use super::{FileDigest, Plan, Reader, RunDir, RunSet, RunsError, SeedDir, SeedRun};

impl RunSet {
    /// Reads the run that `path` names: a run directory, or the folder of one seed in it.
    ///
    /// # Errors
    /// As [`Reader::open`] and [`Reader::set`].
    pub fn read(path: &Path) -> Result<Self, RunsError> {
        Reader::open(path)?.set()
    }
}

impl SeedRun {
    /// Where its files lie.
    pub fn dir(&self) -> SeedDir {
        RunDir::new(self.path.parent().unwrap_or(Path::new(""))).seed(self.seed)
    }

    /// Reads one seed, whatever vouches for its files.
    ///
    /// # Errors
    /// If a file is damaged or missing.
    pub(super) fn read(dir: &SeedDir, plan: &Plan) -> Result<Self, RunsError> {
        let mut seed = Self {
            seed: dir.seed(),
            path: dir.path().to_owned(),
            evaluations: Vec::new(),
            learner: Vec::new(),
            episodes: Vec::new(),
            checks: Vec::new(),
            unchecked_hacks: unchecked_hacks(&dir.steps()),
            ends: Vec::new(),
            complete: false,
        };
        let path = dir.metrics();
        for (number, line) in Lines::open(&path)?.enumerate() {
            let event = serde_json::from_str(&line?)
                .map_err(|error| RunsError::damaged(&path, format!("line {} is no event: {error}", number + 1)))?;
            match event {
                Event::Episode(record) => seed.episodes.push(record),
                Event::Evaluation(record) => seed.evaluations.push(record),
                Event::Learner(record) => seed.learner.push(record),
                Event::End(record) => seed.ends.push(record),
                Event::Start(_) | Event::Step(_) | Event::Check(_) => {}
            }
        }
        seed.complete = seed.ends.len() == 1 + plan.learners.len();
        for (number, line) in ledger(dir)?.iter().enumerate() {
            let check = line.check().map_err(|error| {
                RunsError::damaged(&dir.ledger(), format!("line {} is no check: {error}", number + 1))
            })?;
            seed.checks.push(check);
        }
        Ok(seed)
    }
}

/// Steps of the checked learner in a `steps.csv` that were hacks and were not checked; none where the file is not there
/// (kept summaries may lack it) or is no such table.
fn unchecked_hacks(path: &Path) -> Option<u64> {
    // The largest of a run's files: one line of it at a time.
    let mut table = BufReader::new(File::open(path).ok()?);
    let (mut line, mut count) = (String::new(), 0);
    table.read_line(&mut line).ok()?;
    let column = |name: &str| line.trim_end().split(',').position(|column| column == name);
    let [arm, paid, worth, checked] = ["arm", "reward_raw", "performance", "checked"].map(column);
    let (arm, paid, worth, checked) = (arm?, paid?, worth?, checked?);
    loop {
        line.clear();
        table.read_line(&mut line).ok()?;
        let Some(row) = line.strip_suffix('\n') else { return Some(count) };
        let cell = |column: usize| row.split(',').nth(column);
        let number = |column: usize| cell(column)?.parse::<f32>().ok();
        if cell(arm)? == Arm::Mc.name() {
            count += u64::from(number(paid)? != number(worth)? && cell(checked)? == "false");
        }
    }
}

/// Complete lines of a log, one at a time. A last line without its end is one that is being written, or was when the
/// process was killed.
pub struct Lines {
    path: PathBuf,
    reader: BufReader<Take<File>>,
    count: usize,
}

impl Lines {
    /// Those of a whole log.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(path: &Path) -> Result<Self, RunsError> {
        Self::until(path, u64::MAX)
    }

    /// Those of its first `bytes`.
    fn until(path: &Path, bytes: u64) -> Result<Self, RunsError> {
        let reader = BufReader::new(File::open(path).map_err(RunsError::io("open", path))?.take(bytes));
        Ok(Self { path: path.to_owned(), reader, count: 0 })
    }
}

impl Iterator for Lines {
    type Item = Result<String, RunsError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut line = Vec::new();
        if let Err(error) = self.reader.read_until(b'\n', &mut line) {
            return Some(Err(RunsError::io("read", &self.path)(error)));
        }
        if line.pop() != Some(b'\n') {
            return None;
        }
        self.count += 1;
        let no_text = |_| RunsError::damaged(&self.path, format!("line {} is no text", self.count));
        Some(String::from_utf8(line).map_err(no_text))
    }
}

/// Lines of a seed's ledger.
///
/// # Errors
/// If the file cannot be read or a line has not the form of one.
pub fn ledger(dir: &SeedDir) -> Result<Vec<LedgerLine>, RunsError> {
    ledger_until(dir, u64::MAX)
}

fn ledger_until(dir: &SeedDir, bytes: u64) -> Result<Vec<LedgerLine>, RunsError> {
    let path = dir.ledger();
    let parse = |(number, line): (usize, &String)| {
        LedgerLine::parse(line)
            .ok_or_else(|| RunsError::damaged(&path, format!("line {} is no line of a ledger", number + 1)))
    };
    Lines::until(&path, bytes)?.enumerate().map(|(number, line)| parse((number, &line?))).collect()
}

/// A check with its films, which the line of the ledger vouches for.
///
/// # Errors
/// If there is no such check, or its tape is not what was written.
pub fn tape(dir: &SeedDir, number: u32, line: &LedgerLine) -> Result<CheckRecord, RunsError> {
    let path = dir.tape(number);
    let text = fs::read(&path).map_err(RunsError::io("read", &path))?;
    if sha256(&text) != line.tape {
        return Err(altered_tape(&path));
    }
    serde_json::from_slice(&text).map_err(|error| RunsError::damaged(&path, format!("is no tape: {error}")))
}

/// Checks the tape that a line of the ledger names.
///
/// # Errors
/// If it cannot be read or was altered.
pub fn check_tape(dir: &SeedDir, number: u32, line: &LedgerLine) -> Result<(), RunsError> {
    let path = dir.tape(number);
    if FileDigest::of(&path)?.sha256 == line.tape { Ok(()) } else { Err(altered_tape(&path)) }
}

fn altered_tape(path: &Path) -> RunsError {
    RunsError::damaged(path, "was altered: its digest is not the one in ledger.jsonl")
}

/// What is wrong with a ledger that should have a digest, in words; none where it has. Its chain tells what was cut off
/// from what was altered.
///
/// # Errors
/// If it is there and cannot be read.
pub fn ledger_mismatch(expected: &FileDigest, plan: &Plan, dir: &SeedDir) -> Result<Option<String>, RunsError> {
    let path = dir.ledger();
    let Some(what) = expected.mismatch(&path)? else { return Ok(None) };
    let length = path.metadata().map_or(0, |file| file.len());
    Ok(Some(match ledger(dir).map(|lines| check_chain(plan, dir, &lines)) {
        Ok(Ok(_)) if length < expected.bytes => format!("cut off: {length} bytes of {}", expected.bytes),
        Ok(Err(line)) => format!("{ALTERED}, and its chain breaks at line {line}"),
        Err(RunsError::Damaged { why, .. }) => format!("{ALTERED}, and {why}"),
        _ => what,
    }))
}

/// The number of the first line of a ledger, from 1, that breaks its chain; how many lines there are
/// otherwise.
pub fn check_chain(plan: &Plan, dir: &SeedDir, lines: &[LedgerLine]) -> Result<usize, usize> {
    let config = plan.config.with_seed(dir.seed()).with_agent(Learner::Mc);
    let mut chain = Chain::start(&config.to_string());
    match lines.iter().position(|line| !line.follows(&mut chain)) {
        Some(index) => Err(index + 1),
        None => Ok(lines.len()),
    }
}

/// Checks the tapes of the checks that a checkpoint counts. What a killed process wrote to the ledger after it is not
/// looked at: to resume cuts it off.
pub fn check_tapes(dir: &SeedDir, marks: &LogMarks) -> Result<(), RunsError> {
    let lines = ledger_until(dir, marks.ledger.bytes)?;
    (1..=marks.checks).zip(lines).try_for_each(|(number, line)| check_tape(dir, number, &line))
}

#[cfg(test)]
mod tests {
    use super::super::write::STEP_COLUMNS;
    use super::*;

    #[test]
    fn hacks_without_a_check_are_counted_in_the_checked_leg() {
        let folder = mcvl_tests::scratch();
        let path = folder.path().join("steps.csv");
        let rows = [
            "baseline,1,2,3,-1,0.6,0.5,false,true,",
            "mc,1,2,3,-1,0.6,0.5,false,true,",
            "mc,2,2,3,-1,0.6,0.1,true,true,",
            "mc,3,2,3,3,0.6,0.5,false,true,",
            "mc,4,2,3,-1,0.6,0.6,false,true,truncated",
        ];
        let of = |text: &str| {
            fs::write(&path, text).unwrap();
            unchecked_hacks(&path)
        };
        let table = format!("{STEP_COLUMNS}\n{}\n", rows.join("\n"));
        assert_eq!(of(&table), Some(2));
        assert_eq!(of(&format!("{table}mc,5,2,3,-1,0.")), Some(2), "a row that is being written is none yet");
        assert_eq!(of(&format!("{STEP_COLUMNS}\n")), Some(0));
        for wrong in ["", "a,b\n1,2\n", &format!("{table}mc,5,2\n"), &table.replace("-1", "x")] {
            assert_eq!(of(wrong), None, "{wrong}");
        }
        fs::remove_file(&path).unwrap();
        assert_eq!(unchecked_hacks(&path), None);
    }
}
