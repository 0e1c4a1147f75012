//! The command line: what can be asked, and which exit code answers. stdout carries results, stderr
//! progress and messages.

mod bench;
mod doctor;
mod export;
mod inspect;
mod page;
mod play;
mod progress;
mod replay;
mod report;
mod reproduce;
mod serve;
mod session;
mod settings;
mod target;
mod terminal;
mod train;

use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use mcvl::runs::RunsError;
use mcvl_core::config::{ConfigError, Learner, Preset};

use terminal::{Color, Terminal, say};

/// Width of all help and tables.
const WIDTH: usize = 80;

/// Modification-Considering Value Learning: a reinforcement learner that forecasts what an update would
/// make of it, and refuses what it disapproves of today.
#[derive(Parser)]
#[command(
    name = "mcvl",
    version,
    arg_required_else_help = true,
    after_help = "\
Examples:
  mcvl train box-moving             train both learners, see which is hacked
  mcvl explain runs/box-moving#3    one decision in full, with both futures
  mcvl report runs/box-moving       one HTML file with curves and decisions

Exit codes:
  0 done; 1 an assertion or claim does not hold, or training diverged;
  2 usage or configuration; 3 the machine (disk, corrupt file);
  4 verification mismatch; 130 stopped after saving (by a second Ctrl-C: at
  once, without saving)."
)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

#[derive(Args)]
#[command(next_help_heading = "Everywhere")]
struct Global {
    /// Print only results and errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Print every decision as it is made
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Colours on stdout (auto: on a terminal, unless NO_COLOR is set)
    #[arg(long, global = true, value_enum, default_value_t = Color::Auto, value_name = "WHEN")]
    color: Color,
}

#[derive(Subcommand)]
enum Command {
    /// Train in an environment: Safe first, then each learner in the Full world
    Train(Box<train::TrainArgs>),
    /// List the environments: what the hack is, sizes, budgets
    Envs(inspect::EnvsArgs),
    /// List the decisions of a run
    Ledger(inspect::LedgerArgs),
    /// Show one decision in full: transition, both futures, ratings, why
    Explain(inspect::ExplainArgs),
    /// Re-derive a decision from the run's configuration and compare
    Replay(replay::ReplayArgs),
    /// Check a run against its manifest and its ledger's chain
    Verify(inspect::VerifyArgs),
    /// Compare learners over seeds: means, intervals, verdict quality
    Compare(report::CompareArgs),
    /// Write a self-contained HTML report with curves and decisions
    Report(report::ReportArgs),
    /// Reproduce the paper's experiments: train, judge every claim, draw figures
    Reproduce(Box<reproduce::ReproduceArgs>),
    /// Act in an environment yourself; at the end see the hidden score
    Play(play::PlayArgs),
    /// Write a run in formats that other tools read
    Export(export::ExportArgs),
    /// Serve the page to this machine's browser, with a run on it
    Serve(serve::ServeArgs),
    /// Write the page, with a run on it, as one HTML file that opens from disk
    Page(page::PageArgs),
    /// Measure updates, forecasts, checks and steps per second
    Bench(bench::BenchArgs),
    /// Say what this machine offers and whether its arithmetic is exact
    Doctor(doctor::DoctorArgs),
    /// Print completions for a shell
    #[command(after_help = "Example:\n  mcvl completions bash > ~/.local/share/bash-completion/completions/mcvl")]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// How a command ended that did what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Done {
    /// All is well.
    Well,
    /// It ran, but an assertion or a claim does not hold, or training diverged.
    DoesNotHold,
    /// What was verified is not what it should be.
    Mismatch,
    /// Stopped on request, its state saved.
    Interrupted,
}

/// A request that makes no sense: what, and what would.
#[derive(Debug)]
struct Usage(String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

/// Fails with a [`Usage`] error.
macro_rules! usage {
    ($($argument:tt)*) => { return Err($crate::cli::Usage(format!($($argument)*)).into()) };
}
use usage;

/// Parses the command line, does what it says, and answers with an exit code.
pub fn main() -> ExitCode {
    let command = Cli::command().term_width(WIDTH);
    let cli = match command.try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(error) => {
            // Help that nobody reads to its end is no failure.
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    let mut terminal = Terminal::new(cli.global.color, cli.global.quiet, cli.global.verbose);
    let result = run(cli.command, &mut terminal).and_then(|done| match terminal.out.flush() {
        // That nobody reads to the end changes no verdict.
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(done),
    });
    // Files name themselves in their errors; without a name it is that of the output.
    let result =
        result.map_err(|error| if is_full_stdout(&error) { error.context("cannot write to stdout") } else { error });
    match result {
        Ok(Done::Well) => ExitCode::SUCCESS,
        Ok(Done::DoesNotHold) => ExitCode::from(1),
        Ok(Done::Mismatch) => ExitCode::from(4),
        Ok(Done::Interrupted) => ExitCode::from(130),
        // Results were streamed, and whoever read them has seen enough.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            say(format_args!("error: {error:#}"));
            ExitCode::from(code(&error))
        }
    }
}

fn run(command: Command, terminal: &mut Terminal) -> anyhow::Result<Done> {
    match command {
        Command::Train(arguments) => train::train(&arguments, terminal),
        Command::Envs(arguments) => inspect::envs(&arguments, terminal),
        Command::Ledger(arguments) => inspect::ledger(&arguments, terminal),
        Command::Explain(arguments) => inspect::explain(&arguments, terminal),
        Command::Replay(arguments) => replay::replay(&arguments, terminal),
        Command::Verify(arguments) => inspect::verify(&arguments, terminal),
        Command::Compare(arguments) => report::compare(&arguments, terminal),
        Command::Report(arguments) => report::report(&arguments, terminal),
        Command::Reproduce(arguments) => reproduce::reproduce(&arguments, terminal),
        Command::Play(arguments) => play::play(&arguments, terminal),
        Command::Export(arguments) => export::export(&arguments, terminal),
        Command::Serve(arguments) => serve::serve(&arguments, terminal),
        Command::Page(arguments) => page::page(&arguments, terminal),
        Command::Bench(arguments) => bench::bench(&arguments, terminal),
        Command::Doctor(arguments) => doctor::doctor(&arguments, terminal),
        Command::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "mcvl", &mut text);
            terminal.out.write_all(&text)?;
            Ok(Done::Well)
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

fn is_full_stdout(error: &anyhow::Error) -> bool {
    let full = |error: &io::Error| error.kind() == ErrorKind::StorageFull;
    error.chain().count() == 1 && error.downcast_ref::<io::Error>().is_some_and(full)
}

/// The exit code of an error.
fn code(error: &anyhow::Error) -> u8 {
    if error.is::<Usage>() || error.is::<ConfigError>() {
        return 2;
    }
    match error.downcast_ref::<RunsError>() {
        Some(RunsError::Request(_)) => 2,
        Some(RunsError::Diverged { .. }) => 1,
        _ => 3,
    }
}

/// Reads a value that core knows by name, with core's suggestions.
fn learner(text: &str) -> Result<Learner, String> {
    named(text, Learner::NAMES, Learner::ALL)
}

fn preset(text: &str) -> Result<Preset, String> {
    named(text, Preset::NAMES, Preset::ALL)
}

fn named<T: Copy>(text: &str, names: &[&str], values: &[T]) -> Result<T, String> {
    match names.iter().position(|name| *name == text) {
        Some(index) => Ok(values[index]),
        None => Err(mcvl_core::config::expected_one_of(text, names)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn names_are_those_of_core() {
        for name in Learner::NAMES {
            assert_eq!(learner(name).unwrap().name(), *name);
        }
        for name in Preset::NAMES {
            assert_eq!(preset(name).unwrap().name(), *name);
        }
    }
}
