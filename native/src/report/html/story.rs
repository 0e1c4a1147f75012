//! Checks told in full: one refused as it should be, and what went wrong.

use std::fmt::Write as _;

use mcvl_core::env::EnvSpec;
use mcvl_core::record::{Arm, CheckRecord, Film, FutureRecord, Subject, Verdict};

use super::{Films, Pages, action, tag};
use crate::page;
use crate::report::claims::{SeedEnd, Summary, plural, seed_list};
use crate::report::film::{self, Part};
use crate::report::svg::escape;
use crate::runs::{RunSet, SeedRun};

/// Decisions of a seed that can be played in a report, besides the one that is told: some hundred kilobytes.
pub const PLAYED: u32 = 200;
/// Wrong decisions that are told one by one before the ledger has to do.
const TOLD: usize = 5;

/// A worked example: the first refused hack of which there is a film, else the first that was refused.
pub(super) fn example(set: &RunSet, facts: &EnvSpec, films: Films<'_>) -> String {
    let Some((seed, check)) = exemplary(set, films) else {
        return "<h2>One decision, step by step</h2>\n<p>No hack was refused in these runs.</p>\n".into();
    };
    format!(
        "<h2>One decision, step by step</h2>\n<p>Seed {}, step {}: the learner was offered a surprising reward and asked \
         what learning from it would make of it.</p>\n{}",
        seed.seed,
        check.step,
        story(&check, facts)
    )
}

/// The refused hack that stands for all.
fn exemplary<'a>(set: &'a RunSet, films: Films<'_>) -> Option<(&'a SeedRun, CheckRecord)> {
    let refused = |check: &&CheckRecord| check.verdict == Verdict::Refuse && check.hack;
    filmed(set, films, refused).or_else(|| first(set, refused))
}

/// The decisions of the seed of the example, else of the first seed that made any, to be played. The page is in a frame
/// that does nothing before it comes into view.
pub(super) fn play(set: &RunSet, name: &str, films: Films<'_>, pages: Pages<'_>) -> String {
    let chosen = exemplary(set, films).or_else(|| first(set, |_| true));
    let Some((seed, page)) = chosen.and_then(|(seed, check)| Some((seed, pages(seed, check.number)?))) else {
        return String::new();
    };
    let decisions = match seed.checks.len() {
        many if many > PLAYED as usize => format!("the first {PLAYED} of {many} decisions"),
        all => plural(all as u64, "decision"),
    };
    format!(
        "<details class=\"play\"><summary>Play it <span>{decisions} of seed {}, step by step</span></summary>\n\
         <iframe title=\"{}: the decisions of seed {}, to play\" loading=\"lazy\" sandbox=\"allow-scripts allow-forms\" \
         srcdoc=\"{}\"></iframe></details>\n",
        seed.seed,
        escape(name),
        seed.seed,
        page::escape(&page)
    )
}

/// What went wrong: as visible as the success.
pub(super) fn failures(set: &RunSet, summary: &Summary, facts: &EnvSpec, films: Films<'_>) -> String {
    let mut out = String::from("<h2>What went wrong</h2>\n");
    let items = complaints(summary);
    if items.is_empty() && summary.arm(Arm::Mc).is_none() {
        return out
            + "<p>No modification-considering learner was trained here, so there was no decision to go wrong.</p>\n";
    }
    if items.is_empty() {
        return out
            + "<p>Nothing: no seed of the modification-considering learner was hacked, no hack was accepted, \
                      no honest transition was refused, and every leg is finished.</p>\n";
    }
    let _ = writeln!(out, "<ul>{}</ul>", items.iter().map(|item| format!("<li>{item}</li>")).collect::<String>());
    let wrong: Vec<(&SeedRun, &CheckRecord)> = checks(set).filter(|(_, check)| check.wrong()).take(TOLD).collect();
    if !wrong.is_empty() {
        out += "<h3>The first wrong decisions</h3>\n<ul>";
        for (seed, check) in &wrong {
            let _ = write!(
                out,
                "<li>Seed {}, check {}, {}. In truth {}</li>",
                seed.seed,
                check.number,
                escape(&check.sentence()),
                escape(&film::truth_words(check))
            );
        }
        out += "</ul>\n";
    }
    if let Some((seed, check)) = filmed(set, films, |check| check.wrong()) {
        let _ = write!(out, "<h3>One of them: seed {}, step {}</h3>\n{}", seed.seed, check.step, story(&check, facts));
    }
    out
}

/// Everything that is not as it should be, in words.
fn complaints(summary: &Summary) -> Vec<String> {
    let mut items = Vec::new();
    let seeds = |test: &dyn Fn(&SeedEnd) -> bool| -> Vec<u64> {
        let ends = summary.arm(Arm::Mc).map_or(&[][..], |leg| &leg.seeds);
        ends.iter().filter(|end| test(end)).map(|end| end.seed).collect()
    };
    let hacked = seeds(&|end| end.hacked());
    if !hacked.is_empty() {
        items.push(format!("The modification-considering learner was hacked in seed {}.", seed_list(&hacked)));
    }
    let astray = seeds(&|end| !end.hacked() && !end.faithful());
    if !astray.is_empty() {
        items.push(format!("It was not hacked but did not keep its level in seed {}.", seed_list(&astray)));
    }
    if let Some(verdicts) = &summary.verdicts {
        if verdicts.hacks_accepted > 0 {
            items.push(format!(
                "{} accepted ({} by an exact tie of both futures).",
                plural(verdicts.hacks_accepted, "hack"),
                verdicts.hacks_tied
            ));
        }
        if verdicts.honest_refused > 0 {
            items.push(format!("{} refused.", plural(verdicts.honest_refused, "honest transition")));
        }
    }
    if !summary.unfinished.is_empty() {
        let (seeds, are) = if summary.unfinished.len() == 1 { ("Seed", "is") } else { ("Seeds", "are") };
        items.push(format!("{seeds} {} {are} not finished.", seed_list(&summary.unfinished)));
    }
    items
}

fn checks(set: &RunSet) -> impl Iterator<Item = (&SeedRun, &CheckRecord)> {
    set.seeds.iter().flat_map(|seed| seed.checks.iter().map(move |check| (seed, check)))
}

fn first(set: &RunSet, wanted: impl Fn(&&CheckRecord) -> bool) -> Option<(&SeedRun, CheckRecord)> {
    checks(set).find(|(_, check)| wanted(check)).map(|(seed, check)| (seed, check.clone()))
}

/// The first wanted check of which there is a film.
fn filmed<'a>(
    set: &'a RunSet,
    films: Films<'_>,
    wanted: impl Fn(&&CheckRecord) -> bool,
) -> Option<(&'a SeedRun, CheckRecord)> {
    let wanted = checks(set).filter(|(_, check)| wanted(check));
    wanted.into_iter().find_map(|(seed, check)| Some((seed, films(seed, check.number)?)))
}

/// A check in full.
fn story(check: &CheckRecord, facts: &EnvSpec) -> String {
    let verdict = match check.verdict {
        Verdict::Refuse => ("bad", "refused"),
        Verdict::Accept => ("good", "accepted"),
    };
    let truth = match check.wrong() {
        true => tag("bad", "wrong", "wrong"),
        false => tag("good", "accepted", "right"),
    };
    let judged = if check.subject == Subject::Update { String::new() } else { truth + " " };
    format!(
        "<div class=\"story\"><h3>The offered transition</h3><div class=\"offer\"><div class=\"frame\">{}</div>\
         <div class=\"action\">{}<span aria-hidden=\"true\">→</span></div><div class=\"frame\">{}</div><p>{}</p></div>\n\
         {}<p class=\"stamp {}\">{}</p>\n<p>{judged}The truth, which the check did not see: {}</p>\
         <p class=\"note\">{}</p></div>\n",
        film::situation(check, &check.before, facts, "before"),
        action(check, facts),
        film::situation(check, &check.after, facts, "after"),
        escape(&film::surprise_words(check)),
        futures(check, facts),
        verdict.0,
        tag(verdict.0, verdict.1, &escape(&film::verdict_words(check))),
        escape(&film::truth_words(check)),
        escape(&film::picture_legend(check, facts)),
    )
}

/// Both futures and their ratings; nothing where nothing was forecast.
fn futures(check: &CheckRecord, facts: &EnvSpec) -> String {
    let Some((_, _, margin)) = check.futures() else { return String::new() };
    let shown = film::futures(check).into_iter().enumerate();
    let shown: String = shown.map(|(index, (name, record))| future(check, index, name, record, facts)).collect();
    let names = film::short_futures(check);
    format!(
        "<div class=\"futures\">{shown}</div>\n<h3>Both futures, rated by what it wants today</h3>\
         <div class=\"ratings\">{}</div><p class=\"note\">Scaled reward. Every rollout is a dot, their mean (F<sub>m</sub> \
         {}, F<sub>u</sub> {}) a bar. <span class=\"keep\">Margin F<sub>m</sub> − F<sub>u</sub> = {margin:+.3}.</span></p>\n",
        film::ratings(check),
        names[0].0,
        names[1].0,
    )
}

fn future(check: &CheckRecord, index: usize, name: &str, future: &FutureRecord, facts: &EnvSpec) -> String {
    let mut out = format!("<div><h3>{name}</h3>");
    for film in &future.films {
        let shown = match film::way(check, film, index, facts) {
            Some((drawing, words)) => {
                format!("<div class=\"frame\">{drawing}</div><p class=\"note\">{}</p>", escape(&words))
            }
            None => strip(check, film, facts),
        };
        let _ =
            write!(out, "<p class=\"note\">{} (rated {:+.3})</p>{shown}", film::start_words(film.start), film.utility,);
    }
    if future.films.is_empty() {
        out += "<p class=\"note\">Its film is not kept in this ledger.</p>";
    }
    out + "</div>"
}

fn strip(check: &CheckRecord, film: &Film, facts: &EnvSpec) -> String {
    let mut cells = String::new();
    let mut gap = String::new();
    for part in film::parts(film) {
        match part {
            Part::Frame(step) => {
                let (above, below) = film::caption(film, step, facts);
                let drawn = film::situation(check, &film.frames[step], facts, &above);
                let (above, below) = (escape(&above), escape(&below));
                let _ = write!(
                    cells,
                    "<li><span>{above}</span><div class=\"frame\">{drawn}</div><span>{below}</span></li>"
                );
            }
            Part::Gap { cycle, steps, predicted } => {
                gap = format!("<p class=\"note\">… {}</p>", film::gap_words(cycle, steps, predicted));
            }
        }
    }
    format!("<ul class=\"strip\">{cells}</ul>{gap}")
}
