//! Further workers of the page, which train the two futures of a check: they change no bit, end at once, and are not
//! missed where they fail.

use std::path::Path;

use mcvl_core::token::{Token, decision_digest};
use tempfile::TempDir;

use super::*;

/// What the page is told of the processor, whatever this machine has.
fn cores(count: u32) -> String {
    let source = format!("Object.defineProperty(navigator, 'hardwareConcurrency', {{ value: {count} }})");
    format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", serde_json::json!({ "source": source }))
}

/// The page with a changed worker, in a folder of its own.
fn changed(change: impl Fn(&str) -> String) -> (TempDir, Server) {
    let folder = scratch();
    copy(&root().join("www"), folder.path());
    let worker = folder.path().join("worker.js");
    fs::write(&worker, change(&fs::read_to_string(&worker).unwrap())).unwrap();
    let server = Server::start_page(folder.path(), None);
    (folder, server)
}

fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap() {
        let (path, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if path.is_dir() {
            fs::create_dir(&to).unwrap();
            copy(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}

/// Added to the worker, tells the page of every job that comes to one, and of every slice.
const TELL: &str = r#"
const told = new BroadcastChannel("helpers");
addEventListener("message", ({ data }) => data.kind === "forecast" && told.postMessage(["job", data.index]));
loaded.then(({ Forecast }) => {
  const { poll } = Forecast.prototype;
  Forecast.prototype.poll = function (budget) {
    const future = poll.call(this, budget);
    told.postMessage([future ? "future" : "slice", Date.now()]);
    return future;
  };
});
"#;

/// Keeps what is told in `heard`.
fn listen() -> String {
    let source = "window.heard = []; new BroadcastChannel('helpers').onmessage = ({ data }) => heard.push(data)";
    format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", serde_json::json!({ "source": source }))
}

/// How many times each was told.
const COUNTS: &str = "eval:return ['job', 'slice', 'future'].map((what) => heard.filter(([it]) => it === what).length)";

/// The tokens of all checks: each has the digest of its decision.
const TOKENS: &str = "eval:const tokens = []; for (const row of document.querySelectorAll('#verdicts tr')) { \
    row.querySelector('button').click(); const number = row.dataset.check; \
    for (let i = 0; i < 100 && !document.getElementById('moment-name').textContent.startsWith(`Check ${number},`); i += 1) \
    await new Promise((go) => setTimeout(go, 50)); tokens.unshift(document.getElementById('share-token').value); } \
    return tokens";

/// The tokens of these checks of the run that the link names, computed here.
fn tokens_of(link: &str, checks: &[CheckRecord]) -> Vec<Value> {
    let config: Config = format!("env=box-moving {}", link.replace('&', " ")).parse().unwrap();
    let token = |check: &CheckRecord| {
        let digest = decision_digest(&serde_json::to_string(&check.without_films()).unwrap());
        Token { config: config.clone(), number: check.number, digest }.to_string().into()
    };
    checks.iter().map(token).collect()
}

#[test]
fn further_workers_train_the_futures_and_change_no_bit() {
    let (_folder, server) = changed(|worker| worker.to_owned() + TELL);
    let link = LINK.replace("full_steps=100", "full_steps=20&scheme=all");
    let address = at(&server, &format!("?{link}"));
    let of = |count| [cores(count), listen(), address.clone(), COUNTS.to_owned(), TOKENS.to_owned()];
    let checks = checks_of(&format!("env=box-moving {}", link.replace('&', " ")));
    let tokens = tokens_of(&link, &checks);
    let reused = checks.iter().filter(|check| check.reused).count();
    assert!(reused > 0 && reused < checks.len(), "some checks train one future, others two");
    for (count, jobs) in [(4, 2 * checks.len() - reused), (2, 0)] {
        let (log, seen) = drive_and_listen(&of(count).each_ref().map(String::as_str));
        assert!(log.is_empty(), "the browser complains: {log:?}");
        let counts: Vec<usize> = serde_json::from_value(seen[3].clone()).unwrap();
        assert_eq!((counts[0], counts[2]), (jobs, jobs), "jobs and futures with {count} cores");
        assert_eq!(seen[4], Value::Array(tokens.clone()), "with {count} cores");
        assert!(page(&seen[2]).status.starts_with("Done in"), "{:?}", seen[2]);
    }
}

#[test]
fn a_forecast_that_practises_is_trained_by_further_workers_too() {
    let (_folder, server) = changed(|worker| worker.to_owned() + TELL);
    let settings = "env=rocks-and-diamonds&seed=2&safe_steps=300&full_steps=60&epsilon_decay=100&forecast=20\
                    &practice_reward_updates=20&evaluations=2&rollouts=2&scheme=all&hidden=8";
    let link = at(&server, &format!("?{settings}"));
    let seen = drive(&[&cores(4), &listen(), &link, COUNTS]);
    let checks = checks_of(&settings.replace('&', " "));
    let futures: usize = checks.iter().map(|check| 2 - usize::from(check.reused)).sum();
    assert!(checks.len() > 2);
    assert_eq!(seen[3][0], futures);
    let verdicts = page(&seen[2]).verdicts;
    assert_eq!(verdicts.len(), checks.len());
    for (row, check) in verdicts.iter().rev().zip(&checks) {
        let utilities = [&check.modified, &check.unmodified].map(|future| shown(future.as_ref().unwrap().utility));
        assert!(utilities.iter().all(|utility| row.contains(utility)), "{row:?}: {utilities:?}");
    }
}

#[test]
fn without_its_further_workers_a_run_goes_on_by_itself() {
    let replaced = |from: &str, to: &str| {
        changed(|worker| {
            assert_eq!(worker.matches(from).count(), 1, "{from}");
            worker.replace(from, to)
        })
    };
    let added =
        |text: &str| changed(|worker| format!("{worker}\naddEventListener('message', ({{ data }}) => {text});"));
    let pages = [
        ("cannot be loaded", replaced("hire(\"worker.js\")", "hire(\"missing.js\")")),
        ("cannot be hired", replaced("files.hire(", "files.hireNobody(")),
        ("die before the job", added("{ if (data.kind === 'forecast') throw new Error('died'); }")),
        ("die during the job", added("data.kind === 'forecast' && setTimeout(() => { throw new Error('died'); }, 5)")),
        (
            "one dies at the third job",
            changed(|worker| {
                worker.to_owned()
                    + "\nlet jobs = 0; addEventListener('message', ({ data }) => \
                       { if (data.kind === 'forecast' && ++jobs === 3) throw new Error('died'); });"
            }),
        ),
        ("go without a word", added("data.kind === 'forecast' && setTimeout(() => close(), 5)")),
        (
            "send no future",
            added("data.kind === 'forecast' && postMessage({ ...data, job: null, future: new Uint8Array(40) })"),
        ),
    ];
    let tokens = Value::Array(tokens_of(LINK, &native_checks()));
    let mut commands = vec![cores(4)];
    for (_, (_folder, server)) in &pages {
        commands.extend([at(server, &format!("?{LINK}")), TOKENS.to_owned()]);
    }
    let (_, seen) = drive_and_listen(&commands.iter().map(String::as_str).collect::<Vec<_>>());
    for ((how, _), seen) in pages.iter().zip(seen[1..].chunks(2)) {
        let page = page(&seen[0]);
        assert!(page.status.starts_with("Done in") && page.error.is_empty(), "workers that {how}: {page:?}");
        assert_eq!(seen[1], tokens, "workers that {how}");
    }
}

/// Milliseconds between what is done now and the last slice of a forecast after it, once none came for a second;
/// negative where there was none.
fn latency(act: &str) -> String {
    format!(
        "eval:const now = Date.now(); {act}; let last; do {{ last = heard.length; \
         await new Promise((go) => setTimeout(go, 1000)); }} while (heard.length > last && Date.now() - now < 20000); \
         return heard.at(-1)[1] - now"
    )
}

#[test]
fn forecasts_end_at_once_when_the_visitor_goes_elsewhere() {
    // A slice takes some 20 ms; the rest is for a machine that does other work.
    const SOON: f64 = 500.0;
    let (_folder, server) = changed(|worker| worker.to_owned() + TELL);
    let long = at(&server, &format!("?{}", LINK.replace("forecast=50", "forecast=900000")));
    let busy = "until:return heard.filter(([what]) => what === 'job').length >= 2 && \
                heard.filter(([what]) => what === 'slice').length > 20";
    let go = format!("go:{long}");
    let stop = "document.getElementById('stop').click()";
    let (pause, resume) = (latency(stop), format!("eval:heard = []; {stop}"));
    let on = "until:return heard.filter(([what]) => what === 'slice').length > 5";
    let tape = fs::read_to_string(root().join("www/tape.json")).unwrap();
    let leave = drop_file("own.json", &tape);
    let leave = latency(leave.strip_prefix("eval:").unwrap());
    let other = latency(
        "document.getElementById('set-forecast').value = 50; document.querySelector('#controls button').click()",
    );
    let cores = cores(4);
    let listen = listen();
    let commands = [&cores, &listen, &go, busy, &pause, &resume, on, &leave, &go, busy, &other, "do:", TOKENS];
    let seen = drive(&commands);
    for (index, what) in [(4, "pause"), (7, "leave")] {
        let milliseconds = seen[index].as_f64().unwrap();
        println!("{what}: the last slice ended after {milliseconds} ms");
        assert!(milliseconds < SOON, "{what}: the last slice ended after {milliseconds} ms");
    }
    // The run that came instead is the one that was asked for, to the last bit.
    assert_eq!(seen[12], Value::Array(tokens_of(LINK, &native_checks())));
}
