//! `mcvl train`: from settings to a finished run directory, or one that can be continued.

use std::fs;
use std::io::Write as _;
use std::path::PathBuf;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::Args;
use mcvl::report::claims::Summary;
use mcvl::runs::{
    self, Control, Ending, FileDigest, Job, Lock, Manifest, Outcome, Plan, RunDir, RunSet, RunsError, State,
};
use mcvl::worlds;
use mcvl_core::config::{Learner, Preset};
use mcvl_core::record::{Arm, Verdict};
use mcvl_core::run::{Budget, Status};

use super::progress::{Progress, Style};
use super::settings::{self, Given, Request, Resolved};
use super::terminal::{Terminal, say};
use super::{Done, usage};

/// Arguments of `mcvl train`.
#[derive(Args)]
#[command(after_help = format!("{EXAMPLES}\n\nSee `mcvl train --help` for every setting."))]
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
    /// Several seeds: 0..10 (the end is left out) or 1,5,9
    #[arg(long, value_name = "LIST", value_parser = settings::seeds)]
    seeds: Option<settings::SeedList>,
    /// Seeds at a time; no result depends on it [default: number of cores]
    #[arg(short, long, visible_alias = "threads", value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Source of the defaults: paper or release
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
    /// Stop after this time with the state saved, like 90s, 10m, 2h
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration)]
    max_time: Option<Duration>,
    /// Save the state this often: a kill loses at most about this much work
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration, default_value = "5s")]
    checkpoint_every: Duration,
    /// Exit with 1 unless every claim holds
    #[arg(long)]
    assert_claims: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    /// How progress is shown on stderr
    #[arg(long, value_enum, default_value_t = Style::Auto, value_name = "HOW")]
    progress: Style,
}

const EXAMPLES: &str = "\
Examples:
  mcvl train box-moving                       seed 0, baseline and mc
  mcvl train box-moving --seeds 0..10 -j 4    ten seeds, four at a time
  mcvl train box-moving --set threshold=0.1 -o runs/threshold
  mcvl train box-moving --resume              continue what was stopped";

fn after_long_help() -> String {
    let precedence = "Precedence: defaults < preset < --quick < --config < environment < flags.";
    format!("{EXAMPLES}\n\n{precedence}\n\n{}", settings::list())
}

/// Set by the first signal; the second one ends the process.
static STOP: AtomicBool = AtomicBool::new(false);

/// Trains.
pub fn train(arguments: &TrainArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let resolved = settings::resolve(&arguments.request(), terminal)?;
    let run = RunDir::new(arguments.output.clone().unwrap_or_else(|| settings::default_directory(&arguments.env)));
    let plan = arguments.plan(&resolved);
    if arguments.dry_run {
        return dry_run(arguments, &plan, terminal);
    }
    let stop = || {
        if STOP.swap(true, Ordering::Relaxed) {
            process::exit(130);
        }
        say("stopping: saving the state (once more to abort)");
    };
    ctrlc::set_handler(stop)?;
    let session = if arguments.resume {
        Session::resume(run, &plan, &resolved, arguments)?
    } else {
        Session::begin(arguments.place(run)?, plan, arguments.overwrite)?
    };
    session.work(arguments, terminal)
}

impl TrainArgs {
    fn request(&self) -> Request<'_> {
        let flag = |key: &str, value: String| Given { key: key.to_owned(), value, from: format!("flag --{key}") };
        let mut flags: Vec<Given> = self.set.clone();
        if let [agent] = self.agent[..] {
            flags.push(flag("agent", agent.name().to_owned()));
        }
        flags.extend(self.scheme.as_ref().map(|value| flag("scheme", value.clone())));
        flags.extend(self.variant.as_ref().map(|value| flag("variant", value.clone())));
        flags.extend(self.seed.map(|seed| flag("seed", seed.to_string())));
        flags.extend(self.seeds.as_ref().map(|seeds| flag("seed", seeds[0].to_string())));
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

    /// The directory to begin in, if there is one for a new run.
    fn place(&self, run: RunDir) -> anyhow::Result<RunDir> {
        if run.is_free()? || self.overwrite && run.exists() {
            return Ok(run);
        }
        if self.fresh {
            return Ok(run.next_free()?);
        }
        let (path, fresh) = (run.path().display(), run.next_free()?);
        if !run.exists() {
            usage!("{path} is not empty and holds no run: choose another directory with -o");
        }
        let finished = Manifest::read(&run).is_ok_and(|manifest| manifest.state == State::Finished);
        let state = if finished { "a finished" } else { "an unfinished" };
        usage!(
            "{path} already holds {state} run: --resume continues it, --fresh starts {}, --overwrite deletes it",
            fresh.path().display()
        )
    }

    fn threads(&self) -> usize {
        self.jobs.map_or_else(|| thread::available_parallelism().map_or(1, usize::from), usize::from)
    }

    /// The command that continues this run.
    fn resume_command(&self, run: &RunDir) -> String {
        let place = match run.path() == settings::default_directory(&self.env) {
            true => String::new(),
            false => format!(" -o {}", run.path().display()),
        };
        format!("mcvl train {}{place} --resume", self.env)
    }
}

/// A run directory that this process may write to, and what is to be done in it.
struct Session {
    run: RunDir,
    plan: Plan,
    manifest: Manifest,
    jobs: Vec<runs::ReadyJob>,
    _lock: Lock,
}

impl Session {
    /// Lays out a new run.
    fn begin(run: RunDir, plan: Plan, overwrite: bool) -> anyhow::Result<Self> {
        fs::create_dir_all(run.path()).map_err(RunsError::io("create the folder", run.path()))?;
        let lock = Lock::take(&run)?;
        if overwrite {
            run.clear()?;
        } else if !run.is_free()? {
            // Another process came between the look and the lock.
            usage!("{} was taken by another mcvl a moment ago: choose another directory with -o", run.path().display());
        }
        plan.write(&run)?;
        let mut manifest = Manifest::begin();
        manifest.write(&run, State::Running, &[])?;
        let jobs = jobs(&run, &plan).map(Job::ready).collect();
        Ok(Self { run, plan, manifest, jobs, _lock: lock })
    }

    /// Takes up a run where it stopped. Everything is checked before anything is changed.
    fn resume(run: RunDir, asked: &Plan, resolved: &Resolved, arguments: &TrainArgs) -> anyhow::Result<Self> {
        if !run.exists() {
            usage!("there is no run in {} to resume: leave --resume out to begin one", run.path().display());
        }
        let lock = Lock::take(&run)?;
        let plan = Plan::read(&run)?;
        let mut manifest = match Manifest::read(&run) {
            Ok(manifest) => manifest,
            // Killed between the first two files of a run: nothing was trained yet.
            Err(RunsError::Io { .. }) if !plan.seeds.iter().any(|seed| run.seed(*seed).path().exists()) => {
                Manifest::begin()
            }
            Err(error) => return Err(error.into()),
        };
        if !manifest.is_intact() {
            return Err(RunsError::damaged(&run.manifest(), "was altered: its seal does not fit").into());
        }
        if let Some(expected) = manifest.files.get("run.toml")
            && *expected != FileDigest::of(&run.plan())?
        {
            let why = "was altered since the run began: its digest is not the one in manifest.json";
            return Err(RunsError::damaged(&run.plan(), why).into());
        }
        same_settings(&run, &plan, asked, resolved, arguments)?;
        let jobs = jobs(&run, &plan).map(Job::resume).collect::<Result<Vec<_>, _>>()?;
        if manifest.state != State::Finished {
            manifest.write(&run, State::Running, &finished(&jobs))?;
        }
        Ok(Self { run, plan, manifest, jobs, _lock: lock })
    }

    /// Trains to the end or until stopped, and leaves the directory in order.
    fn work(mut self, arguments: &TrainArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
        // A run that was killed after its last leg still lacks its results.
        let nothing_to_do = self.manifest.state == State::Finished;
        let deadline = arguments.max_time.and_then(|time| Instant::now().checked_add(time));
        let control = Control::new(arguments.checkpoint_every, &STOP, deadline);
        let mut progress = Progress::new(&self.plan, arguments.progress, terminal);
        let jobs = std::mem::take(&mut self.jobs);
        let outcomes = runs::train(jobs, arguments.threads(), &control, |views| progress.tick(views));
        progress.finish();

        let finished: Vec<u64> =
            outcomes.iter().filter(|o| matches!(o.result, Ok(Ending::Finished))).map(|o| o.seed).collect();
        let (mut diverged, mut broken) = (Vec::new(), None);
        for Outcome { result, .. } in outcomes {
            match result {
                Ok(_) => {}
                Err(error @ RunsError::Diverged { .. }) => diverged.push(error),
                Err(error) => broken = broken.or(Some(error)),
            }
        }
        if let Some(error) = broken {
            let resume = arguments.resume_command(&self.run);
            return Err(anyhow::Error::from(error)
                .context(format!("training stopped; what was saved before is intact, continue with `{resume}`")));
        }
        let open = self.plan.seeds.len() - finished.len() - diverged.len();
        if open > 0 {
            self.manifest.write(&self.run, State::Interrupted, &finished)?;
            let seeds = self.plan.seeds.len();
            terminal.note(format_args!("stopped with {open} of {seeds} seeds unfinished; the state is saved"));
            terminal.note(format_args!("continue with: {}", arguments.resume_command(&self.run)));
            return Ok(Done::Interrupted);
        }
        let set = RunSet::read(self.run.path())?;
        let summary = Summary::new(&set);
        if !nothing_to_do {
            write_results(&self.run, &set, &summary)?;
            let state = if diverged.is_empty() { State::Finished } else { State::Diverged };
            self.manifest.write(&self.run, state, &finished)?;
        }
        let mut diverged = diverged.into_iter();
        if let Some(first) = diverged.next() {
            diverged.for_each(|other| terminal.note(format_args!("error: {other}")));
            return Err(first.into());
        }
        self.print(arguments, &set, &summary, nothing_to_do, terminal)?;
        Ok(if arguments.assert_claims && !summary.holds() { Done::DoesNotHold } else { Done::Well })
    }

    fn print(
        &self,
        arguments: &TrainArgs,
        set: &RunSet,
        summary: &Summary,
        nothing_to_do: bool,
        terminal: &mut Terminal,
    ) -> anyhow::Result<()> {
        if arguments.json {
            writeln!(terminal.out, "{}", serde_json::to_string_pretty(summary)?)?;
            return Ok(());
        }
        let path = self.run.path().display();
        if nothing_to_do {
            terminal.note(format_args!("{path} is finished already: nothing to do"));
        }
        writeln!(terminal.out, "{}", summary.text().trim_end())?;
        if self.plan.settings.iter().any(|(_, setting)| setting.from.0 == settings::QUICK_ORIGIN) {
            writeln!(terminal.out, "\nA quick run: fewer steps and shorter forecasts than the paper's setting.")?;
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
}

/// The jobs of a run, one per seed.
fn jobs<'a>(run: &'a RunDir, plan: &'a Plan) -> impl Iterator<Item = Job> + 'a {
    plan.seeds.iter().map(|seed| Job {
        config: plan.config.with_seed(*seed),
        learners: plan.learners.clone(),
        dir: run.seed(*seed),
    })
}

fn finished(jobs: &[runs::ReadyJob]) -> Vec<u64> {
    jobs.iter().filter(|job| job.is_finished()).map(runs::ReadyJob::seed).collect()
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

fn write_results(run: &RunDir, set: &RunSet, summary: &Summary) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(summary)? + "\n";
    runs::write_atomic(&run.summary(), json.as_bytes())?;
    super::report::write_curves(run.path(), "curves", set)?;
    Ok(())
}

/// Shows what a run would be.
fn dry_run(arguments: &TrainArgs, plan: &Plan, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let config = &plan.config;
    let (safe, full) = (u64::from(config.safe_steps), u64::from(config.full_steps));
    let seeds = plan.seeds.len() as u64;
    let updates = seeds * (safe + full * plan.learners.len() as u64);
    write!(terminal.out, "{}", plan.to_toml())?;
    writeln!(terminal.out, "\n# Expected cost: {} per seed ({seeds} in all).", config.experiment().cost)?;
    writeln!(terminal.out, "# At most {updates} updates of the live learners.")?;
    if plan.learners.contains(&Learner::Mc) {
        let check = 2 * u64::from(config.forecast);
        writeln!(terminal.out, "# Each check: at most {check} updates in its two forecasts.")?;
    }
    let speed = speed(plan);
    let seconds = updates as f64 / speed / arguments.threads().min(plan.seeds.len()) as f64;
    writeln!(terminal.out, "# Here: about {speed:.0} updates/s on one core, {seconds:.0} s before the checks.")?;
    Ok(Done::Well)
}

/// Updates per second of this configuration on this machine, from a short trial.
fn speed(plan: &Plan) -> f64 {
    let mut config = plan.config.clone();
    // The trial skips the random steps, which update nothing.
    config.exploration = config.batch;
    let mut run = worlds::begin(&config).expect("the plan's world was looked for");
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_millis(300) && run.poll(Budget(64), &mut ()) == Ok(Status::Working) {}
    run.progress().updates.max(1) as f64 / begun.elapsed().as_secs_f64()
}
