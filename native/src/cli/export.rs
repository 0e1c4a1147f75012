//! `mcvl export`: a run in the formats that other tools read.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use mcvl::export::{self, File};
use mcvl::report::claims::seed_list;
use mcvl::runs::{Reader, RunDir, RunsError, SeedRun, check_target, write_atomic};

use super::terminal::Terminal;
use super::{Done, inspect, usage};

/// Arguments of `mcvl export`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl export runs/box-moving --to csv
  mcvl export runs/box-moving --to tensorboard && tensorboard --logdir runs
  mcvl export runs/box-moving --to safetensors -o weights
  mcvl export runs/box-moving --to tape --seed 0 --check 3 -o demo.json

Tensors are named NETWORK.LAYER.weight and NETWORK.LAYER.bias. Weights are
[inputs, outputs]: y = x W + b, with ReLU between layers; the input of the
reward model is the observation, then the action as one-hot (in Reacher as its
numbers). The metadata has the same with the layout of the observation under
`layout`, the leg under `leg`, and settings that are not defaults under `config`.

In tables returns, performance and reward_raw are raw; reward, predicted,
utilities and margins are scaled, as what networks put out. Events of TensorBoard
all have the time of the run's start: look at them by step. Every column, tag and
tensor is told in docs/export.md.

A run that is not finished is exported as far as it is. Prints the paths of
the files.")]
pub struct ExportArgs {
    /// Run directory, or the folder of a seed in it
    run: PathBuf,
    /// What to write
    #[arg(long, value_name = "FORMAT")]
    to: Format,
    /// The folder; of one tape also the file, NAME.json
    /// [default: export/FORMAT in the run directory]
    #[arg(short, long, value_name = "FILE_OR_FOLDER", verbatim_doc_comment)]
    output: Option<PathBuf>,
    /// Only this seed
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Only this check, in a tape; may be repeated
    #[arg(long = "check", value_name = "N")]
    checks: Vec<u32>,
    /// Replace files that are there
    #[arg(long)]
    overwrite: bool,
}

/// A format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// One JSON file per seed: evaluations, and checks with both futures
    Tape,
    /// Tables of evaluations, learner, episodes and checks
    Csv,
    /// Event files, one run of TensorBoard per seed and leg
    Tensorboard,
    /// Weights at the end of each leg
    Safetensors,
}

impl Format {
    fn name(self) -> &'static str {
        match self {
            Format::Tape => "tape",
            Format::Csv => "csv",
            Format::Tensorboard => "tensorboard",
            Format::Safetensors => "safetensors",
        }
    }
}

/// Writes a run in another format.
pub fn export(arguments: &ExportArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let run = Reader::open(&arguments.run)?;
    let set = run.set()?;
    let seeds = inspect::seeds(&set, arguments.seed)?;
    if seeds.is_empty() {
        usage!("{} has not begun any seed yet", arguments.run.display());
    }
    arguments.check_checks(&seeds)?;
    let files = match arguments.to {
        Format::Tape => {
            let wanted = |number| arguments.checks.is_empty() || arguments.checks.contains(&number);
            export::tapes(&run, &seeds, &wanted)?
        }
        Format::Csv => export::csv(&seeds),
        Format::Tensorboard => {
            let started = run.manifest().map(|manifest| manifest.started.clone()).unwrap_or_default();
            let started = humantime::parse_rfc3339(&started)
                .map_err(|error| RunsError::damaged(&run.run().manifest(), format!("its time `{started}`: {error}")))?;
            export::tensorboard(&seeds, started)
        }
        Format::Safetensors => export::weights(&run, &seeds)?,
    };
    if files.is_empty() {
        usage!("{} has finished no leg yet: there are no weights to export", arguments.run.display());
    }
    let open = set.unfinished();
    if !open.is_empty() {
        let seeds = seed_list(&open);
        terminal.note(format_args!("note: not finished, and exported as far as they are: seeds {seeds}"));
    }
    let files = arguments.place(run.run(), files)?;
    arguments.check_places(&files)?;
    for File { path, bytes } in &files {
        let folder = path.parent().unwrap_or(Path::new(""));
        fs::create_dir_all(folder).map_err(RunsError::io("create the folder", folder))?;
        write_atomic(path, bytes)?;
    }
    // Only now: whoever stops reading the list must not stop the writing.
    for File { path, .. } in &files {
        writeln!(terminal.out, "{}", path.display())?;
    }
    Ok(Done::Well)
}

impl ExportArgs {
    /// Numbers of checks make sense for the tape of one seed.
    fn check_checks(&self, seeds: &[&SeedRun]) -> anyhow::Result<()> {
        if self.checks.is_empty() {
            return Ok(());
        }
        if self.to != Format::Tape {
            usage!("--check chooses what a tape holds; --to {} takes all checks", self.to.name());
        }
        let [seed] = seeds else {
            usage!("--check counts the checks of one seed: choose it with --seed");
        };
        self.checks.iter().try_for_each(|number| inspect::check_exists(&seed.path, *number, seed.checks.len()))
    }

    /// The files at the places where they are to be written.
    fn place(&self, run: &RunDir, mut files: Vec<File>) -> anyhow::Result<Vec<File>> {
        let folder = match &self.output {
            Some(path)
                if self.to == Format::Tape && !path.is_dir() && path.extension().is_some_and(|e| e == "json") =>
            {
                let [file] = &mut files[..] else {
                    usage!(
                        "{} is one file for {} tapes: choose one with --seed, or name a folder",
                        path.display(),
                        files.len()
                    );
                };
                file.path.clone_from(path);
                return Ok(files);
            }
            Some(path) => path.clone(),
            None => run.export(self.to.name()),
        };
        files.iter_mut().for_each(|file| file.path = folder.join(&file.path));
        Ok(files)
    }

    /// Before the first file is written, none may be in the way.
    fn check_places(&self, files: &[File]) -> anyhow::Result<()> {
        files.iter().try_for_each(|file| check_target(&file.path))?;
        match files.iter().find(|file| file.path.exists()) {
            Some(File { path, .. }) if !self.overwrite => {
                usage!("{} is there already: --overwrite replaces it, -o writes elsewhere", path.display())
            }
            _ => Ok(()),
        }
    }
}
