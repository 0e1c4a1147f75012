//! `mcvl reproduce`: the paper's experiments, trained as far as they are not there yet, judged claim by claim.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use mcvl::report::claims::{plural, seed_list};
use mcvl::reproduce::bands::bands;
use mcvl::reproduce::cells::Cell;
use mcvl::reproduce::figures::DRAWINGS;
use mcvl::reproduce::spread::{Measurement, Spread};
use mcvl::reproduce::table::{self, Experiment, TARGETS};
use mcvl::reproduce::{BEGIN, END, QUICK, RECORD_SUFFIX, Record, Results, Verdict, judge, markdown, put};
use mcvl::runs::{Lock, Manifest, Plan, Remote, RunDir, RunSet, RunsError, State, shell_word, write_atomic};
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
    /// Seeds of every cell: 0..10 (the end is left out) or 1,5,9 [default: 0..10]
    #[arg(long, value_name = "LIST", value_parser = settings::seeds)]
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

/// How a cell stands.
struct Standing {
    /// Its finished seeds, if there are some, from the folder of this set and from elsewhere.
    record: Option<Record>,
    /// Whether a part of that was made just now, from a run.
    made: bool,
    /// The part from elsewhere.
    lent: Option<Record>,
    /// Whether it was begun in the folder of this set.
    begun: bool,
    /// Planned seeds that are not finished.
    missing: Vec<u64>,
}

impl Standing {
    /// A cell by what is known of it here and elsewhere; each with whether it was made just now.
    fn new(wanted: &Wanted, own: Option<(Record, bool)>, lent: Option<(Record, bool)>, begun: bool) -> Self {
        let made = [&own, &lent].into_iter().flatten().any(|(_, made)| *made);
        let [own, lent] = [own, lent].map(|part| part.map(|(record, _)| record));
        let missing = |there: Option<&Record>| {
            let there = there.map_or(&[][..], Record::seeds);
            wanted.plan.seeds.iter().copied().filter(|seed| !there.contains(seed)).collect::<Vec<_>>()
        };
        let record = joined(own.clone(), lent.as_ref());
        let missing = match &record {
            // What cannot be joined is of use only as a whole.
            Some(whole) if !whole.is_joinable() && !missing(Some(whole)).is_empty() => missing(own.as_ref()),
            record => missing(record.as_ref()),
        };
        Self { record, made, lent, begun, missing }
    }
}

/// Both together; where that cannot be, the one with more seeds.
fn joined(own: Option<Record>, lent: Option<&Record>) -> Option<Record> {
    let (Some(own), Some(lent)) = (&own, lent) else { return own.or_else(|| lent.cloned()) };
    own.join(lent).or_else(|| Some(if lent.seeds().len() > own.seeds().len() { lent } else { own }.clone()))
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
        standings.push(folder.standing(wanted, lent.remove(wanted.cell.name))?);
    }
    if arguments.dry_run {
        return dry_run(arguments, &wanted, &standings, terminal);
    }
    folder.check_place()?;
    if arguments.evaluate && standings.iter().all(|standing| standing.record.is_none()) {
        let there = folder.0.display();
        usage!("--evaluate: no cell has a finished seed in {there}; name the folder with -o, or results with --from");
    }
    let mut records: BTreeMap<String, Record> = BTreeMap::new();
    let mut end = Done::Well;
    let (mut open, mut made) = (Vec::new(), Vec::new());
    for (wanted, standing) in wanted.iter().zip(standings) {
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
            // The others do not depend on it, and its claims stay unmeasured.
            Err(error) if has_diverged(&error) => {
                if end == Done::Well {
                    end = Done::DoesNotHold;
                }
            }
            // What the others finished is in their records.
            Err(error) => return Err(error),
        }
    }
    let results = judge(&experiments, &records, arguments.quick, arguments.seeds.as_deref());
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
            Verdict::Undecided | Verdict::Unfinished => 33,
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
            let seeds = cell.planned(self.quick, self.seeds.as_deref());
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
        self.from.iter().for_each(|from| add(&format!("--from {}", shell_word(from))));
        if self.output.is_some() {
            add(&format!("-o {}", shell_word(&folder.0)));
        }
        self.pace.manner(resume, remote)
    }
}

/// «seeds 0 to 9», «seed 3».
fn seeds_words(seeds: &[u64]) -> String {
    format!("seed{} {}", if seeds.len() == 1 { "" } else { "s" }, seed_list(seeds))
}

/// The record of all seeds of a cell that are finished by now, and whether nothing stopped it.
type Ending = anyhow::Result<(Option<Record>, bool)>;

fn has_diverged(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(RunsError::Diverged { .. }))
}

/// Whether what is behind such a cell has to wait: somebody said stop, or something failed that will fail again.
fn has_stopped(ending: &Ending) -> bool {
    match ending {
        Ok((_, finished)) => !finished,
        Err(error) => !has_diverged(error),
    }
}

/// Version of what repeated checks draw: those of another cannot be continued.
const DRAWS: u32 = 2;

/// A measurement of spread that is not finished: the checks so far.
#[derive(Serialize, Deserialize)]
struct Begun {
    /// What the repeats draw, see [`DRAWS`]; older files have none.
    #[serde(default)]
    draws: u32,
    config: String,
    trained_ms: u64,
    spread: Spread,
}

/// The folder of a set of experiments.
struct Folder(PathBuf);

impl Folder {
    /// Checks that nothing of somebody else is overwritten: the folder is new or empty, or a set of experiments.
    fn check_place(&self) -> anyhow::Result<()> {
        let is_ours = |name: &str| self.0.join(name).exists();
        let free = RunDir::new(&self.0).is_free()?;
        if !free && !["cells", "records", "results.json"].into_iter().any(is_ours) {
            usage!("{} is not empty and holds no results of mcvl reproduce: choose another with -o", self.0.display());
        }
        Ok(())
    }

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

    /// How a cell stands here, with what is `lent`. Changes nothing.
    fn standing(&self, wanted: &Wanted, lent: Option<(Record, bool)>) -> anyhow::Result<Standing> {
        let (cell, record) = (wanted.cell, self.record(wanted.cell));
        if cell.repeats.is_some() {
            let own = if record.exists() { Some((Record::read(&record)?, false)) } else { None };
            if let Some((own, _)) = &own {
                self.same(wanted, &record, &own.config, own.seeds(), &[], None)?;
            }
            let lent = lent.filter(|_| own.is_none());
            // What is not to be continued does not matter here.
            let open = wanted.train && own.is_none() && lent.is_none();
            let begun = if open { self.begun_measurement(wanted)?.is_some() } else { self.begun(cell).exists() };
            return Ok(Standing::new(wanted, own, lent, begun));
        }
        let run = self.run(cell);
        if !run.is_begun()? {
            return Ok(Standing::new(wanted, None, lent, false));
        }
        let plan = Plan::read(&run)?;
        let elsewhere = lent.as_ref().map_or(&[][..], |(lent, _)| lent.seeds());
        self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, elsewhere, Some(&plan.learners))?;
        let Some(manifest) = Manifest::of_run(&run)? else { return Ok(Standing::new(wanted, None, lent, true)) };
        // A record of this very state spares reading the run; one that cannot be read is made again, and so is that of a
        // run that goes on.
        let finished = manifest.state == State::Finished;
        let own = match Record::read(&record) {
            Ok(found) if finished && found.seal == manifest.seal && found.cell == cell.name => Some((found, false)),
            _ => self.own(cell, &manifest)?.map(|record| (record, true)),
        };
        Ok(Standing::new(wanted, own, lent, true))
    }

    /// The record of the finished seeds of a cell's run; none before the first one.
    fn own(&self, cell: &Cell, manifest: &Manifest) -> anyhow::Result<Option<Record>> {
        finished_seeds(cell, self.run(cell).path(), manifest)
    }

    /// What is here has to be what is wanted, or what was still missing of it when there were seeds `elsewhere`.
    fn same(
        &self,
        wanted: &Wanted,
        place: &Path,
        config: &str,
        seeds: &[u64],
        elsewhere: &[u64],
        learners: Option<&[Learner]>,
    ) -> anyhow::Result<()> {
        let (place, plan) = (place.display(), &wanted.plan);
        let advice = "give the same --seeds, --quick and --from as before, or choose another folder with -o";
        let enough = plan.seeds.iter().all(|seed| seeds.contains(seed) || elsewhere.contains(seed));
        if !enough || seeds.iter().any(|seed| !plan.seeds.contains(seed)) {
            usage!("{place} is of {}, not of {}: {advice}", seeds_words(seeds), seeds_words(&plan.seeds));
        }
        let setting = plan.config.with_seed(seeds.first().copied().unwrap_or(plan.config.seed));
        if config != setting.to_string() || learners.is_some_and(|learners| learners != plan.learners) {
            usage!("{place} is of another setting than the one wanted ({}): {advice}", plan.config);
        }
        Ok(())
    }

    /// Trains what is missing of some cells, each with how it ended; those behind one that stopped are left out.
    fn train_all(
        &self,
        open: &[(&Wanted, Standing)],
        quick: bool,
        manner: &Manner,
        terminal: &Terminal,
    ) -> Vec<(&'static Cell, Ending)> {
        let count = open.len();
        let work = |number: usize, wanted: &Wanted, standing: &Standing, manner: &Manner| {
            let setup = format!("{}, {}", wanted.plan.config, seeds_words(&standing.missing));
            terminal.note(format_args!("{number} of {count}: {} ({setup})", wanted.cell.name));
            let ending = match wanted.cell.extent(quick) {
                None => self.train(wanted, standing, quick, manner, terminal),
                Some(_) => self.measure(wanted, quick, manner, terminal),
            };
            if let Err(error) = &ending
                && (manner.beside || has_diverged(error))
            {
                // The others go on, perhaps for hours.
                terminal.note(format_args!("error: {}: {error:#}", wanted.cell.name));
            }
            ending
        };
        // A card is filled by many seeds: those of all cells that forecast there go there together.
        let fits = |wanted: &Wanted| {
            let has = |remote: &Remote| remote.gpu().supports(&wanted.plan.config).is_ok();
            wanted.cell.extent(quick).is_none() && manner.remote.as_ref().is_some_and(has)
        };
        let numbered = (1..).zip(open).map(|(number, (wanted, standing))| (number, *wanted, standing));
        let (together, alone): (Vec<_>, Vec<_>) = numbered.partition(|(_, wanted, _)| fits(wanted));
        let threads = manner.threads.div_ceil(together.len().max(1));
        let (work, beside) = (&work, &Manner { beside: together.len() > 1, threads, ..manner.clone() });
        let mut ended: Vec<_> = thread::scope(|scope| {
            let started: Vec<_> = together
                .into_iter()
                .map(|(number, wanted, standing)| {
                    (wanted.cell, scope.spawn(move || work(number, wanted, standing, beside)))
                })
                .collect();
            let end = |thread: thread::ScopedJoinHandle<'_, _>| {
                thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            started.into_iter().map(|(cell, thread)| (cell, end(thread))).collect()
        });
        for (number, wanted, standing) in alone {
            if ended.iter().any(|(_, ended)| has_stopped(ended)) {
                break;
            }
            ended.push((wanted.cell, work(number, wanted, standing, manner)));
        }
        ended
    }

    /// Trains what is missing of a cell. The record of all seeds that are finished by then, and whether nothing stopped it.
    fn train(&self, wanted: &Wanted, standing: &Standing, quick: bool, manner: &Manner, terminal: &Terminal) -> Ending {
        let (run, cell) = (self.run(wanted.cell), wanted.cell);
        let elsewhere = standing.lent.as_ref().map_or(&[][..], Record::seeds);
        let session = if run.is_begun()? {
            Session::resume(run.clone(), |plan| {
                self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, elsewhere, Some(&plan.learners))
            })?
        } else {
            Session::begin(run.clone(), cell.plan(quick, &standing.missing)?, false)?
        };
        let (own, finished) = match session.work(manner, terminal)? {
            Ended::Interrupted(_) => (self.own(cell, &Manifest::read(&run)?)?, false),
            Ended::Finished { set, .. } => (Some(Record::of_run(cell.name, &set, &Manifest::read(&run)?)), true),
        };
        let record = joined(own, standing.lent.as_ref());
        if let Some(record) = &record {
            self.keep(record, cell)?;
        }
        Ok((record, finished))
    }

    /// A measurement that was begun here, if it can be continued.
    fn begun_measurement(&self, wanted: &Wanted) -> anyhow::Result<Option<Begun>> {
        let path = self.begun(wanted.cell);
        if !path.exists() {
            return Ok(None);
        }
        let text = fs::read(&path).map_err(RunsError::io("read", &path))?;
        let begun: Begun = serde_json::from_slice(&text)
            .map_err(|error| RunsError::damaged(&path, format!("is no measurement of mcvl: {error}")))?;
        self.same(wanted, &path, &begun.config, &[begun.spread.seed], &[], None)?;
        if begun.draws != DRAWS {
            usage!(
                "{} was begun by a version of mcvl whose repeats draw otherwise: remove it to begin anew, or choose \
                 another folder with -o",
                path.display()
            );
        }
        Ok(Some(begun))
    }

    /// Measures the spread of a cell's checks. Its record, if nothing stopped it, and whether nothing did.
    fn measure(&self, wanted: &Wanted, quick: bool, manner: &Manner, terminal: &Terminal) -> Ending {
        let (cell, config) = (wanted.cell, &wanted.plan.config);
        let run = self.run(cell);
        fs::create_dir_all(run.path()).map_err(RunsError::io("create the folder", run.path()))?;
        let _lock = Lock::take(&run)?;
        let path = self.begun(cell);
        let empty = Spread { seed: config.seed, repeats: 0, updates: 0, checks: Vec::new() };
        let begun = self.begun_measurement(wanted)?;
        let begun = begun.unwrap_or(Begun { draws: DRAWS, config: config.to_string(), trained_ms: 0, spread: empty });
        let extent = cell.extent(quick).expect("only cells with repeats are measured");
        let control = manner.control();
        let (before, started) = (begun.trained_ms, Instant::now());
        let trained = || before + u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        let save = |spread: &Spread| -> anyhow::Result<()> {
            terminal.note(format_args!("{}: {} of {} checks repeated", cell.name, spread.checks.len(), extent.checks));
            let state =
                Begun { draws: DRAWS, config: config.to_string(), trained_ms: trained(), spread: spread.clone() };
            Ok(write_atomic(&path, &serde_json::to_vec(&state)?)?)
        };
        let mut spread = begun.spread;
        let done = Measurement::new(config, extent).go_on(&mut spread, manner.threads, &|| control.stopped(), save)?;
        if !done {
            return Ok((None, false));
        }
        let mut manifest = Manifest::begin();
        manifest.add_time(Duration::from_millis(trained()));
        let record = Record::of_spread(cell.name, &config.to_string(), spread, &manifest);
        self.keep(&record, cell)?;
        Ok((Some(record), true))
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
            write_atomic(path, bands(records, arguments.quick).as_bytes())?;
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

/// Records of seeds that are finished elsewhere, by the cells' names, and whether a part of each was made just now, from
/// a run: several are joined; where that cannot be, the one with most seeds counts.
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
    let fits = |config: &Config, spread: bool, has: &dyn Fn(Learner) -> bool| {
        // The simulators agree to far below what a policy does: either stands for the other.
        let bare =
            |config: &Config| Config { physics: Simulator::ClosedForm, ..config.with_seed(0).with_agent(Learner::Mc) };
        let same = |wanted: &&Wanted| {
            bare(&wanted.plan.config) == bare(config)
                && wanted.cell.repeats.is_some() == spread
                && (spread || wanted.cell.learners.iter().all(|learner| has(*learner)))
        };
        wanted.iter().find(same)
    };
    // Who asks for seeds by name gets no others.
    let asked = |wanted: &Wanted, record: Record| match &arguments.seeds {
        Some(_) if wanted.plan.seeds != record.seeds() => record.only(&wanted.plan.seeds),
        _ => Some(record),
    };
    if !place.is_dir() {
        let record = Record::read(place)?;
        let config: Config = record.config.parse().map_err(|error| RunsError::damaged(place, format!("{error}")))?;
        let has = |learner: Learner| record.arms.iter().any(|leg| leg.arm == Arm::of(learner));
        let wanted = fits(&config, record.spread.is_some(), &has);
        return Ok(wanted.and_then(|wanted| Some((wanted.cell, asked(wanted, record)?))));
    }
    let run = RunDir::new(place);
    let plan = Plan::read(&run)?;
    let has = |learner: Learner| plan.learners.contains(&learner);
    let Some(wanted) = fits(&plan.config, false, &has) else { return Ok(None) };
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

/// The record of the finished seeds of a run; none before the first one.
fn finished_seeds(cell: &Cell, run: &Path, manifest: &Manifest) -> anyhow::Result<Option<Record>> {
    let record = Record::of_run(cell.name, &RunSet::read(run)?, manifest);
    Ok((!record.seeds().is_empty()).then_some(record))
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
        // What is longer than its column still keeps its distance.
        let (seeds, expected) = (format!("{seeds} "), format!("{expected} "));
        let head = format!("{cell:<24}{seeds:<10}{expected:<10}");
        format!("{head}{}", wrap(config, head.chars().count(), super::WIDTH).trim_start())
    };
    writeln!(terminal.out, "{}", row("cell", "seeds", "expected", "configuration"))?;
    for (wanted, standing) in wanted.iter().zip(standings) {
        let plan = &wanted.plan;
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
                let begun = if standing.begun { ", begun" } else { "" };
                (seed_list(&standing.missing), format!("{}{begun}", rough(seconds)))
            }
        };
        writeln!(terminal.out, "{}", row(wanted.cell.name, &seeds, &expected, wanted.cell.config))?;
    }
    let cells = plural(wanted.len() as u64, "cell");
    let (total, threads) = (rough(total), arguments.pace.threads());
    if done == wanted.len() {
        writeln!(terminal.out, "\n{cells}, all done")?;
        return Ok(Done::Well);
    }
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
