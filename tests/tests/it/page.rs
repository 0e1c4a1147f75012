//! The page in a browser: it computes what the native program computes, asks nobody else, and says what is
//! wrong with a link.

mod arm;
mod file;
mod further_workers;
mod plays;
mod tricks;

use std::fs;
use std::process::Command;

use mcvl_core::config::Config;
use mcvl_core::exact;
use mcvl_core::record::{Arm, CheckRecord, Event, Verdict};
use mcvl_core::run::{Budget, Run, Status};
use mcvl_tests::{Server, mcvl, node_reading, root, run, scratch};
use serde::Deserialize;
use serde_json::Value;

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
    origin: String,
    token: String,
    share: String,
    stage: String,
    requests: Vec<String>,
}

/// The checks of the run that the link names, computed here.
fn native_checks() -> Vec<CheckRecord> {
    checks_of(&format!("env=box-moving&{LINK}"))
}

/// The checks of a run, computed here.
fn checks_of(configuration: &str) -> Vec<CheckRecord> {
    let config: Config = configuration.parse().unwrap();
    let (mut run, mut checks) = (Run::new(&config), Vec::new());
    let mut recorder = |event: &Event| {
        if let Event::Check(check) = event {
            checks.push((**check).clone());
        }
    };
    while run.poll(Budget(1000), &mut recorder).unwrap() != Status::Done {}
    checks
}

/// The verdict on a check in the table.
fn word(check: &CheckRecord) -> &'static str {
    match (check.verdict, check.hack) {
        (Verdict::Refuse, true) => "✕ refused",
        (Verdict::Refuse, false) => "✕ refused, wrongly",
        (Verdict::Accept, false) => "✓ accepted",
        (Verdict::Accept, true) => "✓ accepted, wrongly",
    }
}

/// What came of every command of `page.mjs`; the browser may not complain.
fn drive(commands: &[&str]) -> Vec<Value> {
    let (log, seen) = drive_and_listen(commands);
    assert!(log.is_empty(), "the browser complains: {log:?}");
    seen
}

/// The browser's log, and what came of every command.
fn drive_and_listen(commands: &[&str]) -> (Vec<String>, Vec<Value>) {
    let mut seen: Vec<Value> =
        serde_json::from_str(&node_reading("page.mjs", &serde_json::to_string(commands).unwrap()).unwrap()).unwrap();
    let log = serde_json::from_value(seen.pop().unwrap()).unwrap();
    assert_eq!(seen.len(), commands.len());
    (log, seen)
}

/// What stands on the page after each address or `do:SCRIPT`; no page may ask anybody else.
fn pages(server: &Server, visits: &[String]) -> Vec<Page> {
    let seen = drive(&visits.iter().map(String::as_str).collect::<Vec<_>>());
    let pages: Vec<Page> = seen.into_iter().map(|page| serde_json::from_value(page).unwrap()).collect();
    for page in &pages {
        assert!(!page.requests.is_empty() && page.requests.iter().all(|origin| origin == server.origin()), "{page:?}");
    }
    pages
}

/// A number as the page writes it.
fn shown(value: f64) -> String {
    format!("{value:.3}").replace('-', "−")
}

fn stamp(check: &CheckRecord) -> &'static str {
    if check.verdict == Verdict::Refuse { "REFUSED" } else { "ACCEPTED" }
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
        let truth = if check.hack { "fake" } else { "honest" };
        assert_eq!([&row[1], &row[2], &row[8]], [word(check), &check.step.to_string(), truth]);
    }
    let refused = checks.iter().filter(|check| check.verdict == Verdict::Refuse).count();
    assert!(page.tally.starts_with(&format!("{refused} refused")), "{}", page.tally);

    // Without a click: the first refusal, with both futures and the numbers that decided.
    let first = checks.iter().find(|check| check.verdict == Verdict::Refuse).expect("the run has a refusal");
    assert_eq!([&page.moment, &page.stamp], [&name(first), "REFUSED"]);
    assert_eq!(
        page.ratings,
        [&first.modified, &first.unmodified].map(|future| shown(future.as_ref().unwrap().utility))
    );
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
    let films = futures.map(|future| &future.as_ref().unwrap().films[0]);
    let rows = films.map(|film| format!("The world, row by row: {}", film.frames[7].rows().join(", ")));
    assert_eq!(page.boards, rows);

    assert_eq!(pages[4].moment, name(&checks[accepted.number as usize]), "the next check");
}

#[test]
fn decisions_without_a_forecast_and_about_updates_are_shown() {
    let server = Server::start(None);
    let of = |scheme: &str| format!("{}/?{LINK}&scheme={scheme}&check=2", server.origin());
    let pages = pages(&server, &[of("discard"), of("each-step"), of("punish")]);
    assert_eq!([&pages[0].stamp, &pages[0].verdicts[0][5]], ["REFUSED", "–"]);
    assert!(pages[0].tally.contains(" refused, 0 accepted"), "{}", pages[0].tally);
    assert_eq!(pages[1].verdicts.len(), 100, "every update is judged");
    assert!(pages[1].tally.ends_with("; 0 of them wrong in truth."), "{}", pages[1].tally);
    for page in &pages {
        assert!(page.moment.starts_with("Check 2, step "), "{page:?}");
        assert!(page.error.is_empty() && page.status.starts_with("Done in"), "{page:?}");
    }
}

#[test]
fn a_malformed_link_is_answered() {
    let server = Server::start(None);
    let wrong = ["sed=1", "seed=-1", "check=two", "speed=3", &format!("{LINK}&check=999")];
    let pages = pages(&server, &wrong.map(|query| format!("{}/?{query}", server.origin())));
    let said = [
        "unknown setting sed, did you mean seed?",
        "seed: -1 is not a whole number",
        "check: two is not a whole number from 1.",
        "speed: 3 is not 1, 4 or 16.",
        "check: 999 is not here",
    ];
    for (page, said) in pages.iter().zip(said) {
        assert!(page.error.starts_with(said), "{}", page.error);
        assert!(page.status.starts_with("Done in"), "the page goes on: {}", page.status);
        assert!(!page.share.contains("sed=") && !page.share.contains("speed=3"), "a sound link: {}", page.share);
    }
}

/// An address of the page.
fn at(server: &Server, query: &str) -> String {
    format!("{}/{query}", server.origin())
}

/// What stands on the page.
fn page(value: &Value) -> Page {
    serde_json::from_value(value.clone()).unwrap()
}

/// Where a story has to be over and its pace is not the matter.
const HURRY: &str = "hurry:8";

/// Waits until the first refusal is on show with everything.
const TOLD: &str = "until:return document.getElementById('stage').textContent.startsWith('6 of 6')";

#[test]
fn the_first_refusal_is_told_without_a_click_and_derived_again() {
    let server = Server::start(None);
    let told = "return document.getElementById('stage').textContent";
    let hidden = "return [...document.querySelectorAll('.later')].map((part) => part.className || part.id)";
    let (address, first) = (format!("go:{}", at(&server, "")), format!("eval:{told}"));
    let framed = "until:return performance.getEntriesByName('first-frame').length === 1";
    let stamp = "eval:return getComputedStyle(document.getElementById('stamp')).visibility";
    let row = "until:return document.getElementById('origin').textContent.startsWith('Decided here')";
    let seen = drive(&[&address, framed, &first, stamp, TOLD, &format!("eval:{hidden}"), stamp, row, "do:"]);
    assert_eq!(seen[2], "How it goes on if nothing happens", "the story begins before the surprise");
    assert_eq!((&seen[3], &seen[6]), (&"hidden".into(), &"visible".into()), "the verdict comes last");
    assert_eq!(seen[5], Value::Array(Vec::new()), "all is told");
    let page = page(&seen[8]);
    assert_eq!((page.stamp.as_str(), page.moment.as_str()), ("REFUSED", "Check 2, step 7 of the new world"));
    assert!(page.origin.ends_with("It is the recorded one, to the last bit."), "{}", page.origin);
}

#[test]
fn the_recorded_refusal_is_what_this_program_records() {
    let folder = scratch();
    let place = folder.path().join("run");
    run(Command::new(mcvl()).args(["train", "box-moving", "--seed", "0", "-q", "-o"]).arg(&place)).unwrap();
    let anew = folder.path().join("anew.json");
    run(Command::new(mcvl()).args(["export", "--to", "tape", "--check", "2", "-o"]).args([&anew, &place])).unwrap();
    let anew: Value = serde_json::from_str(&fs::read_to_string(anew).unwrap()).unwrap();
    let recorded: Value = serde_json::from_str(&fs::read_to_string(root().join("www/tape.json")).unwrap()).unwrap();
    assert_eq!(recorded, anew, "write www/tape.json again: `mcvl export RUN --to tape --check 2`");
}

#[test]
fn controls_do_what_they_say() {
    let server = Server::start(None);
    let click = |id: &str| format!("do:document.getElementById('{id}').click()");
    let choose = |name: &str, value: &str| {
        format!("eval:document.querySelector('input[name={name}][value=\"{value}\"]').click()")
    };
    let visits = [
        at(&server, &format!("?{LINK}")),
        "do:document.getElementById('set-forecast').value = 20; document.querySelector('#controls button').click(); \
         await new Promise((go) => setTimeout(go, 100))"
            .to_owned(),
        choose("pace", "16"),
        choose("speed", "4"),
        click("another"),
        "do:await new Promise((go) => setTimeout(go, 100)); const line = document.getElementById('timeline'); \
         line.value = line.max; line.dispatchEvent(new Event('input')); await new Promise((go) => setTimeout(go, 300))"
            .to_owned(),
        click("oldest"),
        "eval:const play = document.getElementById('play'); const was = play.textContent; play.click(); \
         return [was, play.textContent]"
            .to_owned(),
        click("back"),
        "eval:document.getElementById('slow').click(); return document.getElementById('stage').textContent".to_owned(),
        TOLD.to_owned(),
        click("newest"),
        click("previous"),
        click("follow"),
        "until:return document.getElementById('follow').textContent === 'Keep watching'".to_owned(),
        "do:".to_owned(),
    ];
    let typo = "eval:document.getElementById('set-threshold').value = '0,5'; \
                document.querySelector('#controls button').click(); await new Promise((go) => setTimeout(go, 300)); \
                return [document.getElementById('error').textContent, document.getElementById('set-threshold').value]";
    let pause = "eval:const stop = document.getElementById('stop'); const step = () => \
                 document.querySelector('.leg p').textContent; stop.click(); \
                 await new Promise((go) => setTimeout(go, 400)); const one = step(); \
                 await new Promise((go) => setTimeout(go, 800)); const same = one === step(); stop.click(); \
                 await new Promise((go) => setTimeout(go, 800)); return [same, one !== step()]";
    let slow = format!("go:{}", at(&server, &format!("?{LINK}&pace=4")));
    let running = "until:return document.querySelector('.leg p')?.textContent.startsWith('step')";
    let mut commands: Vec<&str> = visits.iter().map(String::as_str).collect();
    commands.extend([&*visits[0], typo, &slow, running, pause]);
    let seen = drive(&commands);
    let (seen, paused) = seen.split_at(visits.len());
    assert!(page(&seen[1]).link.contains("forecast=20") && page(&seen[1]).status.starts_with("Done"), "{:?}", seen[1]);
    let link = page(&seen[4]).link;
    assert!(["pace=16", "speed=4", "seed=4", "forecast=20"].iter().all(|part| link.contains(part)), "{link}");
    assert_eq!(paused[1], serde_json::json!(["threshold: 0,5 is not a finite number. Nothing was changed.", "0,5"]));
    assert_eq!(paused[4], serde_json::json!([true, true]), "paused it stands, resumed it goes on");

    let last = page(&seen[5]);
    let newest = last.verdicts.first().unwrap()[0].trim_start_matches('#').to_owned();
    assert!(last.moment.starts_with(&format!("Check {newest},")), "the timeline's end: {last:?}");
    assert_eq!(page(&seen[6]).stamp, "REFUSED");
    assert_eq!(seen[7], serde_json::json!(["Pause", "Play"]));
    assert!(page(&seen[8]).stage.starts_with("5 of 6"), "{}", page(&seen[8]).stage);
    assert_eq!(seen[9], "1 of 6: A surprise");
    assert!(page(&seen[15]).moment.starts_with(&format!("Check {newest},")), "it goes on to the last check");
}

#[test]
fn a_token_opens_the_same_moment_here_and_in_the_terminal() {
    let server = Server::start(None);
    let link = at(&server, &format!("?{LINK}&check=2"));
    let shown = page(&drive(&[&link])[0]);
    assert!(shown.token.starts_with("mcvl1."), "{shown:?}");
    let next = "do:document.getElementById('next').click(); await new Promise((go) => setTimeout(go, 300))";
    let cut = &shown.token[..shown.token.len() - 3];
    let [whole, cut] = [&shown.token, cut].map(|token| at(&server, &format!("?token={token}")));
    let seen: Vec<Page> = drive(&[&whole, next, &cut]).iter().map(page).collect();
    let [again, beside, answered] = &seen[..] else { panic!("{seen:?}") };
    assert_eq!([&again.moment, &again.stamp, &again.token], [&shown.moment, &shown.stamp, &shown.token]);
    assert!(again.origin.ends_with("the decision that the token promises, to the last bit."), "{}", again.origin);
    assert!(again.link.contains("safe_steps=300") && again.link.contains("check=2"), "{}", again.link);
    let replayed = run(Command::new(mcvl()).args(["replay", &shown.token])).unwrap();
    assert!(replayed.contains("SAME"), "{replayed}");

    assert!(beside.moment.starts_with("Check 3,") && beside.origin.ends_with("seconds."), "{}", beside.origin);
    assert!(answered.error.starts_with("the token was cut or altered"), "{}", answered.error);
}

/// Drops a file with this text on the page.
fn drop_file(name: &str, text: &str) -> String {
    format!(
        "eval:const data = new DataTransfer(); data.items.add(new File([{}], {name:?})); \
         document.dispatchEvent(new DragEvent('drop', {{ dataTransfer: data, bubbles: true, cancelable: true }}));",
        serde_json::to_string(text).unwrap()
    )
}

/// The tape without the films of one side of its first check.
fn one_sided(tape: &str) -> String {
    let mut tape: Value = serde_json::from_str(tape).unwrap();
    tape["checks"][0]["modified"].as_object_mut().unwrap().remove("films").expect("a tape has films");
    tape.to_string()
}

#[test]
fn recorded_runs_are_served_and_dropped() {
    let folder = scratch();
    let place = folder.path().join("run");
    let settings = LINK.split('&').filter(|setting| !setting.starts_with("seed="));
    let mut train = Command::new(mcvl());
    train.args(["train", "box-moving", "--seed", "3", "-q", "-o"]).arg(&place);
    run(train.args(settings.flat_map(|setting| ["--set", setting]))).unwrap();
    let ledger = fs::read_to_string(place.join("seed-3/ledger.jsonl")).unwrap();
    let checks = native_checks();
    let said = |text: &str| format!("until:return document.getElementById('status').textContent.startsWith({text:?})");
    let complains =
        |text: &str| format!("until:return document.getElementById('error').textContent.includes({text:?})");

    let server = Server::start(Some(&place));
    let (_, tape) = server.get("/run/seed-3.json");
    let commands = [
        server.link.clone(),
        "do:document.getElementById('again').click(); await new Promise((go) => setTimeout(go, 100))".to_owned(),
        drop_file("own.json", &tape),
        said("own.json"),
        "do:".to_owned(),
        drop_file("ledger.jsonl", &ledger),
        said("ledger.jsonl"),
        "do:".to_owned(),
        drop_file("cut.json", &tape[..tape.len() - 100]),
        complains("cut.json: the file is cut off"),
        drop_file("cut.jsonl", &ledger[..ledger.len() - 9]),
        complains("is cut off: it ends in the middle of a value."),
        drop_file("later.json", &tape.replace("\"version\":1", "\"version\":9")),
        complains("later.json: the tape has version 9, this page reads version 1."),
        drop_file("other.json", "{\"a\": 1}"),
        complains("other.json: this is neither a tape nor a ledger of mcvl."),
        drop_file("picture.png", "\u{89}PNG\r\n"),
        complains("picture.png: the file is no JSON."),
        drop_file("empty.json", ""),
        complains("empty.json: the file is empty."),
        drop_file("altered.json", &tape.replace("\"frames\":[", "\"frames\":[3,")),
        complains("altered.json: "),
        drop_file("legend.json", &tape.replace("\"legend\":[[", "\"legend\":[1,[")),
        complains("legend.json: the"),
        drop_file("films.json", &one_sided(&tape)),
        complains("films.json: entry 1 of its checks is no check."),
        "eval:return document.querySelectorAll('#verdicts tr').length".to_owned(),
        drop_file("check-2.json", &fs::read_to_string(place.join("seed-3/tapes/check-2.json")).unwrap()),
        said("check-2.json"),
        "eval:return document.getElementById('error').hidden".to_owned(),
        "do:".to_owned(),
        // It has one check and names no run: nothing else to vote on, no world to drive.
        "eval:document.getElementById('decide').click(); await new Promise((go) => setTimeout(go, 300)); \
         return [document.getElementById('ballot').firstChild.textContent, \
         document.getElementById('drive-start').hidden, document.getElementById('drive-status').textContent]"
            .to_owned(),
        drop_file("own.json", &tape),
        said("own.json"),
        "eval:document.getElementById('drive-start').click()".to_owned(),
        "until:return document.getElementById('drive-status').textContent.includes('after 0 of 100 steps')".to_owned(),
    ];
    let seen = drive(&commands.iter().map(String::as_str).collect::<Vec<_>>());
    let first = checks.iter().find(|check| check.verdict == Verdict::Refuse).unwrap();
    for index in [0, 4] {
        let page = page(&seen[index]);
        assert_eq!(page.verdicts.len(), checks.len());
        assert_eq!((page.moment, page.stamp.as_str()), (name(first), "REFUSED"));
        assert_eq!((page.scores.len(), page.origin.as_str()), (3, "Recorded by the native program."));
    }
    let own = page(&seen[4]);
    assert!(own.link.starts_with("?env=box-moving&seed=3&") && own.share.contains(&own.link), "{own:?}");
    let derived = page(&seen[1]);
    assert!(derived.status.starts_with("Done in") && derived.origin.starts_with("Decided here"), "{derived:?}");
    assert_eq!(derived.verdicts, page(&seen[0]).verdicts, "what was recorded is what is derived");
    let dropped = page(&seen[7]);
    assert_eq!((dropped.verdicts.len(), dropped.moment), (checks.len(), name(first)));
    assert_eq!(seen[26], checks.len(), "what was on show before the bad files still is");
    assert_eq!(seen[29], true, "a good file takes the complaint away");
    let refused =
        ["There is no other check to vote on.", "A ledger does not name its run, so there is no world to drive."];
    assert_eq!(seen[31], serde_json::json!([refused[0], true, refused[1]]));
    let alone = page(&seen[30]);
    assert!(alone.boards.iter().all(|board| board.contains('A')), "the tape of a check has its films: {alone:?}");
    assert_eq!((alone.verdicts.len(), alone.moment, &*alone.stamp), (1, name(&checks[1]), stamp(&checks[1])));
}

/// Names of the learners whose curves are drawn, and the names in the table of scores.
const LEARNERS: &str = "eval:return [[...document.querySelectorAll('#curves polyline.return')].map((line) => \
    line.getAttribute('class').split(' ')[1]), [...document.querySelectorAll('#scores th')].map((name) => \
    name.firstChild.textContent), [...document.querySelectorAll('.leg figcaption')].map((name) => name.textContent)]";

#[test]
fn every_learner_has_its_name_and_its_curves() {
    let folder = scratch();
    let train = |name: &str, agents: &[&str]| {
        let place = folder.path().join(name);
        let mut train = Command::new(mcvl());
        train.args(["train", "box-moving", "--seed", "3", "-q", "-o"]).arg(&place);
        let settings = LINK.split('&').filter(|setting| !setting.starts_with("seed="));
        train.args(settings.flat_map(|setting| ["--set", setting]));
        run(train.args(agents.iter().flat_map(|agent| ["--agent", agent]))).unwrap();
        Server::start(Some(&place))
    };
    let drawn = "until:return document.querySelectorAll('#curves polyline').length >= 4";
    let arms: Vec<&str> = Arm::ALL.iter().map(|arm| arm.name()).collect();
    let own = "eval:return Object.entries((await import('/dom.js')).LEARNERS)";

    let all = train("all", &arms[1..]);
    let (recorded, live) = (all.link.clone(), at(&all, &format!("?{LINK}&agent=oracle")));
    let seen = drive(&[&recorded, drawn, LEARNERS, own, &live, drawn, LEARNERS]);
    let names: Vec<(String, String)> = serde_json::from_value(seen[3].clone()).unwrap();
    let (keys, names): (Vec<_>, Vec<_>) = names.into_iter().unzip();
    assert_eq!(keys, arms);
    assert_eq!(seen[2], serde_json::json!([arms, names, []]));
    assert_eq!(seen[6], serde_json::json!([arms[..4], names[..4], names[..4]]), "the link names a third learner");

    let alone = train("alone", &["frozen"]);
    let waiting = "eval:return document.getElementById('waiting').textContent";
    let seen = drive(&[&format!("go:{}", alone.link), drawn, waiting, LEARNERS]);
    let said = "This run has no modification-considering learner, so there was nothing to decide.";
    assert_eq!((&seen[2], &seen[3][0]), (&said.into(), &serde_json::json!(["safe", "frozen"])));
}

#[test]
fn an_old_verdict_is_not_spoken_in_a_new_run() {
    let server = Server::start(None);
    // Every verdict that waits to be spoken waits longer, so that one is left when the next run begins; and that
    // run never begins, so that it has no world yet.
    let slow = "const real = setTimeout; window.delayed = 0; window.setTimeout = (then, wait, ...rest) => { \
                if (then.name !== 'speak') return real(then, wait, ...rest); \
                delayed += 1; return real(then, 3000, ...rest); }";
    let slow = format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", serde_json::json!({ "source": slow }));
    let link = at(&server, &format!("?{LINK}"));
    let next = "eval:const { postMessage } = Worker.prototype; window.asked = 0; Worker.prototype.postMessage = \
                function (said) { if (said.kind === 'start') asked += 1; else postMessage.call(this, said); }; \
                document.getElementById('another').click(); return delayed";
    let spoken = "eval:await new Promise((go) => setTimeout(go, 3500)); \
                  return [asked, document.getElementById('latest').textContent]";
    let before = "eval:return document.getElementById('latest').textContent";
    let seen = drive(&[&slow, &link, before, next, spoken]);
    assert!(seen[3].as_u64().unwrap() > 0, "a verdict waited");
    assert_eq!(seen[4], serde_json::json!([1, seen[2]]));
}

#[test]
fn an_embedded_page_shows_what_it_is_asked_for() {
    let server = Server::start(None);
    // Where a part is hidden, so is the way to it.
    let visible = "eval:const ways = [...document.querySelectorAll('.plays > *')].map((way) => way.checkVisibility()); \
                   return [ways, ['header', 'run', 'decision', 'results', 'ledger', 'drive', 'trap', 'explain', 'limits', 'footer'] \
                   .filter((id) => document.getElementById(id).getBoundingClientRect().height > 1)]";
    let embedded = format!("go:{}", at(&server, "?embed=1&hide=run,ledger"));
    let told = "eval:return [...document.querySelectorAll('[data-depth]')].filter((part) => part.checkVisibility()) \
                .map((part) => part.dataset.depth)";
    let formal = format!("go:{}", at(&server, "?depth=formal&hide=run"));
    let seen = drive(&[HURRY, &embedded, TOLD, visible, &at(&server, "?hide=rin"), &formal, told]);
    assert_eq!(seen[6], serde_json::json!(["formal"]));
    assert_eq!(seen[3], serde_json::json!([[true, false], ["decision", "results"]]));
    assert!(page(&seen[4]).error.starts_with("hide: rin is not a list of header, run,"), "{:?}", seen[4]["error"]);
}

#[test]
fn the_second_visit_needs_no_network() {
    let server = Server::start(None);
    let link = at(&server, &format!("?{LINK}"));
    let kept = "until:return (await navigator.serviceWorker.getRegistration())?.active?.state === 'activated'";
    let kill = format!("kill:{}", server.id());
    // The module may be fetched again behind the page's back, so the server goes away between visits.
    let recording = at(&server, "?env=rocks-and-diamonds");
    let (log, seen) = drive_and_listen(&[&link, kept, &recording, &kill, &link, &recording]);
    let (first, second) = (page(&seen[0]), page(&seen[4]));
    assert!(second.status.starts_with("Done in"), "{second:?} {log:?}");
    assert_eq!(first.verdicts, second.verdicts);
    let (seen, again) = (page(&seen[2]), page(&seen[5]));
    assert!(again.error.is_empty() && !again.verdicts.is_empty(), "a recording that was seen: {again:?}");
    assert_eq!(seen.verdicts, again.verdicts);
}

/// A copy of the page whose build has a name.
fn copy_of_the_page(place: &std::path::Path) -> std::path::PathBuf {
    let page = place.join("page");
    for folder in ["", "pkg", "tapes"] {
        fs::create_dir_all(page.join(folder)).unwrap();
        for file in fs::read_dir(root().join("www").join(folder)).unwrap().map(Result::unwrap) {
            if file.path().is_file() {
                fs::copy(file.path(), page.join(folder).join(file.file_name())).unwrap();
            }
        }
    }
    fs::write(page.join("pkg/build.js"), "self.build = 'one';").unwrap();
    page
}

#[test]
fn the_first_recording_is_kept_and_another_build_replaces_all_files() {
    let folder = scratch();
    let copy = copy_of_the_page(folder.path());
    let server = Server::start_page(&copy, None);
    let recording = at(&server, "?env=tomato-watering");
    // It was fetched before the worker was there.
    let kept = "until:return Boolean(await caches.match('tapes/tomato-watering.json'))";
    let later = "return (await (await caches.match('drive.js'))?.text() ?? '').startsWith('// Another build.')";
    let write = |name: &str, text: &str| format!("write:{} {text}", copy.join(name).display());
    let drive_js = fs::read_to_string(copy.join("drive.js")).unwrap();
    let commands: [&str; 10] = [
        &recording,
        kept,
        "until:return (await navigator.serviceWorker.getRegistration())?.active?.state === 'activated'",
        &format!("eval:{later}"),
        &write("drive.js", &format!("// Another build.\n{drive_js}")),
        &write("pkg/build.js", "self.build = 'two';"),
        &at(&server, &format!("?{LINK}")),
        // A file that this visit did not need.
        &format!("until:{later}"),
        &format!("kill:{}", server.id()),
        &recording,
    ];
    let (_, seen) = drive_and_listen(&commands);
    assert_eq!(seen[3], false);
    let (first, again) = (page(&seen[0]), page(&seen[9]));
    assert!(again.error.is_empty() && !again.verdicts.is_empty(), "{again:?}");
    assert_eq!(first.verdicts, again.verdicts);
}

#[test]
fn a_browser_that_cannot_compute_still_tells_the_story() {
    let server = Server::start(None);
    for (lack, words) in [("WebAssembly", "no WebAssembly"), ("Worker", "no web workers")] {
        let without = format!(r#"cdp:Page.addScriptToEvaluateOnNewDocument {{"source": "delete window.{lack}"}}"#);
        let address = format!("go:{}", at(&server, ""));
        let seen = drive(&[HURRY, &without, &address, TOLD, "do:"]);
        let page = page(&seen[4]);
        assert!(page.error.contains(words) && page.error.contains("open a tape"), "{}", page.error);
        assert_eq!((page.stamp.as_str(), page.scores.len()), ("REFUSED", 3), "{page:?}");
    }
}

#[test]
fn with_reduced_motion_nothing_moves_by_itself() {
    let server = Server::start(None);
    let reduce =
        r#"cdp:Emulation.setEmulatedMedia {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}"#;
    let watch = "eval:window.changes = 0; new MutationObserver((list) => (changes += list.length)).observe(document.body, \
                 { subtree: true, childList: true, characterData: true, attributes: true })";
    let later = "until:window.began ??= performance.now(); return performance.now() - began > 2500";
    let quiet = "eval:return [changes, document.getAnimations().length]";
    let stage = "eval:return document.getElementById('stage').textContent";
    let next = "eval:document.getElementById('forward').click()";
    let framed = "until:return performance.getEntriesByName('first-frame').length === 1 && \
                  document.getElementById('module').textContent.startsWith('module') && \
                  document.querySelector('#curves polyline') && \
                  document.getElementById('status').textContent.startsWith('Nothing')";
    let address = format!("go:{}", at(&server, ""));
    let link = format!("go:{}", at(&server, &format!("?{LINK}&check=2&frame=7")));
    let start = "do:document.getElementById('start').click(); await new Promise((go) => setTimeout(go, 200))";
    let wrong = format!("go:{}", at(&server, "?sed=1"));
    let complains = "until:return document.getElementById('error').textContent.startsWith('unknown setting')";
    let done = "until:return document.getElementById('status').textContent.startsWith('Done')";
    let twice = "eval:const rows = [...document.querySelectorAll('#verdicts tr')].map((row) => row.dataset.check); \
                 return [rows.length > 3, rows.length - new Set(rows).size]";
    // The button goes, so the focus moves on.
    let begin = "eval:document.getElementById('start').click(); return document.activeElement.id";
    let mut commands = vec![reduce, &address, framed, watch, later, quiet, stage, next, stage, &link, start, &wrong];
    commands.extend([complains, &address, framed, begin, done, twice]);
    let seen = drive(&commands);
    assert_eq!(seen[15], "stop", "what has the focus after the start");
    assert_eq!(seen[17], serde_json::json!([true, 0]), "the recorded check makes room for the one derived here");
    assert_eq!(seen[5], serde_json::json!([0, 0]), "changes and animations before the visitor acts");
    assert_eq!((&seen[6], &seen[8]), (&"1 of 6: A surprise".into(), &"2 of 6: Copy the agent twice".into()));
    let opened = page(&seen[10]);
    assert!(opened.moment.starts_with("Check 2,") && opened.step.starts_with("step 7 of"), "{opened:?}");
}

#[test]
fn axe_finds_nothing_in_any_state() {
    let server = Server::start(None);
    let media = |name: &str, value: &str| {
        format!(r#"cdp:Emulation.setEmulatedMedia {{"features": [{{"name": "{name}", "value": "{value}"}}]}}"#)
    };
    let size = |width: u32| {
        format!(
            r#"cdp:Emulation.setDeviceMetricsOverride {{"width": {width}, "height": 844, "deviceScaleFactor": 1, "mobile": false}}"#
        )
    };
    let open = "eval:for (const details of document.querySelectorAll('details')) details.open = true";
    let (plain, link) = (format!("go:{}", at(&server, "")), at(&server, &format!("?{LINK}")));
    let (wrong, embedded) = (at(&server, "?sed=1"), at(&server, &format!("?{LINK}&embed=1")));
    let (dark, light, reduced) = (
        media("prefers-color-scheme", "dark"),
        media("prefers-color-scheme", "light"),
        media("prefers-reduced-motion", "reduce"),
    );
    let mut commands = vec![HURRY, &*plain, TOLD, "axe:", &*link, open, "axe:"];
    let (phone, desktop) = (size(390), size(1440));
    commands.extend([
        &*dark, open, "axe:", &*phone, "axe:", &*light, "axe:", &*wrong, "axe:", &*desktop, &*embedded, "axe:",
    ]);
    commands.extend([&*reduced, &*plain, "until:return !document.getElementById('moment').hidden", "axe:"]);
    let seen = drive(&commands);
    let mut states = 0;
    for (command, found) in commands.iter().zip(&seen).filter(|(command, _)| **command == "axe:") {
        states += 1;
        assert_eq!(*found, Value::Array(Vec::new()), "{command} {states}");
    }
    assert_eq!(states, 8);
}

#[test]
fn the_keyboard_reaches_and_moves_everything() {
    let server = Server::start(None);
    let link = at(&server, &format!("?{LINK}"));
    let wanted = "eval:const all = 'a[href], button, input, select, summary, [tabindex=\"0\"]'; \
        const free = [...document.querySelectorAll(all)].filter((part) => !part.disabled && part.checkVisibility() \
          && part.tabIndex >= 0 && (part.type !== 'radio' || part.checked) && !part.closest('tbody')); \
        window.reached = new Set(); window.unseen = []; \
        document.addEventListener('focusin', ({ target }) => { reached.add(target); \
          const { outlineStyle } = getComputedStyle(target.type === 'file' ? target.previousElementSibling : target); \
          if (outlineStyle === 'none') unseen.push(target.outerHTML); }); \
        window.free = free; document.activeElement.blur(); return free.length";
    let tabs = format!("keys:{}", vec!["Tab"; 140].join(","));
    let missed = "eval:return [free.filter((part) => !reached.has(part)).map((part) => part.outerHTML), unseen]";
    let skip = "eval:document.querySelector('.skip').focus()";
    let at_moment = "eval:return document.activeElement.id";
    let play = "eval:return document.getElementById('play').textContent";
    let stage = "eval:return document.getElementById('stage').textContent";
    let seen = drive(&[
        &link,
        wanted,
        &tabs,
        missed,
        skip,
        "keys:Enter",
        at_moment,
        "keys:Period",
        "do:",
        "keys:Comma",
        "do:",
        play,
        "keys:Space",
        play,
        "keys:Space",
        play,
        // From the heading on: back, next, slow motion.
        "keys:Tab,Enter",
        stage,
        "keys:Tab,Space",
        stage,
        "keys:Tab,Enter",
        stage,
        "eval:document.getElementById('seed').focus()",
        "keys:Backspace,5,Enter",
        "until:return location.search.includes('seed=5')",
        "do:await new Promise((go) => setTimeout(go, 100))",
    ]);
    assert!(seen[1].as_u64().unwrap() > 25, "{}", seen[1]);
    assert_eq!(seen[3], serde_json::json!([[], []]), "controls that Tab does not reach, and focus that cannot be seen");
    assert_eq!(seen[6], "moment-title");
    let (next, back) = (page(&seen[8]), page(&seen[10]));
    assert_eq!(back.moment, page(&seen[0]).moment);
    assert_ne!(next.moment, back.moment);
    assert_eq!(
        [&seen[11], &seen[13], &seen[15]],
        ["Pause", "Play", "Pause"],
        "space holds the films, and lets them go"
    );
    let stages = [&seen[17], &seen[19], &seen[21]];
    assert_eq!(stages, ["5 of 6: Rate both with what it wants today", "6 of 6: The verdict", "1 of 6: A surprise"]);
    let (first, other) = (page(&seen[0]), page(&seen[25]));
    assert!(other.status.starts_with("Done in") && other.verdicts != first.verdicts, "another seed: {other:?}");
}

#[test]
fn both_modules_compute_the_committed_digests_in_the_browser() {
    let server = Server::start(None);
    let digests = |name: &str| {
        format!(
            "eval:const module = await import('/pkg/{name}.js'); await module.default({{ module_or_path: '/pkg/{name}_bg.wasm' }}); \
             return module.digests()"
        )
    };
    let address = format!("go:{}", at(&server, "?hide=run"));
    let seen = drive(&[&address, &digests("simd"), &digests("scalar")]);
    for found in &seen[1..] {
        let found: std::collections::BTreeMap<String, String> = serde_json::from_str(found.as_str().unwrap()).unwrap();
        let committed = exact::COMMITTED.iter().map(|(stage, digest)| ((*stage).to_owned(), format!("{digest:016x}")));
        assert_eq!(found, committed.collect());
    }
}

#[test]
fn the_page_preloads_and_keeps_exactly_its_files() {
    let read = |name: &str| fs::read_to_string(root().join("www").join(name)).unwrap();
    let files =
        fs::read_dir(root().join("www")).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut files: Vec<String> = files.filter(|name| name.contains('.') && name != "sw.js").collect();
    files.sort();
    let quoted = |text: &str, before: &str| -> Vec<String> {
        text.lines().filter_map(|line| line.strip_prefix(before)?.split('"').next().map(str::to_owned)).collect()
    };
    let mut kept = quoted(&read("sw.js"), "  \"");
    kept.iter_mut().filter(|name| *name == "./").for_each(|name| *name = "index.html".to_owned());
    kept.sort();
    assert_eq!(kept, files, "files that the service worker keeps");
    let mut preloaded = quoted(&read("index.html"), "<link rel=\"modulepreload\" href=\"");
    preloaded.sort();
    // What the first frame does without comes later; `early.js` is no module.
    let later = [
        "compare.js",
        "controls.js",
        "drive.js",
        "early.js",
        "explain.js",
        "hands.js",
        "recorded.js",
        "redteam.js",
        "trap.js",
        "vote.js",
        "worker.js",
    ];
    let modules: Vec<String> =
        files.into_iter().filter(|name| name.ends_with(".js") && !later.contains(&name.as_str())).collect();
    assert_eq!(preloaded, modules, "modules that the page preloads");
}

#[test]
fn the_page_begins_with_the_words_of_its_world() {
    let page = fs::read_to_string(root().join("www/index.html")).unwrap().replace('\n', " ");
    let world = mcvl_core::experiment::find("box-moving").unwrap();
    let (task, hack) = (world.task, world.hack);
    assert!(
        page.contains(&format!("<strong>Task: </strong>{task}. <strong>The catch: </strong>{hack}.</p>")),
        "{task} {hack}"
    );
}
