//! Records of the same setting with different seeds, put together: a cell may be trained in parts, on several
//! machines, and counts as if it had been trained in one.

use mcvl_core::config::Config;
use mcvl_core::record::Arm;

use super::record::{ArmRecord, Record, SeedLeg};

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
    /// disagree; the wall time of the others alone is not known then. None where one of them
    /// [cannot be joined](Self::is_joinable) or their setting is not valid.
    pub fn join(&self, other: &Self) -> Option<Self> {
        let new: Vec<u64> = other.seeds().iter().copied().filter(|seed| !self.seeds().contains(seed)).collect();
        if new.is_empty() {
            return self.is_joinable().then(|| self.clone());
        }
        let mut joined = self.put_together(other, self.seeds(), &new)?;
        let both = |mine: &str, theirs: &str| {
            let known = mine.split(SEPARATOR).any(|part| part == theirs);
            if known { mine.to_owned() } else { format!("{mine}{SEPARATOR}{theirs}") }
        };
        joined.program = both(&self.program, &other.program);
        joined.commit = self.commit.as_ref().zip(other.commit.as_ref()).map(|(mine, theirs)| both(mine, theirs));
        joined.cpu = both(&self.cpu, &other.cpu);
        joined.seal = both(&self.seal, &other.seal);
        let both = self.trained_ms.zip(other.trained_ms).filter(|_| new.len() == other.seeds().len());
        joined.trained_ms = both.map(|(mine, theirs)| mine + theirs);
        Some(joined)
    }

    /// Some of its seeds alone; none where it [cannot be parted](Self::is_joinable). A record has the wall time of all
    /// its seeds together, so that of fewer is not known.
    pub fn only(&self, seeds: &[u64]) -> Option<Self> {
        let mine: Vec<u64> = self.seeds().iter().copied().filter(|seed| seeds.contains(seed)).collect();
        let trained_ms = self.trained_ms.filter(|_| mine.len() == self.seeds().len());
        Some(Self { trained_ms, ..self.put_together(self, &mine, &[])? })
    }

    fn put_together(&self, other: &Self, mine: &[u64], theirs: &[u64]) -> Option<Self> {
        if !self.is_joinable() || !other.is_joinable() {
            return None;
        }
        let first = *mine.iter().chain(theirs).min()?;
        let config: Config = self.config.parse().ok()?;
        let config = config.with_seed(first);
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

/// Between the parts of what differs.
const SEPARATOR: &str = "; ";

#[cfg(test)]
mod tests {
    use super::*;
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
        assert_eq!(
            (joined.trained_ms, joined.commit.as_deref(), joined.cpu.as_str()),
            (Some(12), Some("a"), "one; two")
        );
        let sealed = |seal: &str, seeds: &[u64]| Record { seal: seal.into(), ..of(seeds) };
        let both = sealed("a", &[0]).join(&sealed("b", &[1])).unwrap();
        assert!(both.is_of("a") && both.is_of("b") && !both.is_of("c"));
        let again = joined.join(&Record { cpu: "one".into(), ..of(&[2]) }).unwrap();
        assert_eq!((again.cpu.as_str(), again.seeds()), ("one; two", &[0, 1, 2][..]));
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
