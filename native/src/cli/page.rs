//! `mcvl page`: the page as one file, with a run in it.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use mcvl::page::{self, Modules, Tape};
use mcvl::runs::{RunsError, TAPE_FORMAT, TAPE_VERSION, check_target, run_tape, write_atomic};
use serde_json::Value;

use super::serve::Shown;
use super::target::{self, Kind};
use super::terminal::Terminal;
use super::{Done, usage};

/// Where `cargo xtask web` leaves the modules.
const MODULES: &str = "www/pkg";
/// The file where no run names a place for it.
const FILE: &str = "mcvl.html";

/// Arguments of `mcvl page`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl page                              mcvl.html: the page, in one file
  mcvl page runs/box-moving              with the decisions of this run
  mcvl page runs/box-moving/seed-3 -o decisions.html
  mcvl page --tape seed-0.json           with a tape that somebody sent

The file opens from disk, and asks nobody for anything. It trains live in the
browser where the modules of `cargo xtask web` are at hand; without them it
plays recorded runs, and is much smaller.")]
pub struct PageArgs {
    /// Run directory, or the folder of a seed in it, to show first
    run: Option<PathBuf>,
    /// Show this tape first (what `mcvl export RUN --to tape` wrote)
    #[arg(long, value_name = "FILE", conflicts_with = "run")]
    tape: Option<PathBuf>,
    /// The file [default: page.html in the run directory, mcvl.html without a run]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Folder of the modules that train [default: www/pkg, if they are there]
    #[arg(long, value_name = "FOLDER")]
    modules: Option<PathBuf>,
    /// Leave the modules out, even if they are there
    #[arg(long, conflicts_with = "modules")]
    no_modules: bool,
    /// Replace the file even if it is no page of mcvl
    #[arg(long)]
    overwrite: bool,
}

/// Writes the page.
pub fn page(arguments: &PageArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let shown = arguments.run.as_deref().map(Shown::find).transpose()?;
    let path = match (&arguments.output, &shown) {
        (Some(path), _) => path.clone(),
        (None, Some(Shown { run, .. })) => run.run().page(),
        (None, None) => FILE.into(),
    };
    if arguments.overwrite {
        check_target(&path)?;
    } else {
        target::check(&path, Kind::Page, target::ADVICE)?;
    }
    let tape = match (&shown, &arguments.tape) {
        (Some(Shown { run, seed }), _) => {
            Some(Tape { name: format!("run/seed-{seed}.json"), text: run_tape(run, *seed, &|_| true)? })
        }
        (None, Some(path)) => Some(Tape { name: link_name(path), text: read_tape(path)? }),
        (None, None) => None,
    };
    let modules = match &arguments.modules {
        Some(folder) => Some(Modules::read(folder)?),
        None if arguments.no_modules => None,
        None if Modules::are_in(Path::new(MODULES)) => Some(Modules::read(Path::new(MODULES))?),
        None => {
            terminal.note(format!(
                "note: there are no modules in {MODULES}, so this page plays recorded runs but trains nothing; `cargo \
                 xtask web` builds them in the repository, --modules says where they lie"
            ));
            None
        }
    };
    write_atomic(&path, page::whole(modules.as_ref(), tape.as_ref()).as_bytes())?;
    writeln!(terminal.out, "{}", path.display())?;
    Ok(Done::Well)
}

/// A tape that lies in a file.
fn read_tape(path: &Path) -> anyhow::Result<String> {
    if !path.exists() {
        usage!("there is no tape at {}: `mcvl export RUN --to tape` writes one", path.display());
    }
    let text = fs::read_to_string(path).map_err(RunsError::io("read", path))?;
    let tape = serde_json::from_str::<Value>(&text).unwrap_or_default();
    if tape["format"] != TAPE_FORMAT {
        usage!("{} is no tape: `mcvl export RUN --to tape` writes one", path.display());
    }
    if tape["version"] != TAPE_VERSION {
        usage!(
            "{} is a tape of format version {}, this program shows version {TAPE_VERSION}: use the version of mcvl that \
             wrote it, or write it again with `mcvl export RUN --to tape`",
            path.display(),
            tape["version"]
        );
    }
    if !(tape["configuration"].is_string() && tape["checks"].is_array()) {
        usage!(
            "{} is damaged: it holds no configuration or no checks; `mcvl export RUN --to tape` writes it",
            path.display()
        );
    }
    Ok(text)
}

/// The name of a tape on the page, from that of its file: links take letters, digits and single marks between them.
fn link_name(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let safe: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    format!("tape/{safe}.json")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tapes_fit_into_links() {
        assert_eq!(link_name(Path::new("out/seed-0.json")), "tape/seed-0.json");
        assert_eq!(link_name(Path::new("Müllers Lauf, 2.json")), "tape/M-llers-Lauf--2.json");
    }
}
