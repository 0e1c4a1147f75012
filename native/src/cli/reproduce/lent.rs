//! Results from elsewhere: runs and records that `--from` names.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mcvl::report::claims::plural;
use mcvl::reproduce::cells::Cell;
use mcvl::reproduce::{RECORD_SUFFIX, Record};
use mcvl::runs::{Manifest, Plan, RunDir, RunSet, RunsError, State};
use mcvl_core::config::{Config, Learner};

use super::super::terminal::Terminal;
use super::super::usage;
use super::folder::joined;
use super::{ReproduceArgs, Wanted};

/// How deep `--from` looks for runs and records.
const DEPTH: u32 = 5;

/// Records of seeds that are finished elsewhere, by the cells' names, and whether a part of each was made just now, from
/// a run: several are joined; where that cannot be, the one with most seeds counts.
pub(super) fn lent(
    folders: &[PathBuf],
    wanted: &[Wanted],
    arguments: &ReproduceArgs,
    terminal: &Terminal,
) -> anyhow::Result<BTreeMap<&'static str, (Record, bool)>> {
    let mut best: BTreeMap<&'static str, (Record, bool)> = BTreeMap::new();
    for folder in folders {
        if !folder.is_dir() {
            usage!("--from {}: there is no such folder", folder.display());
        }
        let mut places = Vec::new();
        look(folder, DEPTH, &mut places)?;
        if places.is_empty() {
            usage!("--from {}: it holds neither runs nor records", folder.display());
        }
        // Records first: they spare reading runs.
        places.sort_by_key(|place| place.is_dir());
        for place in places {
            let Some((cell, record)) = lend(&place, wanted, arguments, terminal)? else { continue };
            let record = Record { cell: cell.name.to_owned(), ..record };
            let (known, made) = best.remove(cell.name).unzip();
            let before = known.as_ref().map_or(0, |known: &Record| known.seeds().len());
            let both = joined(known, Some(&record)).expect("one of them is there");
            let more = both.seeds().len() > before;
            best.insert(cell.name, (both, made.unwrap_or(false) || more && place.is_dir()));
        }
    }
    Ok(best)
}

/// Adds run directories and records below a folder, in the order of their names.
fn look(folder: &Path, depth: u32, places: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    if RunDir::new(folder).exists() {
        places.push(folder.to_owned());
        return Ok(());
    }
    let entries = fs::read_dir(folder).map_err(RunsError::io("read the folder", folder))?;
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(RunsError::io("read the folder", folder))?.path());
    }
    paths.sort();
    for path in paths {
        if path.to_string_lossy().ends_with(RECORD_SUFFIX) {
            places.push(path);
        } else if depth > 0 && path.is_dir() {
            look(&path, depth - 1, places)?;
        }
    }
    Ok(())
}

/// The record that a place has for one of the wanted cells.
fn lend(
    place: &Path,
    wanted: &[Wanted],
    arguments: &ReproduceArgs,
    terminal: &Terminal,
) -> anyhow::Result<Option<(&'static Cell, Record)>> {
    // Of the seeds that are planned, and no others, where they can be told apart.
    let asked = |wanted: &Wanted, record: Record| {
        let planned = record.seeds().iter().all(|seed| wanted.plan.seeds.contains(seed));
        let whole = planned || !record.is_joinable() && arguments.seeds.is_none();
        if whole { Some(record) } else { record.only(&wanted.plan.seeds) }
    };
    if !place.is_dir() {
        let record = Record::read(place)?;
        let config = setting(&record, place)?;
        let wanted = wanted.iter().find(|wanted| wanted.fits_record(&record, &config));
        return Ok(wanted.and_then(|wanted| Some((wanted.cell, asked(wanted, record)?))));
    }
    let run = RunDir::new(place);
    let plan = Plan::read(&run)?;
    let has = |learner: Learner| plan.learners.contains(&learner);
    let Some(wanted) = wanted.iter().find(|wanted| wanted.fits(&plan.config, false, &has)) else { return Ok(None) };
    let manifest = Manifest::read_intact(&run)?;
    // Kept summaries without the logs of their seeds have nothing to read; their records speak for them.
    if manifest.state == State::Finished && !plan.seeds.iter().all(|seed| run.seed(*seed).metrics().exists()) {
        return Ok(None);
    }
    let record = finished_seeds(wanted.cell, place, &manifest)?;
    if manifest.state != State::Finished {
        let seeds = record.as_ref().map_or("none of its seeds is".to_owned(), |record| {
            format!("{} of its {}", record.seeds().len(), plural(plan.seeds.len() as u64, "seed"))
        });
        terminal.note(format_args!("note: {} is not finished: {seeds} used", place.display()));
    }
    Ok(record.and_then(|record| Some((wanted.cell, asked(wanted, record)?))))
}

/// The configuration of a record that lies in a place.
pub(super) fn setting(record: &Record, place: &Path) -> anyhow::Result<Config> {
    Ok(record.config.parse().map_err(|error| RunsError::damaged(place, format!("{error}")))?)
}

/// The record of the finished seeds of a run; none before the first one.
pub(super) fn finished_seeds(cell: &Cell, run: &Path, manifest: &Manifest) -> anyhow::Result<Option<Record>> {
    let record = Record::of_run(cell.name, &RunSet::read(run)?, manifest);
    Ok((!record.seeds().is_empty()).then_some(record))
}
