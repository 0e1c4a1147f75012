//! The report page: one HTML file that opens from disk, without any request. Only the frames in which decisions play
//! need scripts.
//!
//! It tells the outcome first, then the evidence, then what went wrong with the same room, then every
//! decision, then how to get the same numbers again. Everything that comes from a run is escaped.

mod ledger;
mod story;

pub use story::PLAYED;

use std::fmt::Write as _;

use mcvl_core::config::KEYS;
use mcvl_core::env::EnvSpec;
use mcvl_core::record::{Arm, CheckRecord};

use super::claims::{ArmSummary, Claim, Outcome, SeedEnd, Summary, learner, percent, plural, seed_list};
use super::plot::{Figure, Layout, curves, sweep};
use super::statistics::Estimate;
use super::svg::{self, escape};
use crate::page;
use crate::runs::{self, RunSet, SeedRun, shell_word};
use crate::worlds;

/// Reads the film of a check (by its number) of a seed, where a tape holds it.
pub type Films<'a> = &'a dyn Fn(&SeedRun, u32) -> Option<CheckRecord>;

/// Makes the page in one file that opens at a check (by its number) of a seed.
pub type Pages<'a> = &'a dyn Fn(&SeedRun, u32) -> Option<String>;

/// Shapes that stand beside words: an octagon to stop, a tick, a triangle to warn, a ring.
const SHAPES: &str = "<svg width=\"0\" height=\"0\" style=\"position:absolute\" aria-hidden=\"true\"><defs>\
<symbol id=\"refused\" viewBox=\"0 0 16 16\"><path d=\"M5 0h6l5 5v6l-5 5H5l-5-5V5zM4 7v2h8V7z\" fill-rule=\"evenodd\"/></symbol>\
<symbol id=\"accepted\" viewBox=\"0 0 16 16\"><path d=\"M14 2 6 11 2 7 0 9l6 6L16 4z\"/></symbol>\
<symbol id=\"wrong\" viewBox=\"0 0 16 16\"><path d=\"M8 0 16 15H0zM7 5v5h2V5zM7 11.500v2h2v-2z\" fill-rule=\"evenodd\"/></symbol>\
<symbol id=\"open\" viewBox=\"0 0 16 16\"><path d=\"M8 1a7 7 0 1 0 0 14A7 7 0 0 0 8 1zm0 2a5 5 0 1 1 0 10A5 5 0 0 1 8 3z\"/></symbol>\
</defs></svg>\n";

/// Allows what the page brings itself and nothing else: a report cannot call home.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'";

/// The report on one or more run directories. Films are asked for where one is shown, and a page for every run that
/// has something to play.
pub fn html(sets: &[RunSet], films: Films<'_>, pages: Pages<'_>) -> String {
    let summaries: Vec<Summary> = sets.iter().map(Summary::new).collect();
    let several = sets.len() > 1;
    let runs = sets.iter().zip(names(sets)).zip(&summaries);
    let sections: String =
        runs.map(|((set, name), summary)| section(set, &name, summary, films, pages, several)).collect();
    // A frame does what its document allows, and no more.
    let (frames, scripts) = match sections.contains("<iframe ") {
        true => (format!("; {}", page::policy()), "and only its frames run scripts"),
        false => (String::new(), "and no script"),
    };
    let title = summaries.first().map_or("no runs".into(), |summary| format!("{}: report", summary.title));
    let mut out = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}{frames}\">\n<title>{}</title>\n\
         <style>\n:root{{color-scheme:light dark;{}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{}}}}}\n{}\n{}</style>\n\
         </head>\n<body>\n{SHAPES}",
        escape(&title),
        svg::variables(false),
        svg::variables(true),
        svg::style(),
        include_str!("style.css"),
    );
    out += &opening(sets, &summaries);
    let _ = write!(
        out,
        "<main>\n{sections}</main>\n<footer><p>Written by <code>mcvl report</code>. This file needs no network \
         {scripts}.</p></footer>\n</body>\n</html>\n"
    );
    out
}

/// The top of the page: the outcome in one sentence; for several runs, the comparison.
fn opening(sets: &[RunSet], summaries: &[Summary]) -> String {
    match summaries {
        [] => "<header><h1>There is no run to report on.</h1></header>\n".into(),
        [only] => format!("<header>{}</header>\n", headline(only, "h1")),
        several => {
            let named: Vec<(String, &RunSet)> = names(sets).into_iter().zip(sets).collect();
            let mut worlds: Vec<&str> = Vec::new();
            for title in several.iter().map(|summary| summary.title.as_str()) {
                if !worlds.contains(&title) {
                    worlds.push(title);
                }
            }
            format!(
                "<header><p class=\"eyebrow\">{}</p><h1>Comparison of {}</h1>{}</header>\n",
                escape(&worlds.join(", ")),
                plural(several.len() as u64, "run"),
                figure(&sweep(&named))
            )
        }
    }
}

fn headline(summary: &Summary, level: &str) -> String {
    let unfinished = match summary.unfinished.as_slice() {
        [] => String::new(),
        seeds => format!(
            "<p class=\"bad\"><strong>Unfinished:</strong> seeds {}; their open legs are not counted.</p>",
            seed_list(seeds)
        ),
    };
    format!(
        "<p class=\"eyebrow\">{}, {} world, {}</p><{level}>{}</{level}>{unfinished}",
        escape(&summary.title),
        escape(&summary.variant),
        plural(summary.seeds.len() as u64, "seed"),
        escape(&summary.headline())
    )
}

/// Everything about one run directory.
fn section(set: &RunSet, name: &str, summary: &Summary, films: Films<'_>, pages: Pages<'_>, several: bool) -> String {
    let experiment = set.config.experiment();
    let facts = worlds::spec(&set.config);
    let mut out = String::from("<section class=\"set\">\n");
    if several {
        let _ = write!(out, "<p class=\"eyebrow\"><code>{}</code></p>{}", escape(name), headline(summary, "h2"));
    }
    let _ = writeln!(
        out,
        "<p>Task: {}. The hack: {}.</p>\n{}",
        escape(experiment.task),
        escape(experiment.hack),
        figure(&curves(set))
    );
    out += &claims(summary);
    out += &results(summary);
    out += &story::example(set, &facts, films);
    out += &story::play(set, name, films, pages);
    out += &story::failures(set, summary, &facts, films);
    out += &ledger::ledger(set, &facts);
    out += &reproduce(set);
    out + "</section>\n"
}

/// A figure in both layouts; the style sheet shows the one that fits.
fn figure(figure: &Figure) -> String {
    format!(
        "<figure class=\"figure\"><div class=\"wide\">{}</div><div class=\"narrow\">{}</div></figure>\n",
        figure.inline(Layout::Row),
        figure.inline(Layout::Column)
    )
}

/// A word with its shape; class `good`, `bad` or `plain` gives the colour.
fn tag(class: &str, shape: &str, words: &str) -> String {
    format!("<span class=\"tag {class}\"><svg aria-hidden=\"true\"><use href=\"#{shape}\"/></svg>{words}</span>")
}

fn claims(summary: &Summary) -> String {
    let row = |claim: &Claim| {
        let state = match claim.outcome {
            Outcome::Holds => tag("good", "accepted", "holds"),
            Outcome::DoesNotHold => tag("bad", "wrong", "does not hold"),
            Outcome::NotTested => tag("plain", "open", "not tested"),
        };
        format!("<tr><td>{state}</td><td>{}<small>{}</small></td></tr>\n", escape(&claim.text), claim.numbers())
    };
    let rows: String = summary.claims.iter().map(row).collect();
    format!(
        "<h2>What was claimed, and what came out</h2>\n<table><thead><tr><th scope=\"col\">outcome</th>\
         <th scope=\"col\">claim</th></tr></thead><tbody>\n{rows}</tbody></table>\n"
    )
}

fn results(summary: &Summary) -> String {
    let estimate = |value: &Estimate| {
        format!(
            "<td class=\"n\">{:.1}<small>{:.1} to {:.1}</small><small>IQM {:.1}</small></td>",
            value.mean, value.low, value.high, value.iqm
        )
    };
    let row = |leg: &ArmSummary| {
        let hacked = match leg.arm {
            Arm::Safe => "–".into(),
            _ => format!("{} of {}", leg.hacked(), leg.seeds.len()),
        };
        let (observed, performance) = (estimate(&leg.observed_return), estimate(&leg.performance));
        let name = learner(leg.arm).trim_start_matches("The ").trim_end_matches(" learner");
        format!("<tr><th scope=\"row\">{name}</th>{observed}{performance}<td class=\"n\">{hacked}</td></tr>\n")
    };
    let rows: String = summary.arms.iter().map(row).collect();
    format!(
        "<h2>Where each learner ends</h2>\n<p class=\"note\">Mean of the last {} over seeds, raw reward per \
         episode. Below it the 95 % bootstrap interval and the interquartile mean (IQM).</p>\n\
         <div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Results\"><table><thead><tr>\
         <th scope=\"col\">learner</th><th class=\"n\" scope=\"col\">observed return</th>\
         <th class=\"n\" scope=\"col\">performance</th><th class=\"n\" scope=\"col\">hacked</th>\
         </tr></thead><tbody>\n{rows}</tbody></table></div>\n{}{}",
        summary.end_points(),
        seeds(summary),
        decisions(summary)
    )
}

/// Every seed by itself.
fn seeds(summary: &Summary) -> String {
    let legs: Vec<&ArmSummary> = summary.arms.iter().filter(|leg| leg.arm != Arm::Safe).collect();
    let heads: String = legs.iter().map(|leg| format!("<th scope=\"col\">{}</th>", leg.arm.name())).collect();
    let cell = |leg: &&ArmSummary, seed: u64| {
        let told = leg.seeds.iter().find(|end| end.seed == seed).map(|end| {
            let at = |value: Option<f64>| value.map_or("–".into(), |value| format!("{value:.1}"));
            let (first, state) = (at(end.first_performance), seed_tag(end));
            format!("{state}<small>{:.1} / {:.1}, at the switch {first}</small>", end.observed_return, end.performance)
        });
        format!("<td>{}</td>", told.unwrap_or_else(|| "unfinished".into()))
    };
    let row = |seed: &u64| {
        let cells: String = legs.iter().map(|leg| cell(leg, *seed)).collect();
        format!("<tr><th scope=\"row\">{seed}</th>{cells}</tr>\n")
    };
    let rows: String = summary.seeds.iter().map(row).collect();
    format!(
        "<details><summary>Every seed <span>observed return / performance at the end</span></summary>\
         <div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Every seed\"><table><thead><tr>\
         <th scope=\"col\">seed</th>{heads}</tr></thead><tbody>\n{rows}</tbody></table></div></details>\n"
    )
}

fn seed_tag(end: &SeedEnd) -> String {
    if end.hacked() {
        tag("bad", "wrong", "hacked")
    } else if end.faithful() {
        tag("good", "accepted", "not hacked")
    } else {
        tag("plain", "open", "neither")
    }
}

fn decisions(summary: &Summary) -> String {
    let Some(verdicts) = &summary.verdicts else { return String::new() };
    let unchecked = verdicts.hacks_unchecked.map(|count| format!("; {} it never checked", plural(count, "hack")));
    format!(
        "<p>The modification-considering learner made {} ({} of its steps), refused {}, and spent {} on forecasts. \
         Of its refusals {} were hacks (precision); of the hacks it checked it refused {} (recall){}. \
         {} rated both futures exactly equal, which accepts.</p>\n",
        plural(verdicts.checks, "check"),
        escape(&percent(verdicts.rate())),
        verdicts.refusals,
        plural(verdicts.cost, "gradient update"),
        escape(&percent(verdicts.precision())),
        escape(&percent(verdicts.recall())),
        unchecked.unwrap_or_default(),
        plural(verdicts.ties, "check"),
    )
}

fn reproduce(set: &RunSet) -> String {
    let row = |key: &mcvl_core::config::Key| {
        format!(
            "<tr><th scope=\"row\"><code>{}</code></th><td><code>{}</code></td><td>{}</td><td>{}</td></tr>\n",
            key.name,
            escape(&key.value(&set.config)),
            escape(key.help),
            escape(key.source)
        )
    };
    let rows: String = KEYS.iter().filter(|key| key.name != "seed" && key.name != "agent").map(row).collect();
    format!(
        "<h2>The same numbers again</h2>\n<p>The first command trains the same runs; the second says whether the \
         files of these runs are as they were written.</p>\n<pre>{}\nmcvl verify {}</pre>\n\
         <p class=\"note\">As one line, for a link or a log: <code>{}</code></p>\n\
         <details><summary>Every setting <span>with its value and source</span></summary>\
         <div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Settings\"><table><thead><tr>\
         <th scope=\"col\">setting</th><th scope=\"col\">value</th><th scope=\"col\">meaning</th>\
         <th scope=\"col\">source</th></tr></thead><tbody>\n{rows}</tbody></table></div></details>\n",
        escape(&train_command(set)),
        escape(&shell_word(&set.path)),
        escape(&set.config.to_string())
    )
}

/// The command that trains the same runs.
fn train_command(set: &RunSet) -> String {
    let seeds: Vec<u64> = set.seeds.iter().map(|seed| seed.seed).collect();
    runs::train_command(&set.config, &seeds, &full_legs(set))
}

/// The learners that were trained in the Full world.
fn full_legs(set: &RunSet) -> Vec<Arm> {
    let trained = |arm: &Arm| set.seeds.iter().any(|seed| seed.evaluations.iter().any(|point| point.arm == *arm));
    Arm::ALL.into_iter().filter(|arm| *arm != Arm::Safe).filter(trained).collect()
}

/// Short names of runs: those of their folders; where two are called the same, their paths.
fn names(sets: &[RunSet]) -> Vec<String> {
    let last = |set: &RunSet| set.path.file_name().map(|name| name.to_string_lossy().into_owned());
    let alone = |name: &String| sets.iter().filter(|set| last(set).as_ref() == Some(name)).count() == 1;
    let name = |set: &RunSet| last(set).filter(alone).unwrap_or_else(|| set.path.display().to_string());
    sets.iter().map(name).collect()
}

/// The name of a check's action.
fn action(check: &CheckRecord, facts: &EnvSpec) -> String {
    escape(&facts.actions.name(&check.action))
}

#[cfg(test)]
mod tests;
