//! The command line as people and scripts use it: the real program, real files, real signals.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use mcvl_core::config::KEYS;
use mcvl_tests::{mcvl, scratch};
use serde_json::Value;
use tempfile::TempDir;

/// What a command answered.
pub struct Answer {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Answer {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("mcvl prints UTF-8");
        // A process that a signal ended has no code.
        Self { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

/// The program in a folder, without settings from the environment of the tests.
pub fn program(folder: &Path) -> Command {
    let mut command = Command::new(mcvl());
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("MCVL_") || name == "NO_COLOR" {
            command.env_remove(name);
        }
    }
    command.current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs `mcvl` in a folder; the arguments are separated by single spaces.
pub fn ask(folder: &Path, arguments: &str) -> Answer {
    ask_all(folder, &arguments.split(' ').collect::<Vec<_>>())
}

/// Runs `mcvl` in a folder.
pub fn ask_all(folder: &Path, arguments: &[&str]) -> Answer {
    program(folder).args(arguments).output().expect("mcvl starts").into()
}

/// Runs `mcvl`, which has to succeed; what it prints.
pub fn ok(folder: &Path, arguments: &str) -> String {
    let Answer { code, stdout, stderr } = ask(folder, arguments);
    assert_eq!(code, 0, "mcvl {arguments}\n{stdout}{stderr}");
    stdout
}

/// Every file under a folder with its content.
pub fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn visit(root: &Path, folder: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in fs::read_dir(folder).expect("the folder can be read") {
            let path = entry.expect("the folder can be read").path();
            if path.is_dir() {
                visit(root, &path, files);
            } else {
                let inside = path.strip_prefix(root).expect("it lies under the root").to_owned();
                files.insert(inside, fs::read(&path).expect("the file can be read"));
            }
        }
    }
    let mut files = BTreeMap::new();
    visit(folder, folder, &mut files);
    files
}

/// The content of a run that is promised byte for byte: all but the manifest, which has the time.
pub fn promised(run: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = content(run);
    files.remove(Path::new("manifest.json")).expect("a run has a manifest");
    files
}

/// Asserts that two runs are the same; names the files that are not.
pub fn assert_same(one: &Path, other: &Path) {
    let (one, other) = (promised(one), promised(other));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    let different: Vec<_> = one.iter().filter(|(name, bytes)| other[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{different:?} differ");
}

pub fn copy(from: &Path, to: &Path) {
    for (name, bytes) in content(from) {
        let path = to.join(name);
        fs::create_dir_all(path.parent().expect("it has a folder")).expect("the folder can be made");
        fs::write(path, bytes).expect("the file can be written");
    }
}

/// A folder with a finished quick run of two seeds in `run`, trained once and copied for each test.
pub fn finished() -> TempDir {
    static RUN: OnceLock<TempDir> = OnceLock::new();
    let original = RUN.get_or_init(|| {
        let folder = scratch();
        ok(folder.path(), "train box-moving --quick --seeds 0,3 -o run");
        folder
    });
    let folder = scratch();
    copy(original.path(), folder.path());
    folder
}

pub fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error} in {text}"))
}

pub fn lines(path: &Path) -> Vec<String> {
    fs::read_to_string(path).expect("the file can be read").lines().map(str::to_owned).collect()
}

const COMMANDS: &[&str] = &[
    "train",
    "envs",
    "ledger",
    "explain",
    "replay",
    "verify",
    "compare",
    "report",
    "reproduce",
    "play",
    "export",
    "serve",
    "page",
    "bench",
    "doctor",
    "completions",
];

#[test]
fn help_fits_into_80_columns_and_is_complete() {
    let folder = scratch();
    let top = ok(folder.path(), "--help");
    for command in COMMANDS {
        assert!(top.contains(&format!("\n  {command} ")), "{command} is missing in\n{top}");
    }
    let all = COMMANDS.iter().flat_map(|command| [format!("{command} -h"), format!("{command} --help")]);
    for arguments in all.chain(["-h".to_owned(), "--help".to_owned()]) {
        let help = ok(folder.path(), &arguments);
        assert!(help.contains("Usage: mcvl"), "{arguments}");
        for line in help.lines() {
            assert!(line.chars().count() <= 80, "mcvl {arguments}: {line}");
        }
    }
    assert!(top.contains("by a second Ctrl-C: at"), "{top}");
    // What can be played is what has numbered actions.
    let played = ok(folder.path(), "play --help");
    for env in json(&ok(folder.path(), "envs --json")).as_array().unwrap() {
        let name = env["name"].as_str().unwrap();
        let code = ask(folder.path(), &format!("play {name}")).code;
        assert_eq!((code == 0, code), (played.contains(name), code), "{name}: {played}");
    }
    let settings = ok(folder.path(), "train --help");
    for part in ["A second one exits with", "P the paper, A the", "own a choice of this project"] {
        assert!(settings.contains(part), "{part} is missing in\n{settings}");
    }
    for key in KEYS {
        assert!(settings.contains(&format!("\n  {}={}\n", key.name, key.paper)), "{}", key.name);
    }
    assert_eq!(ask_all(folder.path(), &[]).code, 2, "mcvl alone shows the help and is no success");
}

#[test]
fn a_run_leaves_what_it_promises() {
    let folder = scratch();
    let said = ok(folder.path(), "train box-moving --quick -o run");
    for part in ["Box Moving", "baseline", "mc ", "A quick run", "mcvl explain run#", "mcvl report run"] {
        assert!(said.contains(part), "{part} is missing in\n{said}");
    }
    let run = folder.path().join("run");
    for name in ["run.toml", "manifest.json", "summary.json", "curves.svg", "curves.png"] {
        assert!(run.join(name).is_file(), "{name}");
    }
    // What made it, as this program says it of itself.
    let (manifest, doctor) =
        (json(&fs::read_to_string(run.join("manifest.json")).unwrap()), json(&ok(folder.path(), "doctor --json")));
    for name in ["version", "commit", "compiler", "target", "vector", "cpu", "cores"] {
        assert_eq!(manifest[name], doctor[name], "{name}");
    }
    assert!(manifest["compiler"].as_str().unwrap().starts_with("rustc ") && manifest["cpu"] != "", "{manifest}");
    assert_eq!(manifest.get("mujoco"), None, "nothing here is simulated");
    let seed = run.join("seed-0");
    let events: Vec<Value> = lines(&seed.join("metrics.jsonl")).iter().map(|line| json(line)).collect();
    let ends: Vec<&Value> = events.iter().filter(|event| event["kind"] == "end").collect();
    let legs: Vec<&str> = ends.iter().filter_map(|event| event["arm"].as_str()).collect();
    assert_eq!(legs, ["safe", "baseline", "mc"]);
    // Eleven evaluation points per leg: one before the first step and ten after.
    assert_eq!(events.iter().filter(|event| event["kind"] == "evaluation").count(), 33);
    let steps = lines(&seed.join("steps.csv"));
    assert_eq!(steps[0], "arm,step,action,reward_raw,performance,reward,predicted,checked,stored,end");
    assert_eq!(steps.len(), 1 + 300 + 300 + 300);
    let checks = lines(&seed.join("ledger.jsonl"));
    let checked = steps.iter().filter(|row| row.split(',').nth(7) == Some("true")).count();
    assert!(checked > 0 && checked == checks.len(), "{checked} steps checked, {} lines", checks.len());
    for (number, line) in (1..).zip(&checks) {
        let (line, tape) = (json(line), json(&lines(&seed.join(format!("tapes/check-{number}.json"))).concat()));
        assert_eq!((&line["number"], &line["margin"]), (&number.into(), &tape["margin"]));
        assert!(line["modified"].get("films").is_none() && tape["modified"]["films"].is_array());
    }
    for name in ["state.snapshot", "switch.snapshot", "safe.safetensors", "baseline.safetensors", "mc.safetensors"] {
        assert!(seed.join("checkpoints").join(name).is_file(), "{name}");
    }
}

#[test]
fn every_learner_has_a_leg_and_a_place_in_every_report() {
    let folder = scratch();
    let folder = folder.path();
    let learners = ["baseline", "mc", "oracle", "frozen", "frozen-reward"];
    // Asked for in any order, told in one.
    let asked: String = learners.iter().rev().map(|learner| format!(" --agent {learner}")).collect();
    let said = ok(folder, &format!("train box-moving --quick{asked} -o run"));
    let events = lines(&folder.join("run/seed-0/metrics.jsonl"));
    let ends = events.iter().map(|line| json(line)).filter(|event| event["kind"] == "end");
    let legs: Vec<String> = ends.map(|end| end["arm"].as_str().unwrap().to_owned()).collect();
    assert_eq!(legs[1..], learners);
    ok(folder, "report run");
    let html = fs::read_to_string(folder.join("run/report.html")).unwrap();
    let again: String = learners.iter().map(|learner| format!(" --agent {learner}")).collect();
    for learner in learners {
        assert!(said.contains(&format!("\n{learner} ")) && html.contains(&format!(">{learner}<")), "{learner}\n{said}");
        assert!(folder.join(format!("run/seed-0/checkpoints/{learner}.safetensors")).is_file());
    }
    assert!(html.contains(&again), "the report says how to train the same runs");
    ok(folder, "verify run");
    ok(folder, "replay run#1");
    let assertion = "frozen.return == frozen.return.first and frozen_reward.performance <= oracle.performance";
    assert_eq!(ask_all(folder, &["compare", "run", "--assert", assertion]).code, 0);
}

#[test]
fn decisions_of_every_scheme_are_kept_explained_and_derived_again() {
    let folder = scratch();
    let folder = folder.path();
    for (scheme, word) in [
        ("discard", "discarded, without a forecast"),
        ("each-step", "the update"),
        ("punish", "rollouts without it"),
        ("store-predicted", "rollouts without it"),
    ] {
        let said = ok(folder, &format!("train box-moving --quick --agent mc --scheme {scheme} -o {scheme}"));
        assert!(said.contains("checks "), "{scheme}\n{said}");
        let explained = ok(folder, &format!("explain {scheme}#1 --svg check.svg --png check.png"))
            .replace('\n', " ")
            .replace("  ", " ");
        assert!(explained.contains(word), "{scheme}: {explained}");
        assert!(fs::read_to_string(folder.join("check.svg")).unwrap().starts_with("<svg"));
        assert!(fs::read(folder.join("check.png")).unwrap().starts_with(b"\x89PNG"));
        let token = explained.split("mcvl replay ").nth(1).unwrap().trim().to_owned();
        for what in [format!("{scheme}#1"), token] {
            assert!(ok(folder, &format!("replay {what}")).contains("SAME"), "{scheme}");
        }
        ok(folder, &format!("report {scheme}"));
        ok(folder, &format!("verify {scheme}"));
        assert!(ok(folder, &format!("ledger {scheme}")).lines().count() > 1);
    }
    // Nobody asks what a mini-batch was in truth.
    let updates = json(&ok(folder, "ledger each-step --json"));
    assert!(updates.as_array().unwrap().iter().all(|check| check["subject"] == "update"));
    assert_eq!(json(&ok(folder, "ledger each-step --wrong --json")), Value::Array(Vec::new()));
    assert!(ok(folder, "train box-moving --quick --agent mc --scheme none -o none").contains("0 checks"));
    assert_eq!(ask(folder, "explain none#1").code, 2);
}

#[test]
fn weights_are_safetensors_of_the_shapes_of_the_networks() {
    let folder = finished();
    let bytes = fs::read(folder.path().join("run/seed-0/checkpoints/mc.safetensors")).unwrap();
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header = json(std::str::from_utf8(&bytes[8..8 + length]).unwrap());
    assert_eq!(header["value.0.weight"]["dtype"], "F32");
    let shape = |name: &str| -> Vec<u64> { serde_json::from_value(header[name]["shape"].clone()).unwrap() };
    let mut first = shape("value.0.weight");
    first.sort_unstable();
    assert_eq!((first, shape("value.2.bias"), shape("reward.2.bias")), (vec![11, 128], vec![2], vec![1]));
    let end = header.as_object().unwrap().values().filter_map(|tensor| tensor["data_offsets"][1].as_u64()).max();
    assert_eq!(end, Some((bytes.len() - 8 - length) as u64));
    let layout = header["__metadata__"]["layout"].as_str().unwrap();
    for part in [
        "[inputs, outputs]",
        "y = x W + b",
        "ReLU",
        "reward: observation, then the action as one-hot",
        "Actions: up, down. Rewards and values are raw ones times 0.2. Observation: the cell of the box, from the top",
    ] {
        assert!(layout.contains(part), "{part} is missing in {layout}");
    }
    assert_eq!((shape("value.0.weight"), shape("reward.0.weight")), (vec![11, 128], vec![13, 128]));
    assert_eq!((8 + length) % 8, 0, "tensors are aligned");
    assert!(ok(folder.path(), "export --help").contains("y = x W + b"));
    assert_eq!(header["__metadata__"]["leg"], "mc");
    let config = header["__metadata__"]["config"].as_str().unwrap();
    assert!(config.starts_with("env=box-moving") && config.contains("forecast=200"), "{config}");
}

#[test]
fn decisions_are_listed_explained_and_re_derived() {
    let folder = finished();
    let folder = folder.path();
    let count = |arguments: &str| json(&ok(folder, &format!("ledger run --json{arguments}"))).as_array().unwrap().len();
    let (all, refused, accepted) = (count(""), count(" --refused"), count(" --accepted"));
    assert!(refused > 0 && refused + accepted == all, "{refused} + {accepted} of {all}");
    assert_eq!(count(" --seed 0") + count(" --seed 3"), all);
    let wrong = count(" --wrong");
    let list = json(&ok(folder, "ledger run --json"));
    let judged = list.as_array().unwrap().iter();
    let truly = judged.filter(|check| check["hack"].as_bool().unwrap() == (check["verdict"] == "accept")).count();
    assert_eq!(wrong, truly);
    // The head counts the seed's checks, whatever is shown of them.
    let head =
        |arguments: &str| ok(folder, &format!("ledger run/seed-3{arguments}")).lines().next().unwrap().to_owned();
    assert!(head(" --refused").starts_with(&head("")), "{}", head(" --refused"));
    let text = ok(folder, "ledger run/seed-3");
    assert!(text.contains("seed 3: ") && !text.contains("seed 0: "), "{text}");

    let explained = ok(folder, "explain run#1");
    assert!(explained.starts_with("Seed 0, check 1 of mc"), "the run has two seeds: {explained}");
    assert!(ok(folder, "explain run/seed-3#1").starts_with("Seed 3, check 1 of mc"));
    for command in ["explain", "replay"] {
        let help = ok(folder, &format!("{command} --help"));
        assert!(help.contains("Of a run with several seeds, RUN#NUMBER is a check of the first one"), "{help}");
    }
    assert_eq!(explained, ok(folder, "explain run/seed-0#1"));
    assert_ne!(explained, ok(folder, "explain run/seed-3#1"));
    ok(folder, "explain run#1 --svg check.svg");
    assert!(fs::read_to_string(folder.join("check.svg")).unwrap().starts_with("<svg"));

    let token = explained.split_whitespace().find(|word| word.starts_with("mcvl1.")).unwrap();
    assert!(ok(folder, &format!("replay {token}")).contains("SAME"));
    let last = count(" --seed 3");
    let said = ok(folder, &format!("replay run/seed-3#{last}"));
    assert!(said.contains("SAME") && said.contains(&format!("{last} checks")), "{said}");
    // The token needs no files.
    assert!(ok(scratch().path(), &format!("replay {token}")).contains("SAME"));
}

#[test]
fn replay_names_the_first_difference() {
    let folder = finished();
    let seed = folder.path().join("run/seed-0");
    let alter = |name: &str, from: &str, to: &str| {
        let path = seed.join(name);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{name} has no {from}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let answer = ask(folder.path(), "replay run#2");
        fs::write(&path, text).unwrap();
        assert_eq!(answer.code, 4, "{}{}", answer.stdout, answer.stderr);
        answer.stdout
    };
    let said = alter("steps.csv", "\nsafe,120,", "\nsafe,120,9");
    assert!(said.contains("step 120 of the safe leg: action is 9"), "{said}");
    let said = alter("ledger.jsonl", "\"cost\":", "\"cost\":1");
    assert!(said.contains("check 1: cost is 1"), "{said}");
    let said = alter("tapes/check-2.json", "\"arm\":\"mc\"", "\"arm\": \"mc\"");
    assert!(said.contains("check 2: its tape"), "{said}");
    assert_eq!(ask(folder.path(), "replay run#2").code, 0);
}

#[test]
fn runs_are_verified_compared_and_reported() {
    let folder = finished();
    let folder = folder.path();
    assert!(ok(folder, "verify run").contains("run is intact"));
    let compare = |assertion| ask_all(folder, &["compare", "run", "--assert", assertion]);
    let holds = compare("baseline.return > baseline.performance");
    assert_eq!((holds.code, holds.stdout.contains("holds: baseline.return")), (0, true), "{}", holds.stdout);
    for assertion in ["-1e-9 < mc.return", "1E+9 >= mc.return", "mc.return > -2.5e3", "- mc.return < .5e1"] {
        let holds = compare(assertion);
        assert_eq!(holds.code, 0, "{assertion}: {}{}", holds.stdout, holds.stderr);
    }
    let fails = compare("mc.performance > 1000");
    assert_eq!((fails.code, fails.stdout.contains("does not hold: mc.performance")), (1, true), "{}", fails.stdout);

    let paths = ok(folder, "report run");
    assert_eq!(paths.lines().next(), Some("run/report.html"));
    fs::create_dir(folder.join("notes")).unwrap();
    let paths = ok(folder, "report notes run --overwrite");
    assert_eq!(paths.lines().next(), Some("run/report.html"), "the first that is a run");
    let page = fs::read_to_string(folder.join("run/report.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    ok(folder, "report run -o elsewhere.html");
    assert!(folder.join("curves.svg").is_file() && folder.join("curves.png").is_file());
    ok(folder, "verify run");
}

#[test]
fn json_is_valid_and_stdout_has_nothing_else() {
    let folder = finished();
    let folder = folder.path();
    let commands = ["envs --json", "ledger run --json", "verify run --json", "compare run --json", "doctor --json"];
    for arguments in commands.into_iter().chain(["train box-moving --quick --json -o other"]) {
        json(&ok(folder, arguments));
    }
    let envs = json(&ok(folder, "envs --json"));
    assert_eq!((&envs[0]["name"], &envs[0]["observation"]), (&"box-moving".into(), &11.into()));
    let summary = json(&fs::read_to_string(folder.join("other/summary.json")).unwrap());
    assert_eq!(summary["seeds"], serde_json::json!([0]));
    let doctor = json(&ok(folder, "doctor --json"));
    assert_eq!((&doctor["exact"], doctor["stages"].as_u64() > Some(3)), (&true.into(), true));
    // Linked to MuJoCo, of the right version; or how to get it.
    let mujoco = &doctor["mujoco"];
    match mujoco["error"].as_str() {
        None => {
            assert_eq!(mujoco["version"], "3.17.0");
            // A run that it moves says so.
            let short = "--set full_steps=300 --set forecast=20 --set rollouts=2 --set hidden=8 --set evaluations=1";
            ok(folder, &format!("train reacher --quick {short} --agent baseline -q -o arm"));
            let manifest = json(&fs::read_to_string(folder.join("arm/manifest.json")).unwrap());
            assert_eq!(manifest["mujoco"], "3.17.0");
        }
        Some(error) => assert!(error.contains("cargo xtask setup") && error.contains("--features mujoco"), "{error}"),
    }
}

#[test]
fn speed_is_measured_on_one_core_and_on_all() {
    let folder = scratch();
    let answer = ask(folder.path(), "bench box-moving --time 1ms");
    assert_eq!(answer.code, 0, "{}", answer.stderr);
    assert!(answer.stdout.lines().all(|line| line.chars().count() <= 80), "{}", answer.stdout);
    let bench = json(&ok(folder.path(), "bench box-moving --time 1ms --json -q"));
    assert!(bench["cores"].as_u64() > Some(0) && bench["multiply_adds_per_second"]["one"].as_f64() > Some(0.0));
    let measured = bench["measured"].as_array().unwrap();
    assert_eq!(measured.len(), 7);
    for case in measured {
        let name = case["name"].as_str().unwrap();
        assert!(answer.stdout.contains(&format!("\n  {name} ")), "{name} is missing in\n{}", answer.stdout);
        for cores in ["one", "all"] {
            let (rate, share) = (case["per_second"][cores].as_f64(), case["share_of_peak"][cores].as_f64());
            assert!(rate > Some(0.0), "{case}");
            // Where multiply-adds are counted, the share follows from them.
            let peak = bench["multiply_adds_per_second"][cores].as_f64().unwrap();
            let expected = case["multiply_adds"].as_f64().map(|work| rate.unwrap() * work / peak);
            match (share, expected) {
                (Some(share), Some(expected)) => assert!((share / expected - 1.0).abs() < 1e-9, "{case}"),
                neither => assert_eq!(neither, (None, None), "{case}"),
            }
        }
    }
    let reacher = json(&ok(folder.path(), "bench reacher --time 1ms --json -q"));
    let measured = reacher["measured"].as_array().unwrap();
    assert!(measured.len() >= 5 && measured.iter().all(|case| case["per_second"]["one"].as_f64() > Some(0.0)));
    let answer = ask(folder.path(), "bench box-movin");
    assert!(answer.code == 2 && answer.stderr.contains("did you mean `box-moving`?"), "{}", answer.stderr);
}

#[test]
fn claims_are_an_exit_code() {
    let folder = scratch();
    // Twenty steps are too few to find the hack: the first claim cannot hold.
    let short = "train box-moving --quick --set full_steps=20 --assert-claims -o short";
    let answer = ask(folder.path(), short);
    assert_eq!(answer.code, 1, "{}", answer.stdout);
    assert!(answer.stdout.contains("DOES NOT HOLD"), "{}", answer.stdout);
    assert_eq!(ask(folder.path(), &short.replace(" --assert-claims -o short", " -o other")).code, 0);
    // Without the plain learner only the other one's claim is there; without either, or beside a trap, none.
    let alone = ask(folder.path(), &short.replace("-o short", "--agent mc -o alone"));
    assert_eq!(alone.code, 0, "{}", alone.stdout);
    assert!(alone.stdout.contains("NOT TESTED") && alone.stdout.contains("HOLDS"), "{}", alone.stdout);
    for (more, said) in [("--agent frozen", "train one of them"), ("--set trap=9:5", "best returns are not known")] {
        let none = ask(folder.path(), &short.replace("-o short", &format!("{more} -o none")));
        assert!(none.code == 2 && none.stderr.contains(said), "{more}: {}", none.stderr);
        assert!(!folder.path().join("none").exists(), "{more}: nothing was begun");
    }
    ok(folder.path(), "train box-moving --quick --set full_steps=20 --agent frozen -o frozen");
    let resumed = ask(folder.path(), "train box-moving -o frozen --resume --assert-claims");
    assert!(resumed.code == 2 && resumed.stderr.contains("train one of them"), "{}", resumed.stderr);
}

#[test]
fn a_kept_summary_says_how_to_train_its_run_anew() {
    let folder = scratch();
    let kept = mcvl_tests::root().join("results/box-moving/e14");
    let (kept, first) = (kept.display(), format!("{}#1", kept.display()));
    let anew = "`mcvl train box-moving --set against=current --seeds 0..10` trains it anew";
    let words = ["report", "compare", "ledger", "export --to csv", "export --to tape", "page"];
    for command in words.map(|word| format!("{word} {kept}")).into_iter().chain([format!("explain {first}")]) {
        let answer = ask(folder.path(), &command);
        assert!(answer.code == 2 && answer.stderr.contains(anew), "{command}: {}", answer.stderr);
    }
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let folder = finished();
    ok(folder.path(), "train box-moving --quick --seeds 0,3 -j 1 -o one");
    ok(folder.path(), "train box-moving --quick --seeds 0,3 -j 2 -o two");
    ok(folder.path(), "train box-moving --quick --seeds 0,3 -j 4 -o four");
    assert_same(&folder.path().join("one"), &folder.path().join("two"));
    assert_same(&folder.path().join("one"), &folder.path().join("four"));
    assert_same(&folder.path().join("one"), &folder.path().join("run"));
}

#[test]
fn learners_share_the_safe_leg_and_can_run_alone() {
    let folder = finished();
    ok(folder.path(), "train box-moving --quick --seeds 0,3 --agent mc -o mc");
    let rows = |run: &str, legs: &[&str]| -> Vec<String> {
        let rows = lines(&folder.path().join(run).join("seed-0/steps.csv"));
        rows.into_iter().filter(|row| legs.iter().any(|leg| row.starts_with(leg))).collect()
    };
    assert_eq!(rows("mc", &["safe,", "mc,"]), rows("run", &["safe,", "mc,"]));
    assert!(rows("mc", &["baseline,"]).is_empty() && !rows("run", &["baseline,"]).is_empty());
    let ledger = |run: &str| fs::read(folder.path().join(run).join("seed-0/ledger.jsonl")).unwrap();
    assert_eq!(ledger("mc"), ledger("run"));
}

#[test]
fn settings_have_a_precedence_and_an_origin() {
    let folder = scratch();
    fs::write(folder.path().join("my.toml"), "gamma = 0.5\ntau = 0.01\nlr = 0.001\nhidden = 16\n").unwrap();
    let arguments =
        "train box-moving --preset release --quick --config my.toml --set lr=0.002 --set forecast=9 --dry-run";
    let mut command = program(folder.path());
    command.args(arguments.split(' ')).env("MCVL_TAU", "0.02").env("MCVL_LR", "0.003").env("MCVL_REPLAY", "77");
    let answer = Answer::from(command.output().unwrap());
    assert_eq!(answer.code, 0, "{}", answer.stderr);
    for line in [
        "gamma = { value = \"0.5\", from = \"file my.toml\" }",
        "tau = { value = \"0.02\", from = \"environment variable MCVL_TAU\" }",
        "lr = { value = \"0.002\", from = \"flag --set\" }",
        "hidden = { value = \"16\", from = \"file my.toml\" }",
        "replay = { value = \"77\", from = \"environment variable MCVL_REPLAY\" }",
        "forecast = { value = \"9\", from = \"flag --set\" }",
        "safe_steps = { value = \"300\", from = \"flag --quick\" }",
        "threshold = { value = \"0.25\", from = \"preset release\" }",
        "batch = { value = \"32\", from = \"default\" }",
    ] {
        assert!(answer.stdout.contains(&format!("\n{line}\n")), "{line} is missing in\n{}", answer.stdout);
    }
    assert!(!folder.path().join("runs").exists(), "a dry run makes nothing");
}

#[test]
fn a_dry_run_says_what_its_settings_cost() {
    let folder = scratch();
    let dry = |arguments: &str| {
        let said = ok(folder.path(), &format!("train box-moving --quick --dry-run{arguments}"));
        for line in said.lines().filter(|line| line.starts_with('#')) {
            assert!(line.chars().count() <= 80, "{line}");
        }
        let comments: Vec<&str> = said.lines().filter_map(|line| line.strip_prefix("# ")).collect();
        comments.join(" ")
    };
    let (frequent, each) = ("as frequent as at the paper's setting", "Each check: at most");
    let usual = dry("");
    assert!(usual.contains("Each check: at most 400 updates in its forecasts.") && usual.contains(frequent), "{usual}");
    let all = dry(" --scheme all");
    assert!(all.contains(": every step is checked.") && all.contains(each) && !all.contains(frequent), "{all}");
    assert!(dry(" --set against=current").contains("at most 200 updates in its forecasts"));
    for scheme in ["discard", "each-step"] {
        let said = dry(&format!(" --scheme {scheme}"));
        assert!(said.contains(&format!("Checks of the scheme {scheme} make no forecasts.")), "{said}");
        assert!(!said.contains(frequent) && !said.contains(each) && !said.contains("in forecasts"), "{said}");
    }
    for nothing in [" --scheme none", " --agent baseline"] {
        let said = dry(nothing);
        assert!(
            said.contains("Nothing is checked.") && !said.contains(frequent) && !said.contains("forecasts"),
            "{said}"
        );
    }
    let value = json(&ok(folder.path(), "train box-moving --quick --dry-run --json --seeds 2,4"));
    assert_eq!(
        (&value["seeds"], &value["learners"]),
        (&serde_json::json!([2, 4]), &serde_json::json!(["baseline", "mc"]))
    );
    let (updates, check) = (value["updates"].as_u64(), value["forecast_updates_per_check"].as_u64());
    assert_eq!((updates, check), (Some(2 * 3 * 300), Some(400)));
    assert!(value["seconds"].as_f64() > Some(0.0));
    let setting = serde_json::json!({ "value": "300", "from": "flag --quick" });
    assert_eq!(value["settings"]["safe_steps"], setting);
    assert!(!folder.path().join("runs").exists(), "a dry run makes nothing");
}

#[test]
fn lists_fit_into_80_columns() {
    let folder = scratch();
    let folder = folder.path();
    // Punished decisions say most.
    ok(folder, "train box-moving --quick --agent mc --scheme punish -q -o run");
    let reacher = "exploration=40 batch=32 safe_steps=80 full_steps=40 forecast=8 evaluations=1 evaluation_episodes=1 \
                   rollouts=1 rollout_steps=2 threshold=0 practice_reward_updates=2";
    let set: String = reacher.split_whitespace().map(|setting| format!(" --set {setting}")).collect();
    ok(folder, &format!("train reacher --agent mc -q -o reacher{set}"));
    for arguments in ["ledger run", "ledger reacher", "doctor"] {
        let said = ok(folder, arguments);
        assert!(said.lines().count() > 8, "{said}");
        for line in said.lines() {
            assert!(line.chars().count() <= 80, "mcvl {arguments}: {line}");
        }
    }
    // Wrapped, a decision has all its words, each line in its own colour.
    let first = json(&ok(folder, "ledger run --json"))[0].clone();
    let said = ok(folder, "ledger run --color always");
    let plain = ok(folder, "ledger run").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(plain.contains(&format!("#1 step {}: expected", first["step"])), "{plain}");
    assert!(said.lines().all(|line| line.matches("\u{1b}[0m").count() == 1), "{said}");
}

#[test]
fn directories_are_not_overwritten_by_accident() {
    let folder = finished();
    let run = folder.path().join("run");
    ok(folder.path(), "train box-moving --quick -o run --fresh");
    ok(folder.path(), "train box-moving --quick -o run --fresh");
    assert!(folder.path().join("run-2/summary.json").is_file() && folder.path().join("run-3/summary.json").is_file());
    // What mcvl did not write, it does not delete.
    fs::write(run.join("notes.txt"), "mine").unwrap();
    ok(folder.path(), "train box-moving --quick --seed 5 -o run --overwrite");
    assert_eq!(fs::read_to_string(run.join("notes.txt")).unwrap(), "mine");
    assert!(run.join("seed-5").is_dir() && !run.join("seed-0").exists());
    ok(folder.path(), "verify run");
    // Resuming what is finished changes nothing and says how it went.
    let before = content(&run);
    assert!(ok(folder.path(), "train box-moving -o run --resume").contains("Box Moving"));
    assert_eq!(content(&run), before);
}

#[test]
fn completions_know_the_commands() {
    let folder = scratch();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = ok(folder.path(), &format!("completions {shell}"));
        for word in COMMANDS.iter().chain(&["seeds"]) {
            assert!(text.contains(word), "{shell}: {word}");
        }
    }
}

#[test]
fn colours_are_for_terminals_that_want_them() {
    let folder = finished();
    const ESCAPE: char = '\u{1b}';
    assert!(!ok(folder.path(), "ledger run").contains(ESCAPE));
    assert!(ok(folder.path(), "ledger run --color always").contains(ESCAPE));
    // `script` gives the program a terminal.
    let on_terminal = |arguments: &str, no_color: &str| {
        let line = format!("'{}' {arguments}", mcvl().display());
        let mut script = Command::new("script");
        script.args(["-qec", &line, "/dev/null"]).current_dir(folder.path()).env("NO_COLOR", no_color);
        Answer::from(script.stdin(Stdio::null()).output().expect("script (bsdutils) is installed")).stdout
    };
    assert!(on_terminal("ledger run", "").contains(ESCAPE));
    assert!(!on_terminal("ledger run", "1").contains(ESCAPE));
    assert!(on_terminal("ledger run --color always", "1").contains(ESCAPE));
    assert!(!on_terminal("ledger run --color never", "").contains(ESCAPE));
}

#[test]
fn a_reader_that_leaves_is_no_failure() {
    let folder = finished();
    for arguments in ["ledger run --json", "envs", "explain run#1", "doctor", "play box-moving", "export run --to csv"]
    {
        let mut command = program(folder.path());
        let mut child =
            command.args(arguments.split(' ')).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let answer = Answer::from(child.wait_with_output().unwrap());
        // Where there is no display, Mesa's drivers say so on their own.
        let said: Vec<&str> = answer.stderr.lines().filter(|line| !line.contains("XDG_RUNTIME_DIR")).collect();
        assert_eq!((answer.code, &said[..]), (0, &[][..]), "{arguments}");
    }
    // Nor does it change a verdict.
    let mut command = program(folder.path());
    let mut child = command.args(["compare", "run", "--assert", "1 > 2"]).stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(1));
}

#[test]
fn progress_goes_to_stderr_and_can_be_silenced() {
    let folder = scratch();
    let quiet = ask(folder.path(), "train box-moving --quick -q -o quiet");
    assert_eq!((quiet.code, quiet.stderr.as_str()), (0, ""));
    assert!(quiet.stdout.contains("Box Moving") && !quiet.stdout.contains("Next:"), "{}", quiet.stdout);
    let verbose = ask(folder.path(), "train box-moving --quick -v --progress none -o verbose");
    let decisions = verbose.stderr.lines().filter(|line| line.starts_with("seed 0 #")).count();
    assert_eq!(decisions, lines(&folder.path().join("verbose/seed-0/ledger.jsonl")).len());
    assert!(!verbose.stdout.contains("seed 0 #"));
    // Long enough for the first plain line, which comes after three seconds.
    let plain = ask(folder.path(), "train box-moving --seeds 0..400 --max-time 4s --progress plain -o plain");
    assert_eq!(plain.code, 130, "{}", plain.stderr);
    let line = plain.stderr.lines().find(|line| line.starts_with("box-moving: ")).expect("a line of progress");
    assert!(line.contains(" %, ETA ") && line.contains("; seed ") && line.contains(" return "), "{line}");
    assert!(plain.stderr.contains("continue with: mcvl train box-moving -o plain --resume"), "{}", plain.stderr);
}
