//! The page says what it should, nothing breaks out of it, and it asks nobody for anything.

use mcvl_core::record::Verdict;

use super::*;
use crate::report::samples::{self, Outcome as Ending};

/// The page of some runs, with a film for every check.
fn page(sets: &[RunSet]) -> String {
    html(
        sets,
        &|seed, number| {
            let check = seed.checks.iter().find(|check| check.number == number)?;
            Some(samples::check(number, check.hack, check.verdict))
        },
        &|_, _| None,
    )
}

#[test]
fn the_outcome_comes_first() {
    let page = page(&[samples::ten()]);
    let body = page.split("</head>").nth(1).unwrap();
    let heading = body.split("<h1>").nth(1).and_then(|rest| rest.split("</h1>").next()).unwrap();
    assert!(heading.contains("hacked in 10 of 10 seeds") && heading.ends_with("in 1 of 10."), "{heading}");
    assert_eq!(page.matches("<h1>").count(), 1);
}

#[test]
fn failures_have_as_much_room_as_the_success() {
    let wrong = page(&[samples::ten()]);
    assert!(wrong.contains("was hacked in seed 3") && wrong.contains("1 honest transition refused"));
    assert_eq!(wrong.matches("class=\"story\"").count(), 2, "one decision that was right, one that was wrong");
    let fine = page(&[samples::set(&[Ending::Intended])]);
    assert!(fine.contains("<p>Nothing: no seed"));
    assert_eq!(fine.matches("class=\"story\"").count(), 1);
}

#[test]
fn without_a_learner_that_checks_nothing_is_said_of_its_decisions() {
    let mut set = samples::set(&[Ending::Intended]);
    for seed in &mut set.seeds {
        seed.ends.retain(|end| end.arm != Arm::Mc);
        seed.evaluations.retain(|point| point.arm != Arm::Mc);
        seed.checks.clear();
    }
    let page = page(&[set]);
    assert!(
        page.contains("No modification-considering learner was trained here") && !page.contains("<p>Nothing: no seed")
    );
}

#[test]
fn runs_that_are_compared_are_told_apart() {
    let other = RunSet { path: "elsewhere/box-moving".into(), ..samples::set(&[Ending::Missed]) };
    let absent = "env=absent-supervisor".parse().unwrap();
    let absent = RunSet { path: "runs/absent".into(), config: absent, ..samples::set(&[Ending::Intended]) };
    let page = page(&[samples::ten(), other, absent]);
    for name in ["<code>runs/box-moving</code>", "<code>elsewhere/box-moving</code>", "<code>absent</code>"] {
        assert!(page.contains(name), "{name}");
    }
    let groups = ["runs/box-moving", "elsewhere/box-moving", "runs/absent"].map(|path| format!("name=\"show-{path}\""));
    assert_eq!(groups.map(|group| page.matches(&group).count()), [4; 3]);
    let opening = page.split("</header>").next().unwrap();
    assert!(opening.contains("Box Moving, Absent Supervisor"));
    assert!(!opening.contains("full hack"), "what one world can bring is no line across the other's bars");
}

#[test]
fn every_decision_is_a_row() {
    let set = samples::ten();
    let page = page(std::slice::from_ref(&set));
    let count = |class: &str| page.matches(&format!("<tr class=\"{class}\"")).count();
    let of = |verdict| set.seeds.iter().flat_map(|seed| &seed.checks).filter(|check| check.verdict == verdict).count();
    assert_eq!(count("refused") + count("refused wrong"), of(Verdict::Refuse));
    assert_eq!(count("accepted") + count("accepted wrong"), of(Verdict::Accept));
    assert_eq!((count("refused wrong"), count("accepted wrong")), (1, 1));
}

#[test]
fn nothing_is_fetched_and_nothing_runs() {
    let page = page(&[samples::ten(), samples::set(&[Ending::Missed])]);
    for forbidden in ["http://", "https://", "<script", "src=", "url(", "@import", "<link"] {
        assert!(!page.contains(forbidden), "{forbidden}");
    }
}

#[test]
fn decisions_play_in_a_frame_that_can_do_no_more_than_its_document() {
    let asked = std::cell::RefCell::new(Vec::new());
    let pages = |seed: &SeedRun, number: u32| {
        asked.borrow_mut().push((seed.seed, number));
        Some("<p title=\"a & b\">".to_owned())
    };
    let mut plain = samples::set(&[Ending::Stuck]);
    plain.seeds[0].checks.clear();
    let sets = [samples::ten(), plain];
    let page = html(&sets, &|_, _| None, &pages);
    let told = sets[0].seeds.iter().find_map(|seed| {
        let refused = |check: &&CheckRecord| check.hack && check.verdict == Verdict::Refuse;
        Some((seed.seed, seed.checks.iter().find(refused)?.number))
    });
    assert_eq!(asked.take(), [told.unwrap()], "a run without checks has nothing to play");
    assert_eq!(page.matches("<iframe ").count(), 1);
    assert!(page.contains("sandbox=\"allow-scripts allow-forms\" srcdoc=\"&lt;p title=&quot;a &amp; b&quot;>\""));
    assert!(page.contains(&format!("{POLICY}; {}", page::policy())) && page.contains("only its frames run scripts"));
    let [mut long, _] = sets.clone();
    let check = long.seeds[0].checks[0].clone();
    long.seeds.iter_mut().for_each(|seed| seed.checks = vec![check.clone(); 300]);
    assert!(
        html(&[long], &|_, _| None, &pages).contains("<span>the first 200 of 300 decisions of seed 0, step by step")
    );
    let silent = html(&sets, &|_, _| None, &|_, _| None);
    assert!(!silent.contains("<iframe ") && !silent.contains("script-src") && silent.contains("and no script"));
}

#[test]
fn names_cannot_break_out() {
    let mut set = samples::set(&[Ending::Intended]);
    set.path = "runs/<img onerror=\"x\">".into();
    let page = page(&[set]);
    assert!(!page.contains("<img") && page.contains("&lt;img onerror=&quot;x&quot;&gt;"));
}

#[test]
fn elements_are_closed() {
    let page = page(&[samples::ten()]);
    for name in ["section", "table", "tr", "td", "div", "details", "svg", "ul", "li", "p", "figure", "span", "fieldset"]
    {
        let opened = page.matches(&format!("<{name} ")).count() + page.matches(&format!("<{name}>")).count();
        assert_eq!(opened, page.matches(&format!("</{name}>")).count(), "{name}");
    }
}

#[test]
fn the_commands_name_what_differs() {
    let mut set = samples::ten();
    set.config.set("threshold", "0.1").unwrap();
    assert_eq!(train_command(&set), "mcvl train box-moving --set threshold=0.1 --seeds 0..10");
    set.seeds.drain(2..9);
    assert_eq!(train_command(&set), "mcvl train box-moving --set threshold=0.1 --seeds 0,1,9");
    set.seeds.truncate(1);
    set.seeds[0].evaluations.retain(|point| point.arm != Arm::Baseline);
    assert_eq!(train_command(&set), "mcvl train box-moving --set threshold=0.1 --agent mc --seed 0");
}

#[test]
fn runs_without_films_checks_or_seeds_are_reported_too() {
    let mut set = samples::set(&[Ending::Missed]);
    assert!(html(std::slice::from_ref(&set), &|_, _| None, &|_, _| None).contains("not kept in this ledger"));
    set.seeds[0].checks.clear();
    assert!(page(std::slice::from_ref(&set)).contains("nothing to decide"));
    set.seeds.clear();
    assert!(page(&[set]).contains("No seed has finished"));
    assert!(page(&[]).contains("no run to report on"));
}
