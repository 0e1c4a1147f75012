//! A check for the terminal.

use std::fmt::Write as _;
use std::ops::Range;

use mcvl_core::env::{EnvSpec, Frame};
use mcvl_core::record::{CheckRecord, Film, FutureRecord, Verdict};

use super::arm::is_arm;
use super::{
    Part, caption, futures, gap_words, is_picture, legend, milestones, parts, rollout_words, short_futures, signed,
    start_words, surprise_words, truth_words, verdict_words,
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
    /// Whether the boards show an arm: then `#` is a part of it and no wall.
    arm: bool,
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

/// The check in full, at most `width` columns wide (80 suits a terminal; less than 40 counts as 40). A single
/// board that is wider than that stays whole. The heading names the `seed`, where it has to be told from others.
pub fn explain(check: &CheckRecord, seed: Option<u64>, names: &EnvSpec, width: usize, colour: bool) -> String {
    let (width, paint) = (width.max(NARROWEST), Paint { colour, arm: is_arm(names) });
    let heading = |text: &str| paint.put(Ink::Strong, text);
    let title = seed.map_or("Check".to_owned(), |seed| format!("Seed {seed}, check"));
    let mut out = heading(&format!("{title} {} of {}, step {}", check.number, check.arm.name(), check.step));
    let _ = write!(out, "\n\n{}\n", heading("The offered transition"));
    out += &transition(check, names, width, &paint);
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

/// What is shown of the boards of one world that stand together.
enum View {
    /// Grids, whole, with a space between cells so that they look square.
    Grid,
    /// Pictures without spaces, cut to these rows and columns: those in which any of them shows something, and
    /// one around them.
    Picture { rows: Range<usize>, columns: Range<usize> },
}

impl View {
    fn of(boards: &[&str], names: &EnvSpec) -> Self {
        if !boards.iter().any(|board| is_picture(board)) {
            return Self::Grid;
        }
        let empty = |cell: char| cell == ' ' || names.legend.contains(&(cell, "empty"));
        let mut shown = Vec::new();
        for (row, cells) in boards.iter().flat_map(|board| board.split('\n').enumerate()) {
            shown.extend(cells.chars().enumerate().filter(|(_, cell)| !empty(*cell)).map(|(column, _)| (row, column)));
        }
        let (rows, columns) = (shown.iter().map(|at| at.0), shown.iter().map(|at| at.1));
        Self::Picture { rows: around(rows), columns: around(columns) }
    }

    fn rows(&self, board: &str) -> Vec<String> {
        match self {
            Self::Grid => spaced(board),
            Self::Picture { rows, columns } => {
                let cut = |row: &str| row.chars().skip(columns.start).take(columns.len()).collect();
                board.split('\n').skip(rows.start).take(rows.len()).map(cut).collect()
            }
        }
    }
}

/// From one before the first to one after the last; empty where there are none.
fn around(places: impl Iterator<Item = usize> + Clone) -> Range<usize> {
    let (first, last) = (places.clone().min(), places.max());
    first.map_or(0, |first| first.saturating_sub(1))..last.map_or(0, |last| last + 2)
}

/// Before and after, the action between them: side by side, or under each other where that is too wide.
fn transition(check: &CheckRecord, names: &EnvSpec, width: usize, paint: &Paint) -> String {
    let truth = check.after.truth.as_ref().filter(|truth| **truth != check.after.seen);
    let boards: Vec<&str> =
        [&check.before.seen, &check.after.seen].into_iter().chain(truth).map(String::as_str).collect();
    let view = View::of(&boards, names);
    let (before, after) = (view.rows(&check.before.seen), view.rows(&check.after.seen));
    let action = format!("{} -->", names.actions.name(&check.action));
    let (wide, right) = (columns(&before).max(6), columns(&after).max(5));
    // One line for the action or, where its numbers take too much room, one for each of them.
    let lines = |action: &str| action.split_inclusive(", ").map(|part| part.trim_end().to_owned()).collect();
    let choices = match view {
        View::Grid => vec![vec![action.clone()]],
        View::Picture { .. } => vec![vec![action.clone()], lines(&action)],
    };
    let fits = |middle: &Vec<String>| matches!(view, View::Grid) || 2 + wide + columns(middle) + 6 + right <= width;
    let mut out = match choices.iter().find(|middle| fits(middle)) {
        Some(middle) => side_by_side(&before, middle, &after, wide, paint),
        None => {
            let drawn = |name: &str, board: &[String]| format!("  {name}\n{}", indented(board, paint));
            drawn("before", &before) + &wrapped("  ", &action, width) + &drawn("after", &after)
        }
    };
    if let Some(truth) = truth {
        out += "  in truth, after it:\n";
        out += &indented(&view.rows(truth), paint);
    }
    out
}

/// Two boards with the lines of an action between them.
fn side_by_side(before: &[String], action: &[String], after: &[String], wide: usize, paint: &Paint) -> String {
    let height = before.len().max(after.len());
    let between = columns(action) + 6;
    let first = (height / 2).saturating_sub(action.len() - 1);
    let mut out = format!("  {:<wide$}{:between$}after\n", "before", "");
    for row in 0..height {
        let middle = row.checked_sub(first).and_then(|line| action.get(line)).map_or("", String::as_str);
        let left = before.get(row).map_or("", String::as_str);
        let right = after.get(row).map_or("", String::as_str);
        let padding = wide - left.chars().count();
        let line = format!("  {}{:padding$}{middle:^between$}{}", paint_row(left, paint), "", paint_row(right, paint));
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

fn indented(board: &[String], paint: &Paint) -> String {
    board.iter().map(|row| format!("  {}\n", paint_row(row, paint))).collect()
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

/// Frames in rows, the action above and the predicted reward below each; of pictures only some, which say
/// more than their neighbours would.
fn strip(film: &Film, names: &EnvSpec, width: usize, paint: &Paint) -> String {
    if film.frames.iter().any(|frame| is_picture(&frame.seen)) {
        return pictures(film, names, width, paint);
    }
    let parts = parts(film);
    let cells: Vec<Cell> = parts.iter().filter_map(|part| Cell::new(film, *part, names)).collect();
    let mut out = cells_in_rows(&cells, width, paint);
    if let Some(Part::Gap { cycle, steps, predicted }) = parts.last() {
        out += &wrapped("  ... ", &gap_words(*cycle, *steps, *predicted), width);
    }
    out
}

/// Some frames of a film, and under each what is expected of the steps that lead to it.
fn pictures(film: &Film, names: &EnvSpec, width: usize, paint: &Paint) -> String {
    let shown = milestones(film);
    let boards: Vec<&str> = shown.iter().map(|step| film.frames[*step].seen.as_str()).collect();
    let view = View::of(&boards, names);
    let mut from = 0;
    let mut cells = Vec::new();
    for (step, board) in shown.iter().zip(boards) {
        let expected = signed(film.predicted.iter().take(*step).skip(from).sum());
        let (above, below) = match step - from {
            0 => ("start".into(), String::new()),
            1 => (format!("step {step}"), expected),
            _ => (format!("step {step}"), format!("{}-{step}: {expected}", from + 1)),
        };
        cells.push(Cell { lines: [vec![above], view.rows(board), vec![below]].concat() });
        from = *step;
    }
    let left_out = (film.actions.len() + 1).saturating_sub(shown.len());
    let expected = signed(film.predicted.iter().sum());
    let words = match left_out {
        0 => format!("expected {expected} in all"),
        _ => format!("{left_out} of {} steps are left out; expected {expected} in all", film.actions.len()),
    };
    cells_in_rows(&cells, width, paint) + &wrapped("  ... ", &words, width)
}

fn cells_in_rows(cells: &[Cell], width: usize, paint: &Paint) -> String {
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
        Some(Self { lines: [vec![above], spaced(&film.frames[step].seen), vec![below]].concat() })
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

/// Rows of a grid, a space between cells so that they look square.
fn spaced(board: &str) -> Vec<String> {
    board.split('\n').map(|row| row.chars().map(String::from).collect::<Vec<_>>().join(" ")).collect()
}

fn columns(rows: &[String]) -> usize {
    rows.iter().map(|row| row.chars().count()).max().unwrap_or(0)
}

/// The rows of a situation, whole, as the strips show it.
pub fn board(frame: &Frame, colour: bool) -> Vec<String> {
    let picture = is_picture(&frame.seen);
    let rows = if picture { frame.rows().into_iter().map(String::from).collect() } else { spaced(&frame.seen) };
    rows.iter().map(|row| paint_row(row, &Paint { colour, arm: false })).collect()
}

fn paint_row(row: &str, paint: &Paint) -> String {
    let draw = |cell: char| match cell {
        'A' => paint.put(Ink::Agent, "A"),
        'X' if paint.arm => paint.put(Ink::Agent, "X"),
        '#' if paint.arm => "#".into(),
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
        explain(&samples::check(17, hack, verdict), None, &samples::spec(), width, false)
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
        let coloured = explain(&check, None, &samples::spec(), 80, true);
        let mut plain = String::new();
        let mut rest = coloured.as_str();
        while let Some((before, after)) = rest.split_once("\u{1b}[") {
            plain += before;
            rest = after.split_once('m').expect("a code ends with m").1;
        }
        plain += rest;
        let trimmed: Vec<&str> = plain.lines().map(str::trim_end).collect();
        let expected = explain(&check, None, &samples::spec(), 80, false);
        assert_eq!(trimmed, expected.lines().collect::<Vec<_>>());
        assert!(expected.contains("WRONG"));
    }

    #[test]
    fn pictures_fit_and_tell_what_they_leave_out() {
        let (check, spec) = (samples::reach(1), samples::reach_spec());
        for width in [60, 80] {
            let text = explain(&check, None, &spec, width, false);
            let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > width).collect();
            assert!(wide.is_empty(), "{width}: {wide:#?}");
            assert!(text.lines().all(|line| line.trim_end() == line), "no trailing blanks");
            assert!(!text.contains(". ."), "no spaces between cells:\n{text}");
        }
        let text = explain(&check, None, &spec, 80, false);
        assert!(text.lines().count() <= 200, "{} lines", text.lines().count());
        let film = &check.modified.as_ref().unwrap().films[0];
        let sum = |from: usize, to: usize| signed(film.predicted[from..to].iter().sum());
        let told = ["start", "step 10", "step 50", "shoulder", "in truth, after it:", "+ hidden"].map(String::from);
        let sums = [format!("1-10: {}", sum(0, 10)), format!("41-50: {}", sum(40, 50))];
        let all = format!("45 of 50 steps are left out; expected {} in all", sum(0, 50));
        for part in told.into_iter().chain(sums).chain([all]) {
            assert!(text.contains(&part), "`{part}` is missing:\n{text}");
        }
        assert_eq!(text.matches("step 10").count(), 2);
    }

    #[test]
    fn pictures_are_cut_to_what_they_show() {
        let spec = samples::reach_spec();
        let blank = ".".repeat(30);
        let with = |row: usize, cells: &str| {
            let mut rows = vec![blank.clone(); 8];
            rows[row].replace_range(10..10 + cells.len(), cells);
            rows.join("\n")
        };
        let (first, second) = (with(2, "O#o"), with(4, "=.X"));
        let view = View::of(&[&first, &second], &spec);
        assert_eq!(view.rows(&first), [".....", ".O#o.", ".....", ".....", "....."]);
        assert_eq!(view.rows(&second)[3], ".=.X.");
        // At the edge there is no margin to keep.
        let edge = with(0, "X");
        assert_eq!(View::of(&[&edge], &spec).rows(&edge), [".X.", "..."]);
        // Nothing to show is shown as nothing.
        let empty = vec![blank; 3].join("\n");
        assert!(View::of(&[&empty], &spec).rows(&empty).is_empty());
        let grid = "#A.\n...";
        assert_eq!(View::of(&[grid], &spec).rows(grid), ["# A .", ". . ."]);
    }

    #[test]
    fn boards_of_pictures_are_whole_and_without_spaces() {
        let frame = samples::reach(1).before;
        assert_eq!(board(&frame, false), frame.rows());
    }

    #[test]
    fn ledger_lines_without_films_are_explained_too() {
        let mut check = samples::check(1, true, Verdict::Accept);
        check = check.without_films();
        assert!(explain(&check, None, &samples::spec(), 80, false).contains("not kept"));
    }
}
