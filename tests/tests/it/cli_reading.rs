//! No command shows what is not as training wrote it, and every command reads a run that is under way.

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use mcvl_tests::scratch;

use crate::cli::{ask, content, finished, lines, ok, program};
use crate::cli_errors::{Damage, check};

/// Commands that show something of `run`, and whether that includes a tape of seed 0.
const READERS: &[(&str, bool)] = &[
    ("explain run#1", true),
    ("ledger run", false),
    ("compare run", false),
    ("export run --to csv", false),
    ("report run", true),
    ("export run --to tape -o tapes", true),
    ("page run -q", true),
];

#[test]
fn no_reader_shows_a_finished_run_that_was_altered() {
    let folder = finished();
    let folder = folder.path();
    // A page of which the server finds all that it looks for, on a port that is taken: it must not come so far.
    let page = folder.join("page");
    fs::create_dir_all(page.join("pkg")).unwrap();
    for file in ["index.html", "pkg/simd_bg.wasm", "pkg/scalar_bg.wasm"] {
        fs::write(page.join(file), "").unwrap();
    }
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let serve = format!("serve run --page page --port {}", taken.local_addr().unwrap().port());
    let flip = || Damage::Replace("\"verdict\":\"refuse\"", "\"verdict\":\"accept\"");
    let insert = || Damage::Replace("\"step\":", "\"step\":1");
    for (name, damage, part, tapes_only) in [
        ("seed-0/ledger.jsonl", flip(), "manifest.json, and its chain breaks at line ", false),
        ("seed-0/tapes/check-1.json", insert(), "was altered: its digest is not the one in ledger.jsonl", true),
        ("manifest.json", Damage::Replace("\"format\": 1", "\"format\": 7"), "has format version 7", false),
        ("manifest.json", Damage::Replace("\"cpu\": \"", "\"cpu\": \"x"), "was altered: its seal does not fit", false),
        ("manifest.json", Damage::Remove, "cannot read", false),
        ("run.toml", Damage::Replace("# A run", "# The run"), "was altered since the run began", false),
    ] {
        let path = folder.join("run").join(name);
        let whole = fs::read(&path).unwrap();
        damage.apply(&path);
        let readers = READERS.iter().filter(|(_, tapes)| *tapes || !tapes_only).map(|(arguments, _)| *arguments);
        for arguments in readers.chain((!tapes_only).then_some(serve.as_str())) {
            check(folder, arguments, 3, &[name, part]);
        }
        // Deriving it again finds what differs by itself, but not from what.
        if name == "manifest.json" || name == "run.toml" {
            check(folder, "replay run#1", 3, &[name, part]);
        }
        fs::write(&path, whole).unwrap();
    }
    // Of the steps hacks are counted that were never checked.
    let steps = folder.join("run/seed-0/steps.csv");
    assert!(ok(folder, "compare run").contains("never checked"));
    let whole = fs::read(&steps).unwrap();
    Damage::Replace(",true,", ",false,").apply(&steps);
    check(folder, "compare run", 3, &["seed-0/steps.csv", "altered"]);
    fs::remove_file(&steps).unwrap();
    assert!(!ok(folder, "compare run").contains("never checked"), "without them it is not known");
    fs::write(&steps, whole).unwrap();
    // A ledger that does not reach to the check is no reason to look for it elsewhere.
    let ledger = folder.join("run/seed-0/ledger.jsonl");
    fs::write(&ledger, "").unwrap();
    for command in ["explain run#2", "replay run#2"] {
        check(folder, command, 3, &["seed-0/ledger.jsonl: cut off: 0 bytes of"]);
    }
}

/// A folder with a run in `run` that was stopped in the mc leg, after some checks.
fn stopped() -> tempfile::TempDir {
    let folder = scratch();
    let settings = "--set exploration=50 --set safe_steps=300 --set forecast=50 --set epsilon_decay=200";
    let train = format!("train box-moving --agent mc {settings} --set full_steps=1000000 -q -o run --checkpoint-every");
    let mut time = 1;
    while !folder.path().join("run").exists() || checks(folder.path()) < 3 {
        let stopped = ask(folder.path(), &format!("{train} 10ms --max-time {time}s --overwrite"));
        assert_eq!(stopped.code, 130, "{}", stopped.stderr);
        time *= 2;
    }
    folder
}

/// How many lines the ledger of seed 0 has.
fn checks(folder: &Path) -> usize {
    lines(&folder.join("run/seed-0/ledger.jsonl")).len()
}

#[test]
fn no_reader_shows_an_unfinished_run_that_was_altered() {
    let folder = stopped();
    let folder = folder.path();
    let ledger = folder.join("run/seed-0/ledger.jsonl");
    let state = folder.join("run/seed-0/checkpoints/state.snapshot");
    let (whole, saved) = (fs::read_to_string(&ledger).unwrap(), fs::read(&state).unwrap());
    let read = READERS.iter().map(|(arguments, _)| *arguments);
    // The last line is being written.
    fs::write(&ledger, format!("{whole}{{\"arm\":\"mc\",\"num")).unwrap();
    ["ledger run", "compare run", "explain run#1"].iter().for_each(|arguments| drop(ok(folder, arguments)));
    // Decisions of an open leg are no result, and of a run that is not finished nothing is held to be true.
    let said = ok(folder, "compare run");
    assert!(said.contains("unfinished, open legs are not counted: seeds 0") && !said.contains("checks"), "{said}");
    let answer = ask(folder, "compare run --assert 1<2");
    assert_eq!(answer.code, 1, "{}", answer.stdout);
    assert!(answer.stderr.contains("note: 1 of 1 seed of run unfinished"), "{}", answer.stderr);

    let second = whole.match_indices("\"number\":2").next().unwrap().0 + "\"number\":".len();
    let mut altered = whole.clone();
    altered.replace_range(second..=second, "7");
    // Found by what the checkpoint counts; without it, or behind it, by the chain.
    for (text, with_state, part) in [
        (&altered, true, "was altered since the checkpoint was written"),
        (&altered, false, "was altered: its chain breaks at line 2"),
        (&format!("{whole}{}\n", whole.lines().next().unwrap()), true, "was altered: its chain breaks at line "),
        (&String::new(), true, "is cut off: 0 bytes"),
    ] {
        fs::write(&ledger, text).unwrap();
        if !with_state {
            fs::remove_file(&state).unwrap();
        }
        for arguments in read.clone().chain(["explain run#2"]) {
            check(folder, arguments, 3, &["seed-0/ledger.jsonl", part]);
        }
        fs::write(&state, &saved).unwrap();
    }
    fs::write(&ledger, &whole).unwrap();
    let metrics = folder.join("run/seed-0/metrics.jsonl");
    Damage::Replace("\"return\":", "\"return\":1").apply(&metrics);
    check(folder, "compare run", 3, &["seed-0/metrics.jsonl", "was altered since the checkpoint was written"]);
    Damage::Replace("\"return\":1", "\"return\":").apply(&metrics);
    Damage::Replace(",true,", ",false,").apply(&folder.join("run/seed-0/steps.csv"));
    check(folder, "compare run", 3, &["seed-0/steps.csv", "was altered since the checkpoint was written"]);
}

#[test]
fn an_unfinished_run_is_verified_as_strictly_as_a_finished_one() {
    let folder = stopped();
    let folder = folder.path();
    let ledger = folder.join("run/seed-0/ledger.jsonl");
    let whole = fs::read(&ledger).unwrap();
    fs::remove_file(&ledger).unwrap();
    let answer = ask(folder, "verify run");
    assert_eq!(answer.code, 4, "{}", answer.stderr);
    assert!(answer.stdout.contains("MISMATCH seed-0/ledger.jsonl: missing"), "{}", answer.stdout);
    // What cannot be read is a matter of the machine; a folder is read by nobody, not even by root.
    fs::create_dir(&ledger).unwrap();
    check(folder, "verify run", 3, &["seed-0/ledger.jsonl"]);
    fs::remove_dir(&ledger).unwrap();
    fs::write(&ledger, &whole).unwrap();
    ok(folder, "verify run");
    // What came behind the last state is cut off by going on, whatever it is.
    fs::write(&ledger, [&whole[..], b"\0\0\0\n"].concat()).unwrap();
    let answer = ask(folder, "verify run");
    assert_eq!((answer.code, answer.stdout.matches("MISMATCH").count()), (4, 1), "{}", answer.stdout);
    let answer = ask(folder, "train box-moving -o run --resume --max-time 1s");
    assert_eq!(answer.code, 130, "{}", answer.stderr);
    ok(folder, "verify run");
}

#[test]
fn a_run_under_way_is_read_at_any_moment() {
    let folder = scratch();
    let mut command = program(folder.path());
    let settings = "--set exploration=50 --set safe_steps=300 --set forecast=50 --set epsilon_decay=200";
    command.args(format!("train box-moving {settings} --seeds 0..400 -o run --checkpoint-every 5ms").split(' '));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    while !folder.path().join("run/seed-0/metrics.jsonl").exists() {
        assert!(begun.elapsed() < Duration::from_secs(60), "training does not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    let read = ["ledger run", "compare run", "export run --to tape --overwrite"];
    let answers: Vec<_> = read.iter().cycle().take(24).map(|arguments| ask(folder.path(), arguments)).collect();
    assert!(child.try_wait().unwrap().is_none(), "training ended by itself");
    child.kill().unwrap();
    child.wait().unwrap();
    for answer in answers {
        assert_eq!(answer.code, 0, "{}", answer.stderr);
    }
    // Killed, it is as far as it came.
    read.iter().for_each(|arguments| drop(ok(folder.path(), arguments)));
}

#[test]
fn a_run_without_a_manifest_is_read_only_where_nothing_was_trained() {
    let folder = finished();
    let folder = folder.path();
    fs::create_dir(folder.join("killed")).unwrap();
    fs::copy(folder.join("run/run.toml"), folder.join("killed/run.toml")).unwrap();
    let before = content(folder);
    assert_eq!(ok(folder, "ledger killed"), "");
    check(folder, "explain killed#1", 2, &["killed has not begun seed 0 yet"]);
    check(folder, "export killed --to tensorboard", 2, &["killed has not begun any seed yet"]);
    check(folder, "compare killed", 2, &["killed has not begun any seed yet"]);
    assert!(content(folder) == before);
    fs::create_dir(folder.join("killed/seed-3")).unwrap();
    check(folder, "ledger killed", 3, &["cannot read killed/manifest.json"]);
}
