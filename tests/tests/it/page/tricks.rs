//! Watching recorded worlds, taking the check away, fooling the agent, comparing schemes, and what an explanation
//! points at.

use std::fs;
use std::path::Path;

use mcvl_core::experiment::find;
use mcvl_core::record::{Arm, Verdict};
use mcvl_tests::{Server, root};
use serde_json::{Value, json};

use super::plays::{focus, last_score, run_of, says, text, width};
use super::{HURRY, at, checks_of, drive, page};

/// Settings of a short run with checks.
const SHORT: &str = "seed=3&safe_steps=300&full_steps=100&epsilon_decay=100&forecast=50&evaluations=2&rollouts=2";
const TOLD: &str = "until:return performance.getEntriesByName('verdict').length > 0";
const DONE: &str = "until:return document.getElementById('status').textContent.startsWith('Done')";

/// The tapes that the page offers, by their place under `www`.
fn tapes() -> Vec<String> {
    let folder = root().join("www/tapes");
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.map(|name| format!("tapes/{name}")).collect();
    names.sort();
    names
}

fn read(name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(root().join("www").join(name)).unwrap()).unwrap()
}

#[test]
fn every_world_has_a_recorded_run_that_plays_at_once() {
    let server = Server::start(None);
    let links = "eval:return [...document.querySelectorAll('#recorded a')].map((way) => way.getAttribute('href'))";
    let seen = drive(&[&format!("go:{}", at(&server, "?hide=explain")), links]);
    let links: Vec<String> = serde_json::from_value(seen[1].clone()).unwrap();
    assert_eq!(links.len(), 5, "a link for every world");
    let mut commands = vec![HURRY.to_owned()];
    for link in &links[1..] {
        // From the first page, without loading another one.
        let come = "until:return document.getElementById('status').textContent.includes('are kept here')".to_owned();
        let state = "eval:return [location.search, document.getElementById('about').innerText]".to_owned();
        commands.extend([
            format!("go:{}", at(&server, "?hide=explain")),
            "until:return document.querySelector('#recorded a')".into(),
        ]);
        commands.push("eval:window.stays = true".into());
        commands.push(format!("eval:document.querySelector(\"#recorded a[href='{link}']\").click()"));
        commands.extend([come, state, TOLD.into(), "do:".into(), "eval:return stays".into(), "axe:".into()]);
        // The form is that of the tape, to be run or changed.
        commands.push(
            "until:return document.getElementById('about').innerText && document.getElementById('sample').textContent"
                .into(),
        );
        commands.push(
            "eval:return [document.getElementById('env').value, document.getElementById('about').innerText, \
             document.getElementById('sample').textContent, document.getElementById('recorded').innerText]"
                .into(),
        );
    }
    let seen = run_of(&commands);
    let each = seen[1..].chunks(commands[1..].len() / (links.len() - 1));
    for (link, seen) in links[1..].iter().zip(each) {
        let world = link.strip_prefix("?env=").unwrap();
        let tape = read(&format!("tapes/{world}.json"));
        assert_eq!(seen[5][0], json!(format!("{link}&tape=tapes%2F{world}.json")));
        // The words that the page came with are another world's.
        let task = find(world).unwrap().task;
        let (first, then) = (seen[5][1].as_str().unwrap(), seen[11][1].as_str().unwrap());
        assert!(first.is_empty() || first.contains(task), "{world}: {first}");
        assert!(then.contains(task), "{world}: {then}");
        let shown = page(&seen[7]);
        assert_eq!(shown.verdicts.len(), tape["checks"].as_array().unwrap().len());
        assert_eq!(shown.origin, "Recorded by the native program.");
        assert!(shown.stage.starts_with("6 of 6"), "the story is told to its verdict: {}", shown.stage);
        assert_eq!((&seen[8], &seen[9]), (&json!(true), &json!([])), "the page stays, and axe finds nothing");
        assert_eq!(seen[11][0], world);

        // Which run it is, and what became of others like it, stands beside the verdict; what the link does not name
        // stands beside the link.
        let settings: Vec<&str> = tape["configuration"].as_str().unwrap().split(' ').skip(1).collect();
        let (seed, settings): (Vec<_>, Vec<_>) = settings.into_iter().partition(|setting| setting.starts_with("seed="));
        let seed = seed.first().map_or("0", |seed| &seed[5..]);
        let named = if settings.is_empty() { "the paper’s setting".to_owned() } else { settings.join(", ") };
        let mut expected = format!("Recorded: seed {seed}, {named}.");
        if let Some((hacked, seeds)) = hacked(&[&[&*format!("env={world}")], &settings[..]].concat().join(" ")) {
            expected += &format!(" Of {seeds} seeds with it {hacked} are hacked in the end.");
        }
        assert_eq!(seen[11][2], expected);
        let beside = seen[11][3].as_str().unwrap();
        assert!(settings.iter().all(|setting| beside.contains(setting)), "{world}: {beside}");
        assert!(seed == "0" || beside.contains(&format!("(seed {seed}:")), "{world}: {beside}");
    }
    let (hacked, seeds) = hacked("env=rocks-and-diamonds").unwrap();
    let beside = seen.last().unwrap()[3].as_str().unwrap();
    assert!(beside.contains(&format!("seed 0 is hacked, as {hacked} of {seeds} are")), "{beside}");
}

/// The record of runs with these settings; of several, the one with most seeds.
fn record(configuration: &str) -> Option<Value> {
    let folder = root().join("results/records");
    let paths = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
    let names = paths.filter(|path| path.extension().is_some_and(|extension| extension == "json"));
    let all = names.map(|path| serde_json::from_str::<Value>(&fs::read_to_string(path).unwrap()).unwrap());
    let same = all.filter(|record| record["config"] == configuration);
    same.max_by_key(|record| record["summary"]["seeds"].as_array().map_or(0, Vec::len))
}

/// The checking learner's seeds in a record.
fn checking(record: &Value) -> &Vec<Value> {
    let arms = record["summary"]["arms"].as_array().unwrap();
    arms.iter().find(|arm| arm["arm"] == "mc").unwrap()["seeds"].as_array().unwrap()
}

/// How many of the recorded seeds with these settings are hacked, and how many there are.
fn hacked(configuration: &str) -> Option<(usize, usize)> {
    let record = record(configuration)?;
    let of = |seed: &Value, key: &str| seed[key].as_f64().unwrap();
    let parted = |seed: &&Value| of(seed, "return") > of(seed, "performance") + of(seed, "tolerance");
    let seeds = checking(&record);
    Some((seeds.iter().filter(parted).count(), seeds.len()))
}

/// What is said of wrong refusals and of costs is what was recorded.
#[test]
fn limits_say_what_was_recorded() {
    let page = fs::read_to_string(root().join("www/index.html")).unwrap().replace('\n', " ");
    let honest = record("env=box-moving variant=no-inconsistency").unwrap();
    let seeds = checking(&honest);
    let verdicts = |key: &str| seeds.iter().map(|seed| seed["verdicts"][key].as_u64().unwrap()).collect::<Vec<_>>();
    let (refusals, checks) = (verdicts("honest_refused"), verdicts("checks").iter().sum::<u64>());
    let from = |least: u64| refusals.iter().filter(|refusals| **refusals >= least).count();
    let below = seeds.iter().filter(|seed| seed["return"].as_f64().unwrap() < 275.0).count();
    let wrong = format!(
        "{} of {} seeds refuse it all the same, {} of them 23 times or more ({} wrong refusals in {},{:03} checks), and \
         {below} end below the 275 that can be had.",
        from(1),
        seeds.len(),
        from(23),
        refusals.iter().sum::<u64>(),
        checks / 1000,
        checks % 1000
    );
    assert!(page.contains(&wrong), "{wrong}");
    // Hacks that got in, with a check and without.
    for (setting, more) in
        [("rollout_steps=1", "all in one seed of ten"), ("reset_on_refusal=false", "2 of 10 seeds hacked")]
    {
        let record = record(&format!("env=box-moving {setting}")).unwrap();
        let sum = |key: &str| checking(&record).iter().map(|seed| seed["verdicts"][key].as_u64().unwrap()).sum::<u64>();
        let told = format!("accepted, {} unchecked, {more}.", sum("hacks_unchecked"));
        assert!(page.contains(&told), "{told}");
        let (before, accepted) = (page.split_once(&told).unwrap().0, sum("hacks_accepted").to_string());
        assert!(before.rsplit(' ').take(5).any(|word| word == accepted), "{setting}: {accepted}");
    }
    // Updates of a check with two forecasts.
    for (world, cost) in
        [("tape", "1,000"), ("tapes/tomato-watering", "10,000"), ("tapes/rocks-and-diamonds", "40,000")]
    {
        let made = read(&format!("{world}.json"))["checks"][0]["cost"].as_u64().unwrap();
        assert_eq!(made.to_string(), cost.replace(',', ""), "{world}");
        let told = page.split_once("as much training as ").unwrap().1.split_once(" ordinary steps").unwrap().0;
        assert!(told.split([' ']).any(|word| word.trim_end_matches(',') == cost), "{told}");
    }
}

/// The price of a tape is measured, and what comes out is what was recorded.
#[test]
fn short_tapes_are_derived_again_to_the_last_bit() {
    let server = Server::start(None);
    // The others take minutes each: `cargo xtask tapes --derive`.
    let is_short = |name: &String| {
        let tape = read(name);
        tape["world"]["actions"]["discrete"].is_array() && tape["updates"].as_u64().unwrap() < 100_000
    };
    let short: Vec<String> = tapes().into_iter().filter(is_short).collect();
    assert!(short.len() >= 5, "{short:?}");
    // They cost seconds, on a busy machine minutes, also where forecasts are all there is to measure.
    let price = "until:return /about \\d+ (s|min)/.test(document.getElementById('again').textContent)";
    let derive = |name: &String| {
        [
            format!("go:{}", at(&server, &format!("?tape={name}"))),
            price.to_owned(),
            "eval:document.getElementById('again').click()".to_owned(),
            says("status", "came out again"),
            text("status"),
        ]
    };
    let seen = run_of(&short.iter().flat_map(derive).collect::<Vec<_>>());
    for (name, seen) in short.iter().zip(seen.chunks(5)) {
        let count = read(name)["checks"].as_array().unwrap().len();
        let all = format!(" {count} of {count} recorded decisions came out again, to the last bit.");
        assert!(seen[4].as_str().unwrap().ends_with(&all), "{name}: {}", seen[4]);
    }
}

/// Where it fails is a link to a decision that is wrong in truth.
#[test]
fn every_limit_with_a_link_shows_a_wrong_decision() {
    let server = Server::start(None);
    let links = "eval:return [...document.querySelectorAll('#limits a')].map((way) => way.getAttribute('href'))";
    let seen = drive(&[&format!("go:{}", at(&server, "")), links]);
    let links: Vec<String> = serde_json::from_value(seen[1].clone()).unwrap();
    assert!(links.len() >= 6, "{links:?}");
    for link in links {
        let (name, number) = link.strip_prefix("?tape=").unwrap().split_once("&check=").unwrap();
        let tape = read(name);
        let check =
            tape["checks"].as_array().unwrap().iter().find(|check| check["number"].as_u64() == number.parse().ok());
        let check = check.unwrap_or_else(|| panic!("{name} has check {number}"));
        assert_eq!(check["hack"] == json!(true), check["verdict"] == "accept", "{link}: the decision is wrong");
    }
}

#[test]
fn the_gate_is_switched_off_and_on_again_on_the_same_seed() {
    let server = Server::start(None);
    let run = "seed=0&full_steps=600&forecast=300&rollouts=5&evaluations=10";
    let switch = |to: &str| format!("eval:document.querySelector('[name=gate][value={to}]').click()");
    let off = "until:return location.search.includes('scheme=none')".to_owned();
    let commands = [
        at(&server, &format!("?{run}")),
        switch("off"),
        off,
        DONE.to_owned(),
        text("gate-status"),
        text("waiting"),
        "eval:return document.querySelectorAll('#curves .past').length".to_owned(),
        "eval:document.querySelector('[name=gate]:checked').focus()".to_owned(),
        "keys:ArrowLeft".to_owned(),
        "until:return !location.search.includes('scheme')".to_owned(),
        DONE.to_owned(),
        text("gate-status"),
    ];
    let seen = run_of(&commands);
    let said = |state: &str, configuration: String| {
        let (observed, performance) = last_score(&configuration, Arm::Mc);
        format!("With the check {state}: reward {observed:.1}, performance {performance:.1}.").replace('-', "−")
    };
    let on = said("on", format!("env=box-moving&{run}"));
    let off = said("off", format!("env=box-moving&{run}&scheme=none"));
    assert_ne!(on.replace("on", ""), off.replace("off", ""), "it makes a difference");
    assert_eq!(
        (seen[4].as_str().unwrap(), seen[11].as_str().unwrap()),
        (&*format!("{on} {off}"), &*format!("{off} {on}"))
    );
    assert!(seen[5].as_str().unwrap().starts_with("The check is off"), "{}", seen[5]);
    assert_eq!(seen[6], 1, "the run before stays in the picture");
}

/// Another scheme, and what only it reads, come back with the check; where there is no such run, the switch goes back.
#[test]
fn the_check_comes_back_as_it_was() {
    let server = Server::start(None);
    let switch = |to: &str| format!("eval:document.querySelector('[name=gate][value={to}]').click()");
    let link = "eval:return [location.search, document.getElementById('error').textContent]".to_owned();
    let refuse = "eval:const { postMessage } = Worker.prototype; Worker.prototype.postMessage = function (said) { \
                  postMessage.call(this, said.kind === 'judge' ? { ...said, configuration: 'env=nowhere' } : said); }; \
                  document.querySelector('[name=gate][value=off]').click()"
        .to_owned();
    let commands = [
        at(&server, &format!("?{SHORT}&scheme=punish&punishment=-3")),
        switch("off"),
        "until:return location.search.includes('scheme=none')".to_owned(),
        DONE.to_owned(),
        link.clone(),
        switch("on"),
        "until:return !location.search.includes('scheme=none')".to_owned(),
        DONE.to_owned(),
        link,
        refuse,
        says("error", "Nothing was changed."),
        "until:return document.querySelector('[name=gate]:checked').value === 'on'".to_owned(),
    ];
    let seen = run_of(&commands);
    assert_eq!(seen[4], json!([format!("?env=box-moving&{SHORT}&scheme=none"), ""]));
    assert_eq!(seen[8], json!([format!("?env=box-moving&{SHORT}&scheme=punish&punishment=-3"), ""]));
}

/// An attempt by keyboard at the width of a phone; what is found is a link to the decision.
#[test]
fn the_red_team_fools_it_and_gets_a_link() {
    let server = Server::start(None);
    let run = "seed=1&full_steps=600&rollouts=5&evaluations=10";
    let set =
        "eval:const knob = document.querySelector('#red-team-desk [name=forecast]'); knob.value = '30'".to_owned();
    let mut commands = vec![width(390), at(&server, &format!("?{run}")), focus("red-team-start"), "keys:Enter".into()];
    commands.push("until:return document.activeElement.id === 'red-team-cells-bait'".into());
    commands.extend(["axe:".into(), set, format!("keys:{},Enter", ["Tab"; 5].join(","))]);
    commands.push("until:return location.search.includes('trap=9')".into());
    commands.extend([says("red-team-status", "Found: it accepted"), DONE.into(), text("red-team-status")]);
    commands.push("eval:return document.querySelector('#red-team-desk li').textContent".into());
    commands.push("eval:return document.querySelector('#red-team-desk li a').getAttribute('href')".into());
    commands.push("eval:return document.documentElement.scrollWidth".into());
    commands.push("eval:document.querySelector('#red-team-desk li a').click()".into());
    commands.push("do:await new Promise((go) => setTimeout(go, 200))".into());
    let seen = run_of(&commands);
    assert_eq!(seen[5], json!([]), "axe");
    let link = seen[13].as_str().unwrap();
    let settings = link.strip_prefix('?').unwrap().rsplit_once("&check=").unwrap();
    let number: u32 = settings.1.parse().unwrap();
    let checks = checks_of(&settings.0.replace("%3A", ":"));
    let found = &checks[number as usize - 1];
    assert!(found.hack && found.verdict == Verdict::Accept, "an accepted hack");
    let missed = checks.iter().filter(|check| check.hack && check.verdict == Verdict::Accept).count();
    let said = seen[12].as_str().unwrap();
    assert!(said.contains(&format!("fooled, {} checks, {missed} fake rewards accepted", checks.len())), "{said}");
    assert!(seen[14].as_u64().unwrap() <= 390, "{}", seen[14]);
    let opened = page(&seen[16]);
    assert!(opened.moment.starts_with(&format!("Check {number},")) && opened.stamp == "ACCEPTED", "{opened:?}");
}

/// A threshold above every bait: nothing is checked, and it learns as the ordinary learner does.
#[test]
fn the_red_team_wins_where_nothing_is_checked() {
    let server = Server::start(None);
    let commands = [
        at(&server, "?seed=1&rollouts=5&evaluations=10"),
        focus("red-team-start"),
        "keys:Enter".to_owned(),
        "until:return document.activeElement.id === 'red-team-cells-bait'".to_owned(),
        "eval:document.querySelector('#red-team-desk [name=threshold]').value = '1.5'".to_owned(),
        // Not on the world's own fake reward, which would make it more than the threshold.
        format!("keys:{},Enter", ["Tab"; 3].join(",")),
        "until:return location.search.includes('trap=5')".to_owned(),
        DONE.to_owned(),
        text("red-team-status"),
        "eval:return document.querySelector('#red-team-desk li').textContent".to_owned(),
    ];
    let seen = run_of(&commands);
    assert_eq!(seen[8], "Found: it saw nothing to check, and takes the bait in the end.");
    let said = seen[9].as_str().unwrap();
    assert!(said.contains(": fooled, 0 checks, 0 fake rewards accepted; reward "), "{said}");
}

#[test]
fn recorded_sets_are_compared_and_drawn_behind_the_curves() {
    let server = Server::start(None);
    let commands = [
        at(&server, &format!("?{SHORT}")),
        "eval:document.querySelector('#sets summary').click()".to_owned(),
        "until:return document.querySelector('#comparison tbody tr:nth-child(5)')".to_owned(),
        "eval:return [...document.querySelectorAll('#comparison tbody tr')].map((row) => row.innerText.trim().split('\\t'))".to_owned(),
        "eval:return document.querySelectorAll('#curves .band').length".to_owned(),
        "eval:document.querySelector('#comparison tbody tr:nth-child(5) input').click()".to_owned(),
        "until:return document.querySelectorAll('#curves .band').length === 2".to_owned(),
        "axe:".to_owned(),
    ];
    let seen = run_of(&commands);
    let rows: Vec<Vec<String>> = serde_json::from_value(seen[3].clone()).unwrap();
    let bands = read("bands.json");
    let entries = bands["box-moving"].as_array().unwrap();
    assert_eq!((rows.len(), &seen[4]), (entries.len() + 1, &json!(0)));
    for (row, entry) in rows[1..].iter().zip(entries) {
        assert_eq!(row[0].trim(), entry["title"].as_str().unwrap());
        assert_eq!(row[3], format!("{} of {}", entry["hacked"], entry["seeds"]));
    }
    assert_eq!(seen[7], json!([]), "axe");
}

/// Pointed at, chosen with the keyboard or read with formulas: what is spoken of lights up.
#[test]
fn an_explanation_lights_up_what_it_speaks_of() {
    let server = Server::start(None);
    let ways = "eval:const lost = [...document.querySelectorAll('[data-light]')].filter(({ dataset }) => \
                !document.querySelector(dataset.light)); return [document.querySelectorAll('[data-light]').length, \
                lost.map((way) => way.dataset.light)]";
    let commands = [
        at(&server, &format!("?{SHORT}&depth=formal")),
        ways.to_owned(),
        "eval:document.querySelector('[data-light=\"#got\"]').focus()".to_owned(),
        "eval:return [...document.querySelectorAll('.lit')].map((part) => part.id)".to_owned(),
        "eval:document.getElementById('seed').focus()".to_owned(),
        "eval:return document.querySelectorAll('.lit').length".to_owned(),
        // Each is a button with a name, and the space bar shows what it speaks of.
        "eval:return [...document.querySelectorAll('[data-light]')].filter((way) => way.localName !== 'button' || \
         !(way.ariaLabel || way.textContent)).length"
            .to_owned(),
        "axe:".to_owned(),
        "eval:document.querySelector('[data-light=\"#got\"]').focus(); scrollTo(0, document.body.scrollHeight)"
            .to_owned(),
        "keys:Space".to_owned(),
        "until:const { top, bottom } = document.getElementById('got').getBoundingClientRect(); \
         return top > 0 && bottom < innerHeight"
            .to_owned(),
        // Before the first check there is nothing to show; the browser may not complain.
        format!("go:{}", at(&server, "?env=tomato-watering&depth=formal&seed=1")),
        "until:return document.querySelector('[data-light=\".rating\"]').ariaLabel".to_owned(),
        "eval:document.querySelector('[data-light=\".rating\"]').click(); \
         return document.querySelectorAll('.rating').length"
            .to_owned(),
    ];
    let seen = run_of(&commands);
    assert_eq!((&seen[6], &seen[7], &seen[13]), (&json!(0), &json!([]), &json!(0)));
    assert!(seen[1][0].as_u64().unwrap() >= 14, "{}", seen[1]);
    assert_eq!(seen[1][1], json!([]), "everything that is pointed at is there");
    assert_eq!((&seen[3], &seen[5]), (&json!(["got"]), &json!(0)));
}

/// A newcomer's way: the refusal is told, a trap is set and judged, with whatever they have. What they see of both is
/// kept as pictures, `target/tmp/walks`.
struct Walk {
    name: &'static str,
    width: u32,
    dark: bool,
    reduced: bool,
    keyboard: bool,
}

#[test]
fn a_newcomer_sees_a_refusal_sets_a_trap_and_hears_the_verdict() {
    let walks = [
        Walk { name: "desktop", width: 1440, dark: false, reduced: false, keyboard: false },
        Walk { name: "phone, dark", width: 390, dark: true, reduced: false, keyboard: false },
        Walk { name: "keyboard alone, dark", width: 1440, dark: true, reduced: false, keyboard: true },
        Walk { name: "phone, reduced motion, keyboard", width: 390, dark: false, reduced: true, keyboard: true },
    ];
    let server = Server::start(None);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("walks");
    fs::create_dir_all(&folder).unwrap();
    for (index, walk) in walks.iter().enumerate() {
        // What fades in begins to when the verdict was told.
        let still = "until:const [told] = performance.getEntriesByName('verdict'); \
                     return (!told || performance.now() > told.startTime + 1000) && document.getAnimations().length === 0"
            .to_owned();
        let shot = |of: &str| format!("shot:{}", folder.join(format!("{}, {of}.png", walk.name)).display());
        let press = |id: &str| {
            if walk.keyboard {
                vec![focus(id), "keys:Enter".to_owned()]
            } else {
                vec![format!("eval:document.getElementById('{id}').click()")]
            }
        };
        let media = json!({ "features": [
            { "name": "prefers-color-scheme", "value": if walk.dark { "dark" } else { "light" } },
            { "name": "prefers-reduced-motion", "value": if walk.reduced { "reduce" } else { "no-preference" } },
        ] });
        let mut commands = vec![width(walk.width), format!("cdp:Emulation.setEmulatedMedia {media}")];
        // One sees the pace of the story, the others what it tells.
        commands.extend((index > 0).then(|| HURRY.to_owned()));
        commands.push(format!("go:{}", at(&server, "")));
        if walk.reduced {
            // Nothing moves: the reader turns the pages, then lets the run go.
            commands.push("until:return document.getElementById('stage').textContent.startsWith('1 of 6')".into());
            commands.extend((0..5).flat_map(|_| press("forward")));
            commands.push("until:return !document.getElementById('start').hidden".into());
            commands.extend(press("start"));
        } else {
            commands.push(TOLD.into());
        }
        let read = "eval:return ['stamp', 'margin', 'truth'].map((id) => document.getElementById(id).textContent)";
        commands.extend([
            still.clone(),
            shot("refusal"),
            read.to_owned(),
            "until:return !document.getElementById('trap-start').hidden".into(),
        ]);
        let told = commands.len() - 2;
        commands.extend(press("trap-start"));
        commands.push("until:return document.activeElement.id === 'trap-cells-bait'".into());
        if walk.keyboard {
            commands.push(format!("keys:{},Enter", ["Tab"; 5].join(",")));
        } else {
            commands.push("eval:document.querySelectorAll('#trap-cells .cell')[9].click()".into());
        }
        commands.push("until:return location.search.includes('trap=9')".into());
        commands.extend([DONE.into(), text("trap-status"), "axe:".into()]);
        let heard = commands.len() - 2;
        commands.extend([still, shot("trap")]);
        commands.push("eval:return document.documentElement.scrollWidth".into());
        let seen = run_of(&commands);
        let [stamp, margin, truth]: [String; 3] = serde_json::from_value(seen[told].clone()).unwrap();
        assert_eq!(stamp, "REFUSED", "{}", walk.name);
        assert!(margin.starts_with("Learning from it would make the future worse"), "{}: {margin}", walk.name);
        assert!(truth.contains("the rest is fake"), "{}: {truth}", walk.name);
        let said = seen[heard].as_str().unwrap();
        let hacked = said.contains("Ordinary learner: ")
            && said.contains(", hacked.")
            && said.contains(" at the end, not hacked");
        assert!(said.starts_with("A trap in row 5, column 2 pays +5.") && hacked, "{}: {said}", walk.name);
        assert_eq!(seen[heard + 1], json!([]), "{}: axe", walk.name);
        assert!(seen[heard + 4].as_u64().unwrap() <= u64::from(walk.width), "{}: {}", walk.name, seen[heard + 4]);
    }
}

#[test]
fn another_seed_of_a_recorded_world_is_one_of_that_world() {
    let server = Server::start(None);
    let come = "until:return document.getElementById('status').textContent.includes('are kept here')";
    let commands = [
        &format!("go:{}", at(&server, "?env=absent-supervisor")),
        come,
        // At once, before the form can know the world.
        "eval:document.getElementById('another').click()",
        "until:return location.search.includes('seed=')",
        "eval:return location.search",
        // The button is gone until there is a check again, so the focus moves to where that will be.
        "until:return document.activeElement.id === 'moment-title'",
    ];
    let address = drive(&commands)[4].as_str().unwrap().to_owned();
    // With the setting of the recording, which is not the world's own.
    for part in ["env=absent-supervisor", "lr_reward=0.001", "seed=1"] {
        assert!(address.contains(part), "{address}");
    }
}

#[test]
fn a_chosen_check_is_announced_and_fits_the_narrowest_screen() {
    let server = Server::start(None);
    let narrow = width(320);
    let commands = [
        HURRY,
        &narrow,
        &format!("go:{}", at(&server, "?tape=tapes/dead-model.json&check=285")),
        "until:return document.querySelectorAll('#verdicts tr').length === 2",
        "eval:document.querySelector('#verdicts tr[data-check=\"246\"]').click()",
        "until:return document.getElementById('latest').textContent.startsWith('Step ')",
        "eval:return [document.getElementById('latest').textContent, document.documentElement.scrollWidth]",
    ];
    let seen = drive(&commands)[6].clone();
    assert!(seen[0].as_str().unwrap().ends_with("refused."), "{seen}");
    assert!(seen[1].as_u64().unwrap() <= 320, "{seen}");
}
