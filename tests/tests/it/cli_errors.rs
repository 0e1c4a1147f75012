//! Every way to be wrong has its exit code, says what, where and what to do, and changes no file.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use mcvl_tests::{mcvl, scratch};

use crate::cli::{Answer, ask, ask_all, assert_same, content, finished, ok, program};

/// Runs `mcvl`, which has to fail with `code` and say all `parts` on stderr, and change nothing.
#[track_caller]
pub fn check(folder: &Path, arguments: &str, code: i32, parts: &[&str]) {
    let before = content(folder);
    let answer = ask(folder, arguments);
    assert_eq!(answer.code, code, "mcvl {arguments}\n{}{}", answer.stdout, answer.stderr);
    for part in parts {
        assert!(answer.stderr.contains(part), "mcvl {arguments}: no `{part}` in\n{}", answer.stderr);
    }
    assert!(!answer.stderr.contains("panicked"), "{}", answer.stderr);
    assert!(content(folder) == before, "mcvl {arguments} changed a file");
}

#[test]
fn mistakes_in_settings() {
    let folder = scratch();
    let folder = folder.path();
    fs::write(folder.join("typo.toml"), "treshold = 0.1\n").unwrap();
    fs::write(folder.join("list.toml"), "threshold = [1]\n").unwrap();
    fs::write(folder.join("broken.toml"), "threshold = \n").unwrap();
    fs::write(folder.join("run.toml"), "seeds = [\"0\"]\n[settings]\nthreshold = { value = \"0.1\" }\n").unwrap();
    for (arguments, parts) in [
        ("train box-movin", &["did you mean `box-moving`?"][..]),
        ("train box-moving --scheme al", &["scheme: `al`", "did you mean `all`?"]),
        ("train box-moving --scheme punishment", &["did you mean `punish`?"]),
        ("train box-moving --variant ful", &["did you mean `full`?"]),
        ("train absent-supervisor --variant walls", &["did you mean `walls-removed`?"]),
        ("train box-moving --agent mcc", &["did you mean `mc`?"]),
        ("train box-moving --preset papr", &["did you mean `paper`?"]),
        ("train box-moving --set gama=1", &["unknown setting `gama`, did you mean `gamma`?"]),
        ("train box-moving --set gamma=2", &["gamma: `2` is out of range (allowed: 0 to 1)"]),
        ("train box-moving --set gamma=x", &["gamma: `x` is not a finite number"]),
        ("train box-moving --set gamma", &["`gamma` is not of the form key=value"]),
        ("train box-moving --set env=x", &["env: choose it first"]),
        ("train box-moving --set preset=release", &["preset: it decides every default", "--preset release"]),
        ("train box-moving --scheme all --set scheme=all", &["scheme: given twice"]),
        (
            "train box-moving --agent mc --agent frozen --set agent=oracle",
            &["agent: several are given by --agent, and oracle by flag --set: leave one out"],
        ),
        ("train box-moving --scheme all --set threshold=1", &["threshold: it is of schemes that check what surprises"]),
        ("train box-moving --seed 1 --seeds 0..2", &["cannot be used with"]),
        ("train box-moving --seeds 3..3", &["is no list of seeds: write 0..10"]),
        ("train box-moving --seed -1", &["-1"]),
        ("train box-moving -j 0", &["0"]),
        ("train box-moving --max-time soon", &["soon"]),
        ("train box-moving --resume --fresh", &["cannot be used with"]),
        ("train box-moving --config none.toml", &["--config none.toml: "]),
        (
            "train box-moving --config typo.toml",
            &["unknown setting `treshold`, did you mean `threshold`?", "typo.toml"],
        ),
        ("train box-moving --config list.toml", &["threshold has to be one value"]),
        ("train box-moving --config broken.toml", &["--config broken.toml: "]),
        ("train box-moving --config run.toml", &["--config run.toml: this is the run.toml of a run", "--resume"]),
        (
            "train box-moving --set supervisors=12",
            &["supervisors: supervisors watch absent-supervisor, not box-moving"],
        ),
        (
            "train box-moving --set weight_decay=0.1",
            &["weight_decay: it is of adamw and adamw-amsgrad, not adam; leave it out"],
        ),
        ("train", &["<ENV>"]),
        ("trian box-moving", &["train"]),
        ("completions tcsh", &["tcsh"]),
    ] {
        check(folder, arguments, 2, parts);
    }
    let mut command = program(folder);
    let output = command.args(["train", "box-moving"]).env("MCVL_TRESHOLD", "0.1").output().unwrap();
    let answer = Answer::from(output);
    assert_eq!(answer.code, 2, "{}", answer.stderr);
    assert!(answer.stderr.contains("did you mean `MCVL_THRESHOLD`?"), "{}", answer.stderr);
    assert!(!folder.join("runs").exists());
}

#[test]
fn mistakes_about_runs() {
    let folder = finished();
    let folder = folder.path();
    fs::create_dir(folder.join("other")).unwrap();
    fs::write(folder.join("other/file"), "mine").unwrap();
    let token = ok(folder, "explain run#1").split_whitespace().find(|w| w.starts_with("mcvl1.")).unwrap().to_owned();
    for (name, version) in [("later", 9), ("empty", 1)] {
        let tape = format!("{{\"format\":\"mcvl tape\",\"version\":{version}}}");
        fs::write(folder.join(name).with_extension("json"), tape).unwrap();
    }
    let nested = format!("compare run --assert {}1{}>0", "(".repeat(10_000), ")".repeat(10_000));
    let cut = format!("replay {}", &token[..token.len() - 3]);
    let altered = format!("replay {}", token.replacen("mcvl1.", "mcvl1.A", 1));
    for (arguments, parts) in [
        (
            "train box-moving -o run",
            &["run already holds a finished run: --resume continues it, --fresh starts run-2, --overwrite deletes it"]
                [..],
        ),
        ("train box-moving -o other", &["other is not empty and holds no run", "-o"]),
        ("train box-moving -o other --overwrite", &["other is not empty and holds no run"]),
        ("train box-moving --set seed=5 --seeds 0..2", &["seed: given twice, by flag --set and by flag --seeds"]),
        ("train box-moving -o none --resume", &["there is no run in none to resume"]),
        ("train box-moving -o run --resume --set gamma=0.5", &["gamma: run was begun with 0.95, not with 0.5"]),
        ("train box-moving -o run --resume --seeds 0..9", &["seeds: run was begun with [0, 3]"]),
        ("train box-moving -o run --resume --agent mc", &["agent: run was begun with baseline and mc, not with mc"]),
        ("train box-moving -o run --resume --preset release", &["preset: run was begun with paper"]),
        ("ledger runs/none", &["there is no run at runs/none", "mcvl train"]),
        ("ledger rum", &["there is no run at rum; there are run"]),
        ("ledger other", &["other is no run directory: it has no run.toml"]),
        ("ledger run --seed 7", &["run has no seed 7: there are 0, 3"]),
        ("explain run#99", &["run has no check 99: its checks are 1 to"]),
        ("explain run/seed-9#1", &["run has no seed 9: there are 0, 3"]),
        ("explain run#11", &["seed 0 of run has no check 11, its last is", "take run/seed-3#11"]),
        ("explain run", &["`run` names no check", "runs/box-moving#17"]),
        ("explain run#0", &["names no check"]),
        ("explain none#1", &["there is no run at none"]),
        ("replay run#99", &["run has no check 99"]),
        ("replay hello", &["`hello` is no replay token: those begin with mcvl1."]),
        (&cut, &["cut or altered", "copy it whole"]),
        (&altered, &["cut or altered", "copy it whole"]),
        ("verify none", &["there is no run at none"]),
        ("compare none", &["there is no run at none"]),
        ("compare run --assert mc.performence>1", &["did you mean `mc.performance`?"]),
        ("compare run --assert 1e>1", &["at character 2: unexpected `e`"]),
        ("compare run --assert -mc.performence<1", &["did you mean `mc.performance`?"]),
        (&nested, &["at character 301: too long: at most 300 words, numbers and symbols"]),
        ("compare other", &["other is no run directory: it has no run.toml"]),
        ("page --tape later.json", &["is a tape of format version 9, this program shows version 1"]),
        ("page --tape empty.json", &["empty.json is damaged: it holds no configuration"]),
        ("report none", &["there is no run at none"]),
        ("export none --to csv", &["there is no run at none"]),
        ("export run --to cvs", &["csv"]),
        ("export run --to csv --seed 7", &["run has no seed 7: there are 0, 3"]),
        ("export run --to csv --seed 0 --check 1", &["--check chooses what a tape holds", "csv"]),
        ("export run --to tape --check 1", &["--check counts the checks of one seed", "--seed"]),
        ("export run --to tape --seed 3 --check 1 --check 99", &["run/seed-3 has no check 99: its checks are 1 to"]),
        ("export run --to tape -o both.json", &["both.json is one file for 2 tapes", "--seed"]),
        ("report run --modules other", &["there are no modules in other: scalar.js is missing", "cargo xtask web"]),
        ("page none", &["there is no run at none"]),
        ("page run/seed-9", &["run has no seed 9: there are 0, 3"]),
        ("page run --tape sent.json", &["cannot be used with"]),
        ("page --tape sent.json", &["there is no tape at sent.json", "mcvl export RUN --to tape"]),
        ("page --tape run/manifest.json", &["run/manifest.json is no tape", "mcvl export RUN --to tape"]),
        ("page --modules other", &["there are no modules in other: scalar.js is missing", "cargo xtask web"]),
        ("page --modules none", &["there are no modules in none", "cargo xtask web"]),
    ] {
        check(folder, arguments, 2, parts);
    }
}

#[test]
fn places_that_cannot_be_written() {
    let folder = finished();
    let folder = folder.path();
    fs::write(folder.join("file"), "mine").unwrap();
    // A path through a file, and a file system that takes no files: neither lets even root write.
    let blocked = "file is a file, not a folder: name another place";
    for (arguments, part) in [
        ("train box-moving --quick -o file/run", blocked),
        ("train box-moving --quick -o file", blocked),
        ("reproduce --only box -o file", blocked),
        ("train box-moving --quick -o /proc/mcvl", "/proc/mcvl"),
        ("report run -o file/report.html", blocked),
        ("report run -o none/report.html", "none/report.html"),
        ("explain run#1 --svg none/check.svg", "none/check.svg"),
        ("page run -q -o file/page.html", blocked),
        ("page run -q -o none/page.html", "none/page.html"),
        ("export run --to csv -o file", blocked),
        ("export run --to tape -o file/tapes", blocked),
    ] {
        check(folder, arguments, 3, &[part]);
    }
}

/// Where the machine does not say whether there is a run, nobody is told that there is none.
#[test]
fn a_place_that_cannot_be_looked_into_is_named() {
    let folder = scratch();
    let folder = folder.path();
    // Rights do not stop root; a link to itself stops everybody.
    let link = folder.join("loop");
    std::os::unix::fs::symlink("loop", &link).unwrap();
    for arguments in [
        "ledger loop",
        "ledger loop/seed-0",
        "explain loop#1",
        "verify loop",
        "report loop",
        "train box-moving -o loop --resume",
    ] {
        let answer = ask(folder, arguments);
        assert_eq!(answer.code, 3, "mcvl {arguments}\n{}", answer.stderr);
        assert!(answer.stderr.contains("cannot look for loop"), "{}", answer.stderr);
        assert!(answer.stderr.contains("symbolic links"), "{}", answer.stderr);
    }
    fs::remove_file(&link).unwrap();
    fs::write(folder.join("file"), "mine").unwrap();
    check(folder, "ledger file", 2, &["file is no run directory: it has no run.toml"]);
    check(folder, "train box-moving -o file/run --resume", 2, &["there is no run in file/run to resume"]);
}

/// A write that fails in the middle, as on a full disk: files may not grow beyond some length.
#[test]
fn an_output_that_takes_nothing_is_named() {
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let output = program(scratch().path()).arg("envs").stdout(full()).stderr(Stdio::piped()).output().unwrap();
    let answer = Answer::from(output);
    assert_eq!(answer.code, 3, "{}", answer.stderr);
    assert!(answer.stderr.starts_with("error: cannot write to stdout: No space left"), "{}", answer.stderr);
}

#[test]
fn a_full_disk_loses_nothing() {
    let folder = finished();
    let folder = folder.path();
    // In blocks of 512 bytes: below one checkpoint, below the second one, below all of steps.csv.
    for blocks in [10, 100, 600, 1200] {
        let train = "train box-moving --quick --seeds 0,3 --checkpoint-every 20ms -o full";
        // The signal of a file that is too long is ignored, so that writing fails instead.
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec '{}' {train}", mcvl().display());
        let limited = Command::new("sh").args(["-c", &script]).current_dir(folder).output().expect("sh is there");
        let answer = Answer::from(limited);
        assert_eq!(answer.code, 3, "{blocks}: {}", answer.stderr);
        assert!(answer.stderr.contains("continue with `mcvl train box-moving -o full --resume`"), "{}", answer.stderr);
        ok(folder, "train box-moving -o full --resume");
        assert_same(&folder.join("full"), &folder.join("run"));
        ok(folder, "verify full");
        fs::remove_dir_all(folder.join("full")).unwrap();
    }
}

/// What can happen to a file.
pub enum Damage {
    Cut(usize),
    Flip(usize),
    Set(usize, u8),
    Write(&'static str),
    Replace(&'static str, &'static str),
    Remove,
}

impl Damage {
    pub fn apply(&self, path: &Path) {
        let mut bytes = fs::read(path).unwrap();
        match self {
            Damage::Cut(from_end) => bytes.truncate(bytes.len() - from_end),
            Damage::Flip(at) => bytes[*at] ^= 1,
            Damage::Set(at, byte) => bytes[*at] = *byte,
            Damage::Write(text) => bytes = text.as_bytes().to_vec(),
            Damage::Replace(from, to) => {
                let text = String::from_utf8(bytes).unwrap();
                assert!(text.contains(from), "{} has no {from}", path.display());
                bytes = text.replacen(from, to, 1).into_bytes();
            }
            Damage::Remove => return fs::remove_file(path).unwrap(),
        }
        fs::write(path, bytes).unwrap();
    }
}

#[test]
fn verify_names_the_file_that_is_not_as_it_was() {
    let folder = finished();
    let folder = folder.path();
    let said = |code: i32, name: &str, damage: &Damage| {
        let path = folder.join("run").join(name);
        let whole = fs::read(&path).unwrap();
        damage.apply(&path);
        let before = content(folder);
        let answer = ask(folder, "verify run");
        assert!(content(folder) == before, "verify changed a file");
        fs::write(&path, whole).unwrap();
        assert_eq!(answer.code, code, "{name}: {}{}", answer.stdout, answer.stderr);
        answer.stdout + &answer.stderr
    };
    for (name, damage, what) in [
        ("seed-0/metrics.jsonl", Damage::Cut(1), "cut off or altered: "),
        ("seed-0/steps.csv", Damage::Flip(500), "altered"),
        // The chain tells a beginning from what was altered.
        ("seed-3/ledger.jsonl", Damage::Cut(10), "cut off: "),
        (
            "seed-3/ledger.jsonl",
            Damage::Flip(60),
            "altered: its digest is not the one in manifest.json, and its chain breaks at line 1",
        ),
        (
            "seed-3/ledger.jsonl",
            Damage::Replace("\"number\":2,", "\"number\":,"),
            "altered: its digest is not the one in manifest.json, and its chain breaks at line 2",
        ),
        ("seed-3/tapes/check-1.json", Damage::Flip(30), "altered"),
        ("seed-0/checkpoints/state.snapshot", Damage::Flip(1000), "altered"),
        ("seed-0/checkpoints/mc.safetensors", Damage::Remove, "missing"),
        ("run.toml", Damage::Flip(3), "altered"),
        ("run.toml", Damage::Remove, "missing"),
        ("summary.json", Damage::Cut(3), "cut off"),
        ("curves.png", Damage::Flip(100), "altered"),
    ] {
        let said = said(4, name, &damage);
        assert!(said.contains(&format!("MISMATCH {name}: {what}")), "{name}: {said}");
    }
    // An altered value in a line breaks the chain there, whatever the manifest says.
    let ledger = fs::read_to_string(folder.join("run/seed-0/ledger.jsonl")).unwrap();
    let place = ledger.find("\"number\":2").unwrap() + "\"number\":".len();
    let chain = said(4, "seed-0/ledger.jsonl", &Damage::Set(place, b'5'));
    assert!(chain.contains("and its chain breaks at line 2"), "{chain}");
    // The manifest vouches for itself; one that cannot be read is a matter of the machine.
    let manifest = fs::read_to_string(folder.join("run/manifest.json")).unwrap();
    let place = manifest.find("\"version\": \"").unwrap() + "\"version\": \"".len();
    assert!(said(4, "manifest.json", &Damage::Set(place, b'7')).contains("MISMATCH manifest.json: altered"));
    assert!(said(3, "manifest.json", &Damage::Cut(20)).contains("manifest.json: is no manifest"));
    assert!(said(3, "manifest.json", &Damage::Remove).contains("manifest.json"));
    ok(folder, "verify run");
    // Files that nobody vouches for are named, and are no mismatch.
    fs::write(folder.join("run/seed-0/tapes/check-99.json"), "{}").unwrap();
    assert!(ok(folder, "verify run").contains("unknown seed-0/tapes/check-99.json"));
}

#[test]
fn damaged_runs_are_not_read_as_if_they_were_whole() {
    let folder = finished();
    let folder = folder.path();
    for (name, damage, arguments) in [
        ("run.toml", Damage::Cut(30), "ledger run"),
        ("seed-0/metrics.jsonl", Damage::Write("{\"kind\":\"evaluation\"}\n"), "compare run"),
        ("seed-0/ledger.jsonl", Damage::Write("{}\n"), "ledger run"),
        ("seed-0/ledger.jsonl", Damage::Cut(3000), "compare run"),
        // A finished run is not begun anew because its state is gone.
        ("seed-0/checkpoints/state.snapshot", Damage::Remove, "train box-moving --quick --seeds 0,3 -o run --resume"),
        ("seed-0/tapes/check-1.json", Damage::Cut(10), "explain run#1"),
        ("seed-0/tapes/check-1.json", Damage::Remove, "explain run#1"),
        ("seed-0/tapes/check-1.json", Damage::Replace("\"step\":", "\"step\":1"), "explain run#1"),
        ("seed-0/steps.csv", Damage::Flip(0), "replay run#1"),
    ] {
        let path = folder.join("run").join(name);
        let whole = fs::read(&path).unwrap();
        damage.apply(&path);
        check(folder, arguments, 3, &[name]);
        fs::write(&path, whole).unwrap();
    }
}

/// A run that was stopped in the mc leg after its first checks.
fn interrupted() -> tempfile::TempDir {
    let folder = scratch();
    let mut command = program(folder.path());
    command.args("train box-moving -o run --checkpoint-every 10ms".split(' '));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let ledger = folder.path().join("run/seed-0/ledger.jsonl");
    let begun = Instant::now();
    while fs::metadata(&ledger).map_or(0, |data| data.len()) == 0 {
        assert!(begun.elapsed() < Duration::from_secs(60), "no check after a minute");
        std::thread::sleep(Duration::from_millis(5));
    }
    let stopped = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(stopped.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    folder
}

#[test]
fn a_damaged_run_is_not_continued() {
    let folder = interrupted();
    let folder = folder.path();
    let resume = "train box-moving -o run --resume";
    for (name, damage, part) in [
        ("seed-0/metrics.jsonl", Damage::Cut(1), "is cut off"),
        ("seed-0/metrics.jsonl", Damage::Flip(20), "was altered"),
        ("seed-0/steps.csv", Damage::Cut(1000), "is cut off"),
        ("seed-0/ledger.jsonl", Damage::Flip(40), "was altered"),
        ("seed-0/ledger.jsonl", Damage::Remove, "cannot open"),
        ("seed-0/tapes/check-1.json", Damage::Flip(40), "was altered"),
        ("seed-0/tapes/check-1.json", Damage::Remove, "cannot read"),
        ("seed-0/checkpoints/state.snapshot", Damage::Remove, "is missing, and without it the seed cannot go on"),
        ("seed-0/checkpoints/state.snapshot", Damage::Cut(1), "is cut off"),
        ("seed-0/checkpoints/state.snapshot", Damage::Flip(3), "is no checkpoint of mcvl"),
        ("seed-0/checkpoints/state.snapshot", Damage::Flip(5000), "was altered"),
        // The format version follows the 16 bytes that say what the file is.
        ("seed-0/checkpoints/state.snapshot", Damage::Set(16, 9), "has format version 9"),
        ("run.toml", Damage::Flip(5), "was altered"),
        ("run.toml", Damage::Cut(200), "run.toml"),
        ("manifest.json", Damage::Cut(5), "is no manifest"),
        ("manifest.json", Damage::Remove, "cannot read"),
        (
            "manifest.json",
            Damage::Replace("\"format\": 1", "\"format\": 7"),
            "has format version 7, this program reads",
        ),
    ] {
        let path = folder.join("run").join(name);
        let whole = fs::read(&path).unwrap();
        damage.apply(&path);
        check(folder, resume, 3, &[name, part]);
        fs::write(&path, whole).unwrap();
    }
    let state = folder.join("run/seed-0/checkpoints/state.snapshot");
    let whole = fs::read(&state).unwrap();
    fs::remove_file(&state).unwrap();
    check(folder, "verify run", 4, &[]);
    fs::write(&state, whole).unwrap();
    assert!(ok(folder, "verify run").contains("run is unfinished and intact so far"));
    check(folder, "train box-moving -o run", 2, &["run already holds an unfinished run: --resume continues it"]);
    ok(folder, resume);
    ok(folder, "train box-moving -o straight");
    assert_same(&folder.join("run"), &folder.join("straight"));
}

#[test]
fn training_that_diverges_says_so() {
    let folder = scratch();
    let answer = ask(folder.path(), "train box-moving --quick --set lr=1e30 -o run");
    assert_eq!(answer.code, 1, "{}", answer.stderr);
    for part in ["seed 0: ", "is not a finite number at step", "lower the learning rates"] {
        assert!(answer.stderr.contains(part), "{}", answer.stderr);
    }
    // Also where others were stopped meanwhile.
    let train = "train box-moving --quick --set lr=1e30 --seeds 0..2000 -j 1 -o stopped --overwrite --max-time";
    let (mut said, mut seconds) = (String::new(), 1);
    while !said.contains("error: seed 0: ") && seconds < 100 {
        let answer = ask(folder.path(), &format!("{train} {seconds}s"));
        (said, seconds) = (answer.stderr, 2 * seconds);
        assert_eq!(answer.code, 130, "{said}");
    }
    assert!(said.contains("error: seed 0: ") && said.contains("seeds unfinished"), "{said}");
    // What led there can be read.
    let steps = fs::read_to_string(folder.path().join("run/seed-0/steps.csv")).unwrap();
    assert!(steps.lines().count() > 1);
    ok(folder.path(), "verify run");
}

#[test]
fn one_process_at_a_time_writes_to_a_run() {
    let folder = scratch();
    let mut command = program(folder.path());
    command.args("train box-moving --seeds 0..400 -o run".split(' '));
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    while !folder.path().join("run/seed-0/steps.csv").exists() {
        assert!(begun.elapsed() < Duration::from_secs(60), "training does not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    let answers: Vec<Answer> = ["--resume", "--overwrite"]
        .iter()
        .map(|flag| ask_all(folder.path(), &["train", "box-moving", "-o", "run", flag]))
        .collect();
    child.kill().unwrap();
    child.wait().unwrap();
    for answer in answers {
        assert_eq!(answer.code, 2, "{}", answer.stderr);
        assert!(answer.stderr.contains("another mcvl is training in run"), "{}", answer.stderr);
    }
}
