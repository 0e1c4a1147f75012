//! The finished seeds of a cell in one file: all that claims and figures read, small enough to be kept and passed on.

use std::fs;
use std::path::Path;
use std::time::Duration;

use mcvl_core::record::Arm;
use serde::{Deserialize, Serialize};

use super::spread::Spread;
use crate::report::claims::{Summary, plural, seed_list};
use crate::report::statistics::{self, END_POINTS, Estimate, Quantity, mean, sum};
use crate::runs::{Manifest, RunSet, RunsError, SEPARATOR, SeedRun, State, write_atomic};

/// First field of every record.
const FORMAT: &str = "mcvl record";
/// Version of the format.
const VERSION: u32 = 1;
/// Ending of the names of records.
pub const RECORD_SUFFIX: &str = ".record.json";

/// The finished seeds of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Always `mcvl record`.
    pub format: String,
    /// Version of the format.
    pub version: u32,
    /// Name of the cell.
    pub cell: String,
    /// Its configuration as text, with the first seed.
    pub config: String,
    /// Version of mcvl that trained it.
    pub program: String,
    /// Commit of that program, where known.
    pub commit: Option<String>,
    /// Processor.
    pub cpu: String,
    /// Its cores; of several machines, the most.
    pub cores: usize,
    /// Where its seeds were trained on unlike machines: each processor with its cores.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub machines: Vec<String>,
    /// Wall time of training, milliseconds, where known.
    pub trained_ms: Option<u64>,
    /// Seal of the run's manifest: a record of another state of the run has another one. Of several runs, all of them.
    pub seal: String,
    /// Where each learner ends, the decisions, seed by seed; none where the cell measures spread.
    pub summary: Option<Summary>,
    /// Legs of all seeds.
    pub arms: Vec<ArmRecord>,
    /// Spread of repeated checks, where the cell measures that.
    pub spread: Option<Spread>,
}

/// A leg over seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmRecord {
    /// Which leg.
    pub arm: Arm,
    /// Gradient updates of the live learner in this leg, all seeds together, without those taken back.
    pub updates: u64,
    /// Share of the reward model's first-layer units that are dead at the end of the leg, 0 to 1: mean over
    /// seeds and their last 5 points; none where it was not trained.
    pub dead_units: Option<f64>,
    /// Evaluation points, by step.
    pub curve: Vec<Curve>,
    /// Seed by seed, ascending; empty in records that earlier versions wrote, which cannot be joined.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<SeedLeg>,
}

/// A leg of one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeedLeg {
    /// The seed.
    pub seed: u64,
    /// Gradient updates in this leg.
    pub updates: u64,
    /// Share of dead units, as in [`ArmRecord`].
    pub dead_units: Option<f64>,
    /// Evaluation points by step: step, observed return and performance, raw, rounded to four decimals.
    pub points: Vec<(u32, f64, f64)>,
}

/// An evaluation point over seeds, raw units, rounded to four decimals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Steps made in the leg.
    pub step: u32,
    /// Observed return: mean and the ends of its 95 % interval.
    #[serde(rename = "return")]
    pub observed_return: [f64; 3],
    /// Performance, likewise.
    pub performance: [f64; 3],
    /// Seeds that were evaluated at this step.
    pub seeds: usize,
}

impl Curve {
    /// The three numbers of a quantity.
    pub fn of(&self, quantity: Quantity) -> [f64; 3] {
        match quantity {
            Quantity::Return => self.observed_return,
            Quantity::Performance => self.performance,
        }
    }
}

impl Record {
    /// The record of the finished seeds of a run.
    pub fn of_run(cell: &str, set: &RunSet, manifest: &Manifest) -> Self {
        let finished: Vec<SeedRun> = set.seeds.iter().filter(|seed| seed.complete).cloned().collect();
        let planned = finished.iter().map(|seed| seed.seed).collect();
        let set = RunSet { path: set.path.clone(), config: set.config.clone(), planned, seeds: finished };
        let arms = Arm::ALL.into_iter().filter_map(|arm| ArmRecord::of(&set, arm)).collect();
        let bare = Self::bare(cell, &set.config.to_string(), manifest);
        // The time of a session is counted when it ends.
        let trained_ms = bare.trained_ms.filter(|_| manifest.state != State::Running);
        Self { summary: Some(Summary::new(&set)), arms, trained_ms, ..bare }
    }

    /// The record of a measurement of spread.
    pub fn of_spread(cell: &str, config: &str, spread: Spread, manifest: &Manifest) -> Self {
        Self { spread: Some(spread), ..Self::bare(cell, config, manifest) }
    }

    fn bare(cell: &str, config: &str, manifest: &Manifest) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            cell: cell.to_owned(),
            config: config.to_owned(),
            program: manifest.version.clone(),
            commit: manifest.commit.clone(),
            cpu: manifest.cpu.clone(),
            cores: manifest.cores,
            machines: Vec::new(),
            trained_ms: manifest.training_time().map(|time| u64::try_from(time.as_millis()).unwrap_or(u64::MAX)),
            seal: manifest.seal.clone(),
            summary: None,
            arms: Vec::new(),
            spread: None,
        }
    }

    /// Reads a record.
    ///
    /// # Errors
    /// If it cannot be read, is none, or is of another version.
    pub fn read(path: &Path) -> Result<Self, RunsError> {
        let text = fs::read_to_string(path).map_err(RunsError::io("read", path))?;
        Self::parse(&text).map_err(|why| RunsError::damaged(path, why))
    }

    fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Head {
            format: String,
            version: u32,
        }
        let head: Head = serde_json::from_str(text).map_err(|error| format!("is no record of mcvl: {error}"))?;
        if head.format != FORMAT {
            return Err(format!("is no record of mcvl: its format is `{}`", head.format));
        }
        if head.version != VERSION {
            return Err(format!(
                "is a record of format version {}, this program reads version {VERSION}: use the version of mcvl that \
                 wrote it, or leave the file out",
                head.version
            ));
        }
        let record: Self = serde_json::from_str(text).map_err(|error| format!("is damaged: {error}"))?;
        if record.summary.is_some() == record.spread.is_some() {
            return Err("is damaged: it holds neither a run nor a measurement, or both".to_owned());
        }
        let legs = record.summary.iter().flat_map(|summary| &summary.arms).map(|leg| leg.arm);
        if !legs.eq(record.arms.iter().map(|leg| leg.arm))
            || record.summary.is_some() && record.arm(Arm::Safe).is_none()
        {
            return Err(
                "is damaged: its summary and its curves are not of the same legs, or Safe training is none".into()
            );
        }
        record.check_seeds()?;
        Ok(record)
    }

    /// Seeds are told one by one, so each may be there once, and every leg has to be of all of them.
    fn check_seeds(&self) -> Result<(), String> {
        let Some(summary) = &self.summary else { return Ok(()) };
        let advice = "restore the file, make it again from its run, or leave it out";
        if !summary.seeds.is_sorted_by(|one, next| one < next) {
            return Err(format!("is damaged: its seeds are not in ascending order, each once: {advice}"));
        }
        let ends = summary.arms.iter().map(|leg| (leg.arm, leg.seeds.iter().map(|end| end.seed).collect::<Vec<_>>()));
        // Earlier versions kept no legs seed by seed.
        let legs = self.arms.iter().filter(|leg| !leg.seeds.is_empty());
        let legs = legs.map(|leg| (leg.arm, leg.seeds.iter().map(|leg| leg.seed).collect::<Vec<_>>()));
        match ends.chain(legs).find(|(_, seeds)| *seeds != summary.seeds) {
            Some((arm, seeds)) => Err(format!(
                "is damaged: its {} leg is of seeds {}, the record of seeds {}: {advice}",
                arm.name(),
                seed_list(&seeds),
                seed_list(&summary.seeds)
            )),
            None => Ok(()),
        }
    }

    /// Writes the record.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), RunsError> {
        let text = serde_json::to_string(self).expect("a record is plain data") + "\n";
        write_atomic(path, text.as_bytes())
    }

    /// Seeds that are in it, ascending.
    pub fn seeds(&self) -> &[u64] {
        match (&self.summary, &self.spread) {
            (Some(summary), _) => &summary.seeds,
            (None, Some(spread)) => std::slice::from_ref(&spread.seed),
            (None, None) => &[],
        }
    }

    /// Wall time of training, where known: what unlike machines took together, as earlier versions added it, says
    /// nothing.
    pub fn trained(&self) -> Option<Duration> {
        self.trained_ms.filter(|_| !self.machine().contains(SEPARATOR)).map(Duration::from_millis)
    }

    /// The processor and its cores; of several machines, all of them.
    pub fn machine(&self) -> String {
        match self.machines[..] {
            [] => format!("{}, {}", self.cpu, plural(self.cores as u64, "core")),
            _ => self.machines.join(SEPARATOR),
        }
    }

    /// A leg, if it is there.
    pub fn arm(&self, arm: Arm) -> Option<&ArmRecord> {
        self.arms.iter().find(|record| record.arm == arm)
    }

    /// Updates of the gated leg, forecasts included, per update of the ungated one.
    pub fn slowdown(&self) -> Option<f64> {
        let cost = self.summary.as_ref()?.verdicts?.cost;
        let (gated, ungated) = (self.arm(Arm::Mc)?.updates, self.arm(Arm::Baseline)?.updates);
        (ungated > 0).then(|| gated.saturating_add(cost) as f64 / ungated as f64)
    }
}

impl ArmRecord {
    fn of(set: &RunSet, arm: Arm) -> Option<Self> {
        Self::over(arm, set.seeds.iter().filter_map(|seed| SeedLeg::of(seed, arm)).collect())
    }

    /// A leg by its seeds, ascending; none without any.
    pub(super) fn over(arm: Arm, seeds: Vec<SeedLeg>) -> Option<Self> {
        let three = |e: &Estimate| [rounded(e.mean), rounded(e.low), rounded(e.high)];
        let points = || seeds.iter().flat_map(|seed| &seed.points);
        let performance = statistics::curve_of(points().map(|(step, _, value)| (*step, *value)));
        let curve: Vec<Curve> = statistics::curve_of(points().map(|(step, value, _)| (*step, *value)))
            .iter()
            .zip(&performance)
            .map(|(observed, performance)| Curve {
                step: observed.step,
                observed_return: three(&observed.estimate),
                performance: three(&performance.estimate),
                seeds: observed.estimate.count,
            })
            .collect();
        let updates = sum(seeds.iter().map(|seed| seed.updates));
        let dead: Vec<f64> = seeds.iter().filter_map(|seed| seed.dead_units).collect();
        (!curve.is_empty()).then(|| Self { arm, updates, dead_units: mean(&dead), curve, seeds })
    }
}

impl SeedLeg {
    /// The leg of a seed; none if it has no such leg.
    fn of(seed: &SeedRun, arm: Arm) -> Option<Self> {
        let points = statistics::evaluations(seed, arm);
        let points: Vec<_> = points.map(|p| (p.step, rounded(p.observed_return), rounded(p.performance))).collect();
        let made = |arm: Arm| seed.ends.iter().find(|end| end.arm == arm).map(|end| end.updates);
        let before = if arm == Arm::Safe { 0 } else { made(Arm::Safe).unwrap_or(0) };
        let updates = made(arm).unwrap_or(before).saturating_sub(before);
        // A point without an update of the reward model says 0 of it, which is no measurement.
        let dead = seed.learner.iter().filter(|point| point.arm == arm && point.reward_loss > 0.0);
        let dead: Vec<f64> = dead.map(|point| point.dead_units).collect();
        let dead_units = mean(&dead[dead.len().saturating_sub(END_POINTS)..]);
        (!points.is_empty()).then_some(Self { seed: seed.seed, updates, dead_units, points })
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;
    use mcvl_core::record::LearnerRecord;

    #[test]
    fn a_leg_counts_its_own_updates_and_the_dead_units_of_its_end() {
        let mut seed = samples::seed(0, samples::Outcome::Intended);
        // Ends count from the beginning of Safe training on.
        for (end, updates) in seed.ends.iter_mut().zip([900, 1900, 1700]) {
            end.updates = updates;
        }
        let point = |arm, reward_loss, dead_units| LearnerRecord {
            arm,
            step: 0,
            updates: 1000,
            epsilon: 0.1,
            replay: 100,
            value_loss: 0.5,
            reward_loss,
            dead_units,
        };
        // One before the last five, which are a half on average; then one that measures nothing, and another leg's.
        let dead = [1.0, 0.25, 0.5, 0.5, 0.5, 0.75];
        seed.learner = dead.map(|share| point(Arm::Mc, 0.5, share)).to_vec();
        seed.learner.extend([point(Arm::Mc, 0.0, 0.0), point(Arm::Baseline, 0.5, 0.125)]);
        let leg = |arm| SeedLeg::of(&seed, arm).map(|leg| (leg.updates, leg.dead_units));
        let legs = [Arm::Safe, Arm::Baseline, Arm::Mc, Arm::Oracle].map(leg);
        assert_eq!(legs, [Some((900, None)), Some((1000, Some(0.125))), Some((800, Some(0.5))), None]);
    }

    #[test]
    fn the_time_of_a_run_under_way_is_not_known() {
        let mut manifest = Manifest::begin();
        manifest.add_time(Duration::from_secs(7));
        let of = |manifest: &Manifest| Record::of_run("box", &samples::ten(), manifest).trained_ms;
        assert_eq!((manifest.state, of(&manifest)), (State::Running, None));
        for state in [State::Interrupted, State::Finished, State::Diverged] {
            manifest.state = state;
            assert_eq!(of(&manifest), Some(7000), "{state:?}");
        }
    }

    #[test]
    fn a_record_reads_back_and_others_are_named() {
        let record = Record::of_run("box", &samples::ten(), &Manifest::begin());
        let text = serde_json::to_string(&record).unwrap();
        assert_eq!(Record::parse(&text).unwrap(), record);
        assert_eq!((record.seeds().len(), record.arm(Arm::Mc).unwrap().curve.len()), (10, 51));
        let wrong = |from: &str, to: &str| Record::parse(&text.replacen(from, to, 1)).unwrap_err();
        assert!(wrong("\"version\":1", "\"version\":9").contains("format version 9, this program reads version 1"));
        assert!(wrong("mcvl record", "mcvl tape").contains("its format is `mcvl tape`"));
        assert!(wrong("\"arms\"", "\"legs\"").contains("is damaged"));
        for arm in [Arm::Safe, Arm::Mc] {
            let mut cut = record.clone();
            cut.summary.as_mut().unwrap().arms.retain(|leg| leg.arm != arm);
            let why = Record::parse(&serde_json::to_string(&cut).unwrap()).unwrap_err();
            assert!(why.contains("not of the same legs"), "{why}");
        }
        assert!(wrong("\"seeds\":[0,1,", "\"seeds\":[1,0,").contains("not in ascending order, each once: restore"));
        assert!(wrong("\"seeds\":[0,1,", "\"seeds\":[1,1,").contains("not in ascending order"));
        let mut cut = record.clone();
        cut.arms[2].seeds.remove(4);
        let why = Record::parse(&serde_json::to_string(&cut).unwrap()).unwrap_err();
        assert!(why.contains("its mc leg is of seeds 0 to 3, 5 to 9, the record of seeds 0 to 9: restore"), "{why}");
        let mut cut = record.clone();
        cut.summary.as_mut().unwrap().arms[0].seeds.pop();
        let why = Record::parse(&serde_json::to_string(&cut).unwrap()).unwrap_err();
        assert!(why.contains("its safe leg is of seeds 0 to 8"), "{why}");
        let mut old = record.clone();
        old.arms.iter_mut().for_each(|leg| leg.seeds.clear());
        assert_eq!(Record::parse(&serde_json::to_string(&old).unwrap()).unwrap(), old, "earlier versions kept none");
        assert!(Record::parse(&text[..text.len() / 2]).unwrap_err().contains("is no record"));
        assert!(Record::parse("[]").is_err() && Record::parse("").is_err());
    }
}
