//! The page's modules compute what the native program computes, to the last bit, and say so in its words.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::SystemTime;

use mcvl_core::config::{Config, Learner};
use mcvl_core::exact;
use mcvl_core::record::Event;
use mcvl_core::run::{Budget, Run, Status};
use mcvl_tests::{node, root, source};
use serde_json::Value;

/// The modules: without and with SIMD.
const MODULES: [&str; 2] = ["scalar", "simd"];

/// A short run with checks.
const CONFIGURATION: &str = "env=box-moving seed=3 safe_steps=300 full_steps=100 epsilon_decay=100 forecast=40 \
                             evaluations=4 evaluation_episodes=2 rollouts=2";

/// The folder of the modules, after a look whether they are there and made from today's source.
fn package() -> PathBuf {
    let folder = root().join("www/pkg");
    let modified = |path: &PathBuf| fs::metadata(path).and_then(|data| data.modified()).ok();
    let source = source::files().into_iter().filter(|file| {
        (file.path.starts_with("core/src/") || file.path.starts_with("web/")) && file.is(&["rs", "toml"])
    });
    let newest = source.filter_map(|file| modified(&root().join(file.path))).max().unwrap_or(SystemTime::UNIX_EPOCH);
    for module in MODULES {
        let made = modified(&folder.join(format!("{module}_bg.wasm")));
        assert!(made.is_some(), "www/pkg has no module `{module}`: `cargo xtask web` makes it");
        assert!(
            made >= Some(newest),
            "the module `{module}` in www/pkg is older than the source: run `cargo xtask web`"
        );
    }
    folder
}

/// Runs a script with one of the modules.
fn with_module(script: &str, module: &str, arguments: &[&str]) -> String {
    let folder = package();
    let folder = folder.to_str().expect("the path of the repository is UTF-8");
    node(script, &[&[folder, module], arguments].concat()).unwrap()
}

fn hexadecimal(digests: impl IntoIterator<Item = (&'static str, u64)>) -> BTreeMap<String, String> {
    digests.into_iter().map(|(stage, digest)| (stage.to_owned(), format!("{digest:016x}"))).collect()
}

#[test]
fn wasm_digests_equal_native_and_committed() {
    let committed = hexadecimal(exact::COMMITTED.iter().copied());
    assert!(!committed.is_empty());
    assert_eq!(hexadecimal(exact::digests()), committed, "native");
    for module in MODULES {
        let text = with_module("digests.mjs", module, &[]);
        let digests: BTreeMap<String, String> = serde_json::from_str(&text).unwrap();
        assert_eq!(digests, committed, "{module}");
    }
}

/// Polls until the status is `stop`; returns the events as JSON text with sorted keys, which keeps every
/// bit of a number.
fn follow(run: &mut Run, stop: Status) -> Vec<String> {
    let mut events = Vec::new();
    let mut recorder = |event: &Event| events.push(through_text(event));
    while run.poll(Budget(1000), &mut recorder).unwrap() != stop {}
    events
}

fn through_text(event: &Event) -> String {
    let text = serde_json::to_string(event).unwrap();
    serde_json::from_str::<Value>(&text).unwrap().to_string()
}

#[test]
fn wasm_events_equal_native() {
    let mut safe = Run::new(&CONFIGURATION.parse::<Config>().unwrap());
    let mut native = follow(&mut safe, Status::Switch);
    for learner in [Learner::Baseline, Learner::Mc] {
        native.extend(follow(&mut safe.fork(learner).unwrap(), Status::Done));
    }
    assert!(native.iter().any(|event| event.contains("\"verdict\"")), "the configuration has to lead to checks");

    // Budgets differ, too: they have no influence on what a run says.
    for (module, budget) in MODULES.into_iter().zip(["37", "100000"]) {
        let text = with_module("run.mjs", module, &[CONFIGURATION, budget]);
        let polls = text.lines().map(|line| serde_json::from_str::<Vec<Value>>(line).unwrap());
        let events: Vec<String> = polls.flatten().map(|event| event.to_string()).collect();
        assert_eq!(events, native, "{module}");
    }
}

#[test]
fn wasm_errors_can_be_read() {
    let config_error = |text: &str| text.parse::<Config>().unwrap_err().to_string();
    for module in MODULES {
        let messages: Vec<String> = serde_json::from_str(&with_module("errors.mjs", module, &[])).unwrap();
        assert_eq!(messages[0], config_error("env=box-moving treshold=1"));
        assert_eq!(messages[1], config_error("env=box-moving agent=mx"));
        assert!(messages[2].contains("past the switch"), "{}", messages[2]);
    }
}
