//! Automation of the repository: `cargo xtask setup|demo|web|tapes|pictures|figures|test|bench`.

mod demo;
mod figures;
mod mujoco;
mod page;
mod process;
mod setup;
mod tapes;
mod test;
mod web;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use setup::Purpose;

/// Automation of the repository.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Install what building and testing need; says what before it does, skips what is there
    Setup {
        /// Install this alone
        part: Option<Alone>,
    },
    /// Everything, end to end: build, train the main experiment, write its report, serve the page
    Demo {
        /// End after the report instead of serving the page
        #[arg(long)]
        no_serve: bool,
        /// Seeds to train, as in `mcvl train --seeds`
        #[arg(long, default_value = "0..10")]
        seeds: String,
    },
    /// Build the page's WebAssembly modules into www/pkg and report their sizes
    Web,
    /// Take the pictures of the page in docs/page anew
    Pictures,
    /// Record the tapes that come with the page anew: www/tape.json and www/tapes
    Tapes {
        /// Only these, as they lie under www, without the ending
        #[arg(value_name = "NAME")]
        names: Vec<String>,
        /// Record nothing: derive their decisions again in a browser and compare them bit by bit (minutes each)
        #[arg(long)]
        derive: bool,
    },
    /// Measure the page's figures in a browser: first frame, first refusal, verdicts, long tasks
    Figures,
    /// Set up, check and test everything: what continuous integration runs
    Test,
    /// Measure core's speed
    Bench,
}

/// What can be installed alone.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Alone {
    /// MuJoCo's shared library, for Reacher
    Mujoco,
}

fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Setup { part: None } => setup::everything(),
        Command::Setup { part: Some(Alone::Mujoco) } => setup::mujoco_alone(),
        Command::Demo { no_serve, seeds } => demo::demo(&seeds, !no_serve),
        Command::Web => setup::ensure(Purpose::Web).and_then(|()| web::build()),
        Command::Pictures => page::pictures(),
        Command::Tapes { names, derive: false } => tapes::record(&names),
        Command::Tapes { names, derive: true } => tapes::derive(&names),
        Command::Figures => figures::measure(),
        Command::Test => test::test(),
        Command::Bench => process::run(process::cargo().args(["bench", "--package", "mcvl-core"])),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
