//! A run directory at work: laid out or taken up again, trained until it is finished or somebody says
//! stop, and left in order. `mcvl train` has one session, `mcvl reproduce` one per cell.

use std::fs;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use mcvl::gpu::Gpu;
use mcvl::report::claims::Summary;
use mcvl::runs::{self, Control, Ending, Job, Lock, Manifest, Outcome, Plan, Remote, RunDir, RunSet, RunsError, State};

use super::progress::{Progress, Style};
use super::terminal::{Terminal, say};
use super::usage;

/// Set by the first signal; the second one ends the process.
static STOP: AtomicBool = AtomicBool::new(false);

/// Lets the first Ctrl-C or SIGTERM stop training with the state saved, and the second one abort.
pub fn stop_on_signals() -> anyhow::Result<()> {
    let stop = || {
        if STOP.swap(true, Ordering::Relaxed) {
            process::exit(130);
        }
        say("stopping: saving the state (once more to abort)");
    };
    Ok(ctrlc::set_handler(stop)?)
}

/// Flags of whatever trains.
#[derive(Args)]
pub struct Pace {
    /// Threads: seeds at a time, two for a seed where seeds are fewer; no result depends on it [default: number of cores]
    #[arg(short, long, visible_alias = "threads", value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
    /// Stop after this time with the state saved, like 90s, 10m, 2h; a check under way is begun anew later, so give more
    /// time than one takes (in Reacher at the paper's size, minutes)
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration)]
    max_time: Option<Duration>,
    /// Save the state this often: a kill loses at most about this much work, and the check under way
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration, default_value = "5s")]
    checkpoint_every: Duration,
    /// How progress is shown on stderr
    #[arg(long, value_enum, default_value_t = Style::Auto, value_name = "HOW")]
    progress: Style,
    /// What trains the futures of checks
    #[arg(long, value_enum, default_value_t = BackEnd::Cpu, value_name = "WHAT")]
    backend: BackEnd,
    /// Graphics card whose name contains this (see `mcvl doctor`)
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
}

/// What trains the futures of checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackEnd {
    /// The processor: the same bits everywhere
    Cpu,
    /// A graphics card, or an error
    Gpu,
    /// A graphics card where there is one, and the processor otherwise and if it fails
    Auto,
}

impl Pace {
    /// Threads.
    pub fn threads(&self) -> usize {
        self.jobs.map_or_else(|| thread::available_parallelism().map_or(1, usize::from), usize::from)
    }

    /// The manner of a session that begins now and is continued by the command `resume`.
    pub fn manner(&self, resume: String, remote: Option<Remote>) -> Manner {
        let deadline = self.max_time.and_then(|time| Instant::now().checked_add(time));
        let (threads, checkpoint_every, progress) = (self.threads(), self.checkpoint_every, self.progress);
        Manner {
            threads,
            checkpoint_every,
            deadline,
            progress,
            resume: resume + &self.backend(),
            remote,
            beside: false,
        }
    }

    /// The flags that name what forecasts, for the command that continues.
    fn backend(&self) -> String {
        let name = self.backend.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
        let adapter = self.adapter.as_ref().map_or_else(String::new, |adapter| format!(" --adapter '{adapter}'"));
        if self.backend == BackEnd::Cpu { String::new() } else { format!(" --backend {name}{adapter}") }
    }

    /// Opens what forecasts besides the processor.
    ///
    /// # Errors
    /// If a graphics card is asked for and there is none.
    pub fn remote(&self, terminal: &Terminal) -> anyhow::Result<Option<Remote>> {
        if self.adapter.is_some() && self.backend == BackEnd::Cpu {
            usage!("--adapter names a graphics card: add --backend gpu or --backend auto");
        }
        let open = || Gpu::open(self.adapter.as_deref());
        Ok(match self.backend {
            BackEnd::Cpu => None,
            BackEnd::Gpu => Some(Remote::new(open()?, false)),
            BackEnd::Auto => match open() {
                // Software in place of a card is the processor by a longer way.
                Ok(gpu) if !gpu.adapter().software || self.adapter.is_some() => Some(Remote::new(gpu, true)),
                Ok(gpu) => {
                    terminal.note(format_args!("note: forecasts on the processor: {} is software", gpu.adapter()));
                    None
                }
                Err(error) => {
                    terminal.note(format_args!("note: forecasts on the processor: {error}"));
                    None
                }
            },
        })
    }
}

/// How a session works; no result depends on it.
#[derive(Clone)]
pub struct Manner {
    /// Threads, for seeds and for futures.
    pub threads: usize,
    /// A kill loses at most about this much work, and the check under way.
    pub checkpoint_every: Duration,
    /// When to stop with the state saved.
    pub deadline: Option<Instant>,
    /// How progress is shown.
    pub progress: Style,
    /// The command that continues the work.
    pub resume: String,
    /// Where forecasts go besides the processor.
    pub remote: Option<Remote>,
    /// Other sessions work at the same time: progress in lines that name the folder.
    pub beside: bool,
}

impl Manner {
    /// Says when to save and when to stop.
    pub fn control(&self) -> Control {
        Control::new(self.checkpoint_every, &STOP, self.deadline)
    }
}

/// How a session ended.
pub enum Ended {
    /// Every seed is finished.
    Finished {
        /// The run, read back.
        set: Box<RunSet>,
        /// Its summary.
        summary: Box<Summary>,
        /// It was finished before the session began.
        before: bool,
    },
    /// Stopped on request with the state saved; so many seeds are unfinished.
    Interrupted(usize),
}

/// A run directory that this process may write to, and what is to be done in it.
pub struct Session {
    run: RunDir,
    plan: Plan,
    manifest: Manifest,
    jobs: Vec<runs::ReadyJob>,
    _lock: Lock,
}

impl Session {
    /// Lays out a new run.
    pub fn begin(run: RunDir, plan: Plan, overwrite: bool) -> anyhow::Result<Self> {
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
        manifest.moved_by(plan.config.physics);
        manifest.write(&run, State::Running, &[])?;
        let jobs = jobs(&run, &plan).map(Job::ready).collect();
        Ok(Self { run, plan, manifest, jobs, _lock: lock })
    }

    /// What a run that is to be resumed is about, and its manifest, unless it was killed before it had one.
    pub fn begun(run: &RunDir) -> anyhow::Result<(Plan, Option<Manifest>)> {
        let plan = Plan::read(run)?;
        let manifest = Manifest::of_run(run)?;
        manifest.iter().try_for_each(|manifest| manifest.check_plan(run))?;
        Ok((plan, manifest))
    }

    /// Complains where there is no run to resume.
    pub fn check_begun(run: &RunDir) -> anyhow::Result<()> {
        if !run.is_begun()? {
            usage!("there is no run in {} to resume: leave --resume out to begin one", run.path().display());
        }
        Ok(())
    }

    /// Takes up a run where it stopped, if `fits` says that its plan is the wanted one. Everything is
    /// checked before anything is changed.
    pub fn resume(run: RunDir, fits: impl FnOnce(&Plan) -> anyhow::Result<()>) -> anyhow::Result<Self> {
        Self::check_begun(&run)?;
        let lock = Lock::take(&run)?;
        let (plan, manifest) = Self::begun(&run)?;
        let killed = manifest.as_ref().is_some_and(|manifest| manifest.state == State::Running);
        let mut manifest = manifest.unwrap_or_else(Manifest::begin);
        if killed {
            manifest.forget_time();
        }
        manifest.moved_by(plan.config.physics);
        fits(&plan)?;
        let resume = |job: Job| {
            let finished = manifest.knows(&run, &job.dir);
            job.resume(finished)
        };
        let jobs = jobs(&run, &plan).map(resume).collect::<Result<Vec<_>, _>>()?;
        run.clear_unfinished_writes()?;
        if manifest.state != State::Finished {
            manifest.continued();
            manifest.write(&run, State::Running, &finished_seeds(&jobs))?;
        }
        Ok(Self { run, plan, manifest, jobs, _lock: lock })
    }

    /// The directory.
    pub fn run(&self) -> &RunDir {
        &self.run
    }

    /// What is to be done in it.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Where forecasts of this run go besides the processor; the manifest says so.
    fn remote(&mut self, manner: &Manner, finished: bool, terminal: &Terminal) -> anyhow::Result<Option<Remote>> {
        let Some(remote) = manner.remote.as_ref().filter(|_| !finished) else { return Ok(None) };
        let supported = remote.gpu().supports(&self.plan.config);
        let place = match &supported {
            Ok(()) if remote.gpu().is_exact(&self.plan.config) => {
                format!("{}, with the bits of the processor", remote.gpu().adapter())
            }
            Ok(()) => remote.gpu().adapter().to_string(),
            Err(why) => {
                terminal.note(format_args!("note: forecasts on the processor: {why}"));
                format!("processor: {why}")
            }
        };
        self.manifest.forecasts_on(place);
        self.manifest.write(&self.run, State::Running, &finished_seeds(&self.jobs))?;
        Ok(supported.ok().map(|()| remote.apart()))
    }

    /// Trains to the end or until stopped, and leaves the directory in order.
    pub fn work(mut self, manner: &Manner, terminal: &Terminal) -> anyhow::Result<Ended> {
        // A run that was killed after its last leg still lacks its results.
        let before = self.manifest.state == State::Finished;
        let begun = Instant::now();
        let remote = self.remote(manner, before, terminal)?;
        let folder = self.run.path().file_name().map(|name| name.to_string_lossy().into_owned());
        let name = folder.filter(|_| manner.beside).unwrap_or_else(|| self.plan.config.env.clone());
        let style = if manner.beside { manner.progress.in_lines() } else { manner.progress };
        let mut progress = Progress::new(&self.plan, name, style, terminal);
        let jobs = std::mem::take(&mut self.jobs);
        let outcomes =
            runs::train(jobs, manner.threads, remote.as_ref(), &manner.control(), |views| progress.tick(views));
        progress.finish();
        let fallen = remote.as_ref().map(Remote::fallen).unwrap_or_default();
        if let Some(why) = fallen.first() {
            let seeds = fallen.len();
            terminal.note(format_args!("note: {seeds} of the seeds went on forecasting on the processor: {why}"));
            self.manifest.forecasts_on(format!("processor in {seeds} seeds: {why}"));
        }
        if manner.beside {
            // The clock of sessions side by side counts the others' work, too.
            self.manifest.forget_time();
        } else if !before {
            self.manifest.add_time(begun.elapsed());
        }

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
            let resume = &manner.resume;
            return Err(anyhow::Error::from(error)
                .context(format!("training stopped; what was saved before is intact, continue with `{resume}`")));
        }
        let open = self.plan.seeds.len() - finished.len() - diverged.len();
        if open > 0 {
            diverged.iter().for_each(|error| say(format_args!("error: {error}")));
            self.manifest.write(&self.run, State::Interrupted, &finished)?;
            return Ok(Ended::Interrupted(open));
        }
        let set = RunSet::read(self.run.path())?;
        let summary = Summary::new(&set);
        if !before {
            write_results(&self.run, &set, &summary)?;
            let state = if diverged.is_empty() { State::Finished } else { State::Diverged };
            self.manifest.write(&self.run, state, &finished)?;
        }
        let mut diverged = diverged.into_iter();
        if let Some(first) = diverged.next() {
            diverged.for_each(|other| say(format_args!("error: {other}")));
            return Err(first.into());
        }
        Ok(Ended::Finished { set: Box::new(set), summary: Box::new(summary), before })
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

fn finished_seeds(jobs: &[runs::ReadyJob]) -> Vec<u64> {
    jobs.iter().filter(|job| job.is_finished()).map(runs::ReadyJob::seed).collect()
}

fn write_results(run: &RunDir, set: &RunSet, summary: &Summary) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(summary)? + "\n";
    runs::write_atomic(&run.summary(), json.as_bytes())?;
    super::report::write_curves(run, set)
}
