//! The folder of a set of experiments: what is finished there, what is trained there, what is written there.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use mcvl::report::claims::seed_list;
use mcvl::reproduce::bands::bands;
use mcvl::reproduce::cells::Cell;
use mcvl::reproduce::figures::DRAWINGS;
use mcvl::reproduce::spread::{Measurement, Spread};
use mcvl::reproduce::table::Experiment;
use mcvl::reproduce::{BEGIN, END, RECORD_SUFFIX, RESULTS_FORMAT, RESULTS_VERSION, Record, Results, markdown, put};
use mcvl::runs::{Lock, Manifest, Plan, Remote, RunDir, RunsError, State, write_atomic};
use mcvl_core::config::Learner;
use serde::{Deserialize, Serialize};

use super::super::session::{Ended, Manner, Session};
use super::super::terminal::Terminal;
use super::super::{Usage, usage};
use super::lent::{finished_seeds, setting};
use super::{ReproduceArgs, Wanted};

/// Pixels per unit of the PNG figures: sharp on a screen.
const SCALE: f32 = 2.0;
/// Tables beside `results.json`, always written together with it.
const TABLES: [&str; 4] = ["claims.csv", "numbers.csv", "gate.csv", "costs.csv"];
/// What to do where a folder holds something other than what is wanted.
const ADVICE: &str = "give the same --seeds, --quick and --from as before, or choose another folder with -o";

fn other_seeds(place: &Path, seeds: &[u64], plan: &Plan) -> anyhow::Error {
    let (place, found, wanted) = (place.display(), seeds_words(seeds), seeds_words(&plan.seeds));
    Usage(format!("{place} is of {found}, not of {wanted}: {ADVICE}")).into()
}

fn other_setting(place: &Path, plan: &Plan) -> anyhow::Error {
    let place = place.display();
    Usage(format!("{place} is of another setting than the one wanted ({}): {ADVICE}", plan.config)).into()
}

/// «seeds 0 to 9», «seed 3».
fn seeds_words(seeds: &[u64]) -> String {
    format!("seed{} {}", if seeds.len() == 1 { "" } else { "s" }, seed_list(seeds))
}

/// How a cell stands.
pub(super) struct Standing {
    /// Its finished seeds, if there are some, from the folder of this set and from elsewhere.
    pub record: Option<Record>,
    /// Whether a part of that was made just now, from a run.
    pub made: bool,
    /// The part from elsewhere.
    pub elsewhere: Elsewhere,
    /// Whether it was begun in the folder of this set.
    pub begun: bool,
    /// Planned seeds that are not finished.
    pub missing: Vec<u64>,
}

/// Finished seeds of a cell that are not those of its run in the folder of this set.
pub(super) struct Elsewhere {
    /// What `--from` names, and whether it was made just now.
    lent: Option<(Record, bool)>,
    /// What the folder's own record holds: what is finished is never trained again, whatever became of its run.
    kept: Option<Record>,
}

impl Elsewhere {
    fn parts(&self) -> impl Iterator<Item = &Record> {
        self.lent.iter().map(|(lent, _)| lent).chain(&self.kept)
    }

    fn seeds(&self) -> Vec<u64> {
        self.parts().flat_map(Record::seeds).copied().collect()
    }

    /// All that is finished, with what the run of this set has.
    fn with(&self, own: Option<Record>, terminal: &Terminal) -> Option<Record> {
        self.parts().fold(own, |own, part| joined(own, Some(part), terminal))
    }
}

impl Standing {
    /// A cell by what is known of it in its run, with whether that was made just now, and elsewhere.
    fn new(
        wanted: &Wanted,
        own: Option<(Record, bool)>,
        elsewhere: Elsewhere,
        begun: bool,
        terminal: &Terminal,
    ) -> Self {
        let made = [&own, &elsewhere.lent].into_iter().flatten().any(|(_, made)| *made);
        let own = own.map(|(record, _)| record);
        let missing = |there: Option<&Record>| {
            let there = there.map_or(&[][..], Record::seeds);
            wanted.plan.seeds.iter().copied().filter(|seed| !there.contains(seed)).collect::<Vec<_>>()
        };
        let record = elsewhere.with(own.clone(), terminal);
        let missing = match &record {
            // What cannot be joined is of use only as a whole.
            Some(whole) if !whole.is_joinable() && !missing(Some(whole)).is_empty() => missing(own.as_ref()),
            record => missing(record.as_ref()),
        };
        Self { record, made, elsewhere, begun, missing }
    }
}

/// Both together; where that cannot be, the one with more seeds, and a note of what is left out.
pub(super) fn joined(own: Option<Record>, lent: Option<&Record>, terminal: &Terminal) -> Option<Record> {
    let (Some(own), Some(lent)) = (&own, lent) else { return own.or_else(|| lent.cloned()) };
    if let Some(both) = own.join(lent) {
        return Some(both);
    }
    let (used, other) = if lent.seeds().len() > own.seeds().len() { (lent, own) } else { (own, lent) };
    let lost: Vec<u64> = other.seeds().iter().copied().filter(|seed| !used.seeds().contains(seed)).collect();
    if !lost.is_empty() {
        terminal.note(format_args!(
            "note: {}: {} of one record left out: it cannot be joined with that of {}, since one of them does not tell \
             its seeds apart; train the cell anew to have both",
            used.cell,
            seeds_words(&lost),
            seeds_words(used.seeds())
        ));
    }
    Some(used.clone())
}

/// The record of all seeds of a cell that are finished by now, and whether nothing stopped it.
pub(super) type Ending = anyhow::Result<(Option<Record>, bool)>;

pub(super) fn has_diverged(error: &anyhow::Error) -> bool {
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
pub(super) struct Folder(pub PathBuf);

impl Folder {
    /// Checks that nothing of somebody else is overwritten: the folder is new or empty, or a set of experiments that this
    /// version of mcvl knows. The experiments that its tables tell, which go on being told.
    pub fn check_place(&self) -> anyhow::Result<Vec<String>> {
        #[derive(Deserialize)]
        struct Head {
            format: String,
            version: u32,
            #[serde(default)]
            claims: Vec<Told>,
        }
        #[derive(Deserialize)]
        struct Told {
            experiment: String,
        }
        let path = self.0.join("results.json");
        if path.exists() {
            let text = fs::read(&path).map_err(RunsError::io("read", &path))?;
            let why = match serde_json::from_slice::<Head>(&text) {
                Ok(Head { format, version: 1..=RESULTS_VERSION, claims }) if format == RESULTS_FORMAT => {
                    return Ok(claims.into_iter().map(|told| told.experiment).collect());
                }
                Ok(Head { format, version, .. }) if format == RESULTS_FORMAT => format!(
                    "is of version {version}, this program writes version {RESULTS_VERSION}: use the version of mcvl that \
                     wrote it, or choose another folder with -o"
                ),
                _ => "holds no results of mcvl reproduce: choose another folder with -o".to_owned(),
            };
            return Err(RunsError::damaged(&path, why).into());
        }
        // Before the first results there are cells or records alone.
        let is_ours = |name: &str| self.0.join(name).exists();
        if !RunDir::new(&self.0).is_free()? && !["cells", "records"].into_iter().any(is_ours) {
            usage!("{} is not empty and holds no results of mcvl reproduce: choose another with -o", self.0.display());
        }
        if let Some(path) = TABLES.iter().map(|name| self.0.join(name)).find(|path| path.exists()) {
            usage!("{} is there, but no results of mcvl reproduce: choose another folder with -o", path.display());
        }
        Ok(Vec::new())
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
    pub fn standing(
        &self,
        wanted: &Wanted,
        lent: Option<(Record, bool)>,
        terminal: &Terminal,
    ) -> anyhow::Result<Standing> {
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
            return Ok(Standing::new(wanted, own, Elsewhere { lent, kept: None }, begun, terminal));
        }
        let run = self.run(cell);
        let begun = run.is_begun()?;
        let elsewhere = Elsewhere { lent, kept: self.kept(wanted, begun)? };
        let own = if begun { self.in_run(wanted, &run, &elsewhere)? } else { None };
        Ok(Standing::new(wanted, own, elsewhere, begun, terminal))
    }

    /// The finished seeds of a cell's run, and whether their record was made just now.
    fn in_run(&self, wanted: &Wanted, run: &RunDir, elsewhere: &Elsewhere) -> anyhow::Result<Option<(Record, bool)>> {
        let (plan, seeds) = (Plan::read(run)?, elsewhere.seeds());
        self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, &seeds, Some(&plan.learners))?;
        let Some(manifest) = Manifest::of_run(run)? else { return Ok(None) };
        // A record of this very state spares reading the run; that of a run that goes on is made again.
        let finished = manifest.state == State::Finished;
        match &elsewhere.kept {
            Some(found) if finished && found.is_of(&manifest.seal) => Ok(Some((found.clone(), false))),
            _ => Ok(self.own(wanted.cell, &manifest)?.map(|record| (record, true))),
        }
    }

    /// What the folder's record of a cell holds. Where the run is there, one that cannot be read is made again.
    fn kept(&self, wanted: &Wanted, begun: bool) -> anyhow::Result<Option<Record>> {
        let path = self.record(wanted.cell);
        let found = match Record::read(&path) {
            Ok(found) => found,
            Err(_) if begun || !path.exists() => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let seeds = found.seeds();
        if seeds.iter().any(|seed| !wanted.plan.seeds.contains(seed)) {
            return Err(other_seeds(&path, seeds, &wanted.plan));
        }
        self.of_cell(wanted, &path, found).map(Some)
    }

    /// What the folder's record holds of a cell that was not asked for, whatever its seeds.
    pub fn beside(&self, wanted: &Wanted) -> anyhow::Result<Option<Record>> {
        let path = self.record(wanted.cell);
        if !path.exists() {
            return Ok(None);
        }
        self.of_cell(wanted, &path, Record::read(&path)?).map(Some)
    }

    /// A record that a place has for a cell, if it is one of that cell.
    fn of_cell(&self, wanted: &Wanted, path: &Path, found: Record) -> anyhow::Result<Record> {
        if !wanted.fits_record(&found, &setting(&found, path)?) {
            return Err(other_setting(path, &wanted.plan));
        }
        Ok(Record { cell: wanted.cell.name.to_owned(), ..found }.of_learners(wanted.cell.learners))
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
        let plan = &wanted.plan;
        let enough = plan.seeds.iter().all(|seed| seeds.contains(seed) || elsewhere.contains(seed));
        if !enough || seeds.iter().any(|seed| !plan.seeds.contains(seed)) {
            return Err(other_seeds(place, seeds, plan));
        }
        let setting = plan.config.with_seed(seeds.first().copied().unwrap_or(plan.config.seed));
        if config != setting.to_string() || learners.is_some_and(|learners| learners != plan.learners) {
            return Err(other_setting(place, plan));
        }
        Ok(())
    }

    /// Trains what is missing of some cells, each with how it ended; those behind one that stopped are left out.
    pub fn train_all(
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
        let elsewhere = standing.elsewhere.seeds();
        let session = if run.is_begun()? {
            Session::resume(run.clone(), |plan| {
                self.same(wanted, run.path(), &plan.config.to_string(), &plan.seeds, &elsewhere, Some(&plan.learners))
            })?
        } else {
            Session::begin(run.clone(), cell.plan(quick, &standing.missing)?, false)?
        };
        let (ended, diverged) = match session.work(manner, terminal) {
            Ok(ended) => (Some(ended), None),
            // Its other seeds are finished all the same.
            Err(error) if has_diverged(&error) => (None, Some(error)),
            Err(error) => return Err(error),
        };
        let (own, finished) = match ended {
            Some(Ended::Finished { set, .. }) => (Some(Record::of_run(cell.name, &set, &Manifest::read(&run)?)), true),
            _ => (self.own(cell, &Manifest::read(&run)?)?, false),
        };
        let record = self.keep_with(standing.elsewhere.with(own, terminal), wanted, terminal)?;
        diverged.map_or(Ok((record, finished)), Err)
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
        let trained = || before.saturating_add(u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX));
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
        Ok((self.keep_with(Some(record), wanted, terminal)?, true))
    }

    /// Waits until no other process writes records or tables here. Given up when dropped, also by a kill.
    pub fn lock(&self) -> Result<Lock, RunsError> {
        fs::create_dir_all(&self.0).map_err(RunsError::io("create the folder", &self.0))?;
        Lock::wait(&RunDir::new(&self.0))
    }

    /// What is known of a cell, with the seeds that another process has finished here meanwhile.
    pub fn by_now(&self, known: Option<Record>, wanted: &Wanted, terminal: &Terminal) -> Option<Record> {
        let found = self.kept(wanted, true).unwrap_or_else(|why| {
            terminal.note(format_args!("note: left out of tables and figures: {why:#}"));
            None
        });
        match (known, found) {
            (Some(known), Some(found)) if found.seeds().iter().all(|seed| known.seeds().contains(seed)) => Some(known),
            (known, found) => joined(found, known.as_ref(), terminal),
        }
    }

    /// Keeps the record of a cell, if there is one, without losing what another process has kept of it meanwhile.
    fn keep_with(
        &self,
        record: Option<Record>,
        wanted: &Wanted,
        terminal: &Terminal,
    ) -> anyhow::Result<Option<Record>> {
        let _lock = self.lock()?;
        let record = self.by_now(record, wanted, terminal);
        record.iter().try_for_each(|record| self.keep(record, wanted.cell))?;
        Ok(record)
    }

    pub fn keep(&self, record: &Record, cell: &Cell) -> anyhow::Result<()> {
        let path = self.record(cell);
        let folder = path.parent().expect("a record lies in a folder");
        fs::create_dir_all(folder).map_err(RunsError::io("create the folder", folder))?;
        Ok(record.write(&path)?)
    }

    /// Writes tables, page and figures; says what.
    pub fn write(
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
        let tables = [results.claims_csv(), results.numbers_csv(), results.gate_csv(), results.costs_csv()];
        let mut texts = vec![("results.json", json)];
        texts.extend(TABLES.into_iter().zip(tables));
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
            write_atomic(&path.with_extension("csv"), figure.csv().as_bytes())?;
            names.push(format!("{}.svg, .png, .csv", drawing.name));
        }
        written.insert(0, format!("{} ({})", self.0.display(), names.join(", ")));
        Ok(written)
    }

    /// The text of a page with the results put in.
    fn page<'a>(&self, path: &'a Path, results: &Results) -> anyhow::Result<(&'a Path, String)> {
        // Figures are named as seen from the page, so that both can be moved together.
        let whole = |path: &Path| std::path::absolute(path).map_err(RunsError::io("find", path));
        let (page, folder) = (whole(path)?, whole(&self.0)?);
        let seen = pathdiff::diff_paths(&folder, page.parent().unwrap_or(&page)).unwrap_or(folder);
        let figures = if seen.as_os_str().is_empty() { ".".to_owned() } else { seen.display().to_string() };
        Ok((path, Self::put_in(path, &markdown(results, &figures))?))
    }

    /// The text of a page with another text between its two marks.
    pub fn put_in(path: &Path, text: &str) -> anyhow::Result<String> {
        let page = fs::read_to_string(path).map_err(RunsError::io("read", path))?;
        let why = || Usage(format!("--page {}: it lacks the lines `{BEGIN}` and `{END}`", path.display()));
        Ok(put(&page, text).ok_or_else(why)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::progress::Style;
    use crate::cli::terminal::Color;

    /// Its first seed ends, its second one diverges.
    static DIVERGES: Cell = Cell {
        name: "diverges",
        config: "env=box-moving lr=4e11 safe_steps=40 full_steps=40 forecast=5 exploration=5",
        learners: &[Learner::Mc],
        repeats: None,
        ours: true,
    };

    #[test]
    fn seeds_beside_one_that_diverges_are_kept() {
        let scratch = mcvl_tests::scratch();
        let folder = Folder(scratch.path().join("set"));
        let wanted = Wanted { cell: &DIVERGES, plan: DIVERGES.plan(false, &[0, 1]).unwrap(), train: true };
        let terminal = Terminal::new(Color::Never, true, false);
        let manner = Manner {
            threads: 1,
            checkpoint_every: Duration::from_secs(60),
            deadline: None,
            progress: Style::None,
            resume: String::new(),
            remote: None,
            beside: false,
        };
        let standing = folder.standing(&wanted, None, &terminal).unwrap();
        let error = folder.train(&wanted, &standing, false, &manner, &terminal).unwrap_err();
        assert!(has_diverged(&error), "{error:#}");
        let record = Record::read(&folder.record(&DIVERGES)).unwrap();
        assert_eq!(record.seeds(), [0]);
        assert_eq!(folder.by_now(None, &wanted, &terminal), Some(record), "the tables of the same command have it");
    }
}
