//! The page as one file, opened from disk: it shows its tape, trains, and asks nobody for anything.

use std::path::{Path, PathBuf};

use mcvl_core::token::{Token, decision_digest};
use tempfile::TempDir;

use super::plays::{run_of, says, text};
use super::*;
use crate::cli::{ask, finished, json, ok};

/// A folder with the short run of the link in `run`.
fn trained() -> TempDir {
    let folder = scratch();
    let settings = LINK.split('&').filter(|setting| !setting.starts_with("seed="));
    let settings: String = settings.map(|setting| format!(" --set {setting}")).collect();
    ok(folder.path(), &format!("train box-moving --seed 3 -q -o run{settings}"));
    folder
}

/// The folder of the modules.
fn modules() -> PathBuf {
    root().join("www/pkg")
}

/// The address of a file.
fn address(folder: &Path, name: &str) -> String {
    format!("file://{}", folder.join(name).display())
}

/// Where the page got its files from, that is from whom it asked for them.
const ASKED: &str = "eval:return [...new Set(performance.getEntriesByType('resource').map(({ name }) => new URL(name).protocol))]\
                     .filter((protocol) => protocol !== 'blob:')";

/// The replay token of a check of the short run.
fn token(check: &CheckRecord) -> String {
    let config: Config = format!("env=box-moving {}", LINK.replace('&', " ")).parse().unwrap();
    let digest = decision_digest(&serde_json::to_string(&check.without_films()).unwrap());
    Token { config, number: check.number, digest }.to_string()
}

#[test]
fn one_file_shows_its_tape_and_trains_the_native_verdicts() {
    let folder = trained();
    let folder = folder.path();
    ok(folder, &format!("page run --modules {}", modules().display()));
    let checks = native_checks();
    let file = address(folder, "run/page.html");
    let told = "eval:document.getElementById('slow').click()";
    let again = "do:document.getElementById('again').click(); await new Promise((go) => setTimeout(go, 100))";
    // Both modules come out of the file whole.
    let digests = |name: &str| {
        format!(
            "eval:const module = await files.load('pkg/{name}.js'); \
             await module.default({{ module_or_path: files.get('pkg/{name}_bg.wasm') }}); return module.digests()"
        )
    };
    let mut commands = [&format!("go:{file}"), "do:", told, TOLD, "do:", again].map(str::to_owned).to_vec();
    commands.extend(checks.iter().map(|check| {
        format!("do:document.querySelector(\"tr[data-check='{}'] button\").click(); await new Promise((go) => setTimeout(go, 300))", check.number)
    }));
    let rows = commands.len() - checks.len();
    commands.extend([ASKED.to_owned(), digests("simd"), digests("scalar")]);
    commands.extend([
        "eval:document.getElementById('drive-start').click()".to_owned(),
        says("drive-status", "after 0 of 100 steps"),
    ]);
    let seen = run_of(&commands);

    let first = checks.iter().find(|check| check.verdict == Verdict::Refuse).unwrap();
    let recorded = page(&seen[4]);
    assert_eq!(
        [&*recorded.stamp, &*recorded.moment, &*recorded.origin],
        ["REFUSED", &name(first), "Recorded by the native program."]
    );
    assert_eq!((recorded.scores.len(), recorded.verdicts.len()), (3, checks.len()));
    let live = page(&seen[5]);
    assert!(live.status.starts_with("Done in") && live.error.is_empty(), "{live:?}");
    assert_eq!(live.verdicts, recorded.verdicts);
    for (check, shown) in checks.iter().zip(&seen[rows..]) {
        let shown = page(shown);
        assert_eq!([&shown.moment, &shown.token], [&name(check), &token(check)], "the digest of the decision");
        assert!(shown.origin.starts_with("Decided here"), "{}", shown.origin);
    }
    let rest = &seen[rows + checks.len()..];
    assert_eq!(rest[0], serde_json::json!([]), "asked outside the file");
    for found in &rest[1..3] {
        let found: std::collections::BTreeMap<String, String> = serde_json::from_str(found.as_str().unwrap()).unwrap();
        let committed = exact::COMMITTED.iter().map(|(stage, digest)| ((*stage).to_owned(), format!("{digest:016x}")));
        assert_eq!(found, committed.collect());
    }
}

#[test]
fn one_file_without_a_run_has_what_was_recorded_and_takes_links() {
    let folder = scratch();
    let folder = folder.path();
    assert_eq!(ok(folder, &format!("page --modules {}", modules().display())), "mcvl.html\n");
    let file = address(folder, "mcvl.html");
    let checks = native_checks();
    let derived = says("origin", "It is the recorded one, to the last bit.");
    let promised = format!("{file}?token={}", token(&checks[1]));
    let lost = format!("{file}?{LINK}&tape=run/seed-9.json");
    let shown = says("origin", "the decision that the token promises, to the last bit.");
    let sets = "eval:document.querySelector('#sets summary').click()";
    let compared = "until:return document.querySelector('#comparison tbody tr:nth-child(5)')";
    let limit = "eval:document.querySelector(\"a[href^='?tape=tapes/wrong-refusal.json']\").click()";
    let linked = says("moment-name", "Check 60,");
    let (plain, promised, lost) = (format!("go:{file}"), format!("go:{promised}"), format!("go:{lost}"));
    let first = [HURRY, &plain, TOLD, &derived, sets, compared, limit, &linked, "do:"];
    let seen = &drive(&[&first[..], &[&promised, &shown, "do:", &lost, "do:"]].concat())[1..];
    let linked = page(&seen[7]);
    assert!(linked.link.contains("tape=tapes/wrong-refusal.json") && linked.error.is_empty(), "{linked:?}");
    assert_eq!(page(&seen[10]).moment, name(&checks[1]));
    let complaint = "tape: run/seed-9.json cannot be loaded, this page is one file and does not have it.";
    assert!(page(&seen[12]).error.starts_with(complaint), "{}", page(&seen[12]).error);
}

#[test]
fn one_file_without_modules_plays_and_says_what_trains() {
    let folder = trained();
    let folder = folder.path();
    let answer = ask(folder, "page run -o small.html");
    assert_eq!((answer.code, answer.stdout.as_str()), (0, "small.html\n"), "{}", answer.stderr);
    assert!(
        answer.stderr.contains("no modules in www/pkg") && answer.stderr.contains("cargo xtask web"),
        "{}",
        answer.stderr
    );
    ok(folder, "export run --to tape --seed 3 -o sent.json");
    ok(folder, "page --tape sent.json --no-modules");
    ok(folder, "page -o bare.html --no-modules");
    let go = |file: &str| format!("go:{}", address(folder, file));
    let click = "eval:document.getElementById('again').click()";
    let verdict = "until:return performance.getEntriesByName('verdict').length > 0";
    let seen = drive(&[
        &go("small.html"),
        "do:",
        click,
        &says("error", "made without the modules"),
        &text("error"),
        &go("mcvl.html"),
        "do:",
        &go("bare.html"),
        verdict,
        &text("status"),
    ]);
    assert_eq!(page(&seen[1]).verdicts.len(), native_checks().len());
    assert!(seen[4].as_str().unwrap().contains("cargo xtask web builds the modules"), "{}", seen[4]);
    // A tape by itself makes the same page, under its own name.
    assert!(page(&seen[6]).status.starts_with("tape/sent.json: "), "{}", page(&seen[6]).status);
    // Nothing is derived here, and nothing is said to be.
    assert_eq!(seen[9], "Nothing is running.");
}

#[test]
fn a_report_plays_its_decisions_once_they_are_opened() {
    let folder = finished();
    let folder = folder.path();
    ok(folder, "report run");
    let checks = json(&ok(folder, "ledger run --json"));
    let checks = checks.as_array().unwrap();
    let refused = |check: &&Value| check["verdict"] == "refuse" && check["hack"] == true;
    let told = checks.iter().find(refused).expect("a refused hack");
    let moment = format!("Check {}, step {} of the new world", told["number"], told["step"]);
    let seed = told["seed"].as_u64().unwrap();
    let waiting =
        "eval:await new Promise((go) => setTimeout(go, 500)); return document.getElementById('waiting').textContent";
    let open = "eval:const play = document.querySelector('details.play'); play.open = true; play.scrollIntoView(); \
                return play.querySelector('iframe').title";
    let moment = says("moment-name", &moment);
    let commands = [
        &format!("go:{}", address(folder, "run/report.html")),
        "frame:.play iframe",
        waiting,
        "frame:",
        "axe:",
        open,
        "frame:.play iframe",
        &moment,
        "do:",
        "eval:return [...document.querySelectorAll('#links, #drive, #header')].map((part) => part.getBoundingClientRect().height > 1)",
        ASKED,
        "eval:document.getElementById('slow').click()",
        TOLD,
        "frame:",
        "axe:",
    ];
    let seen = drive(&commands);
    assert_eq!(seen[2], "Loading.", "what nobody opened does nothing");
    assert_eq!(seen[5], format!("run: the decisions of seed {seed}, to play"));
    let shown = page(&seen[8]);
    let own = checks.iter().filter(|check| check["seed"] == seed).count();
    assert_eq!((shown.verdicts.len(), &*shown.stamp), (own, "REFUSED"));
    assert_eq!(seen[9], serde_json::json!([false, false, false]), "a frame without an address has no links to share");
    assert_eq!([&seen[4], &seen[10], &seen[14]], [&serde_json::json!([]); 3]);

    // With the modules a visitor derives them again, in the frame.
    ok(folder, &format!("report run -o live.html --modules {}", modules().display()));
    let live = format!("go:{}", address(folder, "live.html"));
    let again = "do:document.getElementById('again').click(); await new Promise((go) => setTimeout(go, 100))";
    let seen = drive(&[&live, open, "frame:.play iframe", &moment, "do:", again]);
    let (recorded, derived) = (page(&seen[4]), page(&seen[5]));
    assert!(derived.status.starts_with("Done in") && derived.origin.starts_with("Decided here"), "{derived:?}");
    assert_eq!((derived.verdicts, derived.error.as_str()), (recorded.verdicts, ""));

    // Nobody checks, or no film was kept: nothing to play.
    ok(folder, "train box-moving --quick --agent baseline -o plain");
    for tapes in ["run/seed-0/tapes", "run/seed-3/tapes"] {
        fs::remove_dir_all(folder.join(tapes)).unwrap();
    }
    for run in ["plain", "run"] {
        ok(folder, &format!("report {run}"));
        let report = fs::read_to_string(folder.join(run).join("report.html")).unwrap();
        assert!(!report.contains("<iframe") && !report.contains("script-src"), "{run}");
        assert!(report.contains("no network and no script"), "{run}");
    }
}
