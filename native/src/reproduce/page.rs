//! Results as a Markdown page: the paper's claim, our figure and our numbers, side by side.

use std::fmt::Write as _;

use super::figures::DRAWINGS;
use super::rows::{QUICK, Results, Row, tally};
use super::table::{EXPERIMENTS, Experiment};
use crate::report::claims::{percent, plural};

/// Line before the part of a page that `mcvl reproduce --page` writes.
pub const BEGIN: &str = "<!-- mcvl reproduce: from here on written by the program -->";
/// Line after it.
pub const END: &str = "<!-- mcvl reproduce: up to here -->";

/// The page. `figures` says where the figures lie, seen from the page, without a final `/`.
pub fn markdown(results: &Results, figures: &str) -> String {
    let mut text = format!("**{}**", results.headline());
    if results.quick {
        let _ = write!(text, " {QUICK}");
    }
    text.push_str("\n\nAn interval is the 95 % interval of a mean over seeds (percentile bootstrap, 1000 resamples); ");
    text.push_str(
        "a value at the end is the mean of the last five evaluation points of a leg. Where E6, E8, E13 to E16 and E18 ",
    );
    text.push_str(
        "claim that one mean is above another, that is *undecided* where the interval of their difference, seed by seed, ",
    );
    text.push_str(
        "contains 0 or is of fewer than four seeds; other claims, those about E6's baselines among them, compare the means themselves. Hacked: at the ",
    );
    text.push_str("end the return is above the performance, by more than 1 (in Reacher 3). E15 has one seed; its intervals are over its checks.\n");
    glance(&mut text, results);
    let mut target = "";
    for experiment in EXPERIMENTS {
        let rows: Vec<&Row> = results.claims.iter().filter(|row| row.experiment == experiment.id).collect();
        if rows.is_empty() {
            continue;
        }
        if experiment.target != target {
            target = experiment.target;
            heading(&mut text, target, figures, results);
        }
        section(&mut text, experiment, &rows);
    }
    worlds(&mut text, results);
    costs(&mut text, results);
    text
}

fn heading(text: &mut String, target: &str, figures: &str, results: &Results) {
    let own: Vec<_> = DRAWINGS.iter().filter(|drawing| drawing.target == target).collect();
    let title = own.first().map_or("Claims without a figure", |drawing| drawing.title);
    let _ = writeln!(text, "\n## {title}");
    let seen = |cell: &str| results.costs.iter().any(|cost| cost.cell == cell);
    for drawing in own.into_iter().filter(|drawing| drawing.cells().iter().any(|cell| seen(cell.name))) {
        let _ = writeln!(text, "\n![{}]({figures}/{}.svg)", drawing.title, drawing.name);
    }
}

/// One line for each experiment, with a link to its rows.
fn glance(text: &mut String, results: &Results) {
    text.push_str(
        "\n## At a glance\n\n| experiment | at the paper's settings | at settings of ours |\n|---|---|---|\n",
    );
    for experiment in EXPERIMENTS.iter().filter(|e| results.claims.iter().any(|row| row.experiment == e.id)) {
        let outcome = |ours: bool| {
            let own = results.claims.iter().filter(|row| row.experiment == experiment.id && row.ours == ours);
            match own.collect::<Vec<_>>()[..] {
                [] => "–".to_owned(),
                [row] => row.outcome_words(),
                ref rows => tally(rows, ""),
            }
        };
        let (paper, ours) = (outcome(false), outcome(true));
        let title = title(experiment);
        let _ = writeln!(text, "| [{title}](#{}) | {} | {} |", slug(&title), cell(&paper), cell(&ours));
    }
}

/// Heading of an experiment's rows.
fn title(experiment: &Experiment) -> String {
    format!("{}: {} ({})", experiment.id, experiment.title, experiment.figure)
}

/// The name under which a heading can be linked to, as GitHub makes it: small letters, digits and hyphens.
fn slug(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.flat_map(char::to_lowercase).map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn section(text: &mut String, experiment: &Experiment, rows: &[&Row]) {
    let _ = writeln!(text, "\n### {}\n", title(experiment));
    let _ = writeln!(text, "The paper: {}.\n", experiment.paper);
    text.push_str("| to be seen | measured | |\n|---|---|---|\n");
    for row in rows {
        let outcome = row.outcome_words();
        let _ = writeln!(text, "| {} | {} | **{outcome}** |", cell(&row.claim), cell(&row.numbers_words()));
    }
    let mut setups: Vec<&str> = rows.iter().flat_map(|row| row.setup.iter().map(String::as_str)).collect();
    setups.sort_unstable();
    setups.dedup();
    let setups: Vec<String> = setups.iter().map(|setup| format!("`{setup}`")).collect();
    let _ = writeln!(text, "\nSetup: {}", setups.join(", "));
}

fn worlds(text: &mut String, results: &Results) {
    if results.worlds.is_empty() {
        return;
    }
    text.push_str("\n## The gate in each world\n\n");
    text.push_str(
        "| world | seeds | checks | per step | refusals | precision | recall (mean of seeds) | hacks never \
         checked | ties (of them hacks) | dead units: Safe, end | updates, gated to ungated |\n\
         |---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for row in &results.worlds {
        let v = &row.verdicts;
        let dead = row.dead_units.map(percent);
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} ({}) | {} | {} ({}) | {}, {} | {} |",
            row.world,
            row.seeds,
            v.checks,
            percent(row.rate),
            v.refusals,
            percent(row.precision),
            percent(row.recall),
            percent(row.recall_of_seeds),
            v.hacks_unchecked.map_or("–".to_owned(), |count| count.to_string()),
            v.ties,
            v.hacks_tied,
            dead[0],
            dead[1],
            row.slowdown.map_or("–".to_owned(), |ratio| format!("{ratio:.1}"))
        );
    }
    text.push_str(
        "\nPrecision: share of the refusals that were hacks; recall: share of the checked hacks that were refused; \
         hacks never checked, since their reward did not surprise, are in neither (–: not recorded); dead units: \
         share of the reward model's first-layer units that no sampled transition activates.\n",
    );
}

fn costs(text: &mut String, results: &Results) {
    let _ = writeln!(text, "\n## Cost\n\n{}", results.cost_words());
    if results.costs.is_empty() {
        return;
    }
    text.push_str("\n| cell | wall time, s | gradient updates | machine |\n|---|---|---|---|\n");
    for cost in &results.costs {
        let seconds = cost.seconds.map_or("–".to_owned(), |seconds| format!("{seconds:.0}"));
        let _ = writeln!(text, "| {} | {seconds} | {} | {} |", cost.cell, cost.updates, cell(&cost.machine));
    }
    let open = EXPERIMENTS.iter().flat_map(Experiment::cells);
    let asked = |name: &str| results.claims.iter().any(|row| names(row).contains(&name));
    let seen = |name: &str| results.costs.iter().any(|cost| cost.cell == name);
    let mut open: Vec<&str> = open.map(|cell| cell.name).filter(|name| asked(name) && !seen(name)).collect();
    open.sort_unstable();
    open.dedup();
    if !open.is_empty() {
        let count = plural(open.len() as u64, "cell");
        let _ = writeln!(text, "\nNot measured yet: {count} ({}).", open.join(", "));
    }
}

/// Cells of a row's claim.
fn names(row: &Row) -> Vec<&'static str> {
    let claims = EXPERIMENTS.iter().filter(|experiment| experiment.id == row.experiment).flat_map(|e| e.claims);
    claims.filter(|claim| claim.text == row.claim).flat_map(|claim| claim.cells).map(|cell| cell.name).collect()
}

/// Text in a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

/// A page with its written part replaced, or none where it has no place for one.
pub fn put(page: &str, written: &str) -> Option<String> {
    let (before, rest) = page.split_once(BEGIN)?;
    let (_, after) = rest.split_once(END)?;
    Some(format!("{before}{BEGIN}\n\n{}\n\n{END}{after}", written.trim()))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::rows::judge;
    use super::super::table::find;
    use super::*;

    #[test]
    fn the_page_names_what_is_missing() {
        let text = markdown(&judge(&find("all"), &BTreeMap::new(), true, &|cell| cell.seeds(true)), "figures");
        assert!(text.contains("### E20: Cost of the gate (appendix D)"), "{text}");
        assert!(
            text.contains("| [E20: Cost of the gate (appendix D)](#e20-cost-of-the-gate-appendix-d) | not measured")
        );
        assert!(text.contains("**not measured (0 of 2 cells done)**") && text.contains("not the paper's setting"));
        assert!(!text.contains("!["), "there is no figure without a number");
        assert!(text.lines().filter(|line| line.starts_with('|')).all(|line| line.ends_with('|')));
    }

    #[test]
    fn only_the_written_part_is_replaced() {
        let page = format!("before\n{BEGIN}\nold\n{END}\nafter\n");
        let put_once = put(&page, "new\n").unwrap();
        assert_eq!(put_once, format!("before\n{BEGIN}\n\nnew\n\n{END}\nafter\n"));
        assert_eq!(put(&put_once, "new").unwrap(), put_once);
        assert_eq!(put("no place", "new"), None);
        assert_eq!(put(BEGIN, "new"), None);
    }
}
