//! Interrupted and resumed is the same as straight, byte for byte, however it was interrupted.

use std::fs;
use std::io::Read as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use mcvl_core::rng::Rng;
use mcvl_tests::{mcvl, scratch};

use crate::cli::{Answer, ask, ask_all, assert_same, content, copy, finished, ok, program};

const TRAIN: &str = "train box-moving --seeds 4,7 -j 2 -o run --checkpoint-every 10ms";
const RESUME: &str = "train box-moving -o run -j 2 --checkpoint-every 10ms --resume";

fn begin(folder: &Path, arguments: &str) -> Child {
    let mut command = program(folder);
    command.args(arguments.split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().expect("mcvl starts")
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().expect("kill is there");
    assert!(sent.success());
}

/// Waits until a file exists and has some content.
fn wait_for(path: &Path) {
    let begun = Instant::now();
    while fs::metadata(path).map_or(0, |data| data.len()) == 0 {
        assert!(begun.elapsed() < Duration::from_secs(60), "{} does not appear", path.display());
        sleep(Duration::from_millis(2));
    }
}

#[test]
fn stopped_by_a_signal_and_resumed_is_the_same_as_straight() {
    let folder = scratch();
    let folder = folder.path();
    ok(folder, "train box-moving --seeds 4,7 -o straight");
    let seed = folder.join("run/seed-4");
    // In the Safe leg, in the baseline leg, in the mc leg.
    let places = ["steps.csv", "checkpoints/safe.safetensors", "ledger.jsonl"];
    for (index, (place, name)) in places.iter().zip(["-TERM", "-INT", "-TERM"]).enumerate() {
        let mut child = begin(folder, if index == 0 { TRAIN } else { RESUME });
        wait_for(&seed.join(place));
        signal(&child, name);
        assert_eq!(child.wait().unwrap().code(), Some(130), "{place}");
        assert!(ok(folder, "verify run").contains("unfinished and intact so far"));
    }
    ok(folder, RESUME);
    assert_same(&folder.join("run"), &folder.join("straight"));
    assert!(ok(folder, "verify run").contains("run is intact"));
}

#[test]
fn twenty_kills_at_any_moment_cost_no_byte() {
    const KILLS: u32 = 20;
    let folder = scratch();
    let folder = folder.path();
    ok(folder, "train box-moving --seeds 4,7 -o straight");
    let seed = std::process::id();
    let mut rng = Rng::new(seed.into());
    let mut kills = 0;
    let mut wait = Duration::from_millis(u64::from(rng.below(300)));
    let mut next = TRAIN;
    while kills < KILLS {
        let mut child = begin(folder, next);
        sleep(wait);
        if child.try_wait().unwrap().is_none() {
            child.kill().unwrap();
            kills += 1;
        }
        child.wait().unwrap();
        wait = Duration::from_millis(u64::from(rng.below(300)));
        // Whatever the moment was, what is there can be read, and is not said to differ.
        if folder.join("run/run.toml").exists() {
            ok(folder, "compare run");
        }
        if fs::read_to_string(folder.join("run/seed-4/ledger.jsonl")).is_ok_and(|text| text.contains('\n')) {
            assert!(ok(folder, "replay run/seed-4#1").starts_with("SAME"));
        }
        // Before its first file a run cannot be resumed; after its last one there is nothing to kill.
        next = match fs::read_to_string(folder.join("run/manifest.json")) {
            Ok(manifest) if manifest.contains("\"finished\"") => {
                assert_same(&folder.join("run"), &folder.join("straight"));
                fs::remove_dir_all(folder.join("run")).unwrap();
                TRAIN
            }
            _ if folder.join("run/run.toml").exists() => RESUME,
            _ => TRAIN,
        };
    }
    if next == RESUME {
        let killed = folder.join("run/manifest.json").exists();
        ok(folder, RESUME);
        let manifest = fs::read_to_string(folder.join("run/manifest.json")).unwrap();
        // Nobody counted what the killed sessions took.
        assert_eq!(manifest.contains("\"trained_ms\""), !killed, "{manifest}");
    } else {
        ok(folder, TRAIN);
    }
    // The moments of the kills differ from run to run; this number brings the waits back.
    println!("waits from seed {seed}");
    assert_same(&folder.join("run"), &folder.join("straight"));
    ok(folder, "verify run");
}

#[test]
fn killed_between_its_first_two_files_a_run_is_resumed() {
    let folder = scratch();
    let folder = folder.path();
    ok(folder, "train box-moving --seeds 4,7 -o straight");
    fs::create_dir(folder.join("run")).unwrap();
    fs::copy(folder.join("straight/run.toml"), folder.join("run/run.toml")).unwrap();
    ok(folder, RESUME);
    assert_same(&folder.join("run"), &folder.join("straight"));
    ok(folder, "verify run");
}

#[test]
fn a_time_limit_saves_and_says_how_to_go_on() {
    let folder = scratch();
    let folder = folder.path();
    let answer = ask_all(folder, &["train", "box-moving", "--seeds", "4,7", "-o", "my run", "--max-time", "300ms"]);
    assert_eq!(answer.code, 130, "{}", answer.stderr);
    let resume = "mcvl train box-moving -o 'my run' --resume";
    assert!(answer.stderr.contains(&format!("continue with: {resume}")), "{}", answer.stderr);
    // What it says is what a shell takes.
    let shell = |line: &str| -> Answer {
        let command = format!("mcvl() {{ \"$0\" \"$@\"; }}\n{line}");
        Command::new("sh").args(["-c", &command]).arg(mcvl()).current_dir(folder).output().unwrap().into()
    };
    let resumed = shell(resume);
    assert_eq!(resumed.code, 0, "{}", resumed.stderr);
    let explain =
        resumed.stdout.lines().find(|line| line.contains("mcvl explain 'my run'#")).expect("it says what is next");
    let explained = shell(explain);
    assert!(explained.code == 0 && explained.stdout.contains("REFUSED"), "{}", explained.stderr);
    ok(folder, "train box-moving --seeds 4,7 -o straight");
    assert_same(&folder.join("my run"), &folder.join("straight"));
}

#[test]
fn a_dry_run_of_what_goes_on_is_about_that_run() {
    let folder = finished();
    let folder = folder.path();
    let said = ok(folder, "train box-moving -o run --resume --dry-run");
    assert!(said.contains(r#"seeds = ["0", "3"]"#) && said.contains("forecast = { value = \"200\""), "{said}");
    for (arguments, why) in [
        ("-o run --resume --dry-run --preset release", "was begun with paper, not with release"),
        ("-o none --resume --dry-run", "there is no run in none to resume"),
    ] {
        let answer = ask(folder, &format!("train box-moving {arguments}"));
        assert_eq!((answer.code, answer.stderr.contains(why)), (2, true), "{}", answer.stderr);
    }
}

#[test]
fn a_seed_does_not_go_on_from_the_state_of_another() {
    let folder = scratch();
    let folder = folder.path();
    let mut child = begin(folder, TRAIN);
    let seeds = ["seed-4", "seed-7"].map(|seed| folder.join("run").join(seed));
    seeds.iter().for_each(|seed| wait_for(&seed.join("steps.csv")));
    signal(&child, "-TERM");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    // All of it, so that the state fits the logs beside it.
    fs::remove_dir_all(&seeds[1]).unwrap();
    copy(&seeds[0], &seeds[1]);
    let before = content(&folder.join("run"));
    let answer = ask(folder, RESUME);
    let why = "run/seed-7/checkpoints/state.snapshot: is of another run than run.toml describes";
    assert_eq!((answer.code, answer.stderr.contains(why)), (3, true), "{}", answer.stderr);
    assert!(content(&folder.join("run")) == before, "nothing was changed, seed 4 did not go on either");
}

#[test]
fn a_second_signal_aborts() {
    let folder = scratch();
    // Large networks: between two polls, and in the saving of a state, there is time for two signals.
    let arguments = "train box-moving -o run --set hidden=1000 --set exploration=32 --progress none";
    let mut command = program(folder.path());
    let mut child = command.args(arguments.split(' ')).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(&folder.path().join("run/manifest.json"));
    sleep(Duration::from_millis(300));
    // Held still, so that both signals arrive at once however busy the machine is. They are two kinds:
    // of one kind a process keeps only one waiting.
    for name in ["-STOP", "-INT", "-TERM", "-CONT"] {
        signal(&child, name);
    }
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    // The first signal alone would have saved the state and said how to go on.
    assert!(said.contains("once more to abort") && !said.contains("continue with"), "{said}");
}
