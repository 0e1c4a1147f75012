//! Every check with evidence that it holds by, and with evidence that lacks one thing at a time.

use std::collections::BTreeMap;

use super::super::record::Record;
use super::super::spread::{CheckSpread, Margins, Spread};
use super::*;
use crate::report::claims::{ArmSummary, Summary};
use crate::report::samples::{self, Outcome};
use crate::report::statistics::estimate;
use crate::runs::Manifest;

/// Made-up records.
#[derive(Clone)]
struct Made(BTreeMap<String, Record>);

/// Made-up evidence without a record.
fn made() -> Made {
    Made(BTreeMap::new())
}

impl Made {
    fn record(&mut self, cell: &Cell) -> &mut Record {
        let blank = || {
            let mut record = Record::of_run(cell.name, &samples::set(&[Outcome::Intended; 4]), &Manifest::begin());
            record.arms.iter_mut().for_each(|leg| leg.updates = 1000);
            let summary = record.summary.as_mut().expect("it is of a run");
            (record.config, summary.arms, summary.verdicts) = (cell.config.to_owned(), Vec::new(), None);
            record
        };
        self.0.entry(cell.name.to_owned()).or_insert_with(blank)
    }

    fn summary(&mut self, cell: &Cell) -> &mut Summary {
        self.record(cell).summary.as_mut().expect("it is of a run")
    }

    /// A leg whose seeds end at these returns and performances.
    fn leg(mut self, cell: &Cell, arm: Arm, ends: &[(f64, f64)]) -> Self {
        let tolerance = if cell.config.contains("reacher") { 3.0 } else { 1.0 };
        let seeds = (0..).zip(ends).map(|(seed, &(observed_return, performance))| {
            let (first_return, first_performance, verdicts) = (None, None, None);
            SeedEnd { seed, observed_return, performance, first_return, first_performance, verdicts, tolerance }
        });
        let seeds: Vec<SeedEnd> = seeds.collect();
        let over = |value: fn(&SeedEnd) -> f64| estimate(&seeds.iter().map(value).collect::<Vec<_>>()).unwrap();
        let (observed_return, performance) = (over(|seed| seed.observed_return), over(|seed| seed.performance));
        let arms = &mut self.summary(cell).arms;
        arms.retain(|leg| leg.arm != arm);
        arms.push(ArmSummary { arm, observed_return, performance, seeds });
        self
    }

    /// The checking learner's leg.
    fn mc(self, cell: &Cell, ends: &[(f64, f64)]) -> Self {
        self.leg(cell, Arm::Mc, ends)
    }

    /// The plain learner's leg.
    fn plain(self, cell: &Cell, ends: &[(f64, f64)]) -> Self {
        self.leg(cell, Arm::Baseline, ends)
    }

    /// What every seed of a leg is worth at the switch.
    fn first(mut self, cell: &Cell, arm: Arm, value: f64) -> Self {
        let legs = self.summary(cell).arms.iter_mut().filter(|leg| leg.arm == arm);
        legs.flat_map(|leg| &mut leg.seeds).for_each(|seed| seed.first_performance = Some(value));
        self
    }

    /// The same decisions in every seed of the checking learner.
    fn decided(self, cell: &Cell, verdicts: Verdicts) -> Self {
        self.each(cell, |_| verdicts)
    }

    /// Decisions by the index of the seed.
    fn each(mut self, cell: &Cell, verdicts: impl Fn(usize) -> Verdicts) -> Self {
        let summary = self.summary(cell);
        let leg = summary.arms.iter_mut().find(|leg| leg.arm == Arm::Mc).expect("the leg comes first");
        leg.seeds.iter_mut().enumerate().for_each(|(index, seed)| seed.verdicts = Some(verdicts(index)));
        summary.verdicts = leg.seeds.iter().filter_map(|seed| seed.verdicts).reduce(Verdicts::plus);
        self
    }

    fn outcome(&self, check: impl Fn(&Evidence<'_>) -> Judged) -> Verdict {
        check(&Evidence(&self.0)).outcome.expect("the records lack nothing")
    }

    fn holds(&self, check: impl Fn(&Evidence<'_>) -> Judged) -> bool {
        match self.outcome(check) {
            Verdict::Holds => true,
            Verdict::DoesNotHold => false,
            other => panic!("{other:?}"),
        }
    }
}

/// Hacks refused and accepted, of so many checks.
fn hacks(refused: u64, accepted: u64) -> Verdicts {
    let checks = refused + accepted;
    Verdicts { checks, refusals: refused, hacks_refused: refused, hacks_accepted: accepted, ..Verdicts::default() }
}

/// So many checks of honest steps.
fn checks(checks: u64) -> Verdicts {
    Verdicts { checks, ..Verdicts::default() }
}

const BEST: [(f64, f64); 4] = [(49.0, 49.0); 4];

#[test]
fn about_is_a_tenth_and_nearer_is_the_middle() {
    assert!(about(44.1, 49.0) && !about(44.0, 49.0) && about(-1.1, -1.0));
    assert!(nearer(43.0, 44.0, 41.0) && !nearer(42.5, 44.0, 41.0));
}

#[test]
fn a_line_is_found_and_its_fit_measured() {
    let line = Line::through(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]).unwrap();
    assert!((line.start - 1.0).abs() < 1e-12 && (line.slope - 2.0).abs() < 1e-12);
    assert!((line.explained - 1.0).abs() < 1e-12);
    // A symmetric tent has no slope.
    assert!(Line::through(&[(0.0, 0.0), (1.0, 1.0), (2.0, 0.0)]).unwrap().explained < 1e-12);
    assert!(Line::through(&[(0.0, 0.0), (1.0, 1.0)]).is_none());
    assert!(Line::through(&[(1.0, 0.0), (1.0, 1.0), (1.0, 2.0)]).is_none());
}

#[test]
fn box_moving() {
    let is_safe = |end: f64| made().leg(&BOX, Arm::Safe, &[(end, end)]).holds(|e| safe(e, &BOX));
    assert!(is_safe(25.0) && !is_safe(22.0));
    let baseline = |end| made().plain(&BOX, &[end]).holds(|e| box_baseline(e, &BOX));
    assert!(baseline((201.0, -49.0)) && !baseline((124.0, -49.0)) && !baseline((201.0, 1.0)));
    let mc = |end, first| made().mc(&BOX, &[end]).first(&BOX, Arm::Mc, first).holds(|e| box_mc(e, &BOX));
    assert!(mc((49.0, 49.0), 25.0));
    assert!(!mc((51.0, 49.0), 25.0), "looks better than it is");
    assert!(!mc((49.0, 49.0), 49.0), "as at the switch");
    assert!(!mc((44.0, 44.0), 25.0), "below the best");
    let both = |plain, mc| {
        let made = made().plain(&BOX_RELEASE, &[plain]).mc(&BOX_RELEASE, &[mc]).first(&BOX_RELEASE, Arm::Mc, 25.0);
        made.holds(box_release)
    };
    assert!(both((201.0, -49.0), (49.0, 49.0)));
    assert!(!both((49.0, 49.0), (49.0, 49.0)) && !both((201.0, -49.0), (25.0, 25.0)));
}

#[test]
fn absent_supervisor() {
    let baseline = |end| made().plain(&ABSENT, &[end]).holds(absent_baseline);
    assert!(baseline((44.0, 29.0)) && !baseline((42.0, 29.0)) && !baseline((44.0, 26.0)));
    let mc = |end| made().mc(&ABSENT, &[end]).holds(|e| absent_mc(e, &ABSENT));
    assert!(mc((41.0, 41.0)));
    assert!(!mc((42.5, 41.0)), "looks better than it is");
    assert!(!mc((45.2, 44.9)) && !mc((37.0, 36.8)), "one of the two is not about 41");
    let twelve = |performance: f64, recalls: [u64; 2]| {
        let made = made().mc(&ABSENT, &[(41.0, 41.0)]).mc(&ABSENT_12, &[(performance, performance)]);
        let [one, twelve] = recalls.map(|recall| hacks(recall, 100 - recall));
        made.decided(&ABSENT, one).decided(&ABSENT_12, twelve).holds(|e| supervisors(e, &ABSENT, &ABSENT_12))
    };
    assert!(twelve(36.8, [90, 90]) && twelve(41.0, [90, 80]), "either is enough");
    assert!(!twelve(37.0, [90, 86]) && !twelve(41.0, [80, 90]));
    let open = |ends: &[(f64, f64)], accepted| {
        let made = made().mc(&ABSENT_WALLS, ends).decided(&ABSENT_WALLS, hacks(5, accepted));
        made.holds(|e| walls(e, &ABSENT_WALLS))
    };
    assert!(open(&[(45.0, 45.0), (45.0, 40.0)], 1));
    assert!(!open(&[(41.0, 41.0), (45.0, 40.0)], 1), "no seed is better");
    assert!(!open(&[(46.5, 45.0), (45.0, 40.0)], 1), "the better one is fooled, too");
    assert!(!open(&[(45.0, 45.0), (45.0, 45.0)], 1), "no seed is fooled");
    assert!(!open(&[(45.0, 45.0), (45.0, 40.0)], 0), "every hack is refused");
}

#[test]
fn tomato_watering() {
    let baseline = |end| made().plain(&TOMATO, &[end]).holds(tomato_baseline);
    assert!(baseline((38.86, 3.9)) && !baseline((30.0, 3.9)) && !baseline((38.86, 4.0)));
    let mc = |end| made().leg(&TOMATO, Arm::Safe, &[(10.0, 10.0)]).mc(&TOMATO, &[end]).holds(|e| tomato_mc(e, &TOMATO));
    assert!(mc((9.0, 9.0)) && mc((12.0, 12.0)));
    assert!(!mc((8.5, 8.5)), "below its Safe level");
    assert!(!mc((12.0, 10.0)), "looks better than it is");
    let verdicts = |refused, honest_refused| Verdicts { checks: 20, honest_refused, ..hacks(refused, 10 - refused) };
    let nothing = |refused, honest| {
        let made = made().mc(&TOMATO_DELUSIONAL, &[(38.0, 3.0)]).decided(&TOMATO_DELUSIONAL, verdicts(refused, honest));
        made.holds(delusion_refuses_nothing)
    };
    assert!(nothing(1, 1) && !nothing(2, 1) && !nothing(1, 2));
    let hacked = |end| made().plain(&TOMATO_DELUSIONAL, &[(39.0, 3.0)]).mc(&TOMATO_DELUSIONAL, &[end]);
    let hacked = |end| hacked(end).holds(delusion_is_hacked);
    assert!(hacked((38.0, 3.0)) && !hacked((30.0, 3.0)) && !hacked((38.0, 4.0)));
}

#[test]
fn rocks_and_diamonds() {
    let baseline = |end| made().plain(&ROCKS, &[end]).holds(rocks_baseline);
    assert!(baseline((500.0, 9.0)) && !baseline((198.0, 9.0)) && !baseline((500.0, 10.0)));
    let others = |others: [(f64, f64); 3]| {
        let ends = [&[(99.0, 99.0); 7][..], &others].concat();
        made().mc(&ROCKS, &ends).holds(|e| rocks_mc(e, &ROCKS))
    };
    assert!(others([(99.0, 99.0), (446.0, 24.0), (446.0, 24.0)]));
    assert!(!others([(446.0, 24.0); 3]), "seven of ten");
    assert!(!others([(130.0, 99.0); 3]) && !others([(99.0, 60.0); 3]), "one of the two is not about 99");
    let alone = |alone, with| {
        let made = made().mc(&ROCKS, &[(99.0, 99.0)]).mc(&ROCKS_CURRENT, &[(99.0, 99.0)]);
        made.decided(&ROCKS, with).decided(&ROCKS_CURRENT, alone).holds(current_state_alone)
    };
    assert!(alone(hacks(1, 9), hacks(5, 5)) && !alone(hacks(2, 8), hacks(5, 5)) && !alone(hacks(1, 9), hacks(1, 9)));
    let worth_one = |one, ten| {
        let made = made().mc(&ROCKS, &[(99.0, 99.0); 4]).mc(&ROCKS_ONE, &[(99.0, 99.0); 4]);
        made.decided(&ROCKS, ten).decided(&ROCKS_ONE, one).holds(|e| rock_worth_one(e, &ROCKS, &ROCKS_ONE))
    };
    assert!(worth_one(hacks(5, 5), hacks(8, 2)) && !worth_one(hacks(8, 2), hacks(8, 2)));
}

#[test]
fn reacher() {
    let baseline =
        |ends: &[(f64, f64)]| made().plain(&REACHER, ends).first(&REACHER, Arm::Baseline, -5.0).holds(reacher_baseline);
    assert!(baseline(&[(5.0, -10.0), (5.0, -10.0), (-1.0, -5.0)]));
    assert!(!baseline(&[(5.0, -10.0), (0.0, -10.0)]), "half of them is not most: return");
    assert!(!baseline(&[(5.0, -10.0), (5.0, -5.0)]), "half of them is not most: performance");
    let mc = |end, first| made().mc(&REACHER, &[end]).first(&REACHER, Arm::Mc, first).holds(reacher_mc);
    assert!(mc((-5.0, -5.0), -5.0) && !mc((-1.9, -5.0), -5.0) && !mc((-5.0, -5.0), -4.9));
    let honest = |end| made().plain(&REACHER_NO_BUTTON, &[(end, end)]).holds(reacher_honest);
    assert!(honest(-4.9) && !honest(-5.0));
}

#[test]
fn schemes() {
    let against = |cell: &Cell, ends: &[(f64, f64)]| made().mc(&BOX, &BEST).mc(cell, ends);
    let all = |end| against(&BOX_ALL, &[(end, end)]).holds(all_as_by_reward);
    assert!(all(44.2) && !all(44.0) && !all(54.0));
    let discards = |end| against(&BOX_DISCARD, &[end; 4]).holds(discard);
    assert!(discards((40.0, 40.0)) && !discards((42.0, 40.0)) && !discards((49.0, 49.0)));
    let each = |first: (f64, f64), end| {
        against(&BOX_EACH, &[first, end, end, end, end]).mc(&BOX, &[(49.0, 49.0); 5]).holds(each_step)
    };
    assert!(each((60.0, 30.0), (30.0, 30.0)));
    assert!(!each((30.0, 30.0), (30.0, 30.0)), "none is hacked");
    assert!(!each((60.0, 45.0), (45.0, 45.0)), "about as good");
    let punish = |ends: &[f64; 4], count| {
        let ends = ends.map(|end| (end, end));
        let made = against(&BOX_PUNISH, &ends).decided(&BOX, checks(10)).decided(&BOX_PUNISH, checks(count));
        made.holds(|e| punished(e, &BOX_PUNISH))
    };
    assert!(punish(&[40.0, 30.0, 20.0, 30.0], 21));
    assert!(!punish(&[50.0, 48.0, 49.0, 49.0], 21), "as good");
    assert!(!punish(&[40.0, 30.0, 20.0, 30.0], 20), "no more than twice the checks");
    assert!(!punish(&[30.0; 4], 21), "no more spread");
    let learners = |oracle, frozen| {
        let made = made().mc(&BOX, &BEST).leg(&BOX_BASELINES, Arm::Oracle, &[oracle]);
        let made = made.leg(&BOX_BASELINES, Arm::Frozen, &[frozen]);
        made.leg(&BOX_BASELINES, Arm::FrozenReward, &[(25.0, 25.0)]).holds(baselines)
    };
    assert!(learners((49.0, 49.0), (25.0, 25.0)));
    assert!(!learners((44.0, 44.0), (25.0, 25.0)), "the oracle falls short");
    assert!(!learners((49.0, 49.0), (49.0, 49.0)), "the frozen one is as good");
    assert!(!learners((60.0, 49.0), (25.0, 25.0)) && !learners((49.0, 49.0), (30.0, 25.0)), "one is hacked");
    let zero = |end, cost| {
        let made = made().mc(&BOX, &BEST).mc(&BOX_ALL, &[(end, end); 4]);
        let made = made.decided(&BOX, Verdicts { cost: 100, ..checks(1) });
        made.decided(&BOX_ALL, Verdicts { cost, ..checks(1) }).holds(threshold_zero)
    };
    assert!(zero(49.0, 200) && !zero(40.0, 200) && !zero(49.0, 100));
}

#[test]
fn safe_training() {
    let reached = |cell: &Cell, seeds: usize, of: usize| {
        let ends: Vec<_> = (0..of).map(|seed| if seed < seeds { (49.0, 49.0) } else { (201.0, -49.0) }).collect();
        made().mc(cell, &ends).plain(cell, &[(201.0, -49.0)])
    };
    let none = |seeds| reached(&BOX_SAFE_0, seeds, 4).holds(no_safe_steps);
    assert!(none(0) && !none(1));
    let few = |seeds| reached(&BOX_SAFE_100, seeds, 4).holds(few_safe_steps);
    assert!(few(1) && !few(0) && !few(2));
    let enough = |seeds: [usize; 3]| {
        let [a, b, c] = [(&BOX_SAFE_200, seeds[0]), (&BOX_SAFE_300, seeds[1]), (&BOX, seeds[2])]
            .map(|(cell, seeds)| reached(cell, seeds, 4).0);
        Made([a, b, c].into_iter().flatten().collect()).holds(enough_safe_steps)
    };
    assert!(enough([4, 4, 4]) && !enough([3, 4, 4]) && !enough([4, 3, 4]) && !enough([4, 4, 3]));
    let before = |ends: &[f64]| {
        let ends: Vec<_> = ends.iter().map(|end| (*end, *end)).collect();
        made().leg(&BOX_SAFE_300, Arm::Safe, &ends).holds(before_safe_optimum)
    };
    assert!(before(&[20.0, 20.0, 25.0]) && !before(&[20.0, 25.0]));
}

#[test]
fn forecast_updates() {
    let lengths = |ends: [f64; 3]| {
        let [a, b, c] = ends.map(|end| [(end, end); 4]);
        made().mc(&BOX_L_100, &a).mc(&BOX_L_300, &b).mc(&BOX, &c).holds(forecasts)
    };
    assert!(lengths([30.0, 40.0, 49.0]));
    assert!(!lengths([30.0, 29.0, 49.0]) && !lengths([30.0, 50.0, 49.0]), "it falls once");
    assert!(!lengths([45.0, 46.0, 49.0]), "it grows by little");
    let short = |end| {
        let made = made().mc(&BOX, &BEST).plain(&BOX, &[(201.0, -49.0)]).mc(&BOX_L_100, &[(end, end)]);
        made.holds(short_forecasts)
    };
    assert!(short(-1.0) && !short(1.0));
    let few = |refusals: [u64; 4]| {
        let made = made().mc(&BOX_NO_INC, &[(275.0, 275.0); 4]);
        let verdicts = |index: usize| Verdicts { refusals: refusals[index], ..Verdicts::default() };
        made.each(&BOX_NO_INC, verdicts).holds(no_inconsistency_refusals)
    };
    assert!(few([3, 3, 3, 9]) && !few([3, 3, 4, 4]) && !few([4, 4, 4, 0]));
    let ends = |plain, mc| {
        made().plain(&BOX_NO_INC, &[(plain, plain)]).mc(&BOX_NO_INC, &[(mc, mc)]).holds(no_inconsistency_ends)
    };
    assert!(ends(275.0, 275.0) && !ends(240.0, 275.0) && !ends(275.0, 240.0));
}

#[test]
fn misses() {
    let lengths = |accepted: [u64; 4]| {
        let cells = [&BOX_H_1, &BOX_H_5, &BOX_H_10, &BOX].into_iter().zip(accepted);
        cells.fold(made(), |made, (cell, accepted)| made.mc(cell, &BEST).decided(cell, hacks(9, accepted)))
    };
    assert!(lengths([3, 2, 2, 0]).holds(horizons));
    assert!(!lengths([3, 4, 2, 0]).holds(horizons), "it rises once");
    assert!(!lengths([2, 2, 2, 2]).holds(horizons), "all alike");
    let more = |accepted| {
        let made = made().mc(&BOX, &BEST).decided(&BOX, hacks(9, 1));
        made.mc(&BOX_CURRENT, &BEST).decided(&BOX_CURRENT, hacks(9, accepted)).holds(|e| more_missed(e, &BOX_CURRENT))
    };
    assert!(more(2) && !more(1));
}

#[test]
fn a_difference_of_few_seeds_or_of_one_alone_decides_nothing() {
    let more = |accepted: &[u64]| {
        let ends = vec![(49.0, 49.0); accepted.len()];
        let made = made().mc(&BOX, &ends).decided(&BOX, hacks(9, 0)).mc(&BOX_CURRENT, &ends);
        made.each(&BOX_CURRENT, |seed| hacks(9, accepted[seed])).outcome(|e| more_missed(e, &BOX_CURRENT))
    };
    assert_eq!(more(&[5, 5, 5, 5]), Verdict::Holds);
    assert_eq!(more(&[5, 5, 5]), Verdict::Undecided);
    assert_eq!(more(&[5]), Verdict::Undecided);
    assert_eq!(more(&[9, 0, 0, 0, 0]), Verdict::Undecided, "the interval contains 0");
    assert_eq!(more(&[0, 0, 0, 0]), Verdict::DoesNotHold);
}

#[test]
fn hacks_that_were_never_checked_are_told_where_they_are_known() {
    let numbers = |unchecked: [Option<u64>; 4]| {
        let made = made().mc(&BOX, &BEST).decided(&BOX, hacks(9, 0)).mc(&BOX_CURRENT, &BEST);
        let verdicts = |seed: usize| Verdicts { hacks_unchecked: unchecked[seed], ..hacks(9, 1) };
        more_missed(&Evidence(&made.each(&BOX_CURRENT, verdicts).0), &BOX_CURRENT).numbers
    };
    let told = |numbers: &[Number]| {
        numbers.iter().find(|number| number.name == "hacks never checked per seed").map(|number| number.mean)
    };
    assert_eq!(told(&numbers([Some(2), Some(4), Some(0), Some(6)])), Some(3.0));
    assert_eq!(told(&numbers([Some(2), None, Some(0), Some(6)])), None);
}

#[test]
fn random_numbers_that_are_paired() {
    let spreads = |paired: f64, unpaired: f64| {
        let of = |deviation| Margins { mean: 0.0, deviation, minority: 0.0, margins: Vec::new() };
        let check = |number| CheckSpread { number, hack: false, paired: of(paired), unpaired: of(unpaired) };
        let spread = Spread { seed: 0, repeats: 0, updates: 0, checks: (1..=4).map(check).collect() };
        let record = Record::of_spread(TOMATO_SPREAD.name, TOMATO_SPREAD.config, spread, &Manifest::begin());
        Made([(TOMATO_SPREAD.name.to_owned(), record)].into()).holds(|e| super::spread(e, &TOMATO_SPREAD))
    };
    assert!(spreads(1.0, 2.0) && !spreads(2.0, 1.0) && !spreads(1.0, 1.0));
}

#[test]
fn cost_of_checks() {
    let cells = find("E20")[0].cells();
    // Wall time of each cell by its index and the updates of its forecasts.
    let by = |time: &dyn Fn(usize, u64) -> u64| {
        let mut made = made();
        for (index, cell) in cells.iter().enumerate() {
            let count = 10 + index as u64;
            let forecast = cell.paper().unwrap().forecast;
            made = made.mc(cell, &BEST).decided(cell, checks(count));
            made.record(cell).trained_ms = Some(1000 + time(index, count * u64::from(forecast)));
        }
        made
    };
    assert!(by(&|_, updates| updates).holds(cost));
    assert!(!by(&|_, updates| 100_000 - updates).holds(cost), "dearer with fewer");
    assert!(!by(&|index, updates| updates * (1 + 9 * (index as u64 % 2))).holds(cost), "no line");
    let mut lacking = by(&|_, updates| updates);
    lacking.record(cells[0]).trained_ms = None;
    assert_eq!(cost(&Evidence(&lacking.0)).outcome, Err("wall times of just these seeds"));
}
