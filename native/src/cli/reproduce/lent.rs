//! Results from elsewhere: runs and records that `--from` names.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mcvl::report::claims::{plural, seed_list};
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
/// a run: several are joined, whatever the order in which they are named; where that cannot be, the one with most seeds
/// counts.
pub(super) fn lent(
    folders: &[PathBuf],
    wanted: &[Wanted],
    arguments: &ReproduceArgs,
    terminal: &Terminal,
) -> anyhow::Result<BTreeMap<&'static str, (Record, bool)>> {
    let mut found: BTreeMap<&'static str, Vec<(Record, bool)>> = BTreeMap::new();
    for folder in folders {
        if !folder.is_dir() {
            usage!("--from {}: there is no such folder", folder.display());
        }
        let mut places = Vec::new();
        look(folder, DEPTH, &mut places)?;
        if places.is_empty() {
            usage!("--from {}: it holds neither runs nor records", folder.display());
        }
        for place in places {
            for (cell, record) in lend(&place, wanted, arguments, terminal)? {
                let record = Record { cell: cell.name.to_owned(), ..record }.of_learners(cell.learners);
                found.entry(cell.name).or_default().push((record, place.is_dir()));
            }
        }
    }
    let best = found.into_iter().map(|(cell, mut records)| {
        // The largest first, which leaves least to be added, and of equal ones a record, which is there already.
        records.sort_by(|(one, made), (other, also)| {
            let order = |record: &Record, made: bool| {
                (
                    Reverse(record.seeds().len()),
                    record.seeds().to_vec(),
                    made,
                    record.seal.clone(),
                    record.config.clone(),
                )
            };
            order(one, *made).cmp(&order(other, *also))
        });
        let all = records.into_iter().fold((None, false), |(known, made), (record, new)| {
            let before = known.as_ref().map_or(0, |known: &Record| known.seeds().len());
            let both = joined(known, Some(&record), terminal);
            let more = both.as_ref().is_some_and(|both| both.seeds().len() > before);
            (both, made || new && more)
        });
        (cell, all)
    });
    Ok(best.filter_map(|(cell, (record, made))| Some((cell, (record?, made)))).collect())
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

/// The records that a place has for the wanted cells; several may be of one setting, with other learners.
fn lend(
    place: &Path,
    wanted: &[Wanted],
    arguments: &ReproduceArgs,
    terminal: &Terminal,
) -> anyhow::Result<Vec<(&'static Cell, Record)>> {
    // Of the seeds that are planned, and no others, where they can be told apart.
    let asked = |wanted: &&Wanted, record: &Record| {
        let planned = |seed: &u64| wanted.plan.seeds.contains(seed);
        let whole = record.seeds().iter().all(planned) || !record.is_joinable() && arguments.seeds.is_none();
        let asked = if whole { Some(record.clone()) } else { record.only(&wanted.plan.seeds) };
        if asked.is_none() && record.seeds().iter().any(planned) {
            let seeds = seed_list(record.seeds());
            terminal.note(format_args!(
                "note: {} is left out: it does not tell its seeds apart, so those asked for cannot be taken from seeds \
                 {seeds}; ask for all of them, or train the cell anew",
                place.display()
            ));
        }
        Some((wanted.cell, asked?))
    };
    if !place.is_dir() {
        let record = Record::read(place)?;
        let config = setting(&record, place)?;
        let fitting = wanted.iter().filter(|wanted| wanted.fits_record(&record, &config));
        return Ok(fitting.filter_map(|wanted| asked(&wanted, &record)).collect());
    }
    let run = RunDir::new(place);
    let plan = Plan::read(&run)?;
    let has = |learner: Learner| plan.learners.contains(&learner);
    let fitting: Vec<&Wanted> = wanted.iter().filter(|wanted| wanted.fits(&plan.config, false, &has)).collect();
    let Some(first) = fitting.first() else { return Ok(Vec::new()) };
    let manifest = Manifest::of_run(&run)?;
    let state = manifest.as_ref().map(|manifest| manifest.state);
    // Kept summaries without the logs of their seeds have nothing to read; their records speak for them.
    if state == Some(State::Finished) && !plan.seeds.iter().all(|seed| run.seed(*seed).metrics().exists()) {
        return Ok(Vec::new());
    }
    // A run that was killed before it had a manifest has trained nothing.
    let record = match &manifest {
        Some(manifest) => finished_seeds(first.cell, place, manifest)?,
        None => None,
    };
    if state != Some(State::Finished) {
        let seeds = record.as_ref().map_or("none of its seeds is".to_owned(), |record| {
            format!("{} of its {}", record.seeds().len(), plural(plan.seeds.len() as u64, "seed"))
        });
        terminal.note(format_args!("note: {} is not finished: {seeds} used", place.display()));
    }
    let Some(record) = record else { return Ok(Vec::new()) };
    Ok(fitting.iter().filter_map(|wanted| asked(wanted, &record)).collect())
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
