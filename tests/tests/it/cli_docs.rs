//! Every command that the README shows runs, in the order in which it shows them, and the program takes every one that
//! another document shows; every link from one document to another leads somewhere.

use std::env;
use std::fs;
use std::process::{Command, Stdio};

use mcvl_tests::source::files;
use mcvl_tests::{mcvl, root, scratch};
use pulldown_cmark::{Event, Parser, Tag, TagEnd};
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

/// Links of a document, and the names under which its headings can be linked to, as GitHub makes them: small letters,
/// digits and hyphens.
fn links_and_headings(text: &str) -> (Vec<String>, Vec<String>) {
    let (mut links, mut headings, mut heading) = (Vec::new(), Vec::new(), None::<String>);
    for event in Parser::new(text) {
        match (event, &mut heading) {
            (Event::Start(Tag::Link { dest_url, .. } | Tag::Image { dest_url, .. }), _) => {
                links.push(dest_url.into_string())
            }
            (Event::Start(Tag::Heading { .. }), _) => heading = Some(String::new()),
            (Event::Text(part) | Event::Code(part), Some(heading)) => heading.push_str(&part),
            (Event::End(TagEnd::Heading(_)), _) => {
                let text = heading.take().unwrap_or_default().to_lowercase().replace(' ', "-");
                headings.push(text.chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_')).collect());
            }
            _ => {}
        }
    }
    (links, headings)
}

#[test]
fn every_link_between_documents_leads_somewhere() {
    let mut count = 0;
    for file in files().iter().filter(|file| file.is(&["md"])) {
        let path = root().join(&file.path);
        let (links, own) = links_and_headings(&file.text);
        for link in links.iter().filter(|link| !link.contains("://")) {
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = path.parent().expect("a file lies in a folder").join(target);
            assert!(target.exists(), "{}: nothing lies at {link}", file.path);
            let known = match link.starts_with('#') {
                true => own.iter().any(|name| name == anchor),
                false if anchor.is_empty() => true,
                false => links_and_headings(&fs::read_to_string(&target).unwrap()).1.iter().any(|name| name == anchor),
            };
            assert!(known, "{}: no heading is called {link}", file.path);
            count += 1;
        }
    }
    assert!(count > 60, "{count}");
}

#[test]
fn headings_are_named_as_github_names_them() {
    let (links, headings) =
        links_and_headings("# A `b`: c (d 5.3)\n[x](y.md#z) ![p](q.png)\n\n```text\n# [n](o)\n```\n");
    assert_eq!((links, headings), (vec!["y.md#z".to_owned(), "q.png".to_owned()], vec!["a-b-c-d-53".to_owned()]));
}
