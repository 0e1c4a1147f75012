//! `mcvl replay`: trains again from the configuration alone and compares, step by step.

use std::io::Write as _;

use clap::Args;
use mcvl::runs::{self, Chain, LedgerLine, Lines, Reference, RunsError, STEP_COLUMNS, SeedDir};
use mcvl::worlds;
use mcvl_core::config::{Config, Learner};
use mcvl_core::record::{Arm, Event, Recorder};
use mcvl_core::run::{Budget, Status};
use mcvl_core::token::Token;

use super::inspect::Found;
use super::terminal::Terminal;
use super::{Done, usage};

/// Arguments of `mcvl replay`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  mcvl replay runs/box-moving#3     compare with the files of the run
  mcvl replay mcvl1.AbCd...         the token that `mcvl explain` prints

Of a run with several seeds, RUN#NUMBER is a check of the first one; name the
folder of another seed for one of its checks.

Exit code: 0 if everything is the same, 4 with the first difference.")]
pub struct ReplayArgs {
    /// Check, like runs/box-moving#17, or a replay token
    #[arg(value_name = "TOKEN|RUN#NUMBER")]
    what: String,
}

/// Re-derives a decision.
pub fn replay(arguments: &ReplayArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let what = arguments.what.as_str();
    // A run may lie in a folder with any name, so a reference is recognised first.
    if what.contains('#') {
        let reference: Reference = what.parse().map_err(super::Usage)?;
        // What differs is found by deriving it again, decision by decision. Only where a ledger does not reach to the
        // check is it for its digest to say why.
        let found = Found::read(&reference, |run, dir| {
            // Where steps are missing, it has to be because they are not written yet.
            if !run.is_finished(dir) {
                run.steps(dir)?;
            }
            match runs::ledger(dir) {
                Ok(lines) if lines.len() >= reference.number as usize => Ok(lines),
                _ => run.ledger(dir),
            }
        })?;
        worlds::available(&found.config)?;
        terminal.note(format_args!("training again from: {}", found.config));
        let expected = Expected::read(&found)?;
        return expected.compare(&found.config, reference.number, what, terminal);
    }
    let token: Token = what.parse().map_err(super::Usage)?;
    if token.config.agent != Learner::Mc {
        usage!("the token is of a run without checks");
    }
    worlds::available(&token.config)?;
    terminal.note(format_args!("training again from: {}", token.config));
    let mut check = None;
    let found = derive(&token.config, token.number, &mut |event| match event {
        Event::Check(record) if record.number == token.number => check = Some(record.clone()),
        _ => {}
    });
    let differs = |what: String, terminal: &mut Terminal| -> anyhow::Result<Done> {
        writeln!(terminal.out, "{} {what}", terminal.paint(31, "DIFFERENT"))?;
        Ok(Done::Mismatch)
    };
    if let Err(error) = found {
        return differs(format!("check {}: the run never comes to it: {error}", token.number), terminal);
    }
    let Some(check) = check else {
        return differs(format!("check {}: the run ends before it", token.number), terminal);
    };
    let line = LedgerLine::seal(&check, "", &mut Chain::start(""));
    writeln!(terminal.out, "#{} {}", check.number, check.sentence())?;
    if line.digest() != token.digest {
        let digests = format!("digest {:016x}, the token says {:016x}", line.digest(), token.digest);
        return differs(format!("check {}: {digests}", token.number), terminal);
    }
    writeln!(terminal.out, "{} the decision was re-derived to the last bit", terminal.paint(32, "SAME"))?;
    Ok(Done::Well)
}

/// Trains from the beginning until the step of check `number` is recorded, or to the end.
fn derive(config: &Config, number: u32, observer: &mut dyn FnMut(&Event)) -> anyhow::Result<()> {
    let mut run = worlds::begin(config)?;
    let mut until = Until { number, step: None, reached: false, observer };
    while !until.reached && run.poll(Budget(64), &mut until)? != Status::Done {}
    Ok(())
}

/// Passes events on until the step of a check. A poll may go on behind it; nothing there was asked for.
struct Until<'a> {
    number: u32,
    step: Option<u32>,
    reached: bool,
    observer: &'a mut dyn FnMut(&Event),
}

impl Recorder for Until<'_> {
    fn record(&mut self, event: &Event) {
        if self.reached {
            return;
        }
        (self.observer)(event);
        match event {
            // The row of the step follows its check: it says what became of the transition.
            Event::Check(check) if check.number == self.number => self.step = Some(check.step),
            Event::Step(step) if step.arm == Arm::Mc => self.reached = self.step == Some(step.step),
            _ => {}
        }
    }
}

/// What the files of a run say, up to a check.
struct Expected {
    steps: Rows,
    /// Whether steps may be missing at the end.
    open: bool,
    lines: std::vec::IntoIter<LedgerLine>,
    chain: Chain,
    tape: Vec<u8>,
    difference: Option<String>,
    steps_compared: usize,
}

impl Expected {
    fn read(found: &Found) -> anyhow::Result<Self> {
        let steps = steps(&found.dir)?;
        let path = found.dir.tape(found.lines.len() as u32);
        let tape = std::fs::read(&path).map_err(RunsError::io("read", &path))?;
        Ok(Self {
            steps,
            open: found.open,
            lines: found.lines.clone().into_iter(),
            chain: Chain::start(&found.config.to_string()),
            tape,
            difference: None,
            steps_compared: 0,
        })
    }

    fn compare(mut self, config: &Config, number: u32, what: &str, terminal: &mut Terminal) -> anyhow::Result<Done> {
        let derived = derive(config, number, &mut |event| self.event(event, number));
        if let (None, Err(error)) = (&self.difference, derived) {
            self.difference = Some(error.to_string());
        }
        if self.difference.is_none() && self.lines.len() > 0 {
            self.difference = Some(format!("check {number}: the run ends before it"));
        }
        match &self.difference {
            Some(difference) => {
                writeln!(terminal.out, "{} {what}: {difference}", terminal.paint(31, "DIFFERENT"))?;
                Ok(Done::Mismatch)
            }
            None => {
                let same = terminal.paint(32, "SAME");
                let steps = self.steps_compared;
                writeln!(terminal.out, "{same} {what}: {steps} steps and {number} checks re-derived to the last bit")?;
                Ok(Done::Well)
            }
        }
    }

    fn event(&mut self, event: &Event, number: u32) {
        if self.difference.is_some() {
            return;
        }
        self.difference = match event {
            Event::Step(step) => {
                let place = format!("step {} of the {} leg", step.step, step.arm.name());
                match self.steps.next().transpose() {
                    Ok(None) if self.open => None,
                    Ok(row) => {
                        self.steps_compared += 1;
                        difference_in_row(&place, row.as_deref(), &runs::step_row(step))
                    }
                    Err(error) => Some(error.to_string()),
                }
            }
            Event::Check(check) => {
                let tape = serde_json::to_vec(&**check).expect("a check is plain data");
                let derived = LedgerLine::seal(check, &runs::sha256(&tape), &mut self.chain);
                let place = format!("check {}", check.number);
                self.lines
                    .next()
                    .map_or_else(
                        || Some(format!("{place}: not in ledger.jsonl")),
                        |line| difference(&place, &line, &derived),
                    )
                    .or_else(|| (check.number == number && tape != self.tape).then(|| format!("{place}: its tape")))
            }
            _ => None,
        };
    }
}

/// Rows of `steps.csv` of the legs that lead to the checks, one at a time: it is the largest file of a run.
type Rows = Box<dyn Iterator<Item = Result<String, RunsError>>>;

fn steps(dir: &SeedDir) -> Result<Rows, RunsError> {
    let path = dir.steps();
    let mut lines = Lines::open(&path)?;
    if lines.next().transpose()?.as_deref() != Some(STEP_COLUMNS) {
        return Err(RunsError::damaged(&path, "does not begin with its columns"));
    }
    let wanted = [Arm::Safe, Arm::Mc].map(|arm| format!("{},", arm.name()));
    Ok(Box::new(
        lines.filter(move |line| line.as_ref().map_or(true, |line| wanted.iter().any(|arm| line.starts_with(arm)))),
    ))
}

/// The first column in which a row is not what it should be.
fn difference_in_row(place: &str, recorded: Option<&str>, derived: &str) -> Option<String> {
    let Some(recorded) = recorded else { return Some(format!("{place}: not in steps.csv")) };
    if recorded == derived {
        return None;
    }
    let cells = recorded.split(',').zip(derived.split(',')).zip(STEP_COLUMNS.split(','));
    let first = cells.into_iter().find(|((was, is), _)| was != is);
    Some(match first {
        Some(((was, is), column)) => format!("{place}: {column} is {was} in steps.csv, {is} re-derived"),
        None => format!("{place}: its row in steps.csv has another number of columns"),
    })
}

/// The first field in which a line is not what it should be.
fn difference(place: &str, recorded: &LedgerLine, derived: &LedgerLine) -> Option<String> {
    if recorded == derived {
        return None;
    }
    let parse = |line: &LedgerLine| serde_json::from_str::<serde_json::Value>(&line.text()).unwrap_or_default();
    let (was, is) = (parse(recorded), parse(derived));
    let fields = is.as_object().into_iter().flatten();
    let first = fields.into_iter().find(|(name, value)| was.get(name.as_str()) != Some(value));
    Some(match first {
        Some((name, value)) => {
            let was = was.get(name.as_str()).map_or("missing".to_owned(), ToString::to_string);
            format!("{place}: {name} is {was} in ledger.jsonl, {value} re-derived")
        }
        None => format!("{place}: its line in ledger.jsonl has other text"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named() {
        let row = "mc,3,1,5,-1,1,0.2,true,false,";
        assert_eq!(difference_in_row("step 3", Some(row), row), None);
        let altered = "mc,3,1,4,-1,1,0.2,true,false,";
        let expected = "step 3: reward_raw is 4 in steps.csv, 5 re-derived";
        assert_eq!(difference_in_row("step 3", Some(altered), row).unwrap(), expected);
        assert_eq!(difference_in_row("step 3", None, row).unwrap(), "step 3: not in steps.csv");
        assert!(difference_in_row("step 3", Some("mc,3"), row).unwrap().contains("number of columns"));

        let line = |verdict: &str| LedgerLine {
            decision: format!("{{\"verdict\":\"{verdict}\"}}"),
            tape: "aa".to_owned(),
            chain: "bb".to_owned(),
        };
        assert_eq!(difference("check 1", &line("accept"), &line("accept")), None);
        let expected = "check 1: verdict is \"refuse\" in ledger.jsonl, \"accept\" re-derived";
        assert_eq!(difference("check 1", &line("refuse"), &line("accept")).unwrap(), expected);
    }
}
