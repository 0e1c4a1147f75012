//! A check for the terminal.

use std::fmt::Write as _;

use mcvl_core::env::{EnvSpec, Frame};
use mcvl_core::record::{CheckRecord, Film, FutureRecord, Verdict};

use super::{
    Part, caption, futures, gap_words, legend, parts, rollout_words, short_futures, start_words, surprise_words,
    truth_words, verdict_words,
};
use crate::report::claims::wrapped;

/// Below this width nothing sensible can be drawn.
const NARROWEST: usize = 40;
/// Columns between two frames.
const GAP: usize = 2;
const LABEL: usize = 24;

/// How words stand out where colour is allowed; none of it carries meaning alone.
#[derive(Clone, Copy)]
enum Ink {
    Strong,
    Faint,
    Agent,
    Good,
    Bad,
}

/// Text without and with colour, so that its width is known.
struct Paint {
    colour: bool,
}

impl Paint {
    fn put(&self, ink: Ink, text: &str) -> String {
        if !self.colour {
            return text.to_owned();
        }
        let code = match ink {
            Ink::Strong => "1",
            Ink::Faint => "2",
            Ink::Agent => "1;36",
            Ink::Good => "1;32",
            Ink::Bad => "1;31",
        };
        format!("\u{1b}[{code}m{text}\u{1b}[0m")
    }
}

/// The check in full, at most `width` columns wide (80 suits a terminal; less than 40 counts as 40).
pub fn explain(check: &CheckRecord, names: &EnvSpec, width: usize, colour: bool) -> String {
    let (width, paint) = (width.max(NARROWEST), Paint { colour });
    let heading = |text: &str| paint.put(Ink::Strong, text);
    let mut out = heading(&format!("Check {} of {}, step {}", check.number, check.arm.name(), check.step));
    let _ = write!(out, "\n\n{}\n", heading("The offered transition"));
    out += &transition(check, names, &paint);
    out += &wrapped("  ", &surprise_words(check), width);
    for (name, future) in futures(check) {
        let _ = write!(out, "\n{}\n", heading(name));
        out += &films(future, names, width, &paint);
    }
    if let Some((_, _, margin)) = check.futures() {
        let _ = write!(out, "\n{}\n", heading("Rated by what it wants today (scaled)"));
        out += &bars(check, margin, width);
    }
    for (name, future) in short_futures(check) {
        out += &wrapped(&format!("  rollouts {name:<12}"), &rollout_words(&future.rollouts), width);
    }
    out.push('\n');
    let verdict_ink = if check.verdict == Verdict::Refuse { Ink::Bad } else { Ink::Good };
    out += &painted(&paint, verdict_ink, &wrapped("", &verdict_words(check), width));
    let truth = format!("The truth, which the check did not see: {}", truth_words(check));
    out += &painted(&paint, if check.wrong() { Ink::Bad } else { Ink::Strong }, &wrapped("", &truth, width));
    out.push('\n');
    out + &wrapped("", &legend(check, names), width)
}

/// Colours every line by itself, so that a pager keeps the colour.
fn painted(paint: &Paint, ink: Ink, text: &str) -> String {
    text.lines().map(|line| paint.put(ink, line) + "\n").collect()
}

/// Before and after side by side, the action between them.
fn transition(check: &CheckRecord, names: &EnvSpec, paint: &Paint) -> String {
    let (before, after) = (rows(&check.before), rows(&check.after));
    let action = format!("{} -->", names.actions.name(&check.action));
    let height = before.len().max(after.len());
    let (wide, between) = (columns(&before), action.chars().count() + 6);
    let mut out = format!("  {:<wide$}{:between$}after\n", "before", "", wide = wide.max(6));
    for row in 0..height {
        let middle = if row == height / 2 { action.as_str() } else { "" };
        let left = before.get(row).map_or("", String::as_str);
        let right = after.get(row).map_or("", String::as_str);
        let padding = wide.max(6) - left.chars().count();
        let line = format!("  {}{:padding$}{middle:^between$}{}", paint_row(left, paint), "", paint_row(right, paint));
        let _ = writeln!(out, "{}", line.trim_end());
    }
    if let Some(truth) = check.after.truth.as_ref().filter(|truth| **truth != check.after.seen) {
        out += "  in truth, after it:\n";
        let truth = Frame { seen: truth.clone(), truth: None };
        for row in rows(&truth) {
            let _ = writeln!(out, "  {}", paint_row(&row, paint));
        }
    }
    out
}

fn films(future: &FutureRecord, names: &EnvSpec, width: usize, paint: &Paint) -> String {
    let mut out = String::new();
    for film in &future.films {
        out += &wrapped("  ", &format!("{} (rated {:+.3})", start_words(film.start), film.utility), width);
        out += &strip(film, names, width, paint);
    }
    if future.films.is_empty() {
        out += "  (its film is not kept in this ledger)\n";
    }
    out
}

/// Frames in rows, the action above and the predicted reward below each.
fn strip(film: &Film, names: &EnvSpec, width: usize, paint: &Paint) -> String {
    let parts = parts(film);
    let cells: Vec<Cell> = parts.iter().filter_map(|part| Cell::new(film, *part, names)).collect();
    let cell = cells.iter().map(Cell::width).max().unwrap_or(1);
    let per_row = ((width - 2 + GAP) / (cell + GAP)).max(1);
    let mut out = String::new();
    for row in cells.chunks(per_row) {
        let height = row.iter().map(|cell| cell.lines.len()).max().unwrap_or(0);
        for line in 0..height {
            let mut text = String::from("  ");
            for (index, cell_of_row) in row.iter().enumerate() {
                let content = cell_of_row.lines.get(line).map_or("", String::as_str);
                let drawn = cell_of_row.draw(line, content, paint);
                let padding = if index + 1 < row.len() { cell + GAP - content.chars().count() } else { 0 };
                let _ = write!(text, "{drawn}{:padding$}", "");
            }
            let _ = writeln!(out, "{}", text.trim_end());
        }
    }
    if let Some(Part::Gap { cycle, steps, predicted }) = parts.last() {
        out += &wrapped("  ... ", &gap_words(*cycle, *steps, *predicted), width);
    }
    out
}

/// A frame with its captions.
struct Cell {
    lines: Vec<String>,
}

impl Cell {
    fn new(film: &Film, part: Part, names: &EnvSpec) -> Option<Self> {
        let Part::Frame(step) = part else { return None };
        let (above, below) = caption(film, step, names);
        Some(Self { lines: [vec![above], rows(&film.frames[step]), vec![below]].concat() })
    }

    fn width(&self) -> usize {
        columns(&self.lines)
    }

    fn draw(&self, line: usize, content: &str, paint: &Paint) -> String {
        match line {
            0 => content.to_owned(),
            _ if line + 1 == self.lines.len() => paint.put(Ink::Faint, content),
            _ => paint_row(content, paint),
        }
    }
}

/// Rows of a frame, a space between cells so that they look square.
fn rows(frame: &Frame) -> Vec<String> {
    let spaced = |row: &str| row.chars().map(String::from).collect::<Vec<_>>().join(" ");
    frame.rows().into_iter().map(spaced).collect()
}

fn columns(rows: &[String]) -> usize {
    rows.iter().map(|row| row.chars().count()).max().unwrap_or(0)
}

/// The rows of a situation, as the strips show it.
pub fn board(frame: &Frame, colour: bool) -> Vec<String> {
    rows(frame).iter().map(|row| paint_row(row, &Paint { colour })).collect()
}

fn paint_row(row: &str, paint: &Paint) -> String {
    let draw = |cell: char| match cell {
        'A' => paint.put(Ink::Agent, "A"),
        '.' | '#' => paint.put(Ink::Faint, &cell.to_string()),
        _ => cell.to_string(),
    };
    row.chars().map(draw).collect()
}

/// Both ratings as bars from a common zero, and their difference.
fn bars(check: &CheckRecord, margin: f64, width: usize) -> String {
    let rated = short_futures(check);
    let half = (width - LABEL - 1) / 2;
    let unit = rated.iter().map(|(_, future)| future.utility.abs()).fold(f64::MIN_POSITIVE, f64::max);
    let bar = |value: f64| {
        // Between 0 and `half`, since the unit is the larger of both.
        let length = (value.abs() / unit * half as f64).round() as usize;
        let full = "█".repeat(length);
        if value < 0.0 { format!("{full:>half$}│") } else { format!("{:half$}│{full}", "") }
    };
    let mut out = String::new();
    for (name, future) in rated {
        let _ = writeln!(out, "  {name:<12}{:>+8.3}  {}", future.utility, bar(future.utility));
    }
    let _ = writeln!(out, "  {:<12}{margin:>+8.3}  (difference)", "margin");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::samples;

    fn text(width: usize, hack: bool, verdict: Verdict) -> String {
        explain(&samples::check(17, hack, verdict), &samples::spec(), width, false)
    }

    #[test]
    fn every_width_is_kept() {
        for width in [40, 60, 80, 132] {
            let text = text(width, true, Verdict::Refuse);
            let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > width).collect();
            assert!(wide.is_empty(), "{width}: {wide:#?}");
            assert!(text.lines().all(|line| line.trim_end() == line), "no trailing blanks");
        }
    }

    #[test]
    fn the_story_is_told_in_order() {
        let text = text(80, true, Verdict::Refuse);
        let parts = ["Check 17 of mc, step 629", "down -->", "Expected +0.02, received +1.00 (raw +5)", "If it learns"];
        let rest = ["If it does not", "with it", "without it", "margin", "REFUSED", "The truth", "A agent"];
        let mut from = 0;
        for part in parts.into_iter().chain(rest) {
            let at = text[from..].find(part).unwrap_or_else(|| panic!("`{part}` is missing or too early:\n{text}"));
            from += at;
        }
    }

    #[test]
    fn frames_stand_as_the_world_draws_them() {
        let text = text(80, true, Verdict::Refuse);
        // Start of the first film: agent in the middle of the room, box in the centre.
        let lines: Vec<&str> = text.lines().skip_while(|line| !line.contains("start")).take(7).collect();
        assert!(lines[0].contains("start   1 down  2 down"), "{lines:#?}");
        assert!(lines[3].starts_with("  B A"), "{lines:#?}");
        assert!(lines[4].starts_with("  . v"), "{lines:#?}");
    }

    #[test]
    fn colour_only_adds_to_what_is_said() {
        let check = samples::check(17, false, Verdict::Refuse);
        let coloured = explain(&check, &samples::spec(), 80, true);
        let mut plain = String::new();
        let mut rest = coloured.as_str();
        while let Some((before, after)) = rest.split_once("\u{1b}[") {
            plain += before;
            rest = after.split_once('m').expect("a code ends with m").1;
        }
        plain += rest;
        let trimmed: Vec<&str> = plain.lines().map(str::trim_end).collect();
        let expected = explain(&check, &samples::spec(), 80, false);
        assert_eq!(trimmed, expected.lines().collect::<Vec<_>>());
        assert!(expected.contains("WRONG"));
    }

    #[test]
    fn ledger_lines_without_films_are_explained_too() {
        let mut check = samples::check(1, true, Verdict::Accept);
        check = check.without_films();
        assert!(explain(&check, &samples::spec(), 80, false).contains("not kept"));
    }
}
