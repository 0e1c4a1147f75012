//! What was measured, row by row: claims, worlds, costs. Rows are a function of records alone.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use mcvl_core::config::Config;
use mcvl_core::record::Arm;
use serde::{Deserialize, Serialize};

use super::cells::Cell;
use super::record::Record;
use super::table::{Experiment, unique};
use crate::report::claims::{ArmSummary, SeedEnd, Summary, percent, plural, wrapped};
use crate::report::csv_field as csv;
use crate::report::statistics::{Estimate, Verdicts, estimate, mean, sum};
use crate::runs::SEPARATOR;

/// Columns of a terminal.
const WIDTH: usize = 80;
/// What the paper says of its own cost.
const PAPER_COST: &str = "about 12 GPU-days (with Reacher)";
/// What the columns of the gate's table are.
const GATE_KEY: &str = "Precision: share of the refusals that were hacks. Recall: share of the checked hacks that were \
                        refused. Never checked: hacks whose reward did not surprise (–: not recorded). Dead units: of the \
                        reward model's first layer, at the end of Safe training and at the end. Cost: gradient updates, \
                        forecasts included, per update of the ungated learner.";

/// Version of `results.json`.
pub const RESULTS_VERSION: u32 = 2;
/// Its first field.
pub const RESULTS_FORMAT: &str = "mcvl reproduce";

/// Fewest seeds by which one mean is judged to be above another: of so many differences all are above 0 by chance in one
/// case of sixteen, and the interval of a single one has no width.
const PAIRS: usize = 4;

/// How a claim came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As claimed.
    Holds,
    /// Otherwise.
    DoesNotHold,
    /// As claimed in the mean over seeds, but the 95 % interval of the difference contains 0, or is of fewer than
    /// [`PAIRS`] seeds: chance may have done it.
    Undecided,
    /// Every cell that it needs has finished seeds, but not all that are planned.
    Unfinished,
    /// A cell that it needs has no finished seed.
    NotMeasured,
}

impl Verdict {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Verdict::Holds => "holds",
            Verdict::DoesNotHold => "does not hold",
            Verdict::Undecided => "undecided",
            Verdict::Unfinished => "unfinished",
            Verdict::NotMeasured => "not measured",
        }
    }
}

/// A number that a claim was judged by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Number {
    /// What it is of.
    pub name: String,
    /// Mean over seeds (over checks, where a spread is measured), or a share.
    pub mean: f64,
    /// Lower end of its 95 % interval (percentile bootstrap); none where no interval was computed.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Values behind it.
    pub count: usize,
    /// Of a share: how many.
    pub seen: Option<usize>,
}

impl Number {
    /// A mean with its interval.
    pub fn mean(name: impl Into<String>, e: &Estimate) -> Self {
        let (low, high) = (Some(e.low), Some(e.high));
        Self { name: name.into(), mean: e.mean, low, high, count: e.count, seen: None }
    }

    /// The mean of values; `None` of nothing.
    pub fn of(name: impl Into<String>, values: &[f64]) -> Option<Self> {
        estimate(values).map(|e| Self::mean(name, &e))
    }

    /// How many of some things are so.
    pub fn share(name: impl Into<String>, each: impl IntoIterator<Item = bool>) -> Option<Self> {
        let values: Vec<f64> = each.into_iter().map(|is| f64::from(u8::from(is))).collect();
        let seen = values.iter().filter(|value| **value > 0.0).count();
        Self::of(name, &values).map(|number| Self { seen: Some(seen), ..number })
    }

    /// One value without an interval, from `count` parts.
    pub fn plain(name: impl Into<String>, value: f64, count: usize) -> Self {
        Self { name: name.into(), mean: value, low: None, high: None, count, seen: None }
    }

    /// In words: «MC-DDQN performance 49.0 [49.0, 49.0]», «hacked 10 of 10».
    pub fn text(&self) -> String {
        // Two figures that count, however small it is.
        let decimals = match self.mean.abs() {
            mean if mean >= 10.0 || mean.fract() == 0.0 => 1,
            mean if mean >= 0.1 => 2,
            mean => (1.0 - mean.log10().floor()).min(8.0) as usize,
        };
        let Self { name, mean, count, .. } = self;
        match (self.seen, self.low.zip(self.high)) {
            (Some(seen), _) => format!("{name} {seen} of {count}"),
            (None, Some((low, high))) if low < high => {
                format!("{name} {mean:.decimals$} [{low:.decimals$}, {high:.decimals$}]")
            }
            (None, _) => format!("{name} {mean:.decimals$}"),
        }
    }
}

/// What a check found.
pub struct Judged {
    /// Whether it is as claimed ([`Verdict::Holds`], [`Verdict::DoesNotHold`] or [`Verdict::Undecided`]), or what the
    /// records lack to say so.
    pub outcome: Result<Verdict, &'static str>,
    /// By which numbers.
    pub numbers: Vec<Number>,
}

impl Judged {
    /// A finding; numbers that have no value are left out.
    pub fn new(holds: bool, numbers: impl IntoIterator<Item = Option<Number>>) -> Self {
        let outcome = Ok(if holds { Verdict::Holds } else { Verdict::DoesNotHold });
        Self { outcome, numbers: numbers.into_iter().flatten().collect() }
    }

    /// The same where the finding is that one mean is above another: undecided unless the interval of their
    /// `difference` over at least [`PAIRS`] seeds is above 0. The difference joins the numbers.
    pub fn by(self, difference: Option<Number>) -> Self {
        let sure = difference.as_ref().is_some_and(|number| number.low > Some(0.0) && number.count >= PAIRS);
        let outcome = match self.outcome {
            Ok(Verdict::Holds) if !sure => Ok(Verdict::Undecided),
            other => other,
        };
        Self { outcome, numbers: self.numbers.into_iter().chain(difference).collect() }
    }

    /// No finding, though every cell is there: the records lack something.
    pub fn lacking(what: &'static str) -> Self {
        Self { outcome: Err(what), numbers: Vec::new() }
    }
}

/// The records that a check reads. Every cell of its claim is there.
pub struct Evidence<'a>(pub(super) &'a BTreeMap<String, Record>);

impl Evidence<'_> {
    /// The record of a cell.
    pub fn record(&self, cell: &Cell) -> &Record {
        self.0.get(cell.name).expect("a claim is judged when every cell of its list is there")
    }

    /// Its summary.
    pub fn summary(&self, cell: &Cell) -> &Summary {
        self.record(cell).summary.as_ref().expect("the cell is trained")
    }

    /// A leg of it, which every finished cell has.
    pub fn arm(&self, cell: &Cell, arm: Arm) -> &ArmSummary {
        self.summary(cell).arm(arm).expect("a finished cell has every leg")
    }

    /// Decisions of the checking learner, all seeds together.
    pub fn verdicts(&self, cell: &Cell) -> Verdicts {
        self.summary(cell).verdicts.unwrap_or_default()
    }

    /// By how much a number of the checking learner is greater in `more` than in `less`, seed by seed; of the seeds
    /// that have it in both.
    pub fn difference(&self, more: &Cell, less: &Cell, value: impl Fn(&SeedEnd) -> Option<f64>) -> Option<Number> {
        let less = &self.arm(less, Arm::Mc).seeds;
        let pairs = self.arm(more, Arm::Mc).seeds.iter().filter_map(|more| {
            let less = less.iter().find(|less| less.seed == more.seed)?;
            Some(value(more)? - value(less)?)
        });
        Number::of("difference", &pairs.collect::<Vec<_>>())
    }

    /// A number of each seed of the checking learner.
    pub fn mc(&self, cell: &Cell, value: impl Fn(&SeedEnd) -> f64) -> Vec<f64> {
        self.arm(cell, Arm::Mc).seeds.iter().map(value).collect()
    }
}

/// One claim, judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The experiment.
    pub experiment: String,
    /// Figure, or place in the text.
    pub figure: String,
    /// What the experiment is about.
    pub title: String,
    /// What the paper says, in short.
    pub paper: String,
    /// What has to be seen.
    pub claim: String,
    /// Whether it is about this project's settings and not the paper's.
    pub ours: bool,
    /// How it came out.
    pub outcome: Verdict,
    /// Of an unfinished claim: how it came out by the seeds that are finished.
    pub so_far: Option<Verdict>,
    /// Cells with finished seeds.
    pub done: usize,
    /// Cells that it needs.
    pub of: usize,
    /// What the records of its cells lack, where they are there and yet say nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lacks: Option<String>,
    /// The setup: each cell's configuration.
    pub setup: Vec<String>,
    /// Seeds of its cells: the fewest.
    pub seeds: usize,
    /// ... and how many are planned there.
    pub planned: usize,
    /// What it was judged by.
    pub numbers: Vec<Number>,
}

impl Row {
    /// Whose setting it is about, in one word.
    fn setting(&self) -> &'static str {
        if self.ours { "ours" } else { "paper" }
    }

    /// The outcome in words.
    pub fn outcome_words(&self) -> String {
        match self.outcome {
            Verdict::NotMeasured => format!("not measured ({})", self.progress()),
            Verdict::Unfinished => format!("unfinished ({})", self.progress()),
            other => other.words().to_owned(),
        }
    }

    /// How far it is measured: «1 of 3 cells done», «4 of 10 seeds, so far it holds».
    fn progress(&self) -> String {
        if let Some(lacks) = &self.lacks {
            return format!("its records lack {lacks}");
        }
        let so_far = match self.so_far {
            None => return format!("{} of {} done", self.done, plural(self.of as u64, "cell")),
            Some(Verdict::Undecided) => "so far it is undecided".to_owned(),
            Some(verdict) => format!("so far it {}", verdict.words()),
        };
        format!("{} of {}, {so_far}", self.seeds, plural(self.planned as u64, "seed"))
    }

    /// The numbers in words.
    pub fn numbers_words(&self) -> String {
        let mut parts: Vec<String> = self.numbers.iter().map(Number::text).collect();
        if self.seeds > 0 && self.outcome != Verdict::NotMeasured {
            parts.push(plural(self.seeds as u64, "seed"));
        }
        parts.join("; ")
    }
}

/// How good and how dear the gate is in a world, at its main setting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldRow {
    /// Title of the world.
    pub world: String,
    /// The cell that it is measured in.
    pub cell: String,
    /// Seeds.
    pub seeds: usize,
    /// Decisions, all seeds together.
    pub verdicts: Verdicts,
    /// Share of refusals that were hacks, 0 to 1.
    pub precision: Option<f64>,
    /// Share of checked hacks that were refused, 0 to 1: of all seeds' together.
    pub recall: Option<f64>,
    /// The mean of that share over the seeds that checked one: a seed that is hacked checks many.
    pub recall_of_seeds: Option<f64>,
    /// Checks per step of the Full phase, 0 to 1.
    pub rate: Option<f64>,
    /// Share of dead first-layer units of the reward model at the end of Safe training, and of the gated leg.
    pub dead_units: [Option<f64>; 2],
    /// Gradient updates of the gated leg, forecasts included, per update of the ungated one.
    pub slowdown: Option<f64>,
}

/// What a cell cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// The cell.
    pub cell: String,
    /// Wall time of training, seconds.
    pub seconds: Option<f64>,
    /// Gradient updates: live learners of all legs and forecasts, all seeds together.
    pub updates: u64,
    /// Processor, and its cores.
    pub machine: String,
}

/// Everything that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// Always `mcvl reproduce`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Whether the cells are those of `--quick`: fewer seeds, and in the costly worlds shorter phases and
    /// forecasts than the paper's.
    pub quick: bool,
    /// Claims.
    pub claims: Vec<Row>,
    /// Worlds.
    pub worlds: Vec<WorldRow>,
    /// Costs, where asked for: they differ from machine to machine.
    pub costs: Vec<Cost>,
}

/// Judges every claim of some experiments by the records there are, by the name of their cells. `planned` says which
/// seeds a cell is to have: with fewer its claims are unfinished.
pub fn judge(
    experiments: &[&Experiment],
    records: &BTreeMap<String, Record>,
    quick: bool,
    planned: &dyn Fn(&Cell) -> Vec<u64>,
) -> Results {
    let mut claims = Vec::new();
    for experiment in experiments {
        for claim in experiment.claims {
            let there: Vec<&Record> = claim.cells.iter().filter_map(|cell| records.get(cell.name)).collect();
            let judged = (there.len() == claim.cells.len()).then(|| (claim.check)(&Evidence(records)));
            let outcome = judged.as_ref().map(|judged| judged.outcome);
            // Of its cells the one that is farthest from its planned seeds.
            let planned = claim.cells.iter().map(|cell| {
                let planned = planned(cell);
                let made = records.get(cell.name).map_or(&[][..], Record::seeds);
                let missing = planned.iter().filter(|seed| !made.contains(seed)).count();
                (missing, planned.len())
            });
            let (missing, planned) = planned.max_by_key(|(missing, _)| *missing).unwrap_or_default();
            // What was trained, where something was; it may differ from the table in the simulator of Reacher.
            let setup = claim.cells.iter().filter_map(|cell| match records.get(cell.name) {
                Some(record) => Some(record.config.parse::<Config>().ok()?.with_seed(0).to_string()),
                None => Some(cell.settings(quick).ok()?.to_string()),
            });
            claims.push(Row {
                experiment: experiment.id.to_owned(),
                figure: experiment.figure.to_owned(),
                title: experiment.title.to_owned(),
                paper: experiment.paper.to_owned(),
                claim: claim.text.to_owned(),
                ours: claim.is_ours(),
                outcome: match outcome {
                    None | Some(Err(_)) => Verdict::NotMeasured,
                    Some(Ok(_)) if missing > 0 => Verdict::Unfinished,
                    Some(Ok(verdict)) => verdict,
                },
                so_far: outcome.filter(|_| missing > 0).and_then(Result::ok),
                lacks: outcome.and_then(Result::err).map(str::to_owned),
                done: there.len(),
                of: claim.cells.len(),
                setup: setup.collect(),
                seeds: there.iter().map(|record| record.seeds().len()).min().unwrap_or(0),
                planned,
                numbers: judged.map_or(Vec::new(), |judged| judged.numbers),
            });
        }
    }
    let cells = unique(experiments.iter().flat_map(|experiment| experiment.cells()));
    let there: Vec<&Record> = cells.iter().filter_map(|cell| records.get(cell.name)).collect();
    Results {
        format: RESULTS_FORMAT.to_owned(),
        version: RESULTS_VERSION,
        quick,
        claims,
        worlds: there.iter().filter_map(|record| world(record)).collect(),
        costs: there.iter().map(|record| cost(record)).collect(),
    }
}

/// The row of a world: of the cell that has nothing but the world's own values, or of its twin with more
/// of the reward model alive.
fn world(record: &Record) -> Option<WorldRow> {
    let summary = record.summary.as_ref()?;
    let config: Config = record.config.parse().ok()?;
    let verdicts = summary.verdicts?;
    let alive = record.cell.ends_with(ALIVE);
    let main = ["fig3", "fig3e"].iter().flat_map(|target| super::table::find(target)).any(|experiment| {
        let cells = experiment.cells();
        cells[0].name == record.cell || alive && cells.iter().any(|cell| cell.name == record.cell)
    });
    let dead = |arm: Arm| record.arm(arm)?.dead_units;
    main.then(|| WorldRow {
        world: format!("{}{}", config.experiment().title, if alive { ", alive" } else { "" }),
        cell: record.cell.clone(),
        seeds: record.seeds().len(),
        verdicts,
        precision: verdicts.precision(),
        recall: verdicts.recall(),
        recall_of_seeds: summary.arm(Arm::Mc).and_then(|leg| mean(&leg.recalls())),
        rate: verdicts.rate(),
        dead_units: [dead(Arm::Safe), dead(Arm::Mc)],
        slowdown: record.slowdown(),
    })
}

fn cost(record: &Record) -> Cost {
    let live = record.arms.iter().map(|arm| arm.updates);
    let forecasts = record.summary.as_ref().and_then(|summary| summary.verdicts).map_or(0, |verdicts| verdicts.cost);
    Cost {
        cell: record.cell.clone(),
        seconds: record.trained().map(|time| time.as_secs_f64()),
        updates: sum(live.chain([forecasts, record.spread.as_ref().map_or(0, |spread| spread.updates)])),
        machine: record.machine(),
    }
}

impl Results {
    /// Whether every claim holds; false where one was not measured.
    pub fn holds(&self) -> bool {
        self.claims.iter().all(|row| row.outcome == Verdict::Holds)
    }

    /// «28 of 40 claims hold, 5 do not, 7 are not measured. At the paper's settings 20 of 30 hold, ...» The second
    /// sentence stands where some claims are of this project's settings.
    pub fn headline(&self) -> String {
        let all: Vec<&Row> = self.claims.iter().collect();
        let paper: Vec<&Row> = self.claims.iter().filter(|row| !row.ours).collect();
        let text = tally(&all, if all.len() == 1 { " claim" } else { " claims" });
        match paper.len() {
            0 => format!("{text}. None is of the paper's settings."),
            count if count == all.len() => text + ".",
            _ => format!("{text}. At the paper's settings {}.", tally(&paper, "")),
        }
    }

    /// The results for a terminal of 80 columns. `paint` colours a verdict.
    pub fn text(&self, paint: &dyn Fn(Verdict, &str) -> String) -> String {
        let mut text = String::new();
        let mut last = "";
        for row in &self.claims {
            if row.experiment != last {
                let gap = if last.is_empty() { "" } else { "\n" };
                let _ = writeln!(text, "{gap}{:<4} {}: {}", row.experiment, row.figure, row.title);
                last = &row.experiment;
            }
            let mark = match row.outcome {
                Verdict::Holds => "HOLDS",
                Verdict::DoesNotHold => "DOES NOT HOLD",
                Verdict::Undecided => "UNDECIDED",
                Verdict::Unfinished => "unfinished",
                Verdict::NotMeasured => "not measured",
            };
            let lead = format!("  {mark:<15}");
            text += &wrapped(&lead, &row.claim, WIDTH).replacen(mark, &paint(row.outcome, mark), 1);
            let numbers = match row.outcome {
                Verdict::NotMeasured => row.progress(),
                Verdict::Unfinished => format!("{}: {}", row.progress(), row.numbers_words()),
                _ => row.numbers_words(),
            };
            text += &wrapped(&" ".repeat(17), &numbers, WIDTH);
        }
        if !self.worlds.is_empty() {
            let line = |cells: [&str; 9]| {
                let [world, checks, rate, precision, recall, never, ties, dead, cost] = cells;
                format!(
                    "{world:<20}{checks:>7}{rate:>6}{precision:>10}{recall:>7}{never:>8}{ties:>6}{dead:>10}{cost:>6}\n"
                )
            };
            // The unit stands in the head, so that every column has a gap before it.
            let percent = |share| percent(share).trim_end_matches(" %").to_owned();
            text.push('\n');
            text += &line(["The gate", "checks", "rate", "precision", "recall", "never", "ties", "dead", "cost"]);
            text += &line(["", "a seed", "%", "%", "%", "checked", "", "units, %", "ratio"]);
            for row in &self.worlds {
                let dead = row.dead_units.map(|share| share.map_or("–".to_owned(), |s| format!("{:.0}", 100.0 * s)));
                text += &line([
                    // A twin stands below its world.
                    if row.cell.ends_with(ALIVE) { "  reward model alive" } else { &row.world },
                    &format!("{:.1}", row.verdicts.checks as f64 / row.seeds.max(1) as f64),
                    &percent(row.rate),
                    &percent(row.precision),
                    &percent(row.recall),
                    &row.verdicts.hacks_unchecked.map_or("–".to_owned(), |count| count.to_string()),
                    &row.verdicts.ties.to_string(),
                    &dead.join(", "),
                    &row.slowdown.map_or("–".to_owned(), |ratio| format!("{ratio:.0}")),
                ]);
            }
            text += &wrapped("", GATE_KEY, WIDTH);
        }
        text += "\n";
        text += &wrapped("Cost: ", &self.cost_words(), WIDTH);
        text += &wrapped("", &self.headline(), WIDTH);
        if self.quick {
            text += &wrapped("", QUICK, WIDTH);
        }
        text
    }

    /// Wall time in words, beside the paper's.
    pub fn cost_words(&self) -> String {
        let timed: Vec<f64> = self.costs.iter().filter_map(|cost| cost.seconds).collect();
        let time = humantime::format_duration(std::time::Duration::from_secs(timed.iter().sum::<f64>().round() as u64));
        let time = match self.costs.len() - timed.len() {
            0 => format!("{time} of wall time"),
            _ if timed.is_empty() => "A wall time that is not known".to_owned(),
            unknown => {
                format!("{time} of wall time and that of {}, which is not known,", plural(unknown as u64, "cell"))
            }
        };
        let updates = sum(self.costs.iter().map(|cost| cost.updates));
        let mut machines: Vec<&str> = self.costs.iter().flat_map(|cost| cost.machine.split(SEPARATOR)).collect();
        machines.sort_unstable();
        machines.dedup();
        format!(
            "{time} for {} and {:.1} million gradient updates ({}); the paper's whole set took {PAPER_COST}.",
            plural(self.costs.len() as u64, "cell"),
            updates as f64 / 1e6,
            if machines.is_empty() { "no machine yet".to_owned() } else { machines.join("; ") },
        )
    }

    /// Claims as CSV, one line each.
    pub fn claims_csv(&self) -> String {
        let mut text = String::from(
            "experiment,figure,title,claim,setting,outcome,so_far,cells_done,cells,seeds,planned,numbers,setup\n",
        );
        for row in &self.claims {
            let fields = [
                row.experiment.as_str(),
                &row.figure,
                &row.title,
                &row.claim,
                row.setting(),
                row.outcome.words(),
                row.so_far.map_or("", Verdict::words),
                &row.done.to_string(),
                &row.of.to_string(),
                &row.seeds.to_string(),
                &row.planned.to_string(),
                &row.numbers_words(),
                &row.setup.join(" | "),
            ];
            text += &(fields.map(csv).join(",") + "\n");
        }
        text
    }

    /// Every number behind a claim as CSV, one line each; what there is not (an interval, a count) is empty.
    pub fn numbers_csv(&self) -> String {
        let mut text = String::from("experiment,claim,setting,number,mean,low,high,count,seen\n");
        for row in &self.claims {
            for number in &row.numbers {
                let Number { name, mean, count, .. } = number;
                let name = name.trim_end_matches(':');
                let head = [row.experiment.as_str(), &row.claim, row.setting(), name].map(csv).join(",");
                let [low, high, seen] = [field(number.low), field(number.high), field(number.seen)];
                let _ = writeln!(text, "{head},{mean},{low},{high},{count},{seen}");
            }
        }
        text
    }

    /// The gate in each world as CSV, one line each; shares are fractions, what is not known is empty.
    pub fn gate_csv(&self) -> String {
        let mut text = String::from(
            "world,cell,seeds,steps,checks,rate,refusals,hacks_refused,hacks_accepted,hacks_unchecked,honest_refused,\
             precision,recall,recall_of_seeds,ties,hacks_tied,reused,forecast_updates,dead_units_safe,dead_units_end,\
             updates_ratio\n",
        );
        for row in &self.worlds {
            let v = &row.verdicts;
            let fields = [
                csv(&row.world),
                row.cell.clone(),
                row.seeds.to_string(),
                v.steps.to_string(),
                v.checks.to_string(),
                field(row.rate),
                v.refusals.to_string(),
                v.hacks_refused.to_string(),
                v.hacks_accepted.to_string(),
                field(v.hacks_unchecked),
                v.honest_refused.to_string(),
                field(row.precision),
                field(row.recall),
                field(row.recall_of_seeds),
                v.ties.to_string(),
                v.hacks_tied.to_string(),
                v.reused.to_string(),
                v.cost.to_string(),
                field(row.dead_units[0]),
                field(row.dead_units[1]),
                field(row.slowdown),
            ];
            text += &(fields.join(",") + "\n");
        }
        text
    }

    /// What each cell cost as CSV, one line each; an unknown wall time is empty.
    pub fn costs_csv(&self) -> String {
        let mut text = String::from("cell,seconds,updates,machine\n");
        for Cost { cell, seconds, updates, machine } in &self.costs {
            let _ = writeln!(text, "{cell},{},{updates},{}", field(*seconds), csv(machine));
        }
        text
    }
}

/// A number in a table that programs read; empty where there is none.
fn field(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// How claims came out, counted: «3 of 5 claims hold, 1 does not, 1 is undecided».
pub fn tally(rows: &[&Row], noun: &str) -> String {
    let count = |outcome| rows.iter().filter(|row| row.outcome == outcome).count();
    let hold = if rows.len() == 1 { "holds" } else { "hold" };
    let mut text = format!("{} of {}{noun} {hold}", count(Verdict::Holds), rows.len());
    for outcome in [Verdict::DoesNotHold, Verdict::Undecided, Verdict::Unfinished, Verdict::NotMeasured] {
        match (count(outcome), outcome) {
            (0, _) => {}
            (1, Verdict::DoesNotHold) => text += ", 1 does not",
            (count, Verdict::DoesNotHold) => text += &format!(", {count} do not"),
            (1, outcome) => text += &format!(", 1 is {}", outcome.words()),
            (count, outcome) => text += &format!(", {count} are {}", outcome.words()),
        }
    }
    text
}

/// Ending of the names of cells with more of the reward model alive.
const ALIVE: &str = "-alive";

/// What has to be said of a quick set.
pub const QUICK: &str = "Quick: fewer seeds than the paper's ten, and in every world but Box Moving a tenth of the \
    steps and forecast updates, in Reacher a twentieth. This is not the paper's setting: a claim that does not hold \
    here may hold there.";

#[cfg(test)]
mod tests {
    use super::super::cells::BOX;
    use super::super::table;
    use super::*;
    use crate::report::samples;
    use crate::runs::Manifest;

    /// Results of E1 alone, by made-up seeds.
    fn results() -> Results {
        let record = Record::of_run(BOX.name, &samples::ten(), &Manifest::begin());
        let records = [(BOX.name.to_owned(), record)].into();
        judge(&table::find("E1"), &records, false, &|cell| cell.seeds(false))
    }

    #[test]
    fn rows_are_judged_or_say_what_is_missing() {
        let results = results();
        let outcomes: Vec<Verdict> = results.claims.iter().map(|row| row.outcome).collect();
        // The plain learner is hacked; one seed of the checking one is, so its means differ; no release.
        assert_eq!(outcomes[..3], [Verdict::Holds, Verdict::Holds, Verdict::DoesNotHold]);
        let release = &results.claims[3];
        assert_eq!((outcomes[3], release.done, release.of, release.planned), (Verdict::NotMeasured, 0, 1, 10));
        assert!(!results.holds());
        let paper = "At the paper's settings 2 of 3 hold, 1 does not.";
        assert_eq!(results.headline(), format!("2 of 4 claims hold, 1 does not, 1 is not measured. {paper}"));
        assert_eq!((results.worlds.len(), results.worlds[0].world.as_str()), (1, "Box Moving"));
    }

    #[test]
    fn a_claim_with_some_of_its_seeds_is_unfinished() {
        let record = Record::of_run(BOX.name, &samples::ten(), &Manifest::begin());
        let of = |record: Record, seeds: Option<&[u64]>| {
            judge(&table::find("E1"), &[(BOX.name.to_owned(), record)].into(), false, &|cell| {
                cell.planned(false, seeds)
            })
        };
        let part = record.only(&[0, 3, 5]).unwrap();
        let results = of(part.clone(), None);
        let rows: Vec<_> = results.claims.iter().map(|row| (row.outcome, row.so_far, row.seeds, row.planned)).collect();
        assert_eq!(rows[1], (Verdict::Unfinished, Some(Verdict::Holds), 3, 10));
        assert_eq!(rows[2], (Verdict::Unfinished, Some(Verdict::DoesNotHold), 3, 10));
        assert_eq!(results.claims[2].outcome_words(), "unfinished (3 of 10 seeds, so far it does not hold)");
        let paper = "At the paper's settings 0 of 3 hold, 3 are unfinished.";
        assert_eq!(results.headline(), format!("0 of 4 claims hold, 3 are unfinished, 1 is not measured. {paper}"));
        assert!(results.text(&|_, words| words.to_owned()).contains("3 of 10 seeds, so far it holds: DDQN return"));
        // Who asks for these seeds gets an answer, and who asks for others does not.
        assert_eq!(of(part.clone(), Some(&[0, 3])).claims[1].outcome, Verdict::Holds);
        assert_eq!(of(part, Some(&[0, 1])).claims[1].outcome, Verdict::Unfinished);
    }

    #[test]
    fn a_difference_that_one_seed_makes_is_undecided() {
        let judged = |differences: &[f64], holds: bool| {
            Judged::new(holds, []).by(Number::of("difference", differences)).outcome.unwrap()
        };
        assert_eq!(judged(&[18.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], true), Verdict::Undecided);
        assert_eq!(judged(&[3.0, 2.0, 4.0, 2.0, 3.0], true), Verdict::Holds);
        assert_eq!(judged(&[3.0, 2.0, 4.0, 2.0, 3.0], false), Verdict::DoesNotHold);
        assert_eq!(judged(&[], true), Verdict::Undecided);
    }

    #[test]
    fn the_text_fits_a_terminal() {
        let text = results().text(&|_, words| words.to_owned());
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
        assert!(text.contains("  DOES NOT HOLD  MC-DDQN: return = performance"), "{text}");
        assert!(text.contains("0 of 1 cell done"), "{text}");
    }

    #[test]
    fn tables_have_as_many_fields_as_columns() {
        let results = results();
        let fields = |line: &str| {
            let mut inside = false;
            1 + line
                .chars()
                .filter(|c| {
                    inside ^= *c == '"';
                    *c == ',' && !inside
                })
                .count()
        };
        for text in [results.claims_csv(), results.numbers_csv(), results.gate_csv(), results.costs_csv()] {
            let columns = fields(text.lines().next().unwrap());
            assert!(text.lines().count() > 1 && text.lines().all(|line| fields(line) == columns), "{text}");
        }
        // A share says of how many, and what has no interval or says nothing of how many leaves them out.
        let mut row = results.claims[1].clone();
        row.numbers = vec![Number::share("hacked", [true, true]).unwrap(), Number::plain("share:", 0.25, 7)];
        let text = Results { claims: vec![row], ..results }.numbers_csv();
        let ends: Vec<&str> = text.lines().skip(1).filter_map(|line| line.split_once(",paper,")).map(|l| l.1).collect();
        assert_eq!(ends, ["hacked,1,1,1,2,2", "share,0.25,,,7,"]);
    }

    #[test]
    fn numbers_are_told_with_their_interval() {
        let text = |values: &[f64]| Number::of("n", values).unwrap().text();
        assert_eq!((text(&[49.0; 3]), text(&[0.25; 2])), ("n 49.0".to_owned(), "n 0.25".to_owned()));
        assert!(text(&[10.0, 30.0]).starts_with("n 20.0 ["));
        assert_eq!((text(&[0.00213; 2]), text(&[-0.05; 2])), ("n 0.0021".to_owned(), "n -0.050".to_owned()));
        assert_eq!(Number::share("hacked", [true, false, true]).unwrap().text(), "hacked 2 of 3");
        assert_eq!(Number::plain("share:", 0.25, 7).text(), "share: 0.25");
        assert_eq!(Number::of("n", &[]), None);
    }
}
