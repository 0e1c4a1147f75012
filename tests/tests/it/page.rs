//! The page in a browser: it computes what the native program computes, asks nobody else, and says what is
//! wrong with a link.

use mcvl_core::config::Config;
use mcvl_core::record::{CheckRecord, Event, Verdict};
use mcvl_core::run::{Budget, Run, Status};
use mcvl_tests::{Server, node};
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
    /// Name of the check on show; empty without one.
    moment: String,
    stamp: String,
    ratings: [String; 2],
    boards: [String; 2],
    step: String,
    play: String,
    hidden: usize,
    link: String,
    requests: Vec<String>,
    log: Vec<String>,
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

/// What stands on the page after each address or `do:SCRIPT`; no page may complain or ask anybody else.
fn pages(server: &Server, visits: &[String]) -> Vec<Page> {
    let visits: Vec<&str> = visits.iter().map(String::as_str).collect();
    let pages: Vec<Page> = serde_json::from_str(&node("page.mjs", &visits).unwrap()).unwrap();
    assert_eq!(pages.len(), visits.len());
    for page in &pages {
        assert!(!page.requests.is_empty() && page.requests.iter().all(|origin| origin == server.origin()), "{page:?}");
        assert!(page.log.is_empty(), "the browser complains: {:?}", page.log);
    }
    pages
}

/// A number as the page writes it.
fn shown(value: f64) -> String {
    format!("{value:.3}").replace('-', "−")
}

fn name(check: &CheckRecord) -> String {
    format!("Check {}, step {} of the new world", check.number, check.step)
}

#[test]
fn page_shows_the_native_verdicts_and_asks_nobody_else() {
    let server = Server::start(None);
    let pages = pages(&server, &[format!("{}/?{LINK}", server.origin())]);
    let page = &pages[0];
    assert!(page.status.starts_with("Done in"), "{page:?}");
    assert_eq!(page.module, "module with SIMD");
    assert_eq!(page.scores.len(), 3, "{:?}", page.scores);

    let checks = native_checks();
    assert_eq!(page.verdicts.len(), checks.len());
    for (row, check) in page.verdicts.iter().rev().zip(&checks) {
        let word = if check.verdict == Verdict::Refuse { "✕ refused" } else { "✓ accepted" };
        let truth = if check.hack { "fake" } else { "honest" };
        assert_eq!([&row[1], &row[2], &row[8]], [word, &check.step.to_string(), truth]);
    }
    let refused = checks.iter().filter(|check| check.verdict == Verdict::Refuse).count();
    assert!(page.tally.starts_with(&format!("{refused} refused")), "{}", page.tally);

    // Without a click: the first refusal, with both futures and the numbers that decided.
    let first = checks.iter().find(|check| check.verdict == Verdict::Refuse).expect("the run has a refusal");
    assert_eq!([&page.moment, &page.stamp], [&name(first), "REFUSED"]);
    assert_eq!(page.ratings, [shown(first.modified.utility), shown(first.unmodified.utility)]);
    assert!(page.boards.iter().all(|board| board.contains('A')), "{:?}", page.boards);
}

#[test]
fn a_row_and_a_link_open_the_same_moment() {
    let server = Server::start(None);
    let checks = native_checks();
    let accepted = checks.iter().find(|check| check.verdict == Verdict::Accept).expect("the run has an acceptance");
    let row = format!(r#"do:document.querySelector("tr[data-check='{}'] button").click()"#, accepted.number);
    let link = format!("?env=box-moving&{LINK}&check={}", accepted.number);
    let filter = r#"do:document.querySelector("[name=filter][value=refused]").click()"#;
    let frame = format!("{}/{link}&frame=7", server.origin());
    let next = r#"do:document.body.dispatchEvent(new KeyboardEvent("keydown", {key: ".", bubbles: true}))"#;
    let visits = [format!("{}/?{LINK}", server.origin()), row, filter.into(), frame, next.into()];
    let pages = pages(&server, &visits);

    assert_eq!([&pages[1].moment, &pages[1].stamp, &pages[1].link], [&name(accepted), "ACCEPTED", &link]);
    let hidden = checks.iter().filter(|check| check.verdict == Verdict::Accept).count();
    assert_eq!(
        [pages[2].link.clone(), pages[2].hidden.to_string()],
        [format!("{link}&filter=refused"), hidden.to_string()]
    );

    // The link alone opens the moment, stands still, and shows the films of the native run.
    let page = &pages[3];
    assert_eq!([&page.moment, &page.stamp, &page.play], [&name(accepted), "ACCEPTED", "Play"]);
    assert!(page.step.starts_with("step 7 of"), "{}", page.step);
    let futures = [&accepted.modified, &accepted.unmodified];
    let rows = futures.map(|future| format!("The world, row by row: {}", future.films[0].frames[7].rows().join(", ")));
    assert_eq!(page.boards, rows);

    assert_eq!(pages[4].moment, name(&checks[accepted.number as usize]), "the next check");
}

#[test]
fn a_malformed_link_is_answered() {
    let server = Server::start(None);
    let wrong = ["sed=1", "seed=-1", "check=two", "speed=3", &format!("{LINK}&check=999")];
    let pages = pages(&server, &wrong.map(|query| format!("{}/?{query}", server.origin())));
    let said = [
        "unknown setting `sed`, did you mean `seed`?",
        "seed: `-1` is not a whole number",
        "check: `two` is not a whole number from 1.",
        "speed: `3` is not `1`, `4` or `16`.",
        "check: this run has no check 999",
    ];
    for (page, said) in pages.iter().zip(said) {
        assert!(page.error.starts_with(said), "{}", page.error);
        assert!(!page.status.starts_with("Nothing"), "the page goes on: {}", page.status);
    }
}
