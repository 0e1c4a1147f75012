//! The page in a browser: it computes what the native program computes, asks nobody else, and says what is
//! wrong with a link.

use std::env;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use mcvl_core::config::Config;
use mcvl_core::record::{CheckRecord, Event, Verdict};
use mcvl_core::run::{Budget, Run, Status};
use mcvl_tests::{node, root};
use serde::Deserialize;

/// A short run with checks.
const LINK: &str = "seed=3&safe_steps=300&full_steps=100&epsilon_decay=100&forecast=50&evaluations=2&rollouts=2";

/// What stands on the page.
#[derive(Debug, Deserialize)]
struct Page {
    status: String,
    error: String,
    tally: String,
    module: String,
    verdicts: Vec<Vec<String>>,
    scores: Vec<Vec<String>>,
    requests: Vec<String>,
    log: Vec<String>,
}

/// The repository's own server, on a port of its own, until it is dropped.
struct Server {
    process: Child,
    address: String,
}

impl Server {
    fn start() -> Self {
        let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["run", "--quiet", "--package", "xtask", "--", "serve", "--port", "0"]);
        let mut process = cargo.current_dir(root()).stdout(Stdio::piped()).spawn().expect("cargo can be started");
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.split_whitespace().next().expect("the server says its address").to_owned();
        Self { process, address }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nothing to stop.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The checks of the run that the link names, computed here.
fn native_checks() -> Vec<CheckRecord> {
    let config: Config = format!("env=box-moving&{LINK}").parse().unwrap();
    let (mut run, mut checks) = (Run::new(&config), Vec::new());
    let mut recorder = |event: &Event| {
        if let Event::Check(check) = event {
            checks.push((**check).clone());
        }
    };
    while run.poll(Budget(1000), &mut recorder).unwrap() != Status::Done {}
    checks
}

#[test]
fn page_shows_the_native_verdicts_and_asks_nobody_else() {
    let server = Server::start();
    let (run, malformed) = (format!("{}/?{LINK}", server.address), format!("{}/?sed=1", server.address));
    let pages: Vec<Page> = serde_json::from_str(&node("page.mjs", &[&run, &malformed]).unwrap()).unwrap();
    let [page, malformed] = pages.as_slice() else { panic!("two pages: {pages:?}") };

    assert!(page.status.starts_with("Done in"), "{page:?}");
    assert_eq!(page.module, "module with SIMD");
    assert_eq!(page.scores.len(), 3, "{:?}", page.scores);

    let checks = native_checks();
    assert!(!checks.is_empty(), "the run has to have checks");
    assert_eq!(page.verdicts.len(), checks.len());
    for (row, check) in page.verdicts.iter().rev().zip(&checks) {
        let word = if check.verdict == Verdict::Refuse { "✕ refused" } else { "✓ accepted" };
        let truth = if check.hack { "fake" } else { "honest" };
        assert_eq!([&row[0], &row[6], &row[7]], [&check.step.to_string(), word, truth]);
    }
    let refused = checks.iter().filter(|check| check.verdict == Verdict::Refuse).count();
    assert!(page.tally.starts_with(&format!("{refused} refused")), "{}", page.tally);

    assert!(page.requests.iter().all(|origin| *origin == server.address), "{:?}", page.requests);
    assert!(page.log.is_empty(), "the browser complains: {:?}", page.log);
    assert_eq!(malformed.error, "unknown setting `sed`, did you mean `seed`?");
}
