//! Progress on stderr: bars on a terminal, plain lines elsewhere, with an ETA that counts the checks to
//! come.

use std::io::{self, IsTerminal as _};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use mcvl::runs::{Plan, SeedView, expected_forecasts};
use mcvl_core::record::Arm;

use super::terminal::{Terminal, say};

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Style {
    /// Bars on a terminal, plain lines elsewhere.
    Auto,
    /// Bars.
    Bar,
    /// A line after a few seconds, then every 30 seconds.
    Plain,
    /// Nothing.
    None,
}

impl Style {
    /// The same where several displays share stderr, which bars cannot.
    pub fn in_lines(self) -> Self {
        if self == Self::None { self } else { Self::Plain }
    }
}

/// The first plain line comes after this, so that short runs stay silent and long ones are seen alive.
const FIRST_LINE: Duration = Duration::from_secs(3);
const NEXT_LINE: Duration = Duration::from_secs(30);

/// Steps after which a run's own share is believed.
const ENOUGH_STEPS: f64 = 100.0;

/// Share of its work that a seed has done at most before it is over: what a run expects can be too little.
const MOST: f64 = 0.99;

/// Parts of a progress bar: an integer scale, since the bar counts in integers.
const SCALE: f64 = 10_000.0;

enum Display {
    Bars { multi: MultiProgress, total: ProgressBar, seeds: Vec<Option<ProgressBar>> },
    Plain { next: Instant },
    Silent,
}

/// Shows how a training run stands.
pub struct Progress<'a> {
    plan: &'a Plan,
    /// What plain lines begin with.
    name: String,
    display: Display,
    begun: Instant,
    /// Work that was done before: a resumed run is not faster for it.
    before: Option<f64>,
    verbose: bool,
}

impl<'a> Progress<'a> {
    /// A display for the seeds of `plan`.
    pub fn new(plan: &'a Plan, name: String, style: Style, terminal: &Terminal) -> Self {
        let bars = match style {
            Style::Auto => io::stderr().is_terminal(),
            Style::Bar => true,
            Style::Plain | Style::None => false,
        };
        let display = if terminal.quiet || style == Style::None {
            Display::Silent
        } else if bars {
            let multi = MultiProgress::new();
            let total = multi.add(bar("total   {bar:12} {percent:>3} %  {wide_msg}"));
            Display::Bars { multi, total, seeds: Vec::new() }
        } else {
            Display::Plain { next: Instant::now() + FIRST_LINE }
        };
        Self { plan, name, display, begun: Instant::now(), before: None, verbose: terminal.verbose }
    }

    /// Shows how the seeds stand.
    pub fn tick(&mut self, views: &[SeedView]) {
        let (done, total) = views
            .iter()
            .map(|view| work(self.plan, view))
            .fold((0.0, 0.0), |sum, seed| (sum.0 + seed.0, sum.1 + seed.1));
        let before = *self.before.get_or_insert(done);
        let eta = eta(self.begun.elapsed(), done - before, total - done);
        if self.verbose {
            self.decisions(views);
        }
        match &mut self.display {
            Display::Silent => {}
            Display::Plain { next } => {
                if Instant::now() >= *next {
                    *next = Instant::now() + NEXT_LINE;
                    say(plain(&self.name, views, done / total, &eta));
                }
            }
            Display::Bars { multi, total: bar_of_all, seeds } => {
                seeds.resize(views.len(), None);
                for (view, slot) in views.iter().zip(seeds) {
                    show_seed(self.plan, multi, bar_of_all, view, slot);
                }
                bar_of_all.set_position((SCALE * done / total) as u64);
                bar_of_all.set_message(format!("{eta}  (return/performance, refused/checks)"));
            }
        }
    }

    /// Removes the bars.
    pub fn finish(self) {
        if let Display::Bars { multi, .. } = self.display {
            // A terminal that went away is no reason to fail.
            let _ = multi.clear();
        }
    }

    fn decisions(&self, views: &[SeedView]) {
        // Where several displays share stderr, lines say whose they are.
        let whose = if self.name == self.plan.config.env { String::new() } else { format!("{} ", self.name) };
        for view in views {
            for check in &view.decisions {
                let line = format!("{whose}seed {} #{} {}", view.seed, check.number, check.sentence());
                match &self.display {
                    Display::Bars { multi, .. } => multi.suspend(|| say(line)),
                    _ => say(line),
                }
            }
        }
    }
}

fn bar(template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).expect("the templates are valid").progress_chars("=> ");
    ProgressBar::new(SCALE as u64).with_style(style)
}

/// Brings the bar of one seed up to date; it exists while somebody works on the seed.
fn show_seed(plan: &Plan, multi: &MultiProgress, total: &ProgressBar, view: &SeedView, slot: &mut Option<ProgressBar>) {
    if view.over || view.progress.is_none() {
        if let Some(bar) = slot.take() {
            bar.finish_and_clear();
            multi.remove(&bar);
        }
        return;
    }
    let bar =
        slot.get_or_insert_with(|| multi.insert_before(total, bar("{prefix:<8}{bar:12} {percent:>3} %  {wide_msg}")));
    let (done, all) = work(plan, view);
    bar.set_prefix(format!("seed {}", view.seed));
    bar.set_position((SCALE * done / all) as u64);
    bar.set_message(figures(view, true));
}

/// One line about everything.
fn plain(name: &str, views: &[SeedView], share: f64, eta: &str) -> String {
    let mut line = format!("{name}: {:.0} %, {eta}", 100.0 * share);
    for view in views.iter().filter(|view| !view.over && view.progress.is_some()) {
        line.push_str(&format!("; seed {} {}", view.seed, figures(view, false)));
    }
    line
}

/// Leg, step, return, performance, checks, refusals and the share of updates that forecasts took; `short` for a bar, which
/// leaves it 52 columns: the bar of all says what its pairs of numbers are.
fn figures(view: &SeedView, short: bool) -> String {
    let Some(progress) = &view.progress else { return String::new() };
    let mut text = format!("{} {}/{}", progress.arm.name(), progress.step, progress.steps);
    if let Some(point) = &view.evaluation {
        let between = if short { "/" } else { " performance " };
        text.push_str(&format!(" return {:.1}{between}{:.1}", point.observed_return, point.performance));
    }
    if progress.arm == Arm::Mc {
        let (checks, refusals) = (progress.checks, progress.refusals);
        let all = progress.updates + progress.forecast_updates;
        let share = 100.0 * progress.forecast_updates as f64 / (all.max(1)) as f64;
        text.push_str(&if short {
            format!(" refused {refusals}/{checks}")
        } else {
            format!(" checks {checks} refused {refusals} ({share:.0} % forecasting)")
        });
    }
    text
}

/// Work done and work in total, in gradient updates: one per step, and what forecasts take.
fn work(plan: &Plan, view: &SeedView) -> (f64, f64) {
    let mut shown = expected_forecasts(&plan.config);
    let mut current = 0.0;
    if let Some(progress) = &view.progress {
        let step = f64::from(progress.step);
        if progress.arm == Arm::Mc && step >= ENOUGH_STEPS {
            shown = progress.forecast_updates as f64 / step;
        }
        current = step + progress.forecast_updates as f64;
    }
    let legs = plan.expected_updates(shown);
    let total: f64 = legs.clone().sum::<f64>().max(1.0);
    if view.over {
        return (total, total);
    }
    let before: f64 = legs.take(view.finished).sum();
    // What is not over has something to do, however much was expected.
    ((before + current).min(MOST * total), total)
}

/// Time to go at the speed so far, in words.
fn eta(elapsed: Duration, done: f64, left: f64) -> String {
    if done <= 0.0 || elapsed < Duration::from_secs(1) {
        return "ETA …".to_owned();
    }
    let seconds = (elapsed.as_secs_f64() * left / done).ceil();
    // Beyond a year nobody reads the seconds.
    let left = Duration::from_secs(seconds.min(3e7) as u64);
    format!("ETA {}", humantime::format_duration(left))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvl_core::config::{Config, Learner, Preset};

    fn view(finished: usize, arm: Arm, step: u32, forecast_updates: u64) -> SeedView {
        let progress = mcvl_core::run::Progress {
            arm,
            step,
            steps: 1000,
            updates: 5,
            checks: 1,
            refusals: 1,
            forecast_updates,
            check: None,
        };
        SeedView { seed: 0, finished, progress: Some(progress), evaluation: None, decisions: Vec::new(), over: false }
    }

    #[test]
    fn work_counts_the_checks_to_come() {
        let config = Config::new("box-moving", Preset::Paper).unwrap();
        let learners = vec![Learner::Baseline, Learner::Mc];
        let plan = Plan { config, seeds: vec![0], learners, settings: Vec::new() };
        // 1000 steps three times, and 30 checks of 1000 updates expected.
        assert_eq!(work(&plan, &view(0, Arm::Safe, 500, 0)), (500.0, 33_000.0));
        assert_eq!(work(&plan, &view(1, Arm::Baseline, 10, 0)), (1_010.0, 33_000.0));
        // After enough steps its own rate counts: 20 updates per step.
        assert_eq!(work(&plan, &view(2, Arm::Mc, 200, 4_000)), (6_200.0, 23_000.0));
        // More checks than expected are no end.
        assert_eq!(work(&plan, &view(2, Arm::Mc, 99, 90_000)), (0.99 * 33_000.0, 33_000.0));
        let over = SeedView { over: true, ..view(3, Arm::Mc, 1000, 0) };
        let (done, total) = work(&plan, &over);
        assert_eq!(done, total);
    }

    #[test]
    fn remaining_time() {
        assert_eq!(eta(Duration::from_secs(10), 100.0, 50.0), "ETA 5s");
        assert_eq!(eta(Duration::from_millis(10), 1.0, 50.0), "ETA …");
        assert_eq!(eta(Duration::from_secs(10), 0.0, 50.0), "ETA …");
    }
}
