//! `mcvl reproduce`: the paper's experiments, trained as far as they are not there yet, judged claim by claim.

mod folder;
mod lent;

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use mcvl::report::claims::{plural, seed_list};
use mcvl::reproduce::bands::is_bands;
use mcvl::reproduce::cells::Cell;
use mcvl::reproduce::table::{self, Experiment, TARGETS};
use mcvl::reproduce::{QUICK, Record, Verdict, judge};
use mcvl::runs::{Plan, Remote, check_target, shell_word};
use mcvl_core::config::{Config, Learner, Simulator, expected_one_of};
use mcvl_core::record::Arm;

use super::session::{Manner, Pace, stop_on_signals};
use super::settings;
use super::terminal::{Terminal, wrap};
use super::train::{Speed, rough};
use super::{Done, usage};
use folder::{Folder, Standing, has_diverged};
use lent::lent;

/// Arguments of `mcvl reproduce`.
#[derive(Args)]
#[command(after_help = "\
Targets: all, fig3, fig3e, fig4a, fig4b, fig5, table (claims without a figure),
or experiments like E1. A cell is one setting over its seeds; experiments share
cells. What is finished is never trained again: the same command continues.
A set can be made in parts: records of some seeds count with --from, and the
records that are written then hold all of them.

Examples:
  mcvl reproduce --quick                      all, fewer seeds, shorter phases
  mcvl reproduce fig4b E13 -o runs/box
  mcvl reproduce all --dry-run                cells, what is done, expected cost
  mcvl reproduce all --evaluate --from results")]
pub struct ReproduceArgs {
    /// What to reproduce [default: all]
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
    /// Fewer seeds, and a tenth or less of the steps where a seed takes minutes: not the paper's setting
    #[arg(long)]
    quick: bool,
    /// Seeds of every cell: 10 (the first ten), 0..10 (the end is left out) or 1,5,9
    /// [default: 10; in Reacher 5, where checks are repeated 1, with --quick fewer]
    #[arg(long, value_name = "LIST", value_parser = settings::seeds_or_count)]
    seeds: Option<settings::SeedList>,
    /// Train this cell only; may be repeated
    #[arg(long, value_name = "CELL")]
    only: Vec<String>,
    /// Use the finished seeds of runs and records in this folder too, and
    /// train only what is missing; may be repeated
    #[arg(long, value_name = "DIR")]
    from: Vec<PathBuf>,
    /// Train nothing: judge what is there
    #[arg(long)]
    evaluate: bool,
    /// Show the cells, what is done and the expected cost, train nothing
    #[arg(long, conflicts_with = "evaluate")]
    dry_run: bool,
    /// Continue (always done; for those who look for it)
    #[arg(long)]
    resume: bool,
    /// Folder of everything [default: runs/reproduce, with --quick runs/reproduce-quick]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Also write the results into this Markdown page, between its two marks
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Also write what the web page shows behind its curves: intervals of every scheme, as JSON
    #[arg(long, value_name = "FILE")]
    bands: Option<PathBuf>,
    /// Exit with 1 unless every claim holds
    #[arg(long)]
    assert_claims: bool,
    /// Print the results as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pace: Pace,
}

/// A cell as it is wanted here.
struct Wanted {
    cell: &'static Cell,
    plan: Plan,
    /// Whether it is to be trained if it is not there.
    train: bool,
}

/// Reproduces.
pub fn reproduce(arguments: &ReproduceArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let experiments = experiments(&arguments.targets)?;
    let wanted = arguments.wanted(&experiments)?;
    let folder = Folder(arguments.folder());
    let mut lent = lent(&arguments.from, &wanted, arguments, terminal)?;
    // Everything that is there is looked at before anything is changed.
    let mut standings: Vec<(&Wanted, Standing)> = Vec::new();
    for wanted in &wanted {
        standings.push((wanted, folder.standing(wanted, lent.remove(wanted.cell.name), terminal)?));
    }
    if arguments.dry_run {
        return dry_run(arguments, &standings, terminal);
    }
    folder.check_place()?;
    arguments.check_targets()?;
    if arguments.evaluate && standings.iter().all(|(_, standing)| standing.record.is_none()) {
        let there = folder.0.display();
        usage!("--evaluate: no cell has a finished seed in {there}; name the folder with -o, or results with --from");
    }
    let mut records: BTreeMap<String, Record> = BTreeMap::new();
    let mut end = Done::Well;
    let (mut open, mut made) = (Vec::new(), Vec::new());
    for (wanted, standing) in standings {
        if let Some(record) = &standing.record {
            made.extend(standing.made.then_some(wanted.cell));
            records.insert(wanted.cell.name.to_owned(), record.clone());
        }
        if wanted.train && !standing.missing.is_empty() {
            open.push((wanted, standing));
        }
    }
    if !open.is_empty() {
        stop_on_signals()?;
    }
    let remote = if open.is_empty() { None } else { arguments.pace.remote(terminal)? };
    let manner = arguments.manner(&folder, remote);
    for (cell, ended) in folder.train_all(&open, arguments.quick, &manner, terminal) {
        match ended {
            Ok((record, finished)) => {
                records.extend(record.map(|record| (cell.name.to_owned(), record)));
                if !finished {
                    end = Done::Interrupted;
                }
            }
            // The others do not depend on it, and its claims go by the seeds that did not: their record is there.
            Err(error) if has_diverged(&error) => {
                if end == Done::Well {
                    end = Done::DoesNotHold;
                }
            }
            // What the others finished is in their records.
            Err(error) => return Err(error),
        }
    }
    // Others may have trained other cells here and told them: from here on one at a time, by what is there now.
    let lock = folder.lock()?;
    let before = folder.check_place()?;
    for wanted in &wanted {
        let record = folder.by_now(records.remove(wanted.cell.name), wanted, terminal);
        records.extend(record.map(|record| (wanted.cell.name.to_owned(), record)));
    }
    let planned = |cell: &Cell| cell.planned(arguments.quick, arguments.seeds.as_deref());
    let results = judge(&experiments, &records, arguments.quick, &planned);
    for cell in made {
        folder.keep(&records[cell.name], cell)?;
    }
    // What else is finished here by now stays in the tables and figures.
    let asked = table::unique(experiments.iter().flat_map(|experiment| experiment.cells()));
    for cell in table::cells().into_iter().filter(|cell| !asked.contains(cell)) {
        match folder.beside(&arguments.wants(cell)?) {
            Ok(record) => records.extend(record.map(|record| (cell.name.to_owned(), record))),
            Err(why) => terminal.note(format_args!("note: left out of tables and figures: {why:#}")),
        }
    }
    let whole = |experiment: &Experiment| experiment.cells().iter().all(|cell| records.contains_key(cell.name));
    let was_told = |experiment: &Experiment| before.iter().any(|id| id == experiment.id);
    let is_asked = |experiment: &Experiment| experiments.iter().any(|asked| asked.id == experiment.id);
    let is_told = |experiment: &&Experiment| is_asked(experiment) || whole(experiment) || was_told(experiment);
    let told: Vec<&Experiment> = table::EXPERIMENTS.iter().filter(is_told).collect();
    // Seeds that are asked for say nothing of what was measured before.
    let planned = |cell: &Cell| match records.get(cell.name) {
        Some(record) if arguments.seeds.is_some() && !asked.contains(&cell) => record.seeds().to_vec(),
        _ => planned(cell),
    };
    let all = judge(&told, &records, arguments.quick, &planned);
    let written = folder.write(&all, &told, &records, arguments)?;
    drop(lock);
    if arguments.json {
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&results)?)?;
    } else {
        let color = |verdict: Verdict| match verdict {
            Verdict::Holds => 32,
            Verdict::DoesNotHold => 31,
            Verdict::Undecided | Verdict::Unfinished => 33,
            Verdict::NotMeasured => 2,
        };
        let text = results.text(&|verdict, words| terminal.paint(color(verdict), words));
        writeln!(terminal.out, "{}", text.trim_end())?;
        for (index, what) in written.iter().enumerate() {
            let lead = if index == 0 { "\nWritten: " } else { "         " };
            writeln!(terminal.out, "{lead}{}", wrap(what, 9, super::WIDTH).trim_start())?;
        }
    }
    if end == Done::Interrupted {
        terminal.note(format_args!("stopped; the state is saved, continue with: {}", manner.resume));
    }
    Ok(if end == Done::Well && arguments.assert_claims && !results.holds() { Done::DoesNotHold } else { end })
}

/// Experiments that the targets name, in the order of the table.
fn experiments(targets: &[String]) -> anyhow::Result<Vec<&'static Experiment>> {
    let mut wanted: Vec<&str> = targets.iter().map(String::as_str).collect();
    if wanted.is_empty() {
        wanted.push("all");
    }
    let mut found = Vec::new();
    for target in wanted {
        let experiments = table::find(target);
        if experiments.is_empty() {
            let ids = table::EXPERIMENTS.iter().map(|experiment| experiment.id);
            let names: Vec<&str> = TARGETS.iter().copied().chain(ids).collect();
            usage!("target: {}", expected_one_of(target, &names));
        }
        found.extend(experiments.into_iter().map(|experiment| experiment.id));
    }
    Ok(table::EXPERIMENTS.iter().filter(|experiment| found.contains(&experiment.id)).collect())
}

impl ReproduceArgs {
    fn folder(&self) -> PathBuf {
        let name = if self.quick { "reproduce-quick" } else { "reproduce" };
        self.output.clone().unwrap_or_else(|| Path::new("runs").join(name))
    }

    /// The cells of some experiments as they are to be trained.
    fn wanted(&self, experiments: &[&Experiment]) -> anyhow::Result<Vec<Wanted>> {
        let cells = table::unique(experiments.iter().flat_map(|experiment| experiment.cells()));
        let names: Vec<&str> = cells.iter().map(|cell| cell.name).collect();
        if let Some(name) = self.only.iter().find(|name| !names.contains(&name.as_str())) {
            usage!("--only: {}", expected_one_of(name, &names));
        }
        cells.into_iter().map(|cell| self.wants(cell)).collect()
    }

    fn wants(&self, cell: &'static Cell) -> anyhow::Result<Wanted> {
        let seeds = cell.planned(self.quick, self.seeds.as_deref());
        let train = !self.evaluate && (self.only.is_empty() || self.only.iter().any(|name| name == cell.name));
        Ok(Wanted { cell, plan: cell.plan(self.quick, &seeds)?, train })
    }

    /// Files beside the folder that are to be written: before hours are spent, nothing of somebody else may be in the way.
    fn check_targets(&self) -> anyhow::Result<()> {
        if let Some(path) = &self.page {
            Folder::put_in(path, "")?;
        }
        let Some(path) = &self.bands else { return Ok(()) };
        check_target(path)?;
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
            usage!("--bands {}: there is no folder {}: make it first", path.display(), folder.display());
        }
        if path.exists() && !fs::read_to_string(path).is_ok_and(|text| is_bands(&text)) {
            usage!("--bands {}: it is there and holds something else: name another file", path.display());
        }
        Ok(())
    }

    fn manner(&self, folder: &Folder, remote: Option<Remote>) -> Manner {
        let mut resume = String::from("mcvl reproduce");
        let mut add = |part: &str| {
            resume.push(' ');
            resume.push_str(part);
        };
        self.targets.iter().for_each(|target| add(target));
        if self.quick {
            add("--quick");
        }
        if let Some(seeds) = &self.seeds {
            // A number alone would be a count; behind the last of all there is none to end before.
            let list = match seeds[..] {
                [seed] => seed.checked_add(1).map_or(format!("{seed},{seed}"), |end| format!("{seed}..{end}")),
                _ => seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(","),
            };
            add(&format!("--seeds {list}"));
        }
        self.only.iter().for_each(|cell| add(&format!("--only {cell}")));
        self.from.iter().for_each(|from| add(&format!("--from {}", shell_word(from))));
        if self.output.is_some() {
            add(&format!("-o {}", shell_word(&folder.0)));
        }
        for (flag, file) in [("--page", &self.page), ("--bands", &self.bands)] {
            file.iter().for_each(|file| add(&format!("{flag} {}", shell_word(file))));
        }
        for (flag, given) in [("--assert-claims", self.assert_claims), ("--json", self.json)] {
            if given {
                add(flag);
            }
        }
        self.pace.manner(resume, remote)
    }
}

impl Wanted {
    /// Whether a result of this configuration is one of the cell: `spread` says that it is a measurement, `has` which
    /// learners it has.
    fn fits(&self, config: &Config, spread: bool, has: &dyn Fn(Learner) -> bool) -> bool {
        // The simulators agree to far below what a policy does: either stands for the other.
        let bare =
            |config: &Config| Config { physics: Simulator::ClosedForm, ..config.with_seed(0).with_agent(Learner::Mc) };
        bare(&self.plan.config) == bare(config)
            && self.cell.repeats.is_some() == spread
            && (spread || self.cell.learners.iter().all(|learner| has(*learner)))
    }

    /// The same of a record with this configuration.
    fn fits_record(&self, record: &Record, config: &Config) -> bool {
        self.fits(config, record.spread.is_some(), &|learner| record.arm(Arm::of(learner)).is_some())
    }
}

/// Shows what would be done.
fn dry_run(arguments: &ReproduceArgs, wanted: &[(&Wanted, Standing)], terminal: &mut Terminal) -> anyhow::Result<Done> {
    let mut speeds: BTreeMap<&str, Speed> = BTreeMap::new();
    let (mut total, mut done) = (0.0, 0);
    let mut rows = Vec::new();
    let row = |cell: &str, seeds: &str, expected: &str, config: &str| {
        // What is longer than its column still keeps its distance.
        let (seeds, expected) = (format!("{seeds} "), format!("{expected} "));
        let head = format!("{cell:<24}{seeds:<10}{expected:<10}");
        format!("{head}{}", wrap(config, head.chars().count(), super::WIDTH).trim_start())
    };
    let mut table = row("cell", "seeds", "expected", "configuration") + "\n";
    for (wanted, standing) in wanted {
        let plan = &wanted.plan;
        let mut expected_time = None;
        let (seeds, expected) = match &standing.record {
            Some(record) if standing.missing.is_empty() => {
                done += 1;
                (seed_list(record.seeds()), "done".to_owned())
            }
            _ if !wanted.train => (seed_list(&standing.missing), "left out".to_owned()),
            _ => {
                // Cells of a world differ in many ways, but hardly in their speed.
                let speed = *speeds.entry(&plan.config.env).or_insert_with(|| Speed::measure(&plan.config));
                let seconds = expected_seconds(wanted, &standing.missing, arguments, speed);
                total += seconds;
                expected_time = Some(seconds.round());
                let begun = if standing.begun { ", begun" } else { "" };
                (seed_list(&standing.missing), format!("{}{begun}", rough(seconds)))
            }
        };
        table += &(row(wanted.cell.name, &seeds, &expected, wanted.cell.config) + "\n");
        rows.push(serde_json::json!({
            "cell": wanted.cell.name,
            "config": wanted.cell.config,
            "finished": standing.record.as_ref().map_or(&[][..], Record::seeds),
            "missing": standing.missing,
            "begun": standing.begun,
            "expected_seconds": expected_time,
        }));
    }
    if arguments.json {
        let all = serde_json::json!({ "cells": rows, "expected_seconds": total.round() });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&all)?)?;
        return Ok(Done::Well);
    }
    write!(terminal.out, "{table}")?;
    let cells = plural(wanted.len() as u64, "cell");
    if done == wanted.len() {
        writeln!(terminal.out, "\n{cells}, all done")?;
        return Ok(Done::Well);
    }
    if total == 0.0 {
        writeln!(terminal.out, "\n{cells}, {done} done; nothing else is to be trained")?;
        return Ok(Done::Well);
    }
    let (total, threads) = (rough(total), arguments.pace.threads());
    writeln!(terminal.out, "\n{cells}, {done} done; here the rest takes about {total} with -j {threads}")?;
    let basis = "Checks are expected as often as at the paper's setting; what was begun counts in full.";
    writeln!(terminal.out, "{}", wrap(basis, 0, super::WIDTH))?;
    if arguments.quick {
        writeln!(terminal.out, "{}", wrap(QUICK, 0, super::WIDTH))?;
    }
    Ok(Done::Well)
}

/// Seconds that some seeds of a cell are expected to take.
fn expected_seconds(wanted: &Wanted, seeds: &[u64], arguments: &ReproduceArgs, speed: Speed) -> f64 {
    let (plan, threads) = (&wanted.plan, arguments.pace.threads());
    let Some(extent) = wanted.cell.extent(arguments.quick) else {
        return speed.wall(plan, seeds.len(), threads);
    };
    let repeats = f64::from(extent.checks * extent.repeats * 2);
    let forecasts = repeats * 2.0 * f64::from(plan.config.forecast) / threads as f64;
    speed.of(f64::from(plan.config.safe_steps), forecasts)
}
