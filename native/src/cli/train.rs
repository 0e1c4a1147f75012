//! `mcvl train`: from settings to a finished run directory, or one that can be continued.

use std::io::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use mcvl::report::claims::{Summary, percent};
use mcvl::runs::{Manifest, Plan, RunDir, RunSet, State, check_forecasts, expected_forecasts, shell_word};
use mcvl::worlds;
use mcvl_core::config::{Config, Learner, Preset, Scheme};
use mcvl_core::record::{Arm, Verdict};
use mcvl_core::run::{Budget, Status};
use serde_json::json;

use super::session::{Ended, Pace, Session, stop_on_signals};
use super::settings::{self, Given, Request, Resolved};
use super::terminal::{Terminal, wrap};
use super::{Done, WIDTH, usage};

/// Arguments of `mcvl train`.
#[derive(Args)]
#[command(after_help = format!("{EXAMPLES}\n\n{STOPPING}\n\nSee `mcvl train --help` for every setting."))]
#[command(after_long_help = after_long_help())]
pub struct TrainArgs {
    /// Environment; `mcvl envs` lists them
    env: String,
    /// Learner of the Full phase: mc, baseline, oracle, frozen or frozen-reward; may be repeated
    /// [default: baseline and mc]
    #[arg(long, value_name = "LEARNER", value_parser = super::learner)]
    agent: Vec<Learner>,
    /// What is done about surprising transitions: by-reward, all, discard, each-step, punish,
    /// store-predicted or none
    #[arg(long, value_name = "SCHEME")]
    scheme: Option<String>,
    /// World of the Full phase
    #[arg(long, value_name = "VARIANT")]
    variant: Option<String>,
    /// One seed
    #[arg(long, value_name = "N", conflicts_with = "seeds")]
    seed: Option<u64>,
    /// Several seeds: 0..10 (the end is left out) or 1,5,9; 10 alone is seed 10
    #[arg(long, value_name = "LIST", value_parser = settings::seeds)]
    seeds: Option<settings::SeedList>,
    /// Source of the defaults: paper, release or, in Reacher, small (minutes)
    #[arg(long, value_name = "PRESET", value_parser = super::preset)]
    preset: Option<Preset>,
    /// Set one value; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = settings::assignment)]
    set: Vec<Given>,
    /// Read settings from a TOML file with lines like `threshold = 0.1`
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Run directory [default: runs/ENV]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Continue the run in the directory; its settings come from there
    #[arg(long, conflicts_with_all = ["fresh", "overwrite"])]
    resume: bool,
    /// If the directory is taken, use DIR-2, DIR-3, ...
    #[arg(long, conflicts_with = "overwrite")]
    fresh: bool,
    /// Delete the run in the directory first
    #[arg(long)]
    overwrite: bool,
    /// Fewer steps and shorter forecasts: seconds, but not the paper's setting
    #[arg(long)]
    quick: bool,
    /// Show the settings and the expected cost, train nothing
    #[arg(long)]
    dry_run: bool,
    /// Exit with 1 unless every claim about the trained learners holds
    #[arg(long)]
    assert_claims: bool,
    /// Print the summary as JSON; with --dry-run the settings and the cost
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pace: Pace,
}

const EXAMPLES: &str = "\
Examples:
  mcvl train box-moving                       seed 0, baseline and mc
  mcvl train box-moving --seeds 0..10 -j 4    ten seeds, four at a time
  mcvl train box-moving --set threshold=0.1 -o runs/threshold
  mcvl train box-moving --resume              continue what was stopped
  mcvl train tomato-watering --seeds 0..100 --backend gpu
                                              a hundred seeds' forecasts together on a graphics card";

const STOPPING: &str = "\
Ctrl-C stops with the state saved and exits with 130. A second one exits with
130 at once and saves nothing more: --resume goes on from the last state that
--checkpoint-every saved.";

fn after_long_help() -> String {
    let precedence = "Precedence: defaults < preset < --quick < --config < environment < flags.";
    format!("{EXAMPLES}\n\n{STOPPING}\n\n{precedence}\n\n{}", settings::list())
}

/// Trains.
pub fn train(arguments: &TrainArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let resolved = settings::resolve(&arguments.request(), terminal)?;
    if let Some(other) = resolved.given.iter().find(|given| given.key == "agent" && arguments.agent.len() > 1) {
        usage!("agent: several are given by --agent, and {} by {}: leave one out", other.value, other.from);
    }
    let run = RunDir::new(arguments.output.clone().unwrap_or_else(|| settings::default_directory(&arguments.env)));
    let plan = arguments.plan(&resolved);
    if !arguments.resume {
        arguments.has_claims(&plan)?;
    }
    let fits = |found: &Plan| {
        same_settings(&run, found, &plan, &resolved, arguments)?;
        arguments.has_claims(found)
    };
    if arguments.dry_run && arguments.resume {
        Session::check_begun(&run)?;
        let (found, _) = Session::begun(&run)?;
        fits(&found)?;
        return dry_run(arguments, &found, terminal);
    }
    if arguments.dry_run {
        return dry_run(arguments, &plan, terminal);
    }
    stop_on_signals()?;
    let remote = arguments.pace.remote(terminal)?;
    let session = if arguments.resume {
        Session::resume(run.clone(), fits)?
    } else {
        Session::begin(arguments.place(run)?, plan, arguments.overwrite)?
    };
    let (run, plan) = (session.run().clone(), session.plan().clone());
    let manner = arguments.pace.manner(arguments.resume_command(&run), remote);
    match session.work(&manner, terminal)? {
        Ended::Interrupted(open) => {
            let seeds = plan.seeds.len();
            terminal.note(format_args!("stopped with {open} of {seeds} seeds unfinished; the state is saved"));
            terminal.note(format_args!("continue with: {}", manner.resume));
            Ok(Done::Interrupted)
        }
        Ended::Finished { set, summary, before } => {
            if arguments.json {
                writeln!(terminal.out, "{}", serde_json::to_string_pretty(&summary)?)?;
            } else {
                if before {
                    let path = run.path().display();
                    terminal.note(format_args!("{path} is finished already: nothing to do"));
                }
                print(&plan, &set, &summary, terminal)?;
            }
            Ok(if arguments.assert_claims && !summary.holds() { Done::DoesNotHold } else { Done::Well })
        }
    }
}

impl TrainArgs {
    fn request(&self) -> Request<'_> {
        let flag = Given::flag;
        let mut flags: Vec<Given> = self.set.clone();
        if let [agent] = self.agent[..] {
            flags.push(flag("agent", agent.name().to_owned()));
        }
        flags.extend(self.scheme.as_ref().map(|value| flag("scheme", value.clone())));
        flags.extend(self.variant.as_ref().map(|value| flag("variant", value.clone())));
        flags.extend(self.seed.map(|seed| flag("seed", seed.to_string())));
        let seeds = |seeds: &Vec<u64>| Given { from: "flag --seeds".to_owned(), ..flag("seed", seeds[0].to_string()) };
        flags.extend(self.seeds.as_ref().map(seeds));
        Request { env: &self.env, preset: self.preset, quick: self.quick, file: self.config.as_deref(), flags }
    }

    fn plan(&self, resolved: &Resolved) -> Plan {
        let config = resolved.config.clone();
        // The order in which legs are told, whatever the order of the flags.
        let order = Arm::ALL[1..].iter().filter_map(|arm| Learner::ALL.iter().find(|l| Arm::of(**l) == *arm).copied());
        let learners = if !self.agent.is_empty() {
            order.filter(|learner| self.agent.contains(learner)).collect()
        } else if resolved.given.iter().any(|given| given.key == "agent") {
            vec![config.agent]
        } else {
            vec![Learner::Baseline, Learner::Mc]
        };
        let seeds = self.seeds.clone().unwrap_or_else(|| vec![config.seed]);
        Plan { config, seeds, learners, settings: resolved.settings.clone() }
    }

    /// Complains where there is nothing to assert, before hours are spent.
    fn has_claims(&self, plan: &Plan) -> anyhow::Result<()> {
        if !self.assert_claims {
            return Ok(());
        }
        if plan.config.optima().is_none() {
            usage!("--assert-claims: nothing is claimed of this world, whose best returns are not known: leave it out");
        }
        if !plan.learners.iter().any(|learner| matches!(learner, Learner::Baseline | Learner::Mc)) {
            usage!("--assert-claims: what is claimed is about baseline and mc: train one of them, or leave it out");
        }
        Ok(())
    }

    /// The directory to begin in, if there is one for a new run.
    fn place(&self, run: RunDir) -> anyhow::Result<RunDir> {
        if run.is_free()? || self.overwrite && run.is_begun()? {
            return Ok(run);
        }
        if self.fresh {
            return Ok(run.next_free()?);
        }
        let (path, fresh) = (run.path().display(), run.next_free()?);
        if !run.is_begun()? {
            usage!("{path} is not empty and holds no run: choose another directory with -o");
        }
        let finished = Manifest::read(&run).is_ok_and(|manifest| manifest.state == State::Finished);
        let state = if finished { "a finished" } else { "an unfinished" };
        usage!(
            "{path} already holds {state} run: --resume continues it, --fresh starts {}, --overwrite deletes it",
            fresh.path().display()
        )
    }

    /// The command that continues this run.
    fn resume_command(&self, run: &RunDir) -> String {
        let place = match run.path() == settings::default_directory(&self.env) {
            true => String::new(),
            false => format!(" -o {}", shell_word(run.path())),
        };
        format!("mcvl train {}{place} --resume", self.env)
    }
}

/// Says how a run came out, and what to look at next.
fn print(plan: &Plan, set: &RunSet, summary: &Summary, terminal: &mut Terminal) -> anyhow::Result<()> {
    let path = shell_word(&set.path);
    writeln!(terminal.out, "{}", summary.text().trim_end())?;
    if plan.settings.iter().any(|(_, setting)| setting.from.0 == settings::QUICK_ORIGIN) {
        writeln!(terminal.out, "\nA quick run: fewer steps and shorter forecasts than the paper's setting.")?;
    }
    if terminal.quiet {
        return Ok(());
    }
    // The first refused hack of the lowest seed shows best what a check is.
    let checks = set.seeds.first().map_or(&[][..], |seed| &seed.checks);
    let shown = checks.iter().find(|c| c.hack && c.verdict == Verdict::Refuse).or(checks.first());
    writeln!(terminal.out, "\nNext:")?;
    if let Some(check) = shown {
        writeln!(terminal.out, "  mcvl explain {path}#{}", check.number)?;
    }
    writeln!(terminal.out, "  mcvl report {path}")?;
    Ok(())
}

/// What was given explicitly has to be what the run was begun with.
fn same_settings(
    run: &RunDir,
    plan: &Plan,
    asked: &Plan,
    resolved: &Resolved,
    arguments: &TrainArgs,
) -> anyhow::Result<()> {
    let path = run.path().display();
    let advice = "--resume takes every setting from run.toml; leave it out, or begin another run with -o";
    if plan.config.env != arguments.env {
        usage!("{path} holds a run of {}, not of {}", plan.config.env, arguments.env);
    }
    if let Some(preset) = arguments.preset.filter(|preset| *preset != plan.config.preset) {
        usage!("preset: {path} was begun with {}, not with {}: {advice}", plan.config.preset.name(), preset.name());
    }
    let quick = if arguments.quick { settings::QUICK } else { &[] };
    let given = resolved.given.iter().map(|given| given.key.as_str()).chain(quick.iter().map(|(key, _)| *key));
    for key in given.filter(|key| !["seed", "agent"].contains(key)) {
        let value = |plan: &Plan| plan.settings.iter().find(|(name, _)| name == key).map(|(_, s)| s.value.clone());
        let (was, is) = (value(plan).unwrap_or_default(), value(asked).unwrap_or_default());
        if was != is {
            usage!("{key}: {path} was begun with {was}, not with {is}: {advice}");
        }
    }
    let is_given = |key: &str| resolved.given.iter().any(|given| given.key == key);
    if is_given("seed") && asked.seeds != plan.seeds {
        usage!("seeds: {path} was begun with {:?}, not with {:?}: {advice}", plan.seeds, asked.seeds);
    }
    if (is_given("agent") || !arguments.agent.is_empty()) && asked.learners != plan.learners {
        let names = |plan: &Plan| plan.learners.iter().map(|l| l.name()).collect::<Vec<_>>().join(" and ");
        usage!("agent: {path} was begun with {}, not with {}: {advice}", names(plan), names(asked));
    }
    Ok(())
}

/// Shows what a run would be.
fn dry_run(arguments: &TrainArgs, plan: &Plan, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let speed = Speed::measure(&plan.config);
    let cost = Cost::of(plan, &speed, arguments.pace.threads());
    if arguments.json {
        let settings = plan.settings.iter().map(|(key, setting)| (key.clone(), json!(setting)));
        let value = json!({
            "config": plan.config.to_string(),
            "seeds": plan.seeds,
            "learners": plan.learners,
            "settings": settings.collect::<serde_json::Map<_, _>>(),
            "updates": cost.live,
            "forecast_updates_per_check": cost.check,
            "live_updates_per_second": speed.live,
            "forecast_updates_per_second": speed.forecast,
            "seconds": cost.seconds,
        });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
        return Ok(Done::Well);
    }
    writeln!(terminal.out, "{}", plan.to_toml())?;
    for sentence in cost.sentences(plan, &speed) {
        for line in wrap(&sentence, 0, WIDTH - 2).lines() {
            writeln!(terminal.out, "# {line}")?;
        }
    }
    Ok(Done::Well)
}

/// What a run is expected to cost.
struct Cost {
    /// Updates of the live learners of all seeds, at most.
    live: u64,
    /// Updates in the forecasts of one check, at most; none where nobody checks.
    check: Option<u64>,
    /// Time.
    seconds: f64,
}

impl Cost {
    fn of(plan: &Plan, speed: &Speed, threads: usize) -> Self {
        let (config, seeds) = (&plan.config, plan.seeds.len());
        let (safe, full) = (u64::from(config.safe_steps), u64::from(config.full_steps));
        let checks = plan.learners.contains(&Learner::Mc) && config.scheme != Scheme::None;
        Self {
            live: seeds as u64 * (safe + full * plan.learners.len() as u64),
            check: checks.then(|| check_forecasts(config)),
            seconds: speed.wall(plan, seeds, threads),
        }
    }

    /// In words, for people.
    fn sentences(&self, plan: &Plan, speed: &Speed) -> Vec<String> {
        let (config, Speed { live, forecast }) = (&plan.config, speed);
        let (scheme, time) = (config.scheme.name(), rough(self.seconds));
        let mut said = vec![
            format!("Expected cost: {} per seed ({} in all).", config.experiment().cost, plan.seeds.len()),
            format!("At most {} updates of the live learners.", self.live),
        ];
        let here = format!("Here: about {live:.0} updates/s of a live learner");
        match self.check {
            Some(0) => said.push(format!("Checks of the scheme {scheme} make no forecasts.")),
            Some(check) => said.push(format!("Each check: at most {check} updates in its forecasts.")),
            None => said.push("Nothing is checked.".to_owned()),
        }
        if self.check.is_none_or(|check| check == 0) {
            said.extend([format!("{here} (one core)."), format!("About {time}.")]);
            return said;
        }
        said.push(format!("{here}, {forecast:.0} in forecasts (one core)."));
        let rate = config.experiment().check_rate;
        said.push(match config.scheme {
            Scheme::All => format!("About {time}: every step is checked."),
            _ => format!(
                "About {time}, if checks are as frequent as at the paper's setting ({} of steps).",
                percent(Some(rate))
            ),
        });
        said
    }
}

/// Gradient updates per second of a configuration on one core of this machine.
#[derive(Clone, Copy, Debug)]
pub struct Speed {
    /// Of a live learner: both networks, the world, evaluations.
    live: f64,
    /// In forecasts.
    forecast: f64,
}

/// Time of each of the two trials.
const TRIAL: Duration = Duration::from_millis(200);
/// Steps that the first one hardly makes in it.
const TRIAL_STEPS: u32 = 20_000;
/// Evaluations that a phase may have.
const MOST_EVALUATIONS: u32 = 100_000;

impl Speed {
    /// Measures by two short trials.
    pub fn measure(config: &Config) -> Self {
        let mut config = config.clone();
        // The trials skip the steps that update nothing, and the evaluation before them; the first stays in Safe training,
        // where nothing is checked.
        (config.exploration, config.learning_starts) = (config.batch, 0);
        let steps = if config.safe_steps > 0 { config.safe_steps } else { config.full_steps };
        let factor = (TRIAL_STEPS / steps.max(1)).min(100).min(MOST_EVALUATIONS / config.evaluations).max(1);
        (config.safe_steps, config.evaluations) = (steps.max(1) * factor, config.evaluations * factor);
        let mut run = worlds::begin(&config).expect("the plan's world was looked for");
        let mut go_on = |budget| run.poll(Budget(budget), &mut ()).map(|status| (status, run.progress().updates));
        let mut made = go_on(1);
        while matches!(made, Ok((Status::Working, 0))) {
            made = go_on(1);
        }
        let (begun, before) = (Instant::now(), made.map_or(0, |(_, updates)| updates));
        let mut after = before;
        while begun.elapsed() < TRIAL
            && let Ok((Status::Working, updates)) = go_on(16)
        {
            after = updates;
        }
        let live = (after - before).max(1) as f64 / begun.elapsed().as_secs_f64();
        // Straight into a check that takes longer than the trial.
        let mut config = config.with_agent(Learner::Mc);
        (config.safe_steps, config.scheme, config.forecast) = (2 * config.batch, Scheme::All, 1_000_000);
        (config.evaluations, config.evaluation_episodes, config.practice_reward_updates) = (1, 1, config.batch);
        let mut run = worlds::begin(&config).expect("the plan's world was looked for");
        while run.progress().check.is_none() && run.poll(Budget(1), &mut ()).is_ok_and(|status| status != Status::Done)
        {
        }
        let (begun, mut updates) = (Instant::now(), 0.0);
        while begun.elapsed() < TRIAL && run.progress().check.is_some() && run.poll(Budget(16), &mut ()).is_ok() {
            updates += 16.0;
        }
        Self { live, forecast: f64::max(updates, 1.0) / begun.elapsed().as_secs_f64() }
    }

    /// Seconds that some seeds of a plan are expected to take on some threads.
    pub fn wall(&self, plan: &Plan, seeds: usize, threads: usize) -> f64 {
        let live: f64 = plan.expected_updates(0.0).sum();
        let all: f64 = plan.expected_updates(expected_forecasts(&plan.config)).sum();
        let (rounds, last) = (seeds / threads, seeds % threads);
        // Threads that are left over train one of the two futures of a check.
        let shared = if 2 * last <= threads { 2.0 } else { 1.0 };
        let rest = if last == 0 { 0.0 } else { self.of(live, (all - live) / shared) };
        rounds as f64 * self.of(live, all - live) + rest
    }

    /// Seconds that so many updates take.
    pub fn of(&self, live: f64, forecast: f64) -> f64 {
        live / self.live + forecast / self.forecast
    }
}

/// A time to two parts or so: «1h 5m», «3m 20s».
pub fn rough(seconds: f64) -> String {
    let step = if seconds < 600.0 { 1 } else { 60 };
    // Far beyond any run, and no sum of times overflows.
    let whole = (seconds.min(1e15) as u64).div_ceil(step) * step;
    humantime::format_duration(Duration::from_secs(whole.max(1))).to_string()
}
