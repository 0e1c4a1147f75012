//! `mcvl reproduce`: the paper's experiments, trained as far as they are not there yet, judged claim by claim.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use mcvl::report::claims::{plural, seed_list};
use mcvl::reproduce::bands::bands;
use mcvl::reproduce::figures::DRAWINGS;
use mcvl::reproduce::spread::{Measurement, Spread};
use mcvl::reproduce::table::{self, Cell, Experiment, TARGETS};
use mcvl::reproduce::{BEGIN, END, QUICK, RECORD_SUFFIX, Record, Results, Verdict, judge, markdown, put};
use mcvl::runs::{Lock, Manifest, Plan, Remote, RunDir, RunSet, RunsError, State, write_atomic};
use mcvl_core::config::{Config, Learner, Simulator, expected_one_of};
use mcvl_core::record::Arm;
use serde::{Deserialize, Serialize};

use super::session::{Ended, Manner, Pace, Session, stop_on_signals};
use super::settings;
use super::terminal::{Terminal, wrap};
use super::train::{Speed, rough};
use super::{Done, Usage, usage};

/// Pixels per unit of the PNG figures: sharp on a screen.
const SCALE: f32 = 2.0;
/// How deep `--from` looks for runs and records.
const DEPTH: u32 = 5;

/// Arguments of `mcvl reproduce`.
#[derive(Args)]
#[command(after_help = "\
Targets: all, fig3, fig4a, fig4b, fig5, table (claims without a figure), or
experiments like E1. A cell is one setting over its seeds; experiments share
cells. What is finished is never trained again: the same command continues.

Examples:
  mcvl reproduce --quick                      all, fewer seeds, shorter phases
  mcvl reproduce fig4b E13 -o runs/box
  mcvl reproduce all --dry-run                cells, what is done, expected cost
  mcvl reproduce all --evaluate --from results")]
pub struct ReproduceArgs {
    /// What to reproduce [default: all]
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
    /// Fewer seeds, and a fifth of the steps where a seed takes minutes: not the paper's setting
    #[arg(long)]
    quick: bool,
    /// Seeds of every cell: 0..10 (the end is left out) or 1,5,9 [default: 0..10]
    #[arg(long, value_name = "LIST", value_parser = settings::seeds)]
    seeds: Option<settings::SeedList>,
    /// Train this cell only; may be repeated
    #[arg(long, value_name = "CELL")]
    only: Vec<String>,
    /// Use finished runs and records in this folder too; may be repeated
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

/// How a cell stands.
enum Standing {
    /// It is finished; its record, and whether that was made just now, from a run.
    Finished(Box<Record>, bool),
    /// It was begun in the folder of this set.
    Begun,
    /// There is nothing.
    Open,
}

/// Reproduces.
pub fn reproduce(arguments: &ReproduceArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let experiments = experiments(&arguments.targets)?;
    let wanted = arguments.wanted(&experiments)?;
    let folder = Folder(arguments.folder());
    let mut lent = lent(&arguments.from, &wanted, arguments, terminal)?;
    // Everything that is there is looked at before anything is changed.
    let mut standings: Vec<Standing> = Vec::new();
    for wanted in &wanted {
        standings.push(match (folder.standing(wanted)?, lent.remove(wanted.cell.name)) {
            (own @ Standing::Finished(..), _) | (own, None) => own,
            (_, Some((lent, made))) => Standing::Finished(Box::new(lent), made),
        });
    }
    if arguments.dry_run {
        return dry_run(arguments, &wanted, &standings, terminal);
    }
    let mut records: BTreeMap<String, Record> = BTreeMap::new();
    let mut end = Done::Well;
    let (mut open, mut made) = (Vec::new(), Vec::new());
    for (wanted, standing) in wanted.iter().zip(standings) {
        match standing {
            Standing::Finished(record, now) => {
                made.extend(now.then_some(wanted.cell));
                records.insert(wanted.cell.name.to_owned(), *record);
            }
            _ if wanted.train => open.push(wanted),
            _ => {}
        }
    }
    if !open.is_empty() {
        stop_on_signals()?;
    }
    let remote = if open.is_empty() { None } else { arguments.pace.remote(terminal)? };
    let manner = arguments.manner(&folder, remote);
    let count = open.len();
    for (number, wanted) in (1..).zip(open) {
        let setup = format!("{}, {}", wanted.plan.config, seeds_words(&wanted.plan.seeds));
        terminal.note(format_args!("{number} of {count}: {} ({setup})", wanted.cell.name));
        let ended = match wanted.cell.extent(arguments.quick) {
            None => folder.train(wanted, &manner, terminal),
            Some(_) => folder.measure(wanted, arguments.quick, &manner),
        };
        match ended {
            Ok(Some(record)) => drop(records.insert(wanted.cell.name.to_owned(), record)),
            Ok(None) => {
                end = Done::Interrupted;
                break;
            }
            // The others do not depend on it, and its claims stay unmeasured.
            Err(error) if matches!(error.downcast_ref(), Some(RunsError::Diverged { .. })) => {
                terminal.note(format_args!("error: {}: {error:#}", wanted.cell.name));
                end = Done::DoesNotHold;
            }
            Err(error) => return Err(error),
        }
    }
    let results = judge(&experiments, &records, arguments.quick);
    for cell in made {
        folder.keep(&records[cell.name], cell)?;
    }
    let written = folder.write(&results, &experiments, &records, arguments)?;
    if arguments.json {
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&results)?)?;
    } else {
        let color = |verdict: Verdict| match verdict {
            Verdict::Holds => 32,
            Verdict::DoesNotHold => 31,
            Verdict::NotMeasured => 2,
        };
        let text = results.text(&|verdict, words| terminal.paint(color(verdict), words));
        writeln!(terminal.out, "{}", text.trim_end())?;
        writeln!(terminal.out, "\nWritten: {}", written.join("\n         "))?;
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
        let wanted = cells.into_iter().map(|cell| {
            let seeds = match &self.seeds {
                Some(seeds) if cell.repeats.is_none() => seeds.clone(),
                Some(seeds) => seeds[..1].to_vec(),
                None => cell.seeds(self.quick),
            };
            let train = !self.evaluate && (self.only.is_empty() || self.only.iter().any(|name| name == cell.name));
            Ok(Wanted { cell, plan: cell.plan(self.quick, &seeds)?, train })
        });
        wanted.collect()
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
            add(&format!("--seeds {}", seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(",")));
        }
        self.only.iter().for_each(|cell| add(&format!("--only {cell}")));
        self.from.iter().for_each(|from| add(&format!("--from {}", from.display())));
        if self.output.is_some() {
            add(&format!("-o {}", folder.0.display()));
        }
        self.pace.manner(resume, remote)
    }
}

/// «seeds 0 to 9», «seed 3».
fn seeds_words(seeds: &[u64]) -> String {
    format!("seed{} {}", if seeds.len() == 1 { "" } else { "s" }, seed_list(seeds))
}

/// A measurement of spread that is not finished: the checks so far.
#[derive(Serialize, Deserialize)]
struct Begun {
    config: String,
    trained_ms: u64,
    spread: Spread,
}

/// The folder of a set of experiments.
struct Folder(PathBuf);

impl Folder {
    fn run(&self, cell: &Cell) -> RunDir {
        RunDir::new(self.0.join("cells").join(cell.name))
    }

    fn record(&self, cell: &Cell) -> PathBuf {
        self.0.join("records").join(format!("{}{RECORD_SUFFIX}", cell.name))
    }

    /// The file in which a measurement grows.
    fn begun(&self, cell: &Cell) -> PathBuf {
        self.run(cell).path().join("spread.json")
    }

    /// How a cell stands here. Changes nothing.
    fn standing(&self, wanted: &Wanted) -> anyhow::Result<Standing> {
        let (cell, record) = (wanted.cell, self.record(wanted.cell));
        if cell.repeats.is_some() {
            if record.exists() {
                let found = Record::read(&record)?;
                self.same(wanted, &record, &found.config, found.seeds(), None)?;
                return Ok(Standing::Finished(Box::new(found), false));
            }
            return Ok(if self.begun(cell).exists() { Standing::Begun } else { Standing::Open });
        }
        let run = self.run(cell);
        if !run.exists() {
            return Ok(Standing::Open);
        }
        let plan = Plan::read(&run)?;
        self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, Some(&plan.learners))?;
        let manifest = match Manifest::read(&run) {
            Ok(manifest) => manifest,
            // Killed between its first two files.
            Err(RunsError::Io { .. }) => return Ok(Standing::Begun),
            Err(error) => return Err(error.into()),
        };
        if !manifest.is_intact() {
            return Err(RunsError::damaged(&run.manifest(), "was altered: its seal does not fit").into());
        }
        if manifest.state != State::Finished {
            return Ok(Standing::Begun);
        }
        // A record of this very state spares reading the run; one that cannot be read is made again.
        if let Ok(found) = Record::read(&record)
            && found.seal == manifest.seal
            && found.cell == cell.name
        {
            return Ok(Standing::Finished(Box::new(found), false));
        }
        let record = Record::of_run(cell.name, &RunSet::read(run.path())?, &manifest);
        Ok(Standing::Finished(Box::new(record), true))
    }

    /// What is here has to be what is wanted.
    fn same(
        &self,
        wanted: &Wanted,
        place: &Path,
        config: &str,
        seeds: &[u64],
        learners: Option<&[Learner]>,
    ) -> anyhow::Result<()> {
        let (place, plan) = (place.display(), &wanted.plan);
        let advice = "give the same --seeds and --quick as before, or choose another folder with -o";
        if seeds != plan.seeds {
            usage!("{place} is of {}, not of {}: {advice}", seeds_words(seeds), seeds_words(&plan.seeds));
        }
        if config != plan.config.to_string() || learners.is_some_and(|learners| learners != plan.learners) {
            usage!("{place} is of another setting than the one wanted ({}): {advice}", plan.config);
        }
        Ok(())
    }

    /// Trains a cell to its end; none if stopped.
    fn train(&self, wanted: &Wanted, manner: &Manner, terminal: &Terminal) -> anyhow::Result<Option<Record>> {
        let run = self.run(wanted.cell);
        let session = if run.exists() {
            Session::resume(run.clone(), |plan| {
                self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, Some(&plan.learners))
            })?
        } else {
            Session::begin(run.clone(), wanted.plan.clone(), false)?
        };
        match session.work(manner, terminal)? {
            Ended::Interrupted(_) => Ok(None),
            Ended::Finished { set, .. } => {
                let record = Record::of_run(wanted.cell.name, &set, &Manifest::read(&run)?);
                self.keep(&record, wanted.cell)?;
                Ok(Some(record))
            }
        }
    }

    /// Measures the spread of a cell's checks; none if stopped.
    fn measure(&self, wanted: &Wanted, quick: bool, manner: &Manner) -> anyhow::Result<Option<Record>> {
        let (cell, config) = (wanted.cell, &wanted.plan.config);
        let run = self.run(cell);
        fs::create_dir_all(run.path()).map_err(RunsError::io("create the folder", run.path()))?;
        let _lock = Lock::take(&run)?;
        let path = self.begun(cell);
        let empty = Spread { seed: config.seed, repeats: 0, updates: 0, checks: Vec::new() };
        let mut begun = Begun { config: config.to_string(), trained_ms: 0, spread: empty };
        if path.exists() {
            let text = fs::read(&path).map_err(RunsError::io("read", &path))?;
            begun = serde_json::from_slice(&text)
                .map_err(|error| RunsError::damaged(&path, format!("is no measurement of mcvl: {error}")))?;
            self.same(wanted, &path, &begun.config, &[begun.spread.seed], None)?;
        }
        let extent = cell.extent(quick).expect("only cells with repeats are measured");
        let control = manner.control();
        let (before, started) = (begun.trained_ms, Instant::now());
        let trained = || before + u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        let save = |spread: &Spread| -> anyhow::Result<()> {
            let state = Begun { config: config.to_string(), trained_ms: trained(), spread: spread.clone() };
            Ok(write_atomic(&path, &serde_json::to_vec(&state)?)?)
        };
        let mut spread = begun.spread;
        let done = Measurement::new(config, extent).go_on(&mut spread, manner.threads, &|| control.stopped(), save)?;
        if !done {
            return Ok(None);
        }
        let mut manifest = Manifest::begin();
        manifest.add_time(Duration::from_millis(trained()));
        let record = Record::of_spread(cell.name, &config.to_string(), spread, &manifest);
        self.keep(&record, cell)?;
        Ok(Some(record))
    }

    fn keep(&self, record: &Record, cell: &Cell) -> anyhow::Result<()> {
        let path = self.record(cell);
        let folder = path.parent().expect("a record lies in a folder");
        fs::create_dir_all(folder).map_err(RunsError::io("create the folder", folder))?;
        Ok(record.write(&path)?)
    }

    /// Writes tables, page and figures; says what.
    fn write(
        &self,
        results: &Results,
        experiments: &[&Experiment],
        records: &BTreeMap<String, Record>,
        arguments: &ReproduceArgs,
    ) -> anyhow::Result<Vec<String>> {
        // A page without a place for them is found before anything is written.
        let page = arguments.page.as_ref().map(|path| self.page(path, results)).transpose()?;
        fs::create_dir_all(&self.0).map_err(RunsError::io("create the folder", &self.0))?;
        let json = serde_json::to_string_pretty(results)? + "\n";
        let mut texts =
            vec![("results.json", json), ("claims.csv", results.claims_csv()), ("numbers.csv", results.numbers_csv())];
        if page.is_none() {
            texts.push(("results.md", format!("# Results\n\n{}", markdown(results, "."))));
        }
        let mut names: Vec<String> = Vec::new();
        for (name, text) in texts {
            write_atomic(&self.0.join(name), text.as_bytes())?;
            names.push(name.to_owned());
        }
        let mut written = Vec::new();
        if let Some((path, text)) = page {
            write_atomic(path, text.as_bytes())?;
            written.push(path.display().to_string());
        }
        if let Some(path) = &arguments.bands {
            write_atomic(path, bands(records).as_bytes())?;
            written.push(path.display().to_string());
        }
        for drawing in DRAWINGS {
            if !experiments.iter().any(|experiment| experiment.target == drawing.target) {
                continue;
            }
            let Some(figure) = drawing.draw(records, arguments.quick) else { continue };
            let path = self.0.join(drawing.name);
            write_atomic(&path.with_extension("svg"), figure.svg().as_bytes())?;
            write_atomic(&path.with_extension("png"), &figure.png(SCALE)?)?;
            names.push(format!("{}.svg, .png", drawing.name));
        }
        written.insert(0, format!("{} ({})", self.0.display(), names.join(", ")));
        Ok(written)
    }

    /// The text of a page with the results put in.
    fn page<'a>(&self, path: &'a Path, results: &Results) -> anyhow::Result<(&'a Path, String)> {
        let text = fs::read_to_string(path).map_err(RunsError::io("read", path))?;
        let beside = path.parent().unwrap_or(Path::new(""));
        // Figures are named as seen from the page where that is possible, else by where they are.
        let figures = self.0.strip_prefix(beside).unwrap_or(&self.0).display().to_string();
        let figures = if figures.is_empty() { ".".to_owned() } else { figures };
        let written = put(&text, &markdown(results, &figures));
        let why = || Usage(format!("--page {}: it lacks the lines `{BEGIN}` and `{END}`", path.display()));
        Ok((path, written.ok_or_else(why)?))
    }
}

/// Records of cells that are finished elsewhere, by the cells' names, and whether each was made just now, from
/// a run: of several the one with most seeds.
fn lent(
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
            let more = |(known, _): &(Record, bool)| record.seeds().len() > known.seeds().len();
            if best.get(cell.name).is_none_or(more) {
                best.insert(cell.name, (Record { cell: cell.name.to_owned(), ..record }, place.is_dir()));
            }
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
    // Whose seeds were asked for by name is content with no others.
    let fits = |config: &Config, seeds: &[u64], spread: bool, has: &dyn Fn(Learner) -> bool| {
        // The simulators agree to far below what a policy does: either stands for the other.
        let bare =
            |config: &Config| Config { physics: Simulator::ClosedForm, ..config.with_seed(0).with_agent(Learner::Mc) };
        let same = |wanted: &&Wanted| {
            bare(&wanted.plan.config) == bare(config)
                && wanted.cell.repeats.is_some() == spread
                && (spread || wanted.cell.learners.iter().all(|learner| has(*learner)))
                && (arguments.seeds.is_none() || wanted.plan.seeds == seeds)
        };
        wanted.iter().find(same).map(|wanted| wanted.cell)
    };
    if !place.is_dir() {
        let record = Record::read(place)?;
        let config: Config = record.config.parse().map_err(|error| RunsError::damaged(place, format!("{error}")))?;
        let has = |learner: Learner| record.arms.iter().any(|leg| leg.arm == Arm::of(learner));
        return Ok(fits(&config, record.seeds(), record.spread.is_some(), &has).map(|cell| (cell, record)));
    }
    let run = RunDir::new(place);
    let plan = Plan::read(&run)?;
    let has = |learner: Learner| plan.learners.contains(&learner);
    let Some(cell) = fits(&plan.config, &plan.seeds, false, &has) else { return Ok(None) };
    let manifest = Manifest::read(&run)?;
    if !manifest.is_intact() {
        return Err(RunsError::damaged(&run.manifest(), "was altered: its seal does not fit").into());
    }
    if manifest.state != State::Finished {
        terminal.note(format_args!("note: {} is not finished and is left out", place.display()));
        return Ok(None);
    }
    // Kept summaries without the logs of their seeds have nothing to read; their records speak for them.
    if !plan.seeds.iter().all(|seed| run.seed(*seed).metrics().exists()) {
        return Ok(None);
    }
    Ok(Some((cell, Record::of_run(cell.name, &RunSet::read(place)?, &manifest))))
}

/// Shows what would be done.
fn dry_run(
    arguments: &ReproduceArgs,
    wanted: &[Wanted],
    standings: &[Standing],
    terminal: &mut Terminal,
) -> anyhow::Result<Done> {
    let mut speeds: BTreeMap<&str, Speed> = BTreeMap::new();
    let (mut total, mut done) = (0.0, 0);
    let row = |cell: &str, seeds: &str, expected: &str, config: &str| {
        let head = format!("{cell:<24}{seeds:<9}{expected:<10}");
        format!("{head}{}", wrap(config, head.chars().count(), super::WIDTH).trim_start())
    };
    writeln!(terminal.out, "{}", row("cell", "seeds", "expected", "configuration"))?;
    for (wanted, standing) in wanted.iter().zip(standings) {
        let plan = &wanted.plan;
        let (seeds, expected) = match standing {
            Standing::Finished(record, _) => {
                done += 1;
                (seed_list(record.seeds()), "done".to_owned())
            }
            _ if !wanted.train => (seed_list(&plan.seeds), "left out".to_owned()),
            other => {
                // Cells of a world differ in many ways, but hardly in their speed.
                let speed = *speeds.entry(&plan.config.env).or_insert_with(|| Speed::measure(&plan.config));
                let seconds = expected_seconds(wanted, arguments, speed);
                total += seconds;
                let begun = if matches!(other, Standing::Begun) { ", begun" } else { "" };
                (seed_list(&plan.seeds), format!("{}{begun}", rough(seconds)))
            }
        };
        writeln!(terminal.out, "{}", row(wanted.cell.name, &seeds, &expected, wanted.cell.config))?;
    }
    let cells = plural(wanted.len() as u64, "cell");
    let (total, threads) = (rough(total), arguments.pace.threads());
    writeln!(terminal.out, "\n{cells}, {done} done; here the rest takes about {total} with -j {threads}")?;
    let basis = "Checks are expected as often as at the paper's setting; what was begun counts in full.";
    writeln!(terminal.out, "{}", wrap(basis, 0, super::WIDTH))?;
    if arguments.quick {
        writeln!(terminal.out, "{}", wrap(QUICK, 0, super::WIDTH))?;
    }
    Ok(Done::Well)
}

/// Seconds that a cell is expected to take.
fn expected_seconds(wanted: &Wanted, arguments: &ReproduceArgs, speed: Speed) -> f64 {
    let (plan, threads) = (&wanted.plan, arguments.pace.threads());
    let Some(extent) = wanted.cell.extent(arguments.quick) else {
        return speed.seconds(plan) * plan.seeds.len().div_ceil(threads) as f64;
    };
    let repeats = f64::from(extent.checks * extent.repeats * 2);
    let forecasts = repeats * 2.0 * f64::from(plan.config.forecast) / threads as f64;
    speed.of(f64::from(plan.config.safe_steps), forecasts)
}
