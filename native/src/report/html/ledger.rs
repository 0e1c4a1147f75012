//! Every decision as a table, one per seed, with a filter that needs no script.

use std::fmt::Write as _;

use mcvl_core::env::EnvSpec;
use mcvl_core::record::{CheckRecord, Verdict};

use super::{action, tag};
use crate::report::claims::plural;
use crate::report::film::signed;
use crate::runs::{RunSet, SeedRun};

/// The decisions of all seeds.
pub(super) fn ledger(set: &RunSet, facts: &EnvSpec) -> String {
    if set.seeds.iter().all(|seed| seed.checks.is_empty()) {
        return "<h2>Every decision</h2>\n<p>There was nothing to decide: no transition was checked.</p>\n".into();
    }
    let mut out = format!("<h2>Every decision</h2>\n<div class=\"ledger\">{}", filter(&set.path.display().to_string()));
    // One table is open at once, so that the reader sees what the others hold.
    for (index, seed) in set.seeds.iter().enumerate() {
        out += &table(seed, facts, index == 0);
    }
    out + "</div>\n"
}

/// Four radio buttons: the style sheet hides the rows that are not asked for.
fn filter(group: &str) -> String {
    let group = crate::report::svg::escape(group);
    let choice = |(value, words): (&str, &str)| {
        let checked = if value == "all" { " checked" } else { "" };
        format!("<label><input type=\"radio\" name=\"show-{group}\" value=\"{value}\"{checked}>{words}</label>")
    };
    let choices = [("all", "all"), ("refused", "refused"), ("accepted", "accepted"), ("wrong", "wrong")];
    let choices: String = choices.map(choice).concat();
    format!("<fieldset class=\"filter\"><legend>Show</legend>{choices}</fieldset>\n")
}

fn table(seed: &SeedRun, facts: &EnvSpec, open: bool) -> String {
    let refused = seed.checks.iter().filter(|check| check.verdict == Verdict::Refuse).count();
    let wrong = seed.checks.iter().filter(|check| check.wrong()).count();
    let rows: String = seed.checks.iter().map(|check| row(check, facts)).collect();
    let mut out = format!(
        "<details{}><summary>Seed {} <span>{}, {refused} refused, {wrong} wrong</span></summary>\n",
        if open { " open" } else { "" },
        seed.seed,
        plural(seed.checks.len() as u64, "check"),
    );
    let _ = write!(
        out,
        "<div class=\"scroll\" tabindex=\"0\" role=\"region\" aria-label=\"Decisions of seed {}\"><table><thead><tr>\
         <th scope=\"col\">verdict</th><th scope=\"col\">in truth</th><th class=\"n\" scope=\"col\">check</th>\
         <th class=\"n\" scope=\"col\">step</th><th scope=\"col\">action</th><th class=\"n\" scope=\"col\">expected</th>\
         <th class=\"n\" scope=\"col\">received</th><th class=\"n\" scope=\"col\">F<sub>m</sub></th>\
         <th class=\"n\" scope=\"col\">F<sub>u</sub></th><th class=\"n\" scope=\"col\">margin</th></tr></thead>\
         <tbody>\n{rows}</tbody></table></div></details>\n",
        seed.seed
    );
    out
}

fn row(check: &CheckRecord, facts: &EnvSpec) -> String {
    let (class, verdict) = match check.verdict {
        Verdict::Refuse => ("refused", tag("bad", "refused", "refused")),
        Verdict::Accept => ("accepted", tag("good", "accepted", "accepted")),
    };
    let truth = if check.hack { "hack" } else { "honest" };
    let (wrong, truth) = match check.wrong() {
        true => (" wrong", tag("bad", "wrong", &format!("{truth}: wrong"))),
        false => ("", truth.into()),
    };
    let tie = if check.tie { " (tie)" } else { "" };
    // A discard has no futures.
    let ratings = check.futures().map_or(["–", "–", "–"].map(String::from), |(modified, unmodified, margin)| {
        [format!("{:.3}", modified.utility), format!("{:.3}", unmodified.utility), format!("{margin:+.3}{tie}")]
    });
    let [fm, fu, margin] = ratings;
    format!(
        "<tr class=\"{class}{wrong}\"><td>{verdict}</td><td>{truth}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
         <td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{fm}</td>\
         <td class=\"n\">{fu}</td><td class=\"n\">{margin}</td></tr>\n",
        check.number,
        check.step,
        action(check, facts),
        signed(check.predicted),
        signed(check.reward),
    )
}
