//! The page in the visitor's hands: other worlds, driving, voting.

use mcvl_core::env::Discrete;
use mcvl_core::experiment::{EXPERIMENTS, Experiment, find};
use mcvl_core::play::Play;

use super::*;

/// A device of this width.
pub(super) fn width(pixels: u32) -> String {
    format!(
        r#"cdp:Emulation.setDeviceMetricsOverride {{"width": {pixels}, "height": 844, "deviceScaleFactor": 1, "mobile": false}}"#
    )
}

pub(super) fn text(id: &str) -> String {
    format!("eval:return document.getElementById('{id}').textContent")
}

/// Waits until an element's text has this in it.
pub(super) fn says(id: &str, words: &str) -> String {
    format!("until:return document.getElementById('{id}').textContent.includes({words:?})")
}

pub(super) fn focus(id: &str) -> String {
    format!("eval:document.getElementById('{id}').focus()")
}

pub(super) fn run_of(commands: &[String]) -> Vec<Value> {
    drive(&commands.iter().map(String::as_str).collect::<Vec<_>>())
}

pub(super) const REDUCE: &str =
    r#"cdp:Emulation.setEmulatedMedia {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}"#;
const DARK_AND_REDUCED: &str = r#"cdp:Emulation.setEmulatedMedia {"features": [
    {"name": "prefers-reduced-motion", "value": "reduce"}, {"name": "prefers-color-scheme", "value": "dark"}]}"#;

#[test]
fn every_world_is_trained_live_and_drawn() {
    let server = Server::start(None);
    let mut commands = Vec::new();
    // The arm is driven here, and trained natively.
    let trained: Vec<&Experiment> = EXPERIMENTS.iter().filter(|experiment| experiment.name != "reacher").collect();
    for experiment in &trained {
        commands.push(at(&server, &format!("?env={}&{LINK}&practice_reward_updates=50", experiment.name)));
        commands.push(
            "eval:const kinds = (place) => [...new Set([...document.querySelectorAll(`${place} .cell`)].map((cell) => \
             cell.className.split(' ')[1]))].filter(Boolean); const letters = [...document.querySelectorAll('.cell')] \
             .filter((cell) => /[a-z]/i.test(cell.textContent)).length; return [kinds('.legs'), letters, \
             document.getElementById('about').textContent]"
                .to_owned(),
        );
        for pixels in [390, 1440] {
            // The curves are drawn anew a little later.
            let fits = "until:return document.documentElement.scrollWidth <= innerWidth";
            commands.extend([width(pixels), fits.to_owned(), "axe:".to_owned()]);
        }
    }
    let seen = run_of(&commands);
    let pictures: [&[&str]; 4] = [
        &["agent", "box", "fake"],
        &["agent", "eye", "goal", "toll", "wall"],
        &["agent", "bucket", "tomato", "wall"],
        &["agent", "diamond", "goal", "lever", "rock", "wall"],
    ];
    for (index, (experiment, pictures)) in trained.iter().zip(pictures).enumerate() {
        let seen = &seen[8 * index..];
        let page = page(&seen[0]);
        assert!(page.status.starts_with("Done in") && page.error.is_empty(), "{page:?}");
        let checks = checks_of(page.link.trim_start_matches('?'));
        assert!(!checks.is_empty() && page.scores.len() == 3, "{}: {page:?}", experiment.name);
        assert_eq!(
            page.verdicts.iter().rev().map(|row| &*row[1]).collect::<Vec<_>>(),
            checks.iter().map(word).collect::<Vec<_>>()
        );
        let kinds: Vec<String> = serde_json::from_value(seen[1][0].clone()).unwrap();
        assert!(pictures.iter().all(|kind| kinds.iter().any(|found| found == kind)), "{kinds:?}");
        assert_eq!(seen[1][1], 0, "{}: what has a picture is not a letter", experiment.name);
        let about = seen[1][2].as_str().unwrap();
        assert!(about.contains(experiment.task) && about.contains(experiment.hack), "{about}");
        for axe in [&seen[4], &seen[7]] {
            assert_eq!(*axe, Value::Array(Vec::new()), "{}", experiment.name);
        }
    }
}

/// Chooses a world in the form, does something more there, and runs it.
fn choose(world: &str, then: &str) -> String {
    format!(
        "eval:document.getElementById('env').value = {world:?}; {then} \
         document.querySelector('#controls button').click()"
    )
}

#[test]
fn a_world_that_is_chosen_in_the_form_is_trained_at_its_own_settings() {
    let server = Server::start(None);
    // A recorded run with settings that Box Moving does not have, then a run whose settings are in the link.
    let filled = "until:return document.getElementById('set-variant')?.value === 'walls-removed'";
    let began = |world: &str| {
        format!(
            "until:return location.search.includes('env={world}') && !location.search.includes('tape') && \
             document.getElementById('command').textContent.startsWith('mcvl train {world}')"
        )
    };
    let link = "eval:return location.search".to_owned();
    let commands = [
        format!("go:{}", at(&server, "?tape=tapes/open-walls.json")),
        filled.to_owned(),
        choose("box-moving", ""),
        began("box-moving"),
        link.clone(),
        text("error"),
        at(&server, &format!("?{LINK}&agent=oracle&check=2")),
        // What is typed for the new world goes along.
        choose("absent-supervisor", "document.getElementById('set-full_steps').value = 70;"),
        began("absent-supervisor"),
        link,
    ];
    let seen = run_of(&commands);
    assert_eq!((&seen[4], &seen[5]), (&"?env=box-moving&seed=1".into(), &"".into()));
    assert_eq!(seen[9], "?seed=3&full_steps=70&env=absent-supervisor");
}

#[test]
fn a_complaint_is_seen_where_the_visitor_is_and_can_be_closed() {
    let server = Server::start(None);
    let commands = [
        width(390),
        at(&server, &format!("?{LINK}")),
        "eval:document.getElementById('settings').open = true; document.getElementById('set-threshold').value = '0,5'; \
         const run = document.querySelector('#controls button'); run.scrollIntoView({ block: 'center' }); run.click()"
            .to_owned(),
        says("error", "Nothing was changed."),
        // What lies over everything else there, far down the page.
        "eval:const { left, top, bottom } = document.getElementById('error').getBoundingClientRect(); \
         return [scrollY > innerHeight, top >= 0 && bottom <= innerHeight, document.elementFromPoint(left + 20, top + 9).id]"
            .to_owned(),
        "axe:".to_owned(),
        focus("heard"),
        "keys:Enter".to_owned(),
        "eval:return [document.getElementById('error').hidden, document.activeElement.id, \
         document.getElementById('heard').checkVisibility()]"
            .to_owned(),
    ];
    let seen = run_of(&commands);
    assert_eq!(seen[4], serde_json::json!([true, true, "error"]));
    assert_eq!(seen[5], serde_json::json!([]));
    assert_eq!(seen[8], serde_json::json!([true, "moment-title", false]));
}

#[test]
fn a_browser_that_takes_no_more_addresses_gets_the_last_one_later() {
    let server = Server::start(None);
    let refuse = "eval:const { replaceState } = history; window.refused = 0; history.replaceState = (...address) => { \
                  if (refused < 2) { refused += 1; if (refused === 1) return; \
                  throw new DOMException('too many', 'SecurityError'); } \
                  replaceState.apply(history, address); }; \
                  for (const check of [4, 2]) document.querySelector(`tr[data-check='${check}'] button`).click(); \
                  dispatchEvent(new PopStateEvent('popstate')); return refused";
    let commands = [
        at(&server, &format!("?{LINK}")),
        refuse.to_owned(),
        says("moment-name", "Check 2,"),
        "until:return location.search.includes('check=')".to_owned(),
        "eval:return location.search".to_owned(),
    ];
    let seen = run_of(&commands);
    assert_eq!(seen[1], 2, "both checks were asked for all the same");
    assert_eq!(seen[4], format!("?env=box-moving&{LINK}&check=2"));
}

#[test]
fn a_story_waits_until_somebody_looks() {
    let server = Server::start(None);
    let source = "window.away = true; Object.defineProperty(document, 'hidden', { get: () => away })";
    let away = format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", serde_json::json!({ "source": source }));
    let framed = "until:return performance.getEntriesByName('first-frame').length === 1".to_owned();
    // Longer than the story takes in a hurry.
    let waits = "eval:await new Promise((go) => setTimeout(go, 2000)); \
                 return performance.getEntriesByName('verdict').length"
        .to_owned();
    let comes = "eval:window.away = false; document.dispatchEvent(new Event('visibilitychange')); \
                 return document.getElementById('stage').textContent"
        .to_owned();
    let told = "until:return performance.getEntriesByName('verdict').length === 1".to_owned();
    let mut commands = vec![HURRY.to_owned(), away];
    for query in ["", "?env=rocks-and-diamonds"] {
        let go = format!("go:{}", at(&server, query));
        commands.extend([go, framed.clone(), waits.clone(), comes.clone(), told.clone()]);
    }
    let seen = run_of(&commands);
    for seen in seen[2..].chunks(5) {
        assert_eq!((&seen[2], &seen[3]), (&0.into(), &"How it goes on if nothing happens".into()));
    }
}

/// What a stage of the first story shows is on the screen when it is told, and nothing moves for it.
#[test]
fn every_stage_is_told_on_the_screen() {
    let server = Server::start(None);
    let ends = |ids: &[&str]| {
        format!(
            "eval:return [Math.round(document.getElementById('before').getBoundingClientRect().top), \
             {ids:?}.filter((id) => document.getElementById(id).getBoundingClientRect().bottom > innerHeight)]"
        )
    };
    let stage =
        |number: u32| format!("until:return document.getElementById('stage').textContent.startsWith('{number} of 6')");
    let mut commands = Vec::new();
    let (phone, desktop) = ([390, 844], [1280, 900]);
    for ([width, height], last) in [(phone, "stamp"), (desktop, "margin")] {
        commands.push(format!(
            r#"cdp:Emulation.setDeviceMetricsOverride {{"width": {width}, "height": {height}, "deviceScaleFactor": 1, "mobile": false}}"#
        ));
        commands.push(format!("go:{}", at(&server, "")));
        commands.extend([stage(4), ends(&["modified-board", "unmodified-board"])]);
        commands.extend([stage(5), ends(&["modified-bar", "unmodified-bar"]), stage(6), ends(&[last])]);
    }
    let seen = run_of(&commands);
    for seen in seen.chunks(8) {
        let shown = [&seen[3], &seen[5], &seen[7]];
        assert!(shown.iter().all(|shown| shown[1] == serde_json::json!([])), "below the screen: {shown:?}");
        assert!(shown.iter().all(|shown| shown[0] == seen[3][0]), "it moves: {shown:?}");
    }
}

#[test]
fn what_is_true_stands_beside_what_the_agent_sees() {
    let server = Server::start(None);
    let link = "env=tomato-watering&seed=3&safe_steps=300&full_steps=300&epsilon_decay=100&forecast=20&evaluations=2\
                &rollouts=2";
    let deluded = checks_of(link).into_iter().find(|check| check.after.truth.is_some());
    let deluded = deluded.expect("the learner steps on the bucket");
    let boards = "eval:return ['after', 'in-truth'].map((id) => document.querySelector(`#${id} .board`)) \
                  .map((board) => board.checkVisibility() && board.ariaLabel)";
    let toggle = "eval:document.getElementById('picture').click()";
    let seen = drive(&[&at(&server, &format!("?{link}&check={}", deluded.number)), boards, toggle, boards]);
    let read = |rows: &str| format!("The world, row by row: {}", rows.replace('\n', ", "));
    let (seen_rows, true_rows) = (read(&deluded.after.seen), read(deluded.after.truth.as_ref().unwrap()));
    assert_ne!(seen_rows, true_rows);
    assert_eq!(seen[1], serde_json::json!([seen_rows, true_rows]));
    assert_eq!(seen[3], serde_json::json!([true_rows, false]));
}

/// The result of a route in a world: what the page says of it.
fn outcome(env: &str, actions: &[u8]) -> (f64, f64) {
    let mut play = Play::new(&format!("env={env}").parse().unwrap(), Arm::Mc);
    for action in actions {
        play.step(Discrete(*action)).expect("the episode is not over");
    }
    (play.score().observed_return, play.score().performance)
}

/// A raw reward as the driver reads it.
pub(super) fn amount(value: f64) -> String {
    let text = format!("{value:+.2}").replace('-', "−");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "+0" || short == "−0" { "0".to_owned() } else { short.to_owned() }
}

pub(super) const TABLE: &str = "eval:return [...document.querySelectorAll('#wheel tbody tr')].map((row) => \
                     [...row.children].map((cell) => cell.textContent))";

#[test]
fn a_visitor_drives_with_the_keyboard_and_learns_the_hidden_score() {
    let server = Server::start(None);
    let mut commands = vec![at(&server, &format!("?{LINK}")), focus("drive-start"), "keys:Enter".to_owned()];
    commands.push(says("drive-status", "after 0 of 100 steps"));
    commands.push("eval:return document.activeElement.className".to_owned());
    // Down to the broken arrow, then between the two arrows that go down.
    let route = [1, 1, 0, 1, 0, 1];
    for (index, action) in route.iter().enumerate() {
        commands.push(format!("keys:{}", if *action == 1 { "ArrowDown" } else { "w" }));
        commands.push(says("drive-status", &format!("after {} of 100 steps", index + 1)));
        commands.push(text("drive-status"));
    }
    let hidden = "eval:return document.getElementById('drive').textContent.includes('worth +') || \
                  document.querySelector('#wheel table') !== null";
    // Behind the world: two buttons of the pad, then the one that stops.
    commands.extend([hidden, "axe:", "keys:Tab,Tab,Tab,Enter"].map(str::to_owned));
    commands.extend([says("drive-status", "You stopped after 6 of 100 steps"), text("drive-status")]);
    commands.extend([TABLE, "axe:", "keys:Enter"].map(str::to_owned));
    commands.push(says("drive-status", "after 0 of 100 steps"));
    let seen = run_of(&commands);

    assert_eq!(seen[4], "helm", "the arrow keys act at once");
    let (observed, performance) = outcome("box-moving", &route);
    assert!(observed > performance, "the route hacks");
    assert_eq!(seen[10], "down: +5. Observed return +5 after 2 of 100 steps.");
    let result = &seen[5 + 3 * route.len()..];
    assert_eq!((&result[0], &result[1]), (&false.into(), &Value::Array(Vec::new())), "nothing tells yet");
    let said = result[4].as_str().unwrap();
    let paid =
        format!("You were paid {}, and it was worth {}. The rest was fake.", amount(observed), amount(performance));
    assert!(said.contains(&paid), "{said}");
    let rows: Vec<[String; 3]> = serde_json::from_value(result[5].clone()).unwrap();
    assert_eq!(rows[0], ["You", &amount(observed), &amount(performance)].map(str::to_owned));
    let row =
        |name: &str| rows.iter().find(|row| row[0].starts_with(name)).unwrap_or_else(|| panic!("{name}: {rows:?}"));
    let best = find("box-moving").unwrap();
    assert_eq!(row("Intended")[1..], [amount(best.intended[0]), amount(best.intended[0])]);
    let hack = best.hacking[0].unwrap();
    assert_eq!(row("The hack")[1..], [amount(hack.0), amount(hack.1)]);
    assert!(!row("Ordinary learner")[1].is_empty() && !row("Modification-considering")[1].is_empty());
    assert_eq!(result[6], Value::Array(Vec::new()));
}

#[test]
fn a_phone_drives_with_swipes_and_buttons_while_nothing_runs() {
    let server = Server::start(None);
    let swipe = |dx: i32, dy: i32| {
        format!(
            "eval:const helm = document.querySelector('.cockpit .helm'); helm.scrollIntoView({{ block: 'center' }}); \
             const {{ left, top, width, height }} = helm.getBoundingClientRect(); \
             window.at = [left + width / 2, top + height / 2]; window.to = [at[0] + {dx}, at[1] + {dy}]; return [at, to]"
        )
    };
    let address = format!("go:{}", at(&server, "?env=absent-supervisor&variant=walls-removed&seed=4"));
    let ready = "until:return !document.getElementById('drive-start').hidden";
    let touch = r#"cdp:Emulation.setTouchEmulationEnabled {"enabled": true}"#;
    let begin = [DARK_AND_REDUCED, &width(390), touch, &address, ready].map(str::to_owned);
    let places = drive(
        &begin
            .iter()
            .map(String::as_str)
            .chain(["eval:document.getElementById('drive-start').click()"])
            .chain([
                &*says("drive-status", "after 0 of 100"),
                &*swipe(0, 90),
                "eval:return document.documentElement.scrollWidth",
            ])
            .collect::<Vec<_>>(),
    );
    assert!(places[8].as_u64().unwrap() <= 390, "{places:?}");
    let [from, to]: [[f64; 2]; 2] = serde_json::from_value(places[7].clone()).unwrap();
    let point = |kind: &str, at: Option<[f64; 2]>| {
        let points: Vec<_> = at.into_iter().map(|[x, y]| serde_json::json!({ "x": x, "y": y })).collect();
        format!("cdp:Input.dispatchTouchEvent {}", serde_json::json!({ "type": kind, "touchPoints": points }))
    };
    let mut commands = begin.to_vec();
    commands.push("eval:document.getElementById('drive-start').click()".to_owned());
    commands.extend([says("drive-status", "after 0 of 100"), swipe(0, 90)]);
    commands.extend([point("touchStart", Some(from)), point("touchMove", Some(to)), point("touchEnd", None)]);
    commands.extend([says("drive-status", "after 1 of 100"), text("drive-status")]);
    for step in 2..=3 {
        commands.push("eval:document.querySelector('.pad .down').click()".to_owned());
        if step == 2 {
            commands.push(says("drive-status", "after 2 of 100"));
        }
    }
    commands.extend([
        says("drive-status", "The episode is over after 3 of 100"),
        text("drive-status"),
        TABLE.to_owned(),
    ]);
    commands.extend(["axe:".to_owned(), text("status"), "eval:return document.getAnimations().length".to_owned()]);
    let seen = run_of(&commands);
    let first = seen[12].as_str().unwrap();
    assert!(first.starts_with("down: −1."), "a swipe down is a step down: {first}");
    let mut config: Config = "env=absent-supervisor".parse().unwrap();
    config.seed = 4;
    config.set("variant", "walls-removed").unwrap();
    let mut play = Play::new(&config, Arm::Mc);
    while play.step(Discrete(1)).is_some() {}
    let score = play.score();
    let rows: Vec<Vec<String>> = serde_json::from_value(seen[18].clone()).unwrap();
    assert_eq!(rows[0], ["You".to_owned(), amount(score.observed_return), amount(score.performance)]);
    assert_eq!(seen[19], Value::Array(Vec::new()));
    assert_eq!((&seen[20], &seen[21]), (&"Nothing starts by itself: press Run.".into(), &0.into()));
}

/// What can be seen that tells the verdict.
const TOLD_TOO_EARLY: &str = "eval:const open = [...document.querySelectorAll('#stamp, #truth, #in-truth, #margin, .rated, \
    #verdicts td:not(:first-child), .mark, #timeline-at')].filter((part) => part.textContent + part.tagName !== 'P' && \
    part.checkVisibility({ visibilityProperty: true })); return open.map((part) => part.id || part.outerHTML)";

#[test]
fn a_visitor_votes_before_the_verdict_and_is_scored() {
    let server = Server::start(None);
    let checks = checks_of(&format!("env=box-moving&{LINK}"));
    let link = at(&server, &format!("?{LINK}&check=1"));
    // What fades in has not yet its contrast.
    let asked =
        "until:return document.body.dataset.vote === 'open' && document.getAnimations().length === 0".to_owned();
    let question = says("ballot", "You decide first");
    let result = "until:return document.getElementById('ballot').textContent.includes('So far you were right') && \
                  document.getAnimations().length === 0"
        .to_owned();
    let number = "eval:return document.getElementById('moment-name').textContent".to_owned();
    let stamp = "eval:return getComputedStyle(document.getElementById('stamp')).visibility".to_owned();
    let vote = |keys: &str| format!("keys:{keys}");
    let mut commands = vec![link.clone(), focus("decide"), "keys:Enter".to_owned(), asked.clone(), question.clone()];
    commands.extend([number.clone(), TOLD_TOO_EARLY.to_owned(), "axe:".to_owned()]);
    // The question has the focus; behind it: learn, refuse, stop.
    commands.extend([vote("Tab,Tab,Enter"), result.clone(), text("ballot"), stamp.clone(), "axe:".to_owned()]);
    commands.extend([
        vote("Tab,Enter"),
        asked.clone(),
        number.clone(),
        vote("Tab,Space"),
        result.clone(),
        text("ballot"),
    ]);
    // Another visit in the same session goes on counting; with reduced motion nothing plays.
    commands.extend([REDUCE.to_owned(), width(390), format!("go:{link}&stage=6")]);
    commands.push("until:return !document.getElementById('start').hidden".to_owned());
    let start = "do:document.getElementById('start').click(); await new Promise((go) => setTimeout(go, 200))";
    commands.extend([start.to_owned(), focus("decide"), "keys:Enter".to_owned(), asked.clone()]);
    commands.extend(["axe:".to_owned(), vote("Tab,Tab,Enter"), result, text("ballot")]);
    commands.push("eval:return [document.documentElement.scrollWidth, document.getAnimations().length]".to_owned());
    commands.extend([
        vote("Tab,Tab,Enter"),
        "eval:return [document.getElementById('ballot').hidden, \
        document.body.dataset.vote ?? null, document.getElementById('stage').textContent]"
            .to_owned(),
    ]);
    let seen = run_of(&commands);

    assert_eq!([&seen[5], &seen[15]], [&name(&checks[1]), &name(&checks[2])], "the checks after the one on show");
    assert_eq!((&seen[6], &seen[7]), (&serde_json::json!([]), &serde_json::json!([])), "what tells the verdict early");
    assert_eq!((&seen[11], &seen[12]), (&"visible".into(), &serde_json::json!([])));
    let (mut you, mut agent) = (0, 0);
    for ((said, check), (refuses, votes)) in [&seen[10], &seen[18], &seen[30]]
        .iter()
        .zip([&checks[1], &checks[2], &checks[1]])
        .zip([(true, 1), (false, 2), (true, 3)])
    {
        let right = |refused: bool| {
            let word = if refused { "refuse it" } else { "learn from it" };
            format!("{word} ({})", if refused == check.hack { "right" } else { "wrong" })
        };
        let refused = check.verdict == Verdict::Refuse;
        you += u32::from(refuses == check.hack);
        agent += u32::from(refused == check.hack);
        let truth = if check.hack { "fake" } else { "honest" };
        let expected = format!(
            "You: {}. The agent: {}. In truth the reward was {truth}. So far you were right in {you} of {votes}, the agent in {agent}.",
            right(refuses),
            right(refused)
        );
        assert!(said.as_str().unwrap().starts_with(&expected), "{said}, not {expected}");
    }
    assert_eq!(seen[27], serde_json::json!([]));
    assert!(seen[31][0].as_u64().unwrap() <= 390 && seen[31][1] == 0, "{}", seen[31]);
    assert_eq!(seen[33], serde_json::json!([true, null, "6 of 6: The verdict"]));
}

/// A learner's last evaluation in a run, computed here.
pub(super) fn last_score(configuration: &str, arm: Arm) -> (f64, f64) {
    scores(configuration, arm).last().map(|&(_, observed, performance)| (observed, performance)).unwrap()
}

/// A learner's evaluations in a run, computed here: step, return, performance.
fn scores(configuration: &str, arm: Arm) -> Vec<(u32, f64, f64)> {
    let config: Config = configuration.parse().unwrap();
    let (mut run, mut all) = (Run::new(&config), Vec::new());
    let mut recorder = |event: &Event| {
        if let Event::Evaluation(point) = event
            && point.arm == arm
        {
            all.push((point.step, point.observed_return, point.performance));
        }
    };
    while run.poll(Budget(1000), &mut recorder).unwrap() != Status::Done {}
    all
}

#[test]
fn a_visitor_sets_a_trap_and_both_learners_are_judged() {
    let server = Server::start(None);
    // A world without a hack of its own.
    let run = "variant=no-hack&seed=0&full_steps=600&forecast=300&rollouts=5&evaluations=10";
    let mut commands = vec![at(&server, &format!("?{run}")), focus("trap-start"), "keys:Enter".to_owned()];
    commands.push("until:return document.activeElement.id === 'trap-cells-bait'".to_owned());
    commands.push("axe:".to_owned());
    // Ten cells of two columns; the last one is the lower end of the room.
    commands.push(format!("keys:{},Enter", ["Tab"; 5].join(",")));
    commands.push("until:return location.search.includes('trap=9')".to_owned());
    commands.push("do:await new Promise((go) => setTimeout(go, 100))".to_owned());
    commands.push(text("trap-status"));
    commands.push(
        "eval:return ['#before .board', '.leg:nth-child(3) .board', '.leg:nth-child(1) .board'].map((board) => \
         document.querySelectorAll(`${board} .trapped`).length)"
            .to_owned(),
    );
    commands.extend([width(390), "until:return document.documentElement.scrollWidth <= 390".to_owned()]);
    commands.extend([focus("trap-start"), "keys:Space".to_owned()]);
    commands.push("until:return document.activeElement.id === 'trap-cells-bait'".to_owned());
    commands.extend(["axe:".to_owned(), "keys:5,0,0,0,0,Tab,Enter".to_owned()]);
    commands.push("until:return document.getElementById('error').textContent.startsWith('trap: ')".to_owned());
    commands.push("eval:document.getElementById('trap-end').click()".to_owned());
    commands.push("until:return !location.search.includes('trap')".to_owned());
    commands.push("do:await new Promise((go) => setTimeout(go, 100))".to_owned());
    let seen = run_of(&commands);

    assert_eq!((&seen[4], &seen[15]), (&serde_json::json!([]), &serde_json::json!([])));
    let trapped = page(&seen[7]);
    assert!(trapped.link.contains("trap=9%3A5"), "{}", trapped.link);
    let configuration = format!("env=box-moving&{run}&trap=9:5");
    let checks = checks_of(&configuration);
    let first = checks.iter().find(|check| check.verdict == Verdict::Refuse).expect("the trap is refused");
    assert!(first.hack, "what the trap pays is fake");
    assert_eq!((&trapped.moment, &*trapped.stamp), (&name(first), "REFUSED"));
    let baseline = scores(&format!("{configuration}&agent=baseline"), Arm::Baseline);
    let checking = scores(&configuration, Arm::Mc);
    let parted = |score: &&(u32, f64, f64)| score.1 > score.2 + 1.0;
    let said = |learner: &str, scores: &[(u32, f64, f64)]| {
        let last = scores.last().unwrap();
        let hacked = match scores.iter().rfind(parted) {
            Some(paid) if paid == last => "hacked".to_owned(),
            Some((step, ..)) => format!("not hacked, though the bait paid it until step {step}"),
            None => "not hacked".to_owned(),
        };
        let number = |value: f64| format!("{value:.1}").replace('-', "−");
        format!("{learner}: reward {}, performance {} at the end, {hacked}.", number(last.1), number(last.2))
    };
    assert!(parted(&baseline.last().unwrap()) && !parted(&checking.last().unwrap()), "{baseline:?} {checking:?}");
    let expected = format!(
        "A trap in row 5, column 2 pays +5.\n{}\n{}",
        said("Ordinary learner", &baseline),
        said("Modification-considering learner", &checking)
    );
    assert_eq!(seen[8], expected);
    assert_eq!(seen[9], serde_json::json!([1, 1, 0]), "Safe training knows no trap");
    assert_eq!(page(&seen[20]).link, format!("?env=box-moving&{run}"));
}
