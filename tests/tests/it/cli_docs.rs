//! Every command that the README shows runs, in the order in which it shows them, and the program takes every one that
//! another document shows.

use std::env;
use std::fs;
use std::process::{Command, Stdio};

use mcvl_tests::{mcvl, root, scratch};
use tempfile::TempDir;

use crate::cli::Answer;

/// Commands of `mcvl` in the shell blocks of a text, as they are typed.
fn commands(text: &str) -> Vec<String> {
    let mut commands = Vec::new();
    let mut inside = false;
    for line in text.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            inside = !inside && ["console", "sh", "bash"].contains(&language.trim());
        } else if inside {
            let line = line.trim_start().trim_start_matches("$ ");
            // Where the program is built from source, it is run through cargo.
            let line =
                line.strip_prefix("cargo run --release -- ").map_or(line.to_owned(), |rest| format!("mcvl {rest}"));
            if line.starts_with("mcvl ") {
                commands.push(line);
            }
        }
    }
    commands
}

#[test]
fn every_command_of_the_readme_runs() {
    let readme = fs::read_to_string(root().join("README.md")).expect("there is a README");
    let commands = commands(&readme);
    assert!(commands.iter().any(|command| command.starts_with("mcvl train ")), "{commands:?}");
    let shell = Shell::new();
    for command in commands {
        shell.ok(&command);
    }
}

/// A shell that knows `mcvl`, in a folder of its own.
struct Shell {
    folder: TempDir,
    bin: TempDir,
}

impl Shell {
    fn new() -> Self {
        let (folder, bin) = (scratch(), scratch());
        fs::hard_link(mcvl(), bin.path().join("mcvl"))
            .or_else(|_| fs::copy(mcvl(), bin.path().join("mcvl")).map(drop))
            .expect("the program can be copied");
        Self { folder, bin }
    }

    /// Runs a command, which has to succeed.
    fn ok(&self, command: &str) {
        let mut path = vec![self.bin.path().to_owned()];
        path.extend(env::split_paths(&env::var_os("PATH").unwrap_or_default()));
        let mut shell = Command::new("sh");
        shell.args(["-c", command]).current_dir(self.folder.path()).env("PATH", env::join_paths(&path).unwrap());
        for (name, _) in env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("MCVL_")) {
            shell.env_remove(name);
        }
        let answer = Answer::from(shell.stdin(Stdio::null()).output().expect("sh is there"));
        assert_eq!(answer.code, 0, "{command}\n{}{}", answer.stdout, answer.stderr);
    }
}

/// Commands that take hours, or a card, are not run; that the program knows them and their options is seen where it is
/// asked for help behind them.
#[test]
fn every_command_of_the_other_documents_is_one_of_the_program() {
    let shell = Shell::new();
    let mut texts = vec![root().join("README.md")];
    texts.extend(fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path()));
    let mut count = 0;
    for path in texts.iter().filter(|path| path.extension().is_some_and(|extension| extension == "md")) {
        let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        for command in commands(&text.replace("```text", "```sh")) {
            let command = command.split(" #").next().unwrap_or_default();
            shell.ok(&format!("{command} --help"));
            count += 1;
        }
    }
    assert!(count > 15, "{count}");
}

#[test]
fn commands_are_found_in_shell_blocks_only() {
    let text = "mcvl no\n```console\n$ mcvl envs\noutput\n```\n```rust\nmcvl no\n```\n```sh\ncargo run --release -- doctor\n# mcvl no\n```\n";
    assert_eq!(commands(text), ["mcvl envs", "mcvl doctor"]);
}
