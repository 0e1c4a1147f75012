//! Records of the same setting with different seeds, put together: a cell may be trained in parts, on several
//! machines, and counts as if it had been trained in one.

use std::collections::BTreeSet;

use mcvl_core::config::{Config, Learner};
use mcvl_core::record::Arm;

use super::record::{ArmRecord, Record, SeedLeg};
use crate::runs::SEPARATOR;

impl Record {
    /// Whether it tells its seeds apart, so that it can be joined with another one and be parted. Measurements of spread
    /// and records of earlier versions, without their seeds, cannot.
    pub fn is_joinable(&self) -> bool {
        let told = |arm: &ArmRecord| arm.seeds.iter().map(|leg| leg.seed).eq(self.seeds().iter().copied());
        self.summary.is_some() && self.arms.iter().all(told)
    }

    /// Whether a run with this seal is in it.
    pub fn is_of(&self, seal: &str) -> bool {
        self.seal.split(SEPARATOR).any(|part| part == seal)
    }

    /// Both together. Of a seed that is in both this record's numbers count, so the order matters only where the two
    /// disagree; the wall time of the others alone is not known then, nor is one of unlike machines together. None where
    /// one of them [cannot be joined](Self::is_joinable) or their setting is not valid.
    pub fn join(&self, other: &Self) -> Option<Self> {
        let new: Vec<u64> = other.seeds().iter().copied().filter(|seed| !self.seeds().contains(seed)).collect();
        if new.is_empty() {
            return self.is_joinable().then(|| self.clone());
        }
        let mut joined = self.put_together(other, self.seeds(), &new)?;
        joined.program = both(&self.program, &other.program);
        joined.commit = self.commit.as_ref().zip(other.commit.as_ref()).map(|(mine, theirs)| both(mine, theirs));
        joined.cpu = both(&self.cpu, &other.cpu);
        joined.cores = self.cores.max(other.cores);
        joined.seal = both(&self.seal, &other.seal);
        let alike = self.machine() == other.machine();
        joined.machines = if alike { self.machines.clone() } else { parts(&self.machine(), &other.machine()) };
        let known = alike && new.len() == other.seeds().len();
        let times = self.trained_ms.zip(other.trained_ms).filter(|_| known);
        joined.trained_ms = times.map(|(mine, theirs)| mine.saturating_add(theirs));
        Some(joined)
    }

    /// Some of its seeds alone; none where it [cannot be parted](Self::is_joinable). A record has the wall time of all
    /// its seeds together, so that of fewer is not known.
    pub fn only(&self, seeds: &[u64]) -> Option<Self> {
        let mine: Vec<u64> = self.seeds().iter().copied().filter(|seed| seeds.contains(seed)).collect();
        let trained_ms = self.trained_ms.filter(|_| mine.len() == self.seeds().len());
        Some(Self { trained_ms, ..self.put_together(self, &mine, &[])? })
    }

    /// What it has of Safe training and of some learners, which are those of a cell: a run may have trained more, and its
    /// wall time is that of all.
    pub fn of_learners(self, learners: &[Learner]) -> Self {
        let wanted = |arm: Arm| arm == Arm::Safe || learners.iter().any(|learner| Arm::of(*learner) == arm);
        let Ok(config) = self.config.parse::<Config>() else { return self };
        if self.arms.iter().all(|leg| wanted(leg.arm)) {
            return self;
        }
        let summary = self.summary.map(|summary| summary.of_legs(&config, wanted));
        let arms = self.arms.into_iter().filter(|leg| wanted(leg.arm)).collect();
        Self { summary, arms, trained_ms: None, ..self }
    }

    fn put_together(&self, other: &Self, mine: &[u64], theirs: &[u64]) -> Option<Self> {
        if !self.is_joinable() || !other.is_joinable() {
            return None;
        }
        let first = *mine.iter().chain(theirs).min()?;
        let config = |record: &Self| Some(record.config.parse::<Config>().ok()?.with_seed(first));
        // They differ at most in the simulator, of which either stands for the other.
        let config = [config(self)?, config(other)?].into_iter().min_by_key(Config::to_string)?;
        let legs = |record: &Self, arm: Arm, seeds: &[u64]| {
            let legs = record.arm(arm).map_or(&[][..], |leg| &leg.seeds).iter();
            legs.filter(|leg| seeds.contains(&leg.seed)).cloned().collect::<Vec<SeedLeg>>()
        };
        let arms = Arm::ALL.into_iter().filter_map(|arm| {
            let mut seeds = legs(self, arm, mine);
            seeds.extend(legs(other, arm, theirs));
            seeds.sort_by_key(|leg| leg.seed);
            ArmRecord::over(arm, seeds)
        });
        let summary = self.summary.as_ref()?.joined(other.summary.as_ref()?, &config, mine, theirs);
        Some(Self { config: config.to_string(), summary: Some(summary), arms: arms.collect(), ..self.clone() })
    }
}

/// The parts of both, each once, in an order that is that of neither.
fn parts(mine: &str, theirs: &str) -> Vec<String> {
    let all: BTreeSet<&str> = [mine, theirs].into_iter().flat_map(|text| text.split(SEPARATOR)).collect();
    all.into_iter().map(str::to_owned).collect()
}

fn both(mine: &str, theirs: &str) -> String {
    parts(mine, theirs).join(SEPARATOR)
}

#[cfg(test)]
mod tests {
    use super::super::rows::judge;
    use super::super::table::find;
    use super::*;
    use crate::report::claims::ArmSummary;
    use crate::report::samples;
    use crate::runs::{Manifest, RunSet};

    /// A record of some of the ten made-up seeds.
    fn of(seeds: &[u64]) -> Record {
        let ten = samples::ten();
        let some: Vec<_> = ten.seeds.iter().filter(|seed| seeds.contains(&seed.seed)).cloned().collect();
        let config = ten.config.with_seed(seeds[0]);
        Record::of_run("box", &RunSet { seeds: some, config, ..ten }, &Manifest::begin())
    }

    /// A record without what says when and where it was made.
    fn bare(record: Record) -> Record {
        Record { seal: String::new(), trained_ms: None, ..record }
    }

    const ALL: [u64; 10] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9];

    #[test]
    fn parts_joined_are_the_whole_to_the_last_bit() {
        let whole = bare(of(&ALL));
        for parts in [[&ALL[..4], &ALL[4..]], [&[1, 3, 8, 9], &[0, 2, 4, 5, 6, 7]]] {
            let [one, other] = parts.map(of);
            assert_eq!(bare(one.join(&other).unwrap()), whole);
            assert_eq!(bare(other.join(&one).unwrap()), whole);
        }
        let (left, right) = (of(&ALL[..6]), of(&ALL[3..]));
        assert_eq!(bare(left.join(&right).unwrap()), whole, "seeds that are in both count once");
        assert_eq!(bare(whole.only(&ALL[3..]).unwrap()), bare(right));
        assert_eq!(whole.only(&[77]), None);
    }

    #[test]
    fn of_a_seed_in_both_the_first_counts() {
        let (one, mut other) = (of(&[0, 1]), of(&[1, 2]));
        for arm in &mut other.arms {
            arm.seeds[0].points[0].1 = 1e6;
        }
        assert_eq!(bare(one.join(&other).unwrap()), bare(of(&[0, 1, 2])));
    }

    #[test]
    fn what_differs_is_named_once() {
        let mut other = of(&[1]);
        let one = Record { trained_ms: Some(5), commit: Some("a".into()), cpu: "one".into(), ..of(&[0]) };
        (other.trained_ms, other.commit, other.cpu) = (Some(7), Some("a".into()), "two".into());
        let joined = one.join(&other).unwrap();
        assert_eq!((joined.commit.as_deref(), joined.cpu.as_str()), (Some("a"), "one; two"));
        let sealed = |seal: &str, seeds: &[u64]| Record { seal: seal.into(), ..of(seeds) };
        let both = sealed("a", &[0]).join(&sealed("b", &[1])).unwrap();
        assert!(both.is_of("a") && both.is_of("b") && !both.is_of("c"));
        let again = joined.join(&Record { cpu: "one".into(), ..of(&[2]) }).unwrap();
        assert_eq!((again.cpu.as_str(), again.seeds()), ("one; two", &[0, 1, 2][..]));
    }

    #[test]
    fn unlike_machines_are_told_and_their_times_are_not_added() {
        let on = |seeds: &[u64], cpu: &str, cores, physics: &str| {
            let record = Record { cpu: cpu.into(), cores, trained_ms: Some(5), seal: cpu.into(), ..of(seeds) };
            Record { config: format!("env=reacher preset=small physics={physics} seed={}", seeds[0]), ..record }
        };
        let (one, two) = (on(&[0, 3], "one", 2, "mujoco"), on(&[1], "two", 64, "closed-form"));
        let again = on(&[2], "one", 64, "mujoco");
        let joined = |parts: [&Record; 3]| parts[0].join(parts[1]).unwrap().join(parts[2]).unwrap();
        let all = joined([&one, &two, &again]);
        assert_eq!(all.machine(), "one, 2 cores; one, 64 cores; two, 64 cores");
        assert_eq!((all.trained_ms, all.trained(), all.cores), (None, None, 64));
        for other in [[&two, &one, &again], [&again, &two, &one], [&two, &again, &one]] {
            assert_eq!(joined(other), all, "whatever the order");
        }
        let alike = one.join(&on(&[1], "one", 2, "closed-form")).unwrap();
        assert_eq!((alike.trained_ms, alike.machine().as_str()), (Some(10), "one, 2 cores"));
        // As earlier versions added them.
        let old = Record { cpu: "one; two".into(), trained_ms: Some(10), ..of(&[0, 1]) };
        assert_eq!(old.trained(), None);
    }

    #[test]
    fn learners_that_a_cell_has_not_are_left_out() {
        let plain = of(&[0, 1]);
        let mut more = plain.clone();
        let (leg, end) = (&more.arms[1], &more.summary.as_ref().unwrap().arms[1]);
        let (leg, end) =
            (ArmRecord { arm: Arm::Oracle, ..leg.clone() }, ArmSummary { arm: Arm::Oracle, ..end.clone() });
        more.arms.push(leg);
        more.summary.as_mut().unwrap().arms.push(end);
        let cell = [Learner::Baseline, Learner::Mc];
        assert_eq!(bare(more.clone().of_learners(&cell)), bare(plain.clone()));
        assert_eq!(Record { trained_ms: Some(5), ..more }.of_learners(&cell).trained_ms, None, "it is that of all");
        assert_eq!(plain.clone().of_learners(&cell), plain);
        let ungated = plain.of_learners(&cell[..1]);
        assert!(ungated.arm(Arm::Mc).is_none() && ungated.summary.as_ref().unwrap().verdicts.is_none());
        assert!(ungated.arm(Arm::Safe).is_some() && ungated.is_joinable());
    }

    #[test]
    fn counts_end_at_the_greatest_number() {
        let huge = |seeds: &[u64]| {
            let mut record = Record { trained_ms: Some(u64::MAX), ..of(seeds) };
            let ends = record.summary.as_mut().unwrap().arms.iter_mut().flat_map(|leg| &mut leg.seeds);
            for verdicts in ends.filter_map(|end| end.verdicts.as_mut()) {
                (verdicts.hacks_accepted, verdicts.cost, verdicts.hacks_unchecked) =
                    (u64::MAX, u64::MAX, Some(u64::MAX));
            }
            record.arms.iter_mut().flat_map(|leg| &mut leg.seeds).for_each(|leg| leg.updates = u64::MAX);
            record
        };
        let joined = huge(&[0, 1]).join(&huge(&[2])).unwrap();
        assert_eq!((joined.trained_ms, joined.arm(Arm::Mc).unwrap().updates), (Some(u64::MAX), u64::MAX));
        let verdicts = joined.summary.as_ref().unwrap().verdicts.unwrap();
        assert_eq!((verdicts.hacks_accepted, verdicts.wrong(), joined.slowdown()), (u64::MAX, u64::MAX, Some(1.0)));
        assert!(verdicts.recall() < Some(0.01) && verdicts.unchecked() == Some(1.0));
        let records = [("box".to_owned(), joined)].into();
        let results = judge(&find("E1"), &records, false, &|cell| cell.seeds(false));
        assert_eq!(results.costs[0].updates, u64::MAX);
        assert!(results.text(&|_, words| words.to_owned()).contains("Cost: "));
    }

    #[test]
    fn the_wall_time_of_a_part_is_not_known() {
        let timed = |seeds: &[u64]| Record { trained_ms: Some(40), ..of(seeds) };
        let time = |record: Option<Record>| record.unwrap().trained_ms;
        assert_eq!((time(timed(&[0, 1, 2]).only(&[0, 1])), time(timed(&[0, 1]).only(&[0, 1, 2]))), (None, Some(40)));
        assert_eq!((time(timed(&[0]).join(&timed(&[1]))), time(timed(&[0]).join(&bare(of(&[1]))))), (Some(80), None));
        assert_eq!(time(timed(&[0, 1]).join(&timed(&[1, 2]))), None, "of the second, seed 2 alone was used");
        assert_eq!(time(timed(&[0, 1]).join(&timed(&[1]))), Some(40), "of the second, nothing was used");
    }

    #[test]
    fn records_that_do_not_tell_seeds_apart_are_left_whole() {
        let (mut old, new) = (of(&[0, 1]), of(&[2]));
        for arm in &mut old.arms {
            arm.seeds.clear();
        }
        assert!(!old.is_joinable() && new.is_joinable());
        assert_eq!((old.join(&new), new.join(&old), old.only(&[0])), (None, None, None));
    }
}
