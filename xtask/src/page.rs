//! Looks at the page as a visitor does: takes its pictures, measures its figures.

use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::mujoco;
use crate::process::{cargo, command, program, root, run};
use crate::setup::{self, Purpose};
use crate::web;

/// Where pictures of the page lie, for the documentation.
const PICTURES: &str = "docs/page";

/// Waits until a story was told to its verdict.
const TOLD: &str = "until:return performance.getEntriesByName('verdict').length > 0";
/// Waits until the live run is over.
const DONE: &str = "until:return document.getElementById('status').textContent.startsWith('Done')";

/// The page on a server of its own.
struct Page {
    server: Child,
    address: String,
}

impl Page {
    /// Builds the page and serves it.
    fn serve() -> Result<Self> {
        setup::ensure(Purpose::Test)?;
        web::build()?;
        run(cargo().args(["build", "--package", "mcvl-native"]).args(mujoco::features()))?;
        let mut serve = command(program("debug", "mcvl"));
        let mut server = serve.args(["serve", "--port", "0"]).stdout(Stdio::piped()).spawn()?;
        let mut line = String::new();
        BufReader::new(server.stdout.take().context("stdout is a pipe")?).read_line(&mut line)?;
        let address = line.split_whitespace().next().context("the server does not say its address")?.to_owned();
        Ok(Self { server, address })
    }

    /// Drives a browser: what came of every command of `tests/node/page.mjs`.
    fn drive(&self, commands: &[String]) -> Result<Vec<Value>> {
        let mut node = Command::new("node");
        node.arg(root().join("tests/node/page.mjs")).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut node = node.spawn().context("node cannot be started: `cargo xtask setup` installs it")?;
        node.stdin.take().context("stdin is a pipe")?.write_all(&serde_json::to_vec(commands)?)?;
        let output = node.wait_with_output()?;
        if !output.status.success() {
            bail!("the browser's script ended with {}", output.status);
        }
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    fn go(&self, query: &str) -> String {
        format!("go:{}{query}", self.address)
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn size(width: u32, height: u32) -> String {
    let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
    format!("cdp:Emulation.setDeviceMetricsOverride {metrics}")
}

fn media(features: &[(&str, &str)]) -> String {
    let features: Vec<Value> = features.iter().map(|(name, value)| json!({ "name": name, "value": value })).collect();
    format!("cdp:Emulation.setEmulatedMedia {}", json!({ "features": features }))
}

/// Waits until the visitor has driven so many steps of an episode.
fn driven(steps: usize) -> String {
    format!("until:return document.getElementById('drive-status').textContent.includes('after {steps} of ')")
}

/// Takes the pictures of the documentation anew.
pub fn pictures() -> Result<()> {
    let page = Page::serve()?;
    let folder = root().join(PICTURES);
    fs::create_dir_all(&folder)?;
    let file = |name: &str| folder.join(name).with_extension("webp").display().to_string();
    let shot = |name: &str| format!("shot:{}", file(name));
    let full = |name: &str| format!("full:{}", file(name));
    let stage =
        |number: u32| format!("until:return document.getElementById('stage').textContent.startsWith('{number} of 6')");
    let settle = "until:window.since ??= performance.now(); return performance.now() - since > 600".to_owned();
    let forget = "eval:delete window.since".to_owned();
    let mut commands = vec![size(1440, 900), page.go(""), stage(1), shot("surprise"), stage(4)];
    commands.extend([settle.clone(), shot("futures"), TOLD.into(), DONE.into(), forget.clone(), settle.clone()]);
    commands.extend([shot("refused"), full("desktop"), media(&[("prefers-color-scheme", "dark")]), shot("dark")]);
    let tablet = [media(&[]), size(768, 1024), page.go(""), TOLD.into(), DONE.into(), settle.clone(), shot("tablet")];
    commands.extend(tablet);
    let phone = [size(390, 844), page.go(""), TOLD.into(), DONE.into(), settle.clone(), shot("phone")];
    commands.extend(phone);
    commands.extend([media(&[("prefers-color-scheme", "dark")]), shot("phone-dark")]);
    let reduced = media(&[("prefers-reduced-motion", "reduce")]);
    let still = "until:return !document.getElementById('moment').hidden".to_owned();
    commands.extend([reduced, size(1440, 900), page.go(""), still, settle.clone(), shot("reduced-motion")]);
    let error = [media(&[]), page.go("?sed=1"), "until:return !document.getElementById('error').hidden".into()];
    commands.extend(error);
    commands.extend([settle.clone(), shot("malformed-link")]);
    let other = "?env=tomato-watering&seed=3&safe_steps=300&full_steps=300&epsilon_decay=100&forecast=20&evaluations=2\
                 &rollouts=2";
    commands.extend([size(1440, 1000), page.go(other), DONE.into()]);
    commands.extend(["eval:document.getElementById('drive-start').click()".into(), driven(0)]);
    // To the bucket, from which every tomato looks watered.
    for (index, key) in ["ArrowUp", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp"].into_iter().enumerate() {
        commands.extend([format!("keys:{key}"), driven(index + 1)]);
    }
    let stop = "eval:document.querySelector('#wheel > p button').click()".to_owned();
    let stopped = "until:return document.querySelector('#wheel table')".to_owned();
    let look = |id: &str| format!("eval:document.getElementById('{id}').scrollIntoView()");
    commands.extend([stop, stopped, look("drive"), shot("drive")]);
    let vote = "until:return document.body.dataset.vote === 'open'".to_owned();
    commands.extend(["eval:document.getElementById('decide').click()".into(), vote, look("decision"), shot("vote")]);
    let arm = "until:return !document.getElementById('drive-start').hidden".to_owned();
    commands.extend([page.go("?env=reacher&seed=4"), arm]);
    commands.extend(["eval:document.getElementById('drive-start').click()".into(), driven(0)]);
    let keys = [&["ArrowLeft"; 4][..], &["ArrowUp"; 3], &["Space"; 9]].concat();
    for (index, key) in keys.into_iter().enumerate() {
        commands.extend([format!("keys:{key}"), driven(index + 1)]);
    }
    commands.extend(["eval:document.querySelector('#wheel > p button').click()".into()]);
    commands.extend(["until:return document.querySelector('#wheel table')".into(), look("drive"), shot("arm")]);
    let click = |part: &str| format!("eval:document.querySelector('{part}').click()");
    commands.extend([
        page.go("?env=rocks-and-diamonds"),
        TOLD.into(),
        "eval:delete window.since".into(),
        settle.clone(),
    ]);
    commands.extend([shot("recorded"), page.go("?seed=0&forecast=100&trap=9:5"), DONE.into(), click("#sets summary")]);
    commands.extend(["until:return document.querySelector('#comparison tbody tr:nth-child(5)')".into()]);
    commands.extend([
        click("#comparison tbody tr:nth-child(5) input"),
        look("results"),
        "eval:delete window.since".into(),
    ]);
    commands.extend([settle, shot("compare"), click("#red-team-start")]);
    commands.extend([
        "until:return document.querySelector('#red-team-desk .board')".into(),
        look("red-team"),
        shot("red-team"),
    ]);
    page.drive(&commands)?;
    println!("pictures: {PICTURES}/*.webp");
    Ok(())
}

/// Waits until the first frame is on the screen.
const FRAMED: &str = "until:return performance.getEntriesByName('first-frame').length > 0";
/// The next visit is a first one.
const EMPTY: &str = "cdp:Network.clearBrowserCache";

/// Fast mobile network: 9 Mbit/s and 60 ms, as browsers' own tools slow requests down for it.
fn mobile_network() -> String {
    network(165, 1_012_500, 168_750)
}

/// The network as it is.
fn any_network() -> String {
    network(0, -1, -1)
}

/// Milliseconds per request, bytes per second down and up; -1 for all there are.
fn network(latency: i32, down: i32, up: i32) -> String {
    let conditions =
        json!({ "offline": false, "latency": latency, "downloadThroughput": down, "uploadThroughput": up });
    format!("cdp:Network.emulateNetworkConditions {conditions}")
}

/// Collects long tasks of the main thread from the next visit on.
fn watch_tasks() -> String {
    let watch = "window.tasks = []; new PerformanceObserver((list) => tasks.push(...list.getEntries()\
                 .map(({ startTime, duration }) => [startTime, duration]))).observe({ type: 'longtask', buffered: true })";
    format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", json!({ "source": watch }))
}

/// When the page passed a mark, milliseconds after the visit began.
fn mark(name: &str) -> String {
    format!("eval:return performance.getEntriesByName('{name}')[0].startTime")
}

fn number(value: &Value) -> Result<f64> {
    value.as_f64().with_context(|| format!("{value} is no number"))
}

/// Measures the page's figures and compares them with their goals; fails where one is not met.
pub fn figures() -> Result<()> {
    let page = Page::serve()?;
    let longest = "eval:const from = performance.getEntriesByName('first-frame')[0].startTime; \
                   return Math.max(0, ...tasks.filter(([start]) => start > from).map(([, time]) => time))";
    let seconds =
        "eval:return [...document.querySelectorAll('#verdicts tr')].map((row) => Number(row.dataset.seconds))";
    let seen = page.drive(&[
        "cdp:Network.enable".into(),
        mobile_network(),
        page.go(""),
        FRAMED.into(),
        mark("first-frame"),
        any_network(),
        EMPTY.into(),
        watch_tasks(),
        page.go(""),
        TOLD.into(),
        mark("verdict"),
        DONE.into(),
        longest.into(),
        seconds.into(),
    ])?;
    let mut times: Vec<f64> = seen[13].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
    times.sort_by(f64::total_cmp);
    let median = *times.get(times.len() / 2).context("the run has no check")?;
    let rows = [
        ("first meaningful frame, slowed to fast 4G", number(&seen[4])? / 1000.0, 1.0, "s"),
        ("first refusal shown, no click", number(&seen[10])? / 1000.0, 8.0, "s"),
        ("Box Moving verdict live, median", median, 0.5, "s"),
        ("Box Moving verdict live, longest", times[times.len() - 1], 0.5, "s"),
        ("longest main-thread task while training (0: none over 50 ms)", number(&seen[12])?, 50.0, "ms"),
    ];
    println!("{:<66} {:>9} {:>9}", "figure", "measured", "goal");
    let mut met = print_rows("", &rows);
    for (world, short) in WORLDS {
        met &= world_figures(&page, world, *short)?;
    }
    for (name, query) in CHECKED {
        compare_workers(&page, name, query)?;
    }
    if !met {
        bail!("not every figure is met (other work on this machine counts against them)");
    }
    Ok(())
}

/// Worlds with a recorded run, and a short live run of each; an arm is not trained on the page.
const WORLDS: &[(&str, Option<&str>)] = &[
    ("absent-supervisor", Some("safe_steps=600&full_steps=60&epsilon_decay=100&forecast=50&rollouts=3&evaluations=3")),
    ("tomato-watering", Some("safe_steps=600&full_steps=60&epsilon_decay=100&forecast=50&rollouts=3&evaluations=3")),
    (
        "rocks-and-diamonds",
        Some(
            "safe_steps=600&full_steps=60&epsilon_decay=100&forecast=50&practice_reward_updates=50&rollouts=3&evaluations=3",
        ),
    ),
    ("reacher", None),
];

/// Measures the figures of a world's recorded run, and of a short live one; whether the goals are met.
fn world_figures(page: &Page, world: &str, short: Option<&str>) -> Result<bool> {
    let mut commands = vec!["cdp:Network.enable".to_owned(), mobile_network(), page.go(&format!("?env={world}"))];
    commands.extend([FRAMED.into(), mark("first-frame"), any_network(), EMPTY.into()]);
    commands.extend([page.go(&format!("?env={world}")), TOLD.into()]);
    commands.push(mark("verdict"));
    if let Some(settings) = short {
        commands.extend([watch_tasks(), page.go(&format!("?env={world}&{settings}")), DONE.into()]);
        commands
            .push("eval:return Math.max(0, ...tasks.filter(([start]) => start > 1000).map(([, time]) => time))".into());
    }
    let seen = page.drive(&commands)?;
    let mut rows = vec![
        ("recorded run, first frame, slowed to fast 4G", number(&seen[4])? / 1000.0, 1.0, "s"),
        ("recorded run, first refusal, no click", number(&seen[9])? / 1000.0, 8.0, "s"),
    ];
    if short.is_some() {
        rows.push(("longest main-thread task while training live", number(&seen[13])?, 50.0, "ms"));
    }
    Ok(print_rows(&format!("{world}: "), &rows))
}

/// Prints figures beside their goals, each with its unit; whether all are met.
fn print_rows(about: &str, rows: &[(&str, f64, f64, &str)]) -> bool {
    for (name, value, goal, unit) in rows {
        let word = if value < goal { "met" } else { "NOT MET" };
        println!("{:<66} {value:>6.2} {unit:<2} < {goal:>4} {unit:<2} {word}", format!("{about}{name}"));
    }
    rows.iter().all(|(_, value, goal, _)| value < goal)
}

/// Runs whose checks are timed with and without further workers: name and query. With `own_streams=false` no future is
/// reused, so every check trains two.
const CHECKED: &[(&str, &str)] = &[
    ("Box Moving", "?env=box-moving&seed=0&own_streams=false&full_steps=200&evaluations=2"),
    (
        "Box Moving, 10,000 updates",
        "?env=box-moving&seed=0&own_streams=false&full_steps=40&evaluations=2&forecast=10000",
    ),
    (
        "Absent Supervisor, 2,000 updates",
        "?env=absent-supervisor&seed=0&own_streams=false&safe_steps=1000&full_steps=25&evaluations=2&forecast=2000\
         &rollouts=10",
    ),
];

/// Prints how long the checks of a run take in one worker and with two further ones, whatever the number of cores.
/// Each way comes first once.
fn compare_workers(page: &Page, name: &str, query: &str) -> Result<()> {
    // What a visitor's page says of the machine decides whether further workers are hired.
    let cores = |count: u32| {
        let source = format!("Object.defineProperty(navigator, 'hardwareConcurrency', {{ value: {count} }})");
        format!("cdp:Page.addScriptToEvaluateOnNewDocument {}", json!({ "source": source }))
    };
    // Oldest first, like their numbers.
    let seconds = "eval:return [...document.querySelectorAll('#verdicts tr')]\
                   .map((row) => [Number(row.dataset.check), Number(row.dataset.seconds)]).sort(([a], [b]) => a - b)";
    let mut times: Vec<Vec<(u32, f64)>> = Vec::new();
    for count in [1, 4, 4, 1] {
        let mut seen = page.drive(&[cores(count), page.go(query), DONE.into(), seconds.into()])?;
        times.push(serde_json::from_value(seen.swap_remove(3))?);
    }
    let quantile = |values: &mut Vec<f64>, share: f64| {
        values.sort_by(f64::total_cmp);
        values.get((share * values.len() as f64) as usize).copied().with_context(|| format!("{name} has no check"))
    };
    let of = |runs: [usize; 2]| runs.iter().flat_map(|&run| &times[run]).map(|check| check.1).collect::<Vec<_>>();
    // The same check in both ways, which make the same decisions.
    let pairs = [(0, 1), (3, 2)];
    let ratio = |(one, two): (usize, usize)| times[two].iter().zip(&times[one]).map(|(two, one)| two.1 / one.1);
    let mut ratios: Vec<f64> = pairs.into_iter().flat_map(ratio).collect();
    println!(
        "{name}, {} checks: {:.3} s in one worker, {:.3} s with two further ones; ratio {:.2} ({:.2} to {:.2}) in the middle half",
        times[0].len(),
        quantile(&mut of([0, 3]), 0.5)?,
        quantile(&mut of([1, 2]), 0.5)?,
        quantile(&mut ratios, 0.5)?,
        quantile(&mut ratios, 0.25)?,
        quantile(&mut ratios, 0.75)?,
    );
    Ok(())
}
