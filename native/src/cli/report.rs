//! Comparing runs and reporting on them.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use mcvl::page::{self, Modules, Tape};
use mcvl::report::claims::{Summary, plural};
use mcvl::report::expression::Expression;
use mcvl::report::{html, plot};
use mcvl::runs::{
    FileDigest, LedgerLine, Manifest, Place, Reader, RunDir, RunSet, RunsError, SeedRun, check_target, ledger,
    run_tape, sha256, tape, write_atomic,
};
use mcvl_core::record::CheckRecord;
use serde_json::json;

use super::target::{self, Kind};
use super::terminal::Terminal;
use super::{Done, Usage, usage};

/// Pixels per unit of the PNG figures: sharp on a screen.
const SCALE: f32 = 2.0;

/// Arguments of `mcvl compare`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl compare runs/box-moving
  mcvl compare runs/* --assert 'mc.performance >= 45'
  mcvl compare runs/box-moving --assert 'fraction(mc.performance >= 48) >= 0.9'

Expressions: numbers like 45 or 1e-9, + - * /, comparisons, and, or, not,
fraction(...) of seeds; metrics like mc.performance, baseline.return.low,
mc.recall, mc.unchecked (an unknown one is answered with all there are).
Every expression has to hold for every run, and of an unfinished one none
does.")]
pub struct CompareArgs {
    /// Run directories
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Exit with 1 unless this is true; may be repeated
    #[arg(long = "assert", value_name = "EXPR", value_parser = expression, allow_hyphen_values = true)]
    assertions: Vec<Expression>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn expression(text: &str) -> Result<Expression, String> {
    Expression::parse(text).map_err(|error| error.to_string())
}

/// Compares the learners of runs over their seeds.
pub fn compare(arguments: &CompareArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let sets = read(&arguments.runs, !arguments.assertions.is_empty(), terminal)?;
    let summaries: Vec<Summary> = sets.iter().map(Summary::new).collect();
    let mut judged = Vec::new();
    for (set, summary) in sets.iter().zip(&summaries) {
        // What is claimed of a run is claimed of all its seeds.
        let whole = summary.unfinished.is_empty();
        for assertion in &arguments.assertions {
            let holds = assertion
                .evaluate(summary)
                .map_err(|error| Usage(format!("--assert on {}: {error}", set.path.display())))?;
            judged.push((set.path.display().to_string(), assertion.to_string(), holds && whole));
        }
        if !arguments.assertions.is_empty() && !whole {
            let (open, planned) = (summary.unfinished.len(), plural(set.planned.len() as u64, "seed"));
            let path = set.path.display();
            terminal.note(format_args!(
                "note: {open} of {planned} of {path} unfinished, so nothing is held to be true of it"
            ));
        }
    }
    if arguments.json {
        let runs: Vec<_> = sets
            .iter()
            .zip(&summaries)
            .map(|(set, summary)| json!({ "run": set.path.display().to_string(), "summary": summary }))
            .collect();
        let assertions: Vec<_> = judged
            .iter()
            .map(|(run, expression, holds)| json!({ "run": run, "expression": expression, "holds": holds }))
            .collect();
        let value = json!({ "runs": runs, "assertions": assertions });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
    } else {
        for (set, summary) in sets.iter().zip(&summaries) {
            writeln!(terminal.out, "{}", terminal.paint(1, set.path.display()))?;
            writeln!(terminal.out, "{}\n", summary.text().trim_end())?;
        }
        for (run, expression, holds) in &judged {
            let (color, verdict) = if *holds { (32, "holds") } else { (31, "does not hold") };
            writeln!(terminal.out, "{}: {expression} ({run})", terminal.paint(color, verdict))?;
        }
    }
    Ok(if judged.iter().all(|(_, _, holds)| *holds) { Done::Well } else { Done::DoesNotHold })
}

/// Reads runs. Folders that are none, which `runs/*` may name, are left out with a note where there are others, and so are
/// runs without a seed, unless something is claimed of every run.
fn read(paths: &[PathBuf], claims: bool, terminal: &Terminal) -> anyhow::Result<Vec<RunSet>> {
    let (mut sets, mut left_out) = (Vec::new(), Vec::new());
    for path in paths {
        match RunSet::read(path) {
            Ok(set) if set.seeds.is_empty() => {
                let why = format!("{} has not begun any seed yet", path.display());
                if claims {
                    usage!("{why}");
                }
                left_out.push(why);
            }
            Ok(set) => sets.push(set),
            Err(RunsError::Request(why)) if path.is_dir() => left_out.push(why),
            Err(error) => return Err(error.into()),
        }
    }
    if let Some(first) = left_out.first().filter(|_| sets.is_empty()) {
        usage!("{first}");
    }
    left_out.iter().for_each(|why| terminal.note(format_args!("note: left out: {why}")));
    Ok(sets)
}

/// Arguments of `mcvl report`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl report runs/box-moving
  mcvl report runs/* -o all.html
  mcvl report runs/box-moving --modules www/pkg

The decisions of one seed of each run can be played in the report. Beside the
report lie the learning curves of each run, as curves.svg and curves.png, or
curves-NAME.svg and curves-NAME.png where there are several (NAME is that of
the run directory; of equal ones the second is NAME-2). A finished run keeps
its curves in its own directory. Files that an earlier report wrote there are
replaced, others only with --overwrite. Prints the paths of the files.")]
pub struct ReportArgs {
    /// Run directories
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// The file [default: report.html in the first run directory]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Folder of the modules of `cargo xtask web`, with which a visitor can
    /// derive the played decisions again [default: none]
    #[arg(long, value_name = "FOLDER", verbatim_doc_comment)]
    modules: Option<PathBuf>,
    /// Replace files that no earlier report wrote
    #[arg(long)]
    overwrite: bool,
}

/// Writes a report, with its curves beside it.
pub fn report(arguments: &ReportArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let sets = read(&arguments.runs, false, terminal)?;
    let path = match &arguments.output {
        Some(path) => path.clone(),
        None => Place::find(&sets[0].path)?.run.report(),
    };
    arguments.check_place(&path)?;
    let curves = beside(path.parent().unwrap_or(Path::new("")), &sets)?;
    let damaged = RefCell::new(None);
    let ledgers = RefCell::new(BTreeMap::new());
    // A tape that is there but is not what was written must not pass for one that was never made.
    let film = |seed: &SeedRun, number: u32| {
        if !seed.dir().tape(number).exists() {
            return None;
        }
        match vouched_tape(seed, number, &mut ledgers.borrow_mut()) {
            Ok(check) => Some(check),
            Err(error) => {
                damaged.borrow_mut().get_or_insert(error);
                None
            }
        }
    };
    let modules = arguments.modules.as_deref().map(Modules::read).transpose()?;
    let page = |seed: &SeedRun, number: u32| match playable(seed, number, modules.as_ref()) {
        Ok(page) => page,
        Err(error) => {
            damaged.borrow_mut().get_or_insert(error);
            None
        }
    };
    let page = html::html(&sets, &film, &page);
    if let Some(error) = damaged.into_inner() {
        return Err(error.into());
    }
    arguments.check_curves(&path, &curves)?;
    let mut page = page.into_bytes();
    page.extend_from_slice(note(&curves).as_bytes());
    for (path, bytes) in [(path, page)].into_iter().chain(curves) {
        write_atomic(&path, &bytes)?;
        writeln!(terminal.out, "{}", path.display())?;
    }
    Ok(Done::Well)
}

impl ReportArgs {
    /// Before anything is made, nothing else than a report may be in its place.
    fn check_place(&self, path: &Path) -> anyhow::Result<()> {
        if self.overwrite { Ok(check_target(path)?) } else { target::check(path, Kind::Report, target::ADVICE) }
    }

    /// Before the first file is written, none of the curves may be in the way of those that lie there.
    fn check_curves(&self, path: &Path, curves: &[(PathBuf, Vec<u8>)]) -> anyhow::Result<()> {
        if self.overwrite {
            return Ok(());
        }
        let noted = if path.is_file() { noted(path)? } else { Vec::new() };
        for (place, bytes) in curves.iter().filter(|(place, _)| place.is_file()) {
            let digest = FileDigest::of(place)?.sha256;
            // In the directory of a run, its curves are its own.
            if check_target(place).is_ok() && !noted.contains(&digest) && digest != sha256(bytes) {
                usage!("{} is there already and is not of this report: {}", place.display(), target::ADVICE);
            }
        }
        Ok(())
    }
}

/// What the last line of a report begins with: it has the digests of the files that were written beside it.
const NOTE: &str = "<!-- beside it: ";

/// The last line of a report beside which these files lie.
fn note(files: &[(PathBuf, Vec<u8>)]) -> String {
    let digests: Vec<String> = files.iter().map(|(_, bytes)| sha256(bytes)).collect();
    if digests.is_empty() { String::new() } else { format!("{NOTE}{} -->\n", digests.join(" ")) }
}

/// The digests of the files that were written beside a report.
fn noted(report: &Path) -> Result<Vec<String>, RunsError> {
    let text = fs::read(report).map_err(RunsError::io("read", report))?;
    let text = String::from_utf8_lossy(&text);
    let digests = text.trim_end().lines().next_back().and_then(|line| line.strip_prefix(NOTE)?.strip_suffix(" -->"));
    Ok(digests.unwrap_or_default().split(' ').map(str::to_owned).collect())
}

/// A check with its films, for which the ledger of its seed vouches; each ledger is read once.
fn vouched_tape(
    seed: &SeedRun,
    number: u32,
    ledgers: &mut BTreeMap<PathBuf, Vec<LedgerLine>>,
) -> Result<CheckRecord, RunsError> {
    let dir = seed.dir();
    if !ledgers.contains_key(&seed.path) {
        ledgers.insert(seed.path.clone(), ledger(&dir)?);
    }
    match ledgers[&seed.path].get(number as usize - 1) {
        Some(line) => tape(&dir, number, line),
        None => Err(RunsError::damaged(&dir.ledger(), format!("has no check {number} any more"))),
    }
}

/// The page in one file that opens at a check of a seed; none where its tape was not kept.
fn playable(seed: &SeedRun, number: u32, modules: Option<&Modules>) -> Result<Option<String>, RunsError> {
    let kept = |other| seed.dir().tape(other).exists();
    if !kept(number) {
        return Ok(None);
    }
    let run = Reader::open(&seed.path)?;
    let wanted = |other| (other == number || other <= html::PLAYED) && kept(other);
    let tape = Tape { name: format!("run/seed-{}.json", seed.seed), text: run_tape(&run, seed.seed, &wanted)? };
    Ok(Some(page::embedded(modules, &tape, number)))
}

/// The curves that lie beside a report in `folder`, each run's under a name of its own.
fn beside(folder: &Path, sets: &[RunSet]) -> anyhow::Result<Vec<(PathBuf, Vec<u8>)>> {
    let named = |path: &Path| if path.as_os_str().is_empty() { PathBuf::from(".") } else { path.to_owned() };
    let place = |path: &Path| fs::canonicalize(named(path)).ok();
    let (mut files, mut taken) = (Vec::new(), BTreeSet::new());
    for set in sets {
        let own = place(&set.path).is_some_and(|path| place(folder) == Some(path));
        // In its own directory a finished run has its curves, and the manifest vouches for them.
        if own && Manifest::read(&RunDir::new(folder)).is_ok_and(|manifest| manifest.files.contains_key("curves.svg")) {
            continue;
        }
        let name = place(&set.path).unwrap_or_else(|| set.path.clone());
        let name = format!("curves-{}", name.file_name().unwrap_or_default().to_string_lossy());
        let alone = (sets.len() == 1).then(|| "curves".to_owned());
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        let is_free = |stem: &String| {
            let theirs = || check_target(&folder.join(format!("{stem}.svg"))).is_err();
            !taken.contains(stem) && (own || !theirs())
        };
        let stem = alone.into_iter().chain([name.clone()]).chain(numbered).find(is_free).expect("numbers do not end");
        let paths = ["svg", "png"].map(|extension| folder.join(format!("{stem}.{extension}")));
        files.extend(paths.into_iter().zip(draw_curves(set)?));
        taken.insert(stem);
    }
    Ok(files)
}

/// The learning curves of a run as SVG and PNG.
fn draw_curves(set: &RunSet) -> anyhow::Result<[Vec<u8>; 2]> {
    let figure = plot::curves(set);
    Ok([figure.svg().into_bytes(), figure.png(SCALE)?])
}

/// Writes the learning curves of a run into its directory.
///
/// # Errors
/// If they cannot be drawn or written.
pub fn write_curves(run: &RunDir, set: &RunSet) -> anyhow::Result<()> {
    let [svg, png] = draw_curves(set)?;
    write_atomic(&run.curves("svg"), &svg)?;
    Ok(write_atomic(&run.curves("png"), &png)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_names_what_lies_beside_it() {
        let path = std::env::temp_dir().join(format!("mcvl-report-{}.html", std::process::id()));
        let files = [(PathBuf::from("a.svg"), b"one".to_vec()), (PathBuf::from("a.png"), b"two".to_vec())];
        fs::write(&path, format!("<html>\n</html>\n{}", note(&files))).unwrap();
        assert_eq!(noted(&path).unwrap(), [sha256(b"one"), sha256(b"two")]);
        fs::write(&path, "<html>\n</html>\n").unwrap();
        assert!(!noted(&path).unwrap().contains(&sha256(b"one")));
        fs::remove_file(&path).unwrap();
        assert_eq!(note(&[]), "");
    }
}
