//! The paper's experiments through the real program: cells train once, stop and go on at any moment, and
//! claims are judged by what is there.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use mcvl_tests::{root, scratch};

use crate::cli::{ask, content, copy, json, ok, program};

/// One cell of seconds: the plain scheme with the shortest forecasts, one seed.
const ONE: &str = "reproduce E8 --seeds 3..4 --only box-forecast-100";

/// Files of a set that are promised byte for byte: what was learned and judged, not how long it took.
fn promised(set: &Path) -> Vec<(String, Vec<u8>)> {
    let names = ["claims.csv", "numbers.csv", "fig5.svg"].map(String::from);
    let of = |name: String| (name.clone(), fs::read(set.join(&name)).unwrap_or_else(|e| panic!("{name}: {e}")));
    let cells = content(&set.join("cells"));
    let cells = cells.into_iter().filter(|(name, _)| !name.ends_with("manifest.json"));
    names.map(of).into_iter().chain(cells.map(|(name, bytes)| (name.display().to_string(), bytes))).collect()
}

#[test]
fn a_dry_run_lists_the_cells_and_makes_nothing() {
    let folder = scratch();
    let folder = folder.path();
    let said = ok(folder, "reproduce all --dry-run");
    for part in ["absent-1-12", "env=rocks-and-diamonds rollouts=0", "41 cells, 0 done", "0 to 9", "tomato-spread"] {
        assert!(said.contains(part), "{part} is missing in\n{said}");
    }
    let boxes = said.lines().filter(|line| line.starts_with("box ")).count();
    assert_eq!(boxes, 1, "what several experiments need is one cell\n{said}");
    assert!(said.lines().all(|line| line.chars().count() <= 80), "{said}");
    let quick = ok(folder, "reproduce fig4b --quick --dry-run");
    assert!(quick.contains("5 cells, 0 done") && quick.contains("0 to 3"), "{quick}");
    assert!(!folder.join("runs").exists());
}

#[test]
fn cells_are_trained_once_and_claims_judged() {
    let folder = scratch();
    let folder = folder.path();
    let said = ok(folder, &format!("{ONE} -o set"));
    assert!(said.contains("not measured   performance grows") && said.contains("1 of 3 cells done"), "{said}");
    assert!(said.lines().filter(|line| !line.starts_with("Written")).all(|line| line.chars().count() <= 80), "{said}");
    let before = content(&folder.join("set/cells"));
    // The same command finds everything there and changes nothing; another one goes on from there.
    assert_eq!(ok(folder, &format!("{ONE} -o set --resume")), said);
    assert_eq!(content(&folder.join("set/cells")), before);
    let all = ok(folder, "reproduce E8 E20 --seeds 3..4 --only box-forecast-300 -o set --json");
    let results = json(&all);
    assert_eq!(results["format"], "mcvl reproduce");
    let outcomes: Vec<_> = results["claims"].as_array().unwrap().iter().map(|row| (&row["done"], &row["of"])).collect();
    assert_eq!(outcomes, [(&2.into(), &3.into()), (&1.into(), &2.into()), (&2.into(), &13.into())]);
    ok(folder, "reproduce E8 --seeds 3..4 -o set");
    let results = json(&fs::read_to_string(folder.join("set/results.json")).unwrap());
    let row = &results["claims"][0];
    assert!(
        ["undecided", "does-not-hold"].contains(&row["outcome"].as_str().unwrap()),
        "one seed decides nothing: {row}"
    );
    assert_eq!((row["numbers"].as_array().unwrap().len(), &row["seeds"]), (4, &1.into()));
    assert_eq!(row["setup"][0], "env=box-moving forecast=100");
    for name in ["claims.csv", "numbers.csv", "results.md", "fig5.svg", "fig5.png", "records/box.record.json"] {
        assert!(folder.join("set").join(name).is_file(), "{name}");
    }
    ok(folder, "verify set/cells/box");

    // Where less is asked for, the rest of what is known stays in the files.
    let files = ["claims.csv", "numbers.csv", "results.json", "results.md", "fig5.svg"];
    let read = |set: &str, name: &str| fs::read_to_string(folder.join(set).join(name)).unwrap();
    let before = files.map(|name| read("set", name));
    let said = ok(folder, "reproduce E1 --seeds 3..4 -o set");
    assert!(said.contains("E1") && !said.contains("E8"), "{said}");
    for (name, before) in files.iter().zip(&before) {
        let after = read("set", name);
        assert_eq!(after == *before, *name == "fig5.svg", "E1 is there now, too: {name}");
    }
    // Of E20, which was asked for first, most cells are missing; it stays told, with one more by now.
    let after = read("set", "claims.csv");
    assert!(before[0].contains("\nE20,") && after.contains("\nE20,"), "{after}");
    assert!(before[0].lines().filter(|line| !line.starts_with("E20,")).all(|line| after.contains(line)), "{after}");
    // Also where it has other seeds than those that are asked for; and what nobody can read is named.
    let tables = read("set", "claims.csv");
    let record = folder.join("set/records/box-forecast-300.record.json");
    let whole = fs::read(&record).unwrap();
    let stopped = || {
        let answer = ask(folder, "reproduce E9 --seeds 4..5 -o set --max-time 200ms");
        assert_eq!(answer.code, 130, "{}", answer.stderr);
        answer.stderr
    };
    stopped();
    assert!(tables.lines().all(|line| read("set", "claims.csv").contains(line)), "{}", read("set", "claims.csv"));
    fs::write(&record, "{}").unwrap();
    let said = stopped();
    assert!(said.contains("note: left out of tables and figures: ") && said.contains("box-forecast-300"), "{said}");
    let grows = |line: &&str| line.starts_with("E8,") && line.contains("performance grows");
    let told = read("set", "claims.csv");
    assert!(told.lines().find(grows).unwrap().contains(",not measured,,2,3,") && told.contains("\nE1,"), "{told}");
    fs::write(&record, whole).unwrap();
    fs::remove_dir_all(folder.join("set/cells/box-no-inconsistency")).unwrap();
    ok(folder, "reproduce E1 E8 --seeds 3..4 -o set");

    // The records alone are enough elsewhere, and so are the runs.
    for (from, to) in [("set/records", "by-records"), ("set/cells", "by-runs")] {
        ok(folder, &format!("reproduce E1 E8 --seeds 3..4 --evaluate --from {from} -o {to}"));
        for name in ["claims.csv", "numbers.csv", "fig5.svg"] {
            // Nobody asked for E9 and E20 there.
            let told = |set: &str| {
                let text = read(set, name);
                text.lines().filter(|line| !line.contains(",not measured,")).map(str::to_owned).collect::<Vec<_>>()
            };
            assert_eq!(told(to), told("set"), "{name} {from}");
        }
    }
    assert!(!folder.join("by-records/records").exists() && folder.join("by-runs/records/box.record.json").is_file());
}

#[test]
fn nothing_of_somebody_else_is_overwritten_and_nothing_is_judged_where_nothing_is() {
    let folder = scratch();
    let folder = folder.path();
    fs::create_dir(folder.join("mine")).unwrap();
    fs::write(folder.join("mine/results.md"), "precious").unwrap();
    let answer = ask(folder, &format!("{ONE} -o mine"));
    assert_eq!(answer.code, 2);
    let why = "mine is not empty and holds no results of mcvl reproduce: choose another with -o";
    assert!(answer.stderr.contains(why), "{}", answer.stderr);
    assert_eq!(fs::read_dir(folder.join("mine")).unwrap().count(), 1);
    assert_eq!(fs::read_to_string(folder.join("mine/results.md")).unwrap(), "precious");
    // What looks like a set may be another's, and one of a later version is not this program's to rewrite.
    let table = folder.join("mine/claims.csv");
    fs::create_dir(folder.join("mine/cells")).unwrap();
    fs::write(&table, "precious").unwrap();
    let theirs = r#"{"format": "mcvl reproduce", "version": 9, "claims": []}"#;
    for (results, code, part) in [
        (None, 2, "claims.csv is there, but no results of mcvl reproduce: choose another folder"),
        (Some(r#"{"my": "own file"}"#), 3, "results.json: holds no results of mcvl reproduce: choose another folder"),
        (Some(theirs), 3, "results.json: is of version 9, this program writes version 2"),
    ] {
        results.iter().for_each(|text| fs::write(folder.join("mine/results.json"), text).unwrap());
        let answer = ask(folder, &format!("{ONE} -o mine"));
        assert_eq!((answer.code, answer.stderr.contains(part)), (code, true), "{}", answer.stderr);
        assert_eq!(fs::read_to_string(&table).unwrap(), "precious");
        assert!(results.is_none_or(|text| fs::read_to_string(folder.join("mine/results.json")).unwrap() == text));
    }
    let answer = ask(folder, "reproduce E8 --evaluate -o typo");
    assert_eq!(answer.code, 2);
    assert!(answer.stderr.contains("no cell has a finished seed in typo"), "{}", answer.stderr);
    assert!(!folder.join("typo").exists());
    // Before anything is trained.
    fs::write(folder.join("notes.txt"), "precious").unwrap();
    for (flag, why) in [("--bands", "holds something else"), ("--page", "it lacks the lines")] {
        let answer = ask(folder, &format!("{ONE} -o new {flag} notes.txt"));
        assert_eq!((answer.code, answer.stderr.contains(why)), (2, true), "{}", answer.stderr);
        assert!(!folder.join("new").exists());
    }
    assert_eq!(fs::read_to_string(folder.join("notes.txt")).unwrap(), "precious");
    for _ in 0..2 {
        ok(folder, "reproduce E8 --seeds 3..4 --only box-forecast-100 -o new --bands bands.json");
    }
    assert_eq!(fs::read_to_string(folder.join("bands.json")).unwrap(), "{}\n");
}

/// A cell that is trained in parts, in several folders, is the cell that is trained in one.
#[test]
fn parts_of_a_cell_are_joined() {
    let folder = scratch();
    let folder = folder.path();
    let cell = "reproduce E7 --only box-safe-100";
    ok(folder, &format!("{cell} --seeds 3,5 -o whole"));
    ok(folder, &format!("{cell} --seeds 3..4 -o one"));
    let rest = format!("{cell} --seeds 3,5 --from one/records -o other");
    let said = ok(folder, &format!("{rest} --dry-run"));
    assert!(said.lines().any(|line| line.starts_with("box-safe-100            5 ")), "{said}");
    let said = ok(folder, &rest);
    let run = folder.join("other/cells/box-safe-100");
    assert!(run.join("seed-5").is_dir() && !run.join("seed-3").exists(), "what is there is not trained again");
    let record = |set: &str| {
        let path = folder.join(set).join("records/box-safe-100.record.json");
        let mut record = json(&fs::read_to_string(path).unwrap());
        // How long it took, and the seals of the runs.
        ["trained_ms", "seal"].iter().for_each(|name| drop(record.as_object_mut().unwrap().remove(*name)));
        record
    };
    assert_eq!(record("other"), record("whole"));
    for name in ["claims.csv", "numbers.csv"] {
        let read = |set: &str| fs::read_to_string(folder.join(set).join(name)).unwrap();
        assert_eq!(read("other"), read("whole"), "{name}");
    }
    // Nothing is left to do, and what was trained for a part is not mistaken for the whole.
    assert_eq!(ok(folder, &rest), said);
    assert_eq!(ok(folder, &format!("{cell} --seeds 3,5 -o other")), said, "the record has both");
    let path = folder.join("other/records/box-safe-100.record.json");
    let bytes = fs::read(&path).unwrap();
    fs::remove_file(&path).unwrap();
    let answer = ask(folder, &format!("{cell} --seeds 3,5 -o other"));
    fs::write(&path, bytes).unwrap();
    assert_eq!(answer.code, 2, "{}", answer.stderr);
    assert!(answer.stderr.contains("is of seed 5, not of seeds 3, 5: give the same --seeds, --quick and --from"));

    // A claim with some of its seeds says so.
    let said = ok(folder, "reproduce E7 --evaluate --from other/records -o all");
    let row = said.split("100 steps: some seeds").nth(1).unwrap_or_else(|| panic!("{said}"));
    assert!(said.contains("\n  unfinished ") && row.contains("2 of 10 seeds, so far it"), "{said}");
}

/// Whatever became of the runs, what a folder's records hold is neither trained again nor replaced by less.
#[test]
fn a_record_outlives_its_run() {
    let folder = scratch();
    let folder = folder.path();
    let said = ok(folder, &format!("{ONE} -o set"));
    let path = folder.join("set/records/box-forecast-100.record.json");
    let whole = fs::read(&path).unwrap();
    fs::remove_dir_all(folder.join("set/cells")).unwrap();
    assert_eq!(ok(folder, &format!("{ONE} -o set")), said);
    assert!(!folder.join("set/cells").exists() && fs::read(&path).unwrap() == whole);
    // A seed more: that one alone is trained, and both are in the record, stopped or not.
    let more = ask(folder, "reproduce E8 --seeds 3,4 --only box-forecast-100 -o set --max-time 200ms");
    assert_eq!(more.code, 130, "{}", more.stderr);
    assert_eq!(fs::read(&path).unwrap(), whole);
    ok(folder, "reproduce E8 --seeds 3,4 --only box-forecast-100 -o set");
    let run = folder.join("set/cells/box-forecast-100");
    assert!(run.join("seed-4").is_dir() && !run.join("seed-3").exists());
    let both = fs::read(&path).unwrap();
    assert_eq!(json(&String::from_utf8_lossy(&both))["summary"]["seeds"], json("[3, 4]"));
    // Fewer seeds, another setting, or a record that nobody can read: said, and left alone.
    for (arguments, code, part) in [
        (
            "reproduce E8 --seeds 3..4 --only box-forecast-100",
            2,
            "record.json is of seeds 3, 4, not of seed 3: give the",
        ),
        ("reproduce E8 --seeds 3..4 --evaluate --from .", 2, "record.json is of seeds 3, 4, not of seed 3"),
    ] {
        fs::remove_dir_all(folder.join("set/cells")).ok();
        let answer = ask(folder, &format!("{arguments} -o set"));
        assert_eq!((answer.code, answer.stderr.contains(part)), (code, true), "{arguments}\n{}", answer.stderr);
        assert_eq!(fs::read(&path).unwrap(), both);
    }
    let other = String::from_utf8_lossy(&both).replacen("forecast=100", "forecast=101", 1);
    for (bytes, code, part) in [
        (&both[..both.len() / 2], 3, "is no record of mcvl"),
        (other.as_bytes(), 2, "record.json is of another setting than the one wanted"),
    ] {
        fs::write(&path, bytes).unwrap();
        let answer = ask(folder, "reproduce E8 --seeds 3,4 --only box-forecast-100 -o set");
        assert_eq!((answer.code, answer.stderr.contains(part)), (code, true), "{}", answer.stderr);
    }
}

/// Of a run that is not finished, the seeds that are count.
#[test]
fn finished_seeds_of_a_run_that_goes_on_are_used() {
    let folder = scratch();
    let folder = folder.path();
    // However slow the machine is, a seed is finished in the end.
    let train = "train box-moving --set scheme=discard --seeds 0..500 -j 1 -o run --overwrite --max-time";
    let finished = || fs::read_to_string(folder.join("run/manifest.json")).is_ok_and(|text| text.contains("seed-0/"));
    let mut seconds = 4;
    while !finished() {
        let answer = ask(folder, &format!("{train} {seconds}s"));
        assert_eq!(answer.code, 130, "{}", answer.stderr);
        seconds *= 2;
    }
    let answer = ask(folder, "reproduce fig4a --evaluate --from run -o set");
    assert_eq!(answer.code, 0, "{}", answer.stderr);
    assert!(answer.stderr.contains("is not finished: ") && answer.stderr.contains("of its 500 seeds used"));
    let record = json(&fs::read_to_string(folder.join("set/records/box-discard.record.json")).unwrap());
    let seeds = record["summary"]["seeds"].as_array().unwrap().len();
    assert!((1..500).contains(&seeds) && record["summary"]["unfinished"] == json("[]"), "{seeds}");
}

#[test]
fn stopped_and_continued_gives_the_same_bytes() {
    let folder = scratch();
    let folder = folder.path();
    ok(folder, &format!("{ONE} -o straight"));
    // By a kill between its first two files, by the clock, by a signal, by a kill.
    let cell = "cells/box-forecast-100";
    fs::create_dir_all(folder.join("cut").join(cell)).unwrap();
    fs::copy(folder.join("straight").join(cell).join("run.toml"), folder.join("cut").join(cell).join("run.toml"))
        .unwrap();
    let answer = ask(folder, &format!("{ONE} -o cut --max-time 200ms"));
    assert_eq!(answer.code, 130, "{}", answer.stderr);
    let hint = "continue with: mcvl reproduce E8 --seeds 3..4 --only box-forecast-100 -o cut";
    assert!(answer.stderr.contains(hint), "{}", answer.stderr);
    assert!(answer.stdout.contains("not measured"), "what is there is judged all the same");
    for signal in ["-TERM", "-KILL"] {
        let mut command = program(folder);
        command.args(format!("{ONE} -o cut --checkpoint-every 10ms").split(' '));
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("mcvl starts");
        sleep(Duration::from_millis(150));
        if child.try_wait().unwrap().is_none() {
            assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        }
        child.wait().unwrap();
    }
    ok(folder, &format!("{ONE} -o cut"));
    let (straight, cut) = (promised(&folder.join("straight")), promised(&folder.join("cut")));
    let names = |set: &[(String, Vec<u8>)]| set.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&straight), names(&cut));
    for ((name, one), (_, other)) in straight.iter().zip(&cut) {
        assert!(one == other, "{name} differs");
    }
}

#[test]
fn what_does_not_fit_is_said_and_left_alone() {
    let folder = scratch();
    let folder = folder.path();
    let fails = |arguments: &str, code: i32, part: &str| {
        let answer = ask(folder, arguments);
        assert_eq!(answer.code, code, "{arguments}\n{}", answer.stderr);
        assert!(answer.stderr.contains(part), "{arguments}\n{}", answer.stderr);
    };
    fails("reproduce fig6", 2, "`fig6` is none of all, fig3");
    fails("reproduce fig5a", 2, "did you mean `fig5`?");
    // No experiment is near enough to another number.
    fails("reproduce E21", 2, "E19, E20\n");
    fails("reproduce E8 --only box-l", 2, "--only: `box-l` is none of");
    fails("reproduce E8 --seeds x", 2, "is no list of seeds");
    fails("reproduce E8 --evaluate --from nowhere", 2, "there is no such folder");
    fs::create_dir(folder.join("empty")).unwrap();
    fails("reproduce E8 --evaluate --from empty", 2, "holds neither runs nor records");
    let answer = ask(folder, &format!("{ONE} -o set --max-time 200ms"));
    assert_eq!(answer.code, 130, "{}", answer.stderr);
    let before = content(&folder.join("set"));
    let cell = folder.join("set/cells/box-forecast-100");
    fails("reproduce E8 --seeds 0..2 -o set", 2, "is of seed 3, not of seeds 0, 1");
    fails("reproduce E8 --quick -o set", 2, "give the same --seeds, --quick and --from as before");
    assert_eq!(content(&folder.join("set")), before, "nothing was changed");

    // Half written, altered, of another version.
    copy(&folder.join("set"), &folder.join("half"));
    let plan = fs::read_to_string(cell.join("run.toml")).unwrap();
    fs::write(folder.join("half/cells/box-forecast-100/run.toml"), &plan[..plan.len() / 2]).unwrap();
    fails(&format!("{ONE} -o half"), 3, "run.toml: is no run.toml");
    copy(&folder.join("set"), &folder.join("altered"));
    let manifest = folder.join("altered/cells/box-forecast-100/manifest.json");
    fs::write(&manifest, fs::read_to_string(&manifest).unwrap().replace("interrupted", "finished")).unwrap();
    fails(&format!("{ONE} -o altered"), 3, "was altered: its seal does not fit");
    fs::create_dir(folder.join("old")).unwrap();
    let record = r#"{"format":"mcvl record","version":0}"#;
    fs::write(folder.join("old/box.record.json"), record).unwrap();
    fails("reproduce E8 --evaluate --from old", 3, "format version 0, this program reads version 1");
    fs::write(folder.join("old/box.record.json"), &record[..20]).unwrap();
    fails("reproduce E8 --evaluate --from old", 3, "is no record of mcvl");
    let state = folder.join("set/cells/box-forecast-100/seed-3/checkpoints/state.snapshot");
    let bytes = fs::read(&state).unwrap();
    fs::write(&state, &bytes[..bytes.len() / 2]).unwrap();
    fails(&format!("{ONE} -o set"), 3, "cut off");
    fs::write(&state, &bytes).unwrap();
    ok(folder, &format!("{ONE} -o set"));
    // A finished cell whose logs are not what training wrote gives no numbers, neither here nor elsewhere.
    fs::remove_file(folder.join("set/records/box-forecast-100.record.json")).unwrap();
    for (log, part) in [("ledger", "altered: its digest"), ("metrics", "metrics.jsonl: missing")] {
        let path = folder.join(format!("set/cells/box-forecast-100/seed-3/{log}.jsonl"));
        let bytes = fs::read(&path).unwrap();
        if log == "ledger" {
            let mut altered = bytes.clone();
            altered[bytes.len() / 2] ^= 1;
            fs::write(&path, altered).unwrap();
        } else {
            fs::remove_file(&path).unwrap();
        }
        fails(&format!("{ONE} --evaluate -o set"), 3, part);
        if log == "ledger" {
            fails("reproduce E8 --evaluate --seeds 3..4 --from set/cells -o other", 3, part);
        }
        fs::write(&path, &bytes).unwrap();
    }
    ok(folder, &format!("{ONE} --evaluate -o set"));
    fails(&format!("{ONE} --evaluate --page none.md -o set"), 3, "cannot read none.md");
    fs::write(folder.join("page.md"), "no marks").unwrap();
    fails(&format!("{ONE} --evaluate --page page.md -o set"), 2, "lacks the lines");
}

#[test]
fn repeated_checks_are_measured_and_resumed() {
    let folder = scratch();
    let folder = folder.path();
    let command = "reproduce E15 --quick --only absent-spread";
    let answer = ask(folder, &format!("{command} -o cut --max-time 300ms"));
    assert!([0, 130].contains(&answer.code), "{}", answer.stderr);
    for set in ["straight", "cut"] {
        let said = ok(folder, &format!("{command} -o {set}"));
        assert!(said.contains("deviation of the margin, paired"), "{said}");
    }
    let numbers = |set: &str| fs::read_to_string(folder.join(set).join("numbers.csv")).unwrap();
    assert_eq!(numbers("cut"), numbers("straight"));
    let record = json(&fs::read_to_string(folder.join("straight/records/absent-spread.record.json")).unwrap());
    let checks = record["spread"]["checks"].as_array().unwrap();
    assert_eq!((checks.len(), checks[0]["paired"]["margins"].as_array().unwrap().len()), (3, 5));
    // What an older version began is not continued with other draws.
    let begun = folder.join("old/cells/absent-spread/spread.json");
    fs::create_dir_all(begun.parent().unwrap()).unwrap();
    let config = record["config"].clone();
    let spread = serde_json::json!({ "seed": record["spread"]["seed"], "repeats": 0, "updates": 0, "checks": [] });
    let old = serde_json::json!({ "config": config, "trained_ms": 0, "spread": spread }).to_string();
    fs::write(&begun, &old).unwrap();
    let refused = ask(folder, &format!("{command} -o old"));
    assert!(refused.code == 2 && refused.stderr.contains("remove it to begin anew"), "{}", refused.stderr);
    assert_eq!(fs::read_to_string(&begun).unwrap(), old);
}

#[test]
fn seeds_without_a_time_of_their_own_say_nothing_of_cost() {
    let folder = scratch();
    let of = |seeds: &str| {
        let results = root().join("results");
        ok(folder.path(), &format!("reproduce E20 --evaluate --seeds {seeds} --from {} -o out", results.display()))
    };
    assert!(of("0..10").contains("HOLDS"));
    let part = of("0..4");
    assert!(
        part.contains("not measured") && part.contains("its records lack wall times of just these seeds"),
        "{part}"
    );
}

#[test]
fn asserted_claims_decide_how_the_program_ends() {
    let folder = scratch();
    let from = format!("--evaluate --from {}", root().join("results").display());
    for (of, outcome, code) in [
        ("E1", "holds", 0),
        ("E9", "does-not-hold", 1),
        // Nothing speaks against what was not measured, but it was not seen to hold either.
        ("E20 --seeds 0..4", "not-measured", 1),
    ] {
        let answer = ask(folder.path(), &format!("reproduce {of} {from} -o set --json --assert-claims"));
        assert_eq!(answer.code, code, "{of}: {}", answer.stderr);
        let results = json(&answer.stdout);
        let mut outcomes = results["claims"].as_array().unwrap().iter().map(|row| &row["outcome"]);
        assert!(outcomes.all(|found| found == outcome), "{of}: {}", answer.stdout);
    }
}

/// What lies elsewhere may have more than is asked for, and the page may lie beside the folder.
#[test]
fn results_from_elsewhere_are_cut_to_what_is_planned_and_shown_where_the_page_lies() {
    let folder = scratch();
    let folder = folder.path();
    let results = root().join("results");
    let evaluate = format!("reproduce E1 --evaluate --from {}", results.display());
    let quick = ok(folder, &format!("{evaluate} --quick -o quick"));
    assert!(quick.contains("hacked 4 of 4") && !quick.contains("10 seeds"), "{quick}");
    assert!(quick.contains("A wall time that is not known for 2 cells"), "{quick}");
    fs::create_dir(folder.join("docs")).unwrap();
    let marks = "<!-- mcvl reproduce: from here on written by the program -->\n<!-- mcvl reproduce: up to here -->\n";
    fs::write(folder.join("docs/page.md"), marks).unwrap();
    ok(folder, &format!("{evaluate} -o figures --page docs/page.md"));
    let page = fs::read_to_string(folder.join("docs/page.md")).unwrap();
    assert!(page.contains("](../figures/fig3.svg)"), "{page}");
    let refused = ask(folder, &format!("{evaluate} -o other --bands none/bands.json"));
    assert!(
        refused.code == 2 && refused.stderr.contains("there is no folder none: make it first"),
        "{}",
        refused.stderr
    );
    assert!(!folder.join("other").exists());
}

#[test]
fn a_dry_run_as_json_says_what_is_missing() {
    let folder = scratch();
    let ask =
        |from: &str| json(&ok(folder.path(), &format!("reproduce E1 --only box --seeds 0..12 --dry-run --json{from}")));
    let from = format!(" --from {}", root().join("results").display());
    let [bare, lent] = [ask(""), ask(&from)].map(|plan| plan["cells"][0].clone());
    assert_eq!(
        (&bare["cell"], &bare["missing"][0], &lent["missing"]),
        (&"box".into(), &0.into(), &[10, 11][..].into())
    );
    assert!(bare["expected_seconds"].as_f64() > lent["expected_seconds"].as_f64());
    assert_eq!(bare["finished"].as_array().unwrap().len() + lent["finished"].as_array().unwrap().len(), 10);
    // What the trial of a dry run changes stays within what settings may be.
    for safe_steps in [0, 1, 100] {
        ok(
            folder.path(),
            &format!("train box-moving --set safe_steps={safe_steps} --set evaluations=100000 --dry-run"),
        );
    }
}

/// Two terminals may train different cells in one folder at the same time; neither loses what the other one tells.
#[cfg(unix)]
#[test]
fn two_processes_in_one_folder_tell_what_both_have() {
    let folder = scratch();
    let folder = folder.path();
    let mut command = program(folder);
    command.args("reproduce E8 --seeds 3..4 --only box-forecast-300 -o set".split(' '));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("mcvl starts");
    let signal = |signal: &str| {
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    };
    for _ in 0..30_000 {
        if folder.join("set/cells/box-forecast-300/run.toml").exists() {
            break;
        }
        sleep(Duration::from_millis(2));
    }
    signal("-STOP");
    // The other one does the whole of its work while this one trains.
    let other = ask(folder, "reproduce E8 E9 --seeds 3..4 --only box-forecast-100 -o set");
    signal("-CONT");
    assert_eq!(other.code, 0, "{}", other.stderr);
    assert!(child.wait().unwrap().success());
    let told = fs::read_to_string(folder.join("set/claims.csv")).unwrap();
    let done = told.lines().find(|line| line.starts_with("E8,") && line.contains("performance grows"));
    assert!(done.unwrap().contains(",2,3,") && told.contains("\nE9,"), "{told}");

    // Tables are written by one at a time.
    let lock = fs::File::create(folder.join("set/.lock")).unwrap();
    lock.lock().unwrap();
    let mut command = program(folder);
    command.args("reproduce E8 --seeds 3..4 --evaluate -o set".split(' '));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("mcvl starts");
    sleep(Duration::from_secs(2));
    assert!(child.try_wait().unwrap().is_none(), "it waits");
    drop(lock);
    assert!(child.wait().unwrap().success());
}

/// A run may have more learners than a cell, and be one of several cells.
#[test]
fn a_run_counts_for_every_cell_that_it_fits_with_the_learners_of_that_cell() {
    let folder = scratch();
    let folder = folder.path();
    let agents =
        ["baseline", "mc", "oracle", "frozen", "frozen-reward"].map(|name| format!(" --agent {name}")).concat();
    ok(folder, &format!("train box-moving --seeds 3..4{agents} -o runs/all"));
    ok(folder, "train box-moving --seeds 5..6 -o runs/plain");
    // Killed between its first two files.
    fs::create_dir(folder.join("runs/killed")).unwrap();
    fs::copy(folder.join("runs/plain/run.toml"), folder.join("runs/killed/run.toml")).unwrap();
    let answer = ask(folder, "reproduce E1 E6 --seeds 3,5 --evaluate --from runs -o set");
    assert_eq!(answer.code, 0, "{}", answer.stderr);
    assert!(answer.stderr.contains("killed is not finished: none of its seeds is used"), "{}", answer.stderr);
    let read = |set: &str, cell: &str| {
        let path = folder.join(set).join(format!("records/{cell}.record.json"));
        json(&fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
    };
    let legs = |record: &serde_json::Value| {
        let legs = record["arms"].as_array().unwrap().iter().map(|leg| leg["arm"].as_str().unwrap().to_owned());
        (legs.collect::<Vec<_>>().join(" "), record["summary"]["seeds"].clone())
    };
    let both = read("set", "box");
    assert_eq!(legs(&both), ("safe baseline mc".to_owned(), json("[3, 5]")));
    let baselines = legs(&read("set", "box-baselines"));
    assert_eq!(baselines, ("safe oracle frozen frozen-reward".to_owned(), json("[3]")));
    // Whatever is named first.
    for (index, from) in ["--from runs/all --from runs/plain", "--from runs/plain --from runs/all"].iter().enumerate() {
        ok(folder, &format!("reproduce E1 --seeds 3,5 --evaluate {from} -o set-{index}"));
        assert_eq!(read(&format!("set-{index}"), "box"), both, "{from}");
    }
}

#[test]
fn records_that_cannot_be_joined_or_parted_are_named() {
    let folder = scratch();
    let folder = folder.path();
    let text = fs::read_to_string(root().join("results/records/box.record.json")).unwrap();
    // As an earlier version wrote it, and ten other seeds.
    let (mut old, mut new) = (json(&text), json(&text));
    let legs = |record: &mut serde_json::Value| record["arms"].as_array_mut().unwrap().clone();
    old["arms"] = legs(&mut old).into_iter().map(|mut leg| drop_seeds(&mut leg)).collect();
    let shift = |seeds: &mut serde_json::Value| {
        for seed in seeds.as_array_mut().unwrap() {
            let number = if seed.is_object() { &mut seed["seed"] } else { seed };
            *number = (number.as_u64().unwrap() + 10).into();
        }
    };
    shift(&mut new["summary"]["seeds"]);
    for place in ["/arms", "/summary/arms"] {
        new.pointer_mut(place).unwrap().as_array_mut().unwrap().iter_mut().for_each(|leg| shift(&mut leg["seeds"]));
    }
    for (name, record) in [("old", old), ("new", new)] {
        fs::create_dir(folder.join(name)).unwrap();
        fs::write(folder.join(name).join("box.record.json"), record.to_string()).unwrap();
    }
    let says = |seeds: &str, part: &str| {
        let command = format!("reproduce E1 --only box --seeds {seeds} --evaluate --from old --from new -o set");
        let answer = ask(folder, &command);
        assert!(answer.code == 0 && answer.stderr.contains(part), "{}", answer.stderr);
    };
    says("0..20", "note: box: seeds 10 to 19 of one record left out: it cannot be joined with that of seeds 0 to 9");
    says("5..15", "box.record.json is left out: it does not tell its seeds apart");
}

/// Records come from anywhere, so their numbers may be any.
#[test]
fn records_with_absurd_counts_are_judged_all_the_same() {
    const COUNTS: &[&str] = &[
        "trained_ms",
        "updates",
        "cost",
        "hacks_refused",
        "hacks_accepted",
        "hacks_unchecked",
        "honest_refused",
        "ties",
    ];
    fn alter(value: &mut serde_json::Value) {
        match value {
            serde_json::Value::Array(items) => items.iter_mut().for_each(alter),
            serde_json::Value::Object(fields) => {
                for (name, value) in fields {
                    match name.as_str() {
                        name if COUNTS.contains(&name) && value.is_u64() => *value = u64::MAX.into(),
                        "checks" if value.is_u64() => *value = 0.into(),
                        _ => alter(value),
                    }
                }
            }
            _ => {}
        }
    }
    let folder = scratch();
    let folder = folder.path();
    fs::create_dir(folder.join("records")).unwrap();
    for entry in fs::read_dir(root().join("results/records")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "json") {
            let mut record = json(&fs::read_to_string(&path).unwrap());
            alter(&mut record);
            fs::write(folder.join("records").join(path.file_name().unwrap()), record.to_string()).unwrap();
        }
    }
    ok(folder, "reproduce all --evaluate --from records -o set");
    // Those of some seeds are summed anew.
    let answer = ask(folder, "reproduce all --evaluate --seeds 0..5 --from records -o some");
    assert_eq!(answer.code, 0, "{}", answer.stderr);
    let path = folder.join("records/box.record.json");
    let text = fs::read_to_string(&path).unwrap().replacen("\"seeds\":[0,1,", "\"seeds\":[1,0,", 1);
    fs::write(&path, text).unwrap();
    let answer = ask(folder, "reproduce all --evaluate --from records -o other");
    assert_eq!(answer.code, 3, "{}", answer.stderr);
    assert!(answer.stderr.contains("box.record.json: is damaged: its seeds are not in asc"), "{}", answer.stderr);
}

fn drop_seeds(leg: &mut serde_json::Value) -> serde_json::Value {
    leg.as_object_mut().unwrap().remove("seeds");
    leg.take()
}

/// The page of results is what the program makes of the committed records, and its figures are there.
#[test]
fn the_page_of_results_is_made_of_the_committed_records() {
    let folder = scratch();
    let folder = folder.path();
    let (docs, results) = (root().join("docs"), root().join("results"));
    fs::copy(docs.join("results.md"), folder.join("results.md")).unwrap();
    let command = format!("reproduce all --evaluate --from {} -o results --page results.md", results.display());
    let said = ok(folder, &format!("{command} --bands bands.json"));
    assert!(said.lines().filter(|line| !line.starts_with("Written")).all(|line| line.chars().count() <= 80), "{said}");
    // No column of the gate's table touches the next one: behind each world's name are nine numbers.
    let numbers = |line: &str| line.split_whitespace().filter(|word| !word.starts_with(char::is_alphabetic)).count();
    let gate = said.lines().skip_while(|line| !line.starts_with("The gate")).skip(2).take(8);
    assert_eq!(gate.map(numbers).collect::<Vec<_>>(), [9; 8], "{said}");
    let read = |path: &Path| fs::read_to_string(path).unwrap();
    let advice = "run: mcvl reproduce all --evaluate --from results -o docs/results --page docs/results.md \
                  --bands www/bands.json";
    assert!(
        read(&folder.join("bands.json")) == read(&root().join("www/bands.json")),
        "www/bands.json is older: {advice}"
    );
    assert!(read(&folder.join("results.md")) == read(&docs.join("results.md")), "docs/results.md is older: {advice}");
    for name in [
        "fig3.svg",
        "fig3-alive.svg",
        "fig4a.svg",
        "fig4b.svg",
        "fig5.svg",
        "fig5-alive.svg",
        "claims.csv",
        "numbers.csv",
        "gate.csv",
        "costs.csv",
        "fig3.csv",
        "fig4a.csv",
    ] {
        let same = read(&folder.join("results").join(name)) == read(&docs.join("results").join(name));
        assert!(same, "docs/results/{name} is older: {advice}");
    }
}
