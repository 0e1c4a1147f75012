//! Running other programs from the root of the repository, and where things lie.

use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};

use anyhow::{Context, Result, bail};

/// The repository: where cargo says this package lies, else (started by hand) the current folder.
pub fn root() -> PathBuf {
    match env::var_os("CARGO_MANIFEST_DIR") {
        Some(package) => Path::new(&package).parent().expect("xtask lies in the repository").to_owned(),
        None => PathBuf::from("."),
    }
}

/// Where cargo puts what it builds.
pub fn target() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |folder| root().join(folder))
}

/// A program that cargo built, by the folder of its profile (`debug`, `release`) and its name.
pub fn program(folder: &str, name: &str) -> PathBuf {
    target().join(folder).join(format!("{name}{}", env::consts::EXE_SUFFIX))
}

/// A program that will run in the root of the repository.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// The cargo that runs this, so that the toolchain stays the same.
pub fn cargo() -> Command {
    let mut command = command(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // Written out, so that what is built lies where `target` says, whatever cargo's own settings are.
    command.env("CARGO_TARGET_DIR", target());
    command
}

/// Runs a command with this terminal's input and output, and fails if it fails.
pub fn run(command: &mut Command) -> Result<()> {
    let status = status(command)?;
    if !status.success() {
        bail!("`{}` ended with {status}", line(command));
    }
    Ok(())
}

/// Runs a command with this terminal's input and output and says how it ended.
pub fn status(command: &mut Command) -> Result<ExitStatus> {
    let line = line(command);
    eprintln!("$ {line}");
    command.status().with_context(|| format!("`{line}` could not be started"))
}

/// What a command prints, if it succeeds.
pub fn output(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::null()).stdin(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether a program of one of these names is on the search path.
pub fn exists(names: &[&str]) -> bool {
    let path = env::var_os("PATH").unwrap_or_default();
    env::split_paths(&path)
        .any(|folder| names.iter().any(|name| folder.join(format!("{name}{}", env::consts::EXE_SUFFIX)).is_file()))
}

/// A command as it would be typed, with the program's name instead of its path.
fn line(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = program.file_name().unwrap_or(program.as_os_str());
    let quoted = |part: &OsStr| {
        let text = part.to_string_lossy().into_owned();
        if text.contains([' ', '<', '>', '*']) { format!("'{text}'") } else { text }
    };
    std::iter::once(name).chain(command.get_args()).map(quoted).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_shown_as_it_would_be_typed() {
        let mut command = command("/somewhere/bin/mcvl");
        command.args(["compare", "runs/demo", "--assert", "mc.performance > 0"]);
        assert_eq!(line(&command), "mcvl compare runs/demo --assert 'mc.performance > 0'");
    }

    #[test]
    fn a_failure_names_the_command() {
        let error = run(command("rustc").args(["--print", "no-such-thing"])).unwrap_err().to_string();
        assert!(error.contains("`rustc --print no-such-thing` ended with"), "{error}");
        let error = run(&mut command("no-such-program-anywhere")).unwrap_err().to_string();
        assert!(error.contains("`no-such-program-anywhere` could not be started"), "{error}");
    }
}
