//! Every check of the repository, stage by stage; what continuous integration runs.

use std::fs;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::Result;

use crate::process::{cargo, command, exists, program, root, run};
use crate::setup::{BARE, Purpose};
use crate::{mujoco, setup, web};

/// A stage: its name and what it does.
type Stage = (&'static str, fn() -> Result<()>);

/// What is built and tested. One selection for all stages: cargo compiles dependencies again for another
/// one. The glue has no tests and a large tree of its own. MuJoCo is in wherever its library is.
fn everything() -> Vec<&'static str> {
    [&["--workspace", "--exclude", "xtask-glue"], mujoco::features()].concat()
}

const STAGES: &[Stage] = &[
    ("setup", || setup::ensure(Purpose::Test)),
    ("format", || run(cargo().args(["fmt", "--all", "--check"]))),
    ("lint", lint),
    ("core alone on a bare target", || run(cargo().args(["build", "--package", "mcvl-core", "--target", BARE]))),
    ("web", web::build),
    ("build", || run(cargo().arg("build").args(everything()).arg("--all-targets"))),
    ("tests", tests),
    ("documentation tests", || run(with_program(cargo().args(["test", "--doc"]).args(everything())))),
    ("documentation", || {
        run(cargo().env("RUSTDOCFLAGS", "-D warnings").args(["doc", "--package", "mcvl-core", "--no-deps"]))
    }),
    ("examples", examples),
];

/// Runs the stages in order and ends with a summary; the first failure ends it.
pub fn test() -> Result<()> {
    let mut done: Vec<(&str, Duration)> = Vec::new();
    for (name, stage) in STAGES {
        eprintln!("\n== {name} ==");
        let start = Instant::now();
        let result = stage();
        done.push((name, start.elapsed()));
        eprintln!("-- {name}: {:.1} s", start.elapsed().as_secs_f64());
        if let Err(error) = result {
            summary(&done);
            return Err(error.context(format!("stage `{name}` failed")));
        }
    }
    summary(&done);
    println!("every stage passed");
    Ok(())
}

fn summary(done: &[(&str, Duration)]) {
    println!("\n{:<30} {:>8}", "stage", "seconds");
    for (name, duration) in done {
        println!("{name:<30} {:>8.1}", duration.as_secs_f64());
    }
    let total: Duration = done.iter().map(|(_, duration)| duration).sum();
    println!("{:<30} {:>8.1}", "total", total.as_secs_f64());
}

/// Everything with MuJoCo, then what stands in for it where it is not linked, then without graphics cards too. Of the
/// whole workspace each time: dependencies keep their features, so that only `native` is looked at again.
fn lint() -> Result<()> {
    let lint = |features: &[&str]| {
        let workspace = ["clippy", "--workspace", "--all-targets"];
        run(cargo().args(workspace).args(features).args(["--", "-D", "warnings"]))
    };
    let features = mujoco::features();
    if !features.is_empty() {
        lint(features)?;
    }
    lint(&[])?;
    lint(&["--no-default-features"])
}

/// Unit and integration tests, with cargo-nextest where it is installed.
fn tests() -> Result<()> {
    if exists(&["cargo-nextest"]) {
        return run(with_program(cargo().args(["nextest", "run"]).args(everything())));
    }
    eprintln!("cargo-nextest is not installed (`cargo xtask setup` does it): `cargo test` runs the same tests");
    let test = |filter: &[&str]| {
        let kinds = ["--lib", "--bins", "--tests", "--"];
        run(with_program(cargo().arg("test").args(everything()).args(kinds).args(filter)))
    };
    test(&["--skip", "page::"])?;
    // Browsers starve one another.
    test(&["page::", "--test-threads=1"])
}

/// Tells the tests which `mcvl` to run: the one that the stage before built. Where there is a driver, tests of
/// graphics cards may not be skipped.
fn with_program(command: &mut Command) -> &mut Command {
    if setup::vulkan() {
        command.env("MCVL_REQUIRE_GPU", "1");
    }
    command.env("MCVL_BIN", program("debug", "mcvl"))
}

/// Runs every example of core, as the build stage left it: what documentation shows has to work.
fn examples() -> Result<()> {
    let Ok(folder) = fs::read_dir(root().join("core/examples")) else { return Ok(()) };
    let mut names: Vec<String> = Vec::new();
    for entry in folder {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            names.extend(path.file_stem().map(|name| name.to_string_lossy().into_owned()));
        }
    }
    names.sort();
    names.iter().try_for_each(|name| run(&mut command(program("debug/examples", name))))
}
