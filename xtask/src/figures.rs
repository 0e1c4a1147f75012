//! Measures the page's figures in a browser.

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::page::{DONE, Page, TOLD};

/// Waits until the first frame is on the screen.
const FRAMED: &str = "until:return performance.getEntriesByName('first-frame').length > 0";
/// The next visit is a first one.
const EMPTY: &str = "cdp:Network.clearBrowserCache";

/// Fast mobile network, 9 Mbit/s and 60 ms, as browsers' own tools slow requests down for it: by 2.75 times its latency.
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
pub fn measure() -> Result<()> {
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
        // A visitor who reads the story to its end and takes the next thing at once.
        page.go(""),
        TOLD.into(),
        "until:return !document.getElementById('trap-start').hidden".into(),
        "eval:document.getElementById('trap-start').click()".into(),
        "until:return document.querySelectorAll('#trap-cells .cell').length > 9".into(),
        "eval:document.querySelectorAll('#trap-cells .cell')[9].click()".into(),
        "until:return location.search.includes('trap=9')".into(),
        DONE.into(),
        "eval:return performance.now()".into(),
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
        ("a trap set, met and judged, since the page was opened", number(&seen[22])? / 1000.0, 60.0, "s"),
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
