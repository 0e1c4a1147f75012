//! Comparing runs and reporting on them.

use std::cell::RefCell;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use mcvl::page::{self, Modules, Tape};
use mcvl::report::claims::Summary;
use mcvl::report::expression::Expression;
use mcvl::report::{html, plot};
use mcvl::runs::{Manifest, Place, RunDir, RunSet, RunsError, SeedRun, run_tape, tape, write_atomic};
use serde_json::json;

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

Expressions: numbers, + - * /, comparisons, and, or, not, fraction(...) of
seeds; metrics like mc.performance, baseline.return.low, mc.recall. Every
expression has to hold for every run.")]
pub struct CompareArgs {
    /// Run directories
    #[arg(required = true, value_name = "RUN")]
    runs: Vec<PathBuf>,
    /// Exit with 1 unless this is true; may be repeated
    #[arg(long = "assert", value_name = "EXPR", value_parser = expression)]
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
        for assertion in &arguments.assertions {
            let holds = assertion
                .evaluate(summary)
                .map_err(|error| Usage(format!("--assert on {}: {error}", set.path.display())))?;
            judged.push((set.path.display().to_string(), assertion.to_string(), holds));
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

The decisions of one seed of each run can be played in the report.")]
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
}

/// Writes a report, with its curves beside it.
pub fn report(arguments: &ReportArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let sets = read(&arguments.runs, false, terminal)?;
    let path = arguments.output.clone().unwrap_or_else(|| arguments.runs[0].join("report.html"));
    let damaged = RefCell::new(None);
    // A tape that is there but cannot be read must not pass for one that was never made.
    let film = |seed: &SeedRun, number: u32| {
        let dir = seed.dir();
        let tape = dir.tape(number).exists().then(|| tape(&dir, number))?;
        match tape {
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
    write_atomic(&path, page.as_bytes())?;
    writeln!(terminal.out, "{}", path.display())?;
    let folder = path.parent().unwrap_or(Path::new(""));
    for set in &sets {
        // In its own directory a finished run has its curves, and the manifest vouches for them.
        let run = RunDir::new(folder);
        if set.path == folder && Manifest::read(&run).is_ok_and(|manifest| manifest.files.contains_key("curves.svg")) {
            continue;
        }
        // Beside several runs' report each figure needs the name of its run.
        let name = set.path.file_name().unwrap_or_default().to_string_lossy();
        let stem = if sets.len() == 1 { "curves".to_owned() } else { format!("curves-{name}") };
        for path in write_curves(folder, &stem, set)? {
            writeln!(terminal.out, "{}", path.display())?;
        }
    }
    Ok(Done::Well)
}

/// The page in one file that opens at a check of a seed; none where its tape was not kept.
fn playable(seed: &SeedRun, number: u32, modules: Option<&Modules>) -> Result<Option<String>, RunsError> {
    let kept = |other| seed.dir().tape(other).exists();
    if !kept(number) {
        return Ok(None);
    }
    let run = Place::find(&seed.path)?.run;
    let wanted = |other| (other == number || other <= html::PLAYED) && kept(other);
    let tape = Tape { name: format!("run/seed-{}.json", seed.seed), text: run_tape(&run, seed.seed, &wanted)? };
    Ok(Some(page::embedded(modules, &tape, number)))
}

/// Writes the learning curves of a run as SVG and PNG.
///
/// # Errors
/// If they cannot be drawn or written.
pub fn write_curves(folder: &Path, stem: &str, set: &RunSet) -> anyhow::Result<[PathBuf; 2]> {
    let figure = plot::curves(set);
    let paths = ["svg", "png"].map(|extension| folder.join(stem).with_extension(extension));
    write_atomic(&paths[0], figure.svg().as_bytes())?;
    write_atomic(&paths[1], &figure.png(SCALE)?)?;
    Ok(paths)
}
