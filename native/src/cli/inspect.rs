//! Looking at what is there: environments, decisions, and whether files are what was written.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use mcvl::report::claims::plural;
use mcvl::report::film;
use mcvl::runs::{self, LedgerLine, Place, Reader, Reference, RunSet, RunsError, SeedDir, SeedRun, State, shell_word};
use mcvl::worlds;
use mcvl_core::config::{Config, Learner, Preset};
use mcvl_core::experiment::{EXPERIMENTS, Experiment};
use mcvl_core::record::{CheckRecord, Verdict};
use mcvl_core::token::Token;
use serde::Serialize;
use serde_json::json;

use super::target::{self, Kind};
use super::terminal::{Terminal, wrap};
use super::{Done, WIDTH};

/// Arguments of `mcvl envs`.
#[derive(Args)]
pub struct EnvsArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Lists the environments.
pub fn envs(arguments: &EnvsArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    if arguments.json {
        let list: Vec<_> = EXPERIMENTS.iter().map(env_json).collect::<anyhow::Result<_>>()?;
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&list)?)?;
        return Ok(Done::Well);
    }
    for (index, experiment) in EXPERIMENTS.iter().enumerate() {
        if index > 0 {
            writeln!(terminal.out)?;
        }
        let config = Config::new(experiment.name, Preset::Paper)?;
        let spec = worlds::spec(&config);
        let name = terminal.paint(1, experiment.name);
        let facts = [
            format!("Task: {}.", experiment.task),
            format!("Hack: {}.", experiment.hack),
            format!("Best Safe return: {}. {}.", experiment.safe_best, variants(experiment)),
            format!(
                "Observation: {} numbers; {} actions; episodes of at most {} steps.",
                spec.observation.width,
                spec.actions.features(),
                spec.max_steps
            ),
            format!(
                "Default budget: {} Safe and {} Full steps, forecasts of {} updates: {} per seed.",
                config.safe_steps, config.full_steps, config.forecast, experiment.cost
            ),
        ];
        writeln!(terminal.out, "{name}  {}", experiment.title)?;
        for fact in facts {
            writeln!(terminal.out, "{}", wrap(&fact, 2, WIDTH))?;
        }
    }
    Ok(Done::Well)
}

/// «Variant full: 49 at best, by the hack return 201, performance -49; variant ...».
fn variants(experiment: &Experiment) -> String {
    let rows = experiment.variants.iter().zip(experiment.intended).zip(experiment.hacking);
    let texts = rows.map(|((name, intended), hacking)| match hacking {
        Some((observed, performance)) => {
            format!("variant {name}: {intended} at best, by the hack return {observed}, performance {performance}")
        }
        None => format!("variant {name}: {intended} at best, no hack"),
    });
    let text = texts.collect::<Vec<_>>().join("; ");
    text.replacen("variant", "Variant", 1)
}

fn env_json(experiment: &Experiment) -> anyhow::Result<serde_json::Value> {
    let config = Config::new(experiment.name, Preset::Paper)?;
    let spec = worlds::spec(&config);
    let rows = experiment.variants.iter().zip(experiment.intended).zip(experiment.hacking);
    let variants: Vec<_> = rows
        .map(|((name, intended), hacking)| {
            let hack = hacking.map(|(observed, hidden)| json!({ "return": observed, "performance": hidden }));
            json!({ "name": name, "intended": intended, "hack": hack })
        })
        .collect();
    Ok(json!({
        "name": experiment.name,
        "title": experiment.title,
        "task": experiment.task,
        "hack": experiment.hack,
        "cost": experiment.cost,
        "safe_best": experiment.safe_best,
        "variants": variants,
        "maps": experiment.maps(),
        "observation": spec.observation.width,
        "observation_layout": worlds::observation(&spec),
        "actions": spec.actions.features(),
        "action_names": worlds::actions(&spec),
        "reward_scale": spec.reward_scale,
        "max_steps": spec.max_steps,
        "safe_steps": config.safe_steps,
        "full_steps": config.full_steps,
        "forecast": config.forecast,
    }))
}

/// Arguments of `mcvl ledger`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl ledger runs/box-moving
  mcvl ledger runs/box-moving --wrong --seed 3
  mcvl ledger runs/box-moving --json | jq '.[].margin'")]
pub struct LedgerArgs {
    /// Run directory, or the folder of a seed in it
    run: PathBuf,
    /// Only refusals
    #[arg(long, conflicts_with = "accepted")]
    refused: bool,
    /// Only acceptances
    #[arg(long)]
    accepted: bool,
    /// Only decisions that were wrong in truth: a hack accepted, or an honest transition refused
    #[arg(long)]
    wrong: bool,
    /// Only this seed
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A decision in the list, its numbers with the digits that they have in the run.
#[derive(Serialize)]
struct Listed<'a> {
    seed: u64,
    #[serde(flatten)]
    check: &'a CheckRecord,
}

/// Lists decisions.
pub fn ledger(arguments: &LedgerArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let set = RunSet::read(&arguments.run)?;
    let seeds = seeds(&set, arguments.seed)?;
    let shown = |check: &&CheckRecord| {
        let refused = check.verdict == Verdict::Refuse;
        (!arguments.refused || refused) && (!arguments.accepted || !refused) && (!arguments.wrong || check.wrong())
    };
    if arguments.json {
        let list: Vec<_> = (seeds.iter())
            .flat_map(|run| run.checks.iter().filter(shown).map(|check| Listed { seed: run.seed, check }))
            .collect();
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&list)?)?;
        return Ok(Done::Well);
    }
    for run in seeds {
        let checks: Vec<&CheckRecord> = run.checks.iter().filter(shown).collect();
        let (count, wrong) = (run.checks.len(), run.checks.iter().filter(|check| check.wrong()).count());
        let refused = run.checks.iter().filter(|check| check.verdict == Verdict::Refuse).count();
        let some = if checks.len() < count { format!("; {} shown", checks.len()) } else { String::new() };
        let count = plural(count as u64, "check");
        let title = format!("seed {}: {count}, {refused} refused, {wrong} wrong{some}", run.seed);
        writeln!(terminal.out, "{}", terminal.paint(1, title))?;
        for check in checks {
            let color = if check.verdict == Verdict::Refuse { 31 } else { 32 };
            let truth = if check.hack { "hack" } else { "honest" };
            let wrong = if check.wrong() { ", WRONG" } else { "" };
            let sentence = format!("{} ({truth}{wrong})", check.sentence());
            let line = terminal.listed(&format!("  #{:<4}", check.number), &sentence, color);
            write!(terminal.out, "{line}")?;
        }
    }
    Ok(Done::Well)
}

/// The seeds of a run that were asked for: one, or all that have begun.
pub fn seeds(set: &RunSet, only: Option<u64>) -> anyhow::Result<Vec<&SeedRun>> {
    let seeds: Vec<&SeedRun> = set.seeds.iter().filter(|run| only.is_none_or(|only| only == run.seed)).collect();
    if let (Some(seed), true) = (only, seeds.is_empty()) {
        let there: Vec<String> = set.seeds.iter().map(|run| run.seed.to_string()).collect();
        super::usage!("{} has no seed {seed}: there are {}", set.path.display(), there.join(", "));
    }
    Ok(seeds)
}

/// Arguments of `mcvl explain`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl explain runs/box-moving#3
  mcvl explain runs/box-moving/seed-7#3 --svg decision.svg

Of a run with several seeds, RUN#NUMBER is a check of the first one; name the
folder of another seed for one of its checks.")]
pub struct ExplainArgs {
    /// Check, like runs/box-moving#17 or runs/box-moving/seed-3#17
    #[arg(value_name = "RUN#NUMBER")]
    check: Reference,
    /// Write it as a picture as well; in a browser the arm of Reacher moves
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Write it as a PNG as well
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
}

/// Shows one decision in full.
pub fn explain(arguments: &ExplainArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    for (path, kind) in [(&arguments.svg, Kind::Svg), (&arguments.png, Kind::Png)] {
        path.iter().try_for_each(|path| target::check(path, kind, "name another file"))?;
    }
    let found = Found::read(&arguments.check, Reader::ledger)?;
    let tape = runs::tape(&found.dir, arguments.check.number, found.line())?;
    let spec = worlds::spec(&found.config);
    let seed = (!found.alone).then(|| found.dir.seed());
    write!(terminal.out, "{}", film::explain(&tape, seed, &spec, WIDTH, terminal.color))?;
    let token = Token { config: found.config.clone(), number: tape.number, digest: found.line().digest() };
    writeln!(terminal.out, "\nRe-derive it anywhere:\n  mcvl replay {token}")?;
    if let Some(path) = &arguments.svg {
        runs::write_atomic(path, film::svg(&tape, &spec).as_bytes())?;
    }
    if let Some(path) = &arguments.png {
        runs::write_atomic(path, &film::png(&tape, &spec)?)?;
    }
    Ok(Done::Well)
}

/// A check of a run that is there.
pub struct Found {
    /// Folder of its seed.
    pub dir: SeedDir,
    /// Configuration of the learner that made it.
    pub config: Config,
    /// The ledger up to it.
    pub lines: Vec<LedgerLine>,
    /// Whether the run has no other seed.
    pub alone: bool,
    /// Whether its seed is under way, so that its logs may end anywhere behind the last checkpoint.
    pub open: bool,
}

impl Found {
    /// Finds what a reference names, in the ledger that `read` gives of a seed.
    pub fn read(
        reference: &Reference,
        read: impl Fn(&Reader, &SeedDir) -> Result<Vec<LedgerLine>, RunsError>,
    ) -> anyhow::Result<Self> {
        let run = Reader::open(&reference.place)?;
        let (place, plan) = (run.place(), run.plan());
        let dir = named_seed(&run)?;
        let (seed, path) = (dir.seed(), place.run.path().display());
        let mut lines = read(&run, &dir)?;
        let (count, number) = (lines.len(), reference.number);
        // Without a seed it is the first one; who meant a later one is told where the check is.
        if place.seed.is_none() && number as usize > count {
            let has = |other: &&u64| {
                let lines = run.ledger(&place.run.seed(**other));
                lines.is_ok_and(|lines| lines.len() >= number as usize)
            };
            if let Some(other) = plan.seeds.iter().find(has) {
                super::usage!(
                    "seed {seed} of {path} has no check {number}, {}: take {path}/seed-{other}#{number}",
                    if count == 0 { "it has none".to_owned() } else { format!("its last is {count}") }
                );
            }
        }
        check_exists(&reference.place, number, count)?;
        lines.truncate(reference.number as usize);
        let config = plan.config.with_seed(seed).with_agent(Learner::Mc);
        let open = !run.is_finished(&dir);
        Ok(Self { dir, config, lines, alone: plan.seeds.len() == 1, open })
    }

    /// The line of the check itself.
    pub fn line(&self) -> &LedgerLine {
        self.lines.last().expect("checks are counted from 1")
    }
}

/// The seed that a place names, or the first one of its run. It has to be of the run and begun.
pub fn named_seed(run: &Reader) -> anyhow::Result<SeedDir> {
    let (place, plan) = (run.place(), run.plan());
    let (path, seed) = (place.run.path().display(), place.seed.unwrap_or(plan.seeds[0]));
    if !plan.seeds.contains(&seed) {
        let there: Vec<String> = plan.seeds.iter().map(u64::to_string).collect();
        super::usage!("{path} has no seed {seed}: there are {}", there.join(", "));
    }
    let dir = place.run.seed(seed);
    if !dir.path().exists() {
        super::usage!("{path} has not begun seed {seed} yet");
    }
    Ok(dir)
}

/// Fails unless `number` is one of the `count` checks of a run or seed.
pub fn check_exists(place: &Path, number: u32, count: usize) -> anyhow::Result<()> {
    if (1..=count).contains(&(number as usize)) {
        return Ok(());
    }
    let path = place.display();
    let there = match count {
        0 => "it has no checks".to_owned(),
        _ => format!("its checks are 1 to {count} (`mcvl ledger {}` lists them)", shell_word(place)),
    };
    super::usage!("{path} has no check {number}: {there}");
}

/// Arguments of `mcvl verify`.
#[derive(Args)]
#[command(after_help = "Example:\n  mcvl verify runs/box-moving && echo untouched")]
pub struct VerifyArgs {
    /// Run directory
    run: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Compares a run with its manifest, chains and checkpoints.
pub fn verify(arguments: &VerifyArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let run = match Place::find(&arguments.run) {
        Ok(place) => place.run,
        // run.toml itself may be what is missing: the manifest says so.
        Err(RunsError::Request(_)) if runs::RunDir::new(&arguments.run).manifest().exists() => {
            runs::RunDir::new(&arguments.run)
        }
        Err(error) => return Err(error.into()),
    };
    let seen = runs::verify(&run)?;
    let path = run.path().display();
    if arguments.json {
        let findings: Vec<_> = seen.findings.iter().map(|f| json!({ "file": f.file, "what": f.what })).collect();
        let value = json!({
            "files": seen.files,
            "links": seen.links,
            "state": seen.state,
            "unknown": seen.unknown,
            "findings": findings,
        });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
    } else {
        for finding in &seen.findings {
            writeln!(terminal.out, "{} {}: {}", terminal.paint(31, "MISMATCH"), finding.file, finding.what)?;
        }
        for file in &seen.unknown {
            writeln!(terminal.out, "unknown {file}: not in the manifest")?;
        }
        let checked = format!("{} files and {} links of the ledger", seen.files, seen.links);
        if !seen.findings.is_empty() {
            writeln!(terminal.out, "{path} is not as it was written (checked {checked})")?;
        } else if seen.state != State::Finished {
            writeln!(terminal.out, "{path} is unfinished and intact so far: {checked}")?;
        } else {
            writeln!(terminal.out, "{path} is intact: {checked}")?;
        }
    }
    Ok(if seen.findings.is_empty() { Done::Well } else { Done::Mismatch })
}
