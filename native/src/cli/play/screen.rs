//! Playing with the keyboard: the terminal in raw mode, on its second screen.

use std::io::{self, Write as _};
use std::panic;
use std::process;

use crossterm::cursor::{Hide, MoveTo, Show};
use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::terminal::{
    Clear, ClearType, DisableLineWrap, EnableLineWrap, EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode,
    enable_raw_mode, is_raw_mode_enabled, size,
};
use crossterm::{execute, queue};
use mcvl::report::film;
use mcvl_core::env::Discrete;

use super::{Done, Game, Input, amount};
use crate::cli::WIDTH;
use crate::cli::terminal::{Terminal, wrap};

/// Plays until the episode is over or the player ends it.
pub fn play(game: &mut Game, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let _raw = Raw::enter()?;
    let mut last = None;
    while !game.is_over() {
        draw(game, last, terminal)?;
        let Event::Key(key) = event::read()? else { continue };
        if key.kind == KeyEventKind::Release {
            continue;
        }
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            match key.code {
                KeyCode::Char('c') => return Ok(Done::Interrupted),
                // The end of the input, as the terminal would have it.
                KeyCode::Char('d') => break,
                _ => continue,
            }
        }
        match input(key.code, game.names) {
            Some(Input::Act(action)) => last = game.act(action),
            Some(Input::Quit) => break,
            None => {}
        }
    }
    Ok(Done::Well)
}

/// What a key asks for, if anything.
fn input(key: KeyCode, names: &[&str]) -> Option<Input> {
    let name = match key {
        KeyCode::Up | KeyCode::Char('w' | 'W') => "up",
        KeyCode::Down | KeyCode::Char('s' | 'S') => "down",
        KeyCode::Left | KeyCode::Char('a' | 'A') => "left",
        KeyCode::Right | KeyCode::Char('d' | 'D') => "right",
        KeyCode::Esc | KeyCode::Char('q' | 'Q') => return Some(Input::Quit),
        _ => return None,
    };
    names.iter().position(|known| *known == name).map(|index| Input::Act(Discrete(index as u8)))
}

/// Draws everything anew: it is a few lines, and a resized window needs it.
fn draw(game: &Game, last: Option<f32>, terminal: &mut Terminal) -> io::Result<()> {
    // A terminal that does not tell its size is taken for a usual one.
    let (columns, rows) = match size() {
        Ok((columns, rows)) if columns > 0 && rows > 0 => (usize::from(columns), usize::from(rows)),
        _ => (WIDTH, usize::MAX),
    };
    let width = columns.min(WIDTH);
    let (score, spec, frame) = (game.score(), game.play.spec(), game.play.frame());
    let last = last.map_or(String::new(), |reward| amount(f64::from(reward)));
    let figures = [
        format!("step   {:>7} of {}", score.steps, spec.max_steps),
        format!("reward {last:>7}"),
        format!("return {:>7}", amount(score.observed_return)),
    ];
    let board = film::board(&frame, false);
    let wide = board.iter().map(|row| row.chars().count()).max().unwrap_or(0);
    let title = game.title(terminal, width).lines().map(str::to_owned).collect();
    let mut middle = Vec::new();
    let painted = film::board(&frame, terminal.color);
    for index in 0..board.len().max(figures.len()) {
        let (plain, drawn) =
            (board.get(index).map_or("", String::as_str), painted.get(index).map_or("", String::as_str));
        let gap = wide + 4 - plain.chars().count();
        middle.push(format!("  {drawn}{:gap$}{}", "", figures.get(index).map_or("", String::as_str)));
    }
    let keys = if game.names.contains(&"left") { "arrows or w a s d: move" } else { "up and down, or w and s: move" };
    let keys = terminal.paint(2, format!("{keys}; q: end"));
    let legend = wrap(&film::legend_of(spec, &[&frame]), 0, width);
    let legend = legend.lines().map(|line| terminal.paint(2, line)).collect();
    queue!(terminal.out, Clear(ClearType::All))?;
    for (row, line) in (0..).zip(&fit(title, middle, keys, legend, rows)) {
        queue!(terminal.out, MoveTo(0, row))?;
        write!(terminal.out, "{line}")?;
    }
    terminal.out.flush()
}

/// The lines of a screen with this many rows. Where they are too few, what the characters mean goes first, then the
/// task, then the empty lines and the name of the world.
fn fit(title: Vec<String>, board: Vec<String>, keys: String, legend: Vec<String>, rows: usize) -> Vec<String> {
    let blank = || vec![String::new()];
    let mut parts = [title, blank(), board, blank(), vec![keys], legend];
    for (part, left) in [(5, 0), (0, 1), (3, 0), (1, 0), (0, 0)] {
        let lines: usize = parts.iter().map(Vec::len).sum();
        let keep = parts[part].len().saturating_sub(lines.saturating_sub(rows)).max(left);
        parts[part].truncate(keep);
    }
    let mut lines = parts.concat();
    lines.truncate(rows);
    lines
}

/// The terminal in raw mode until this is dropped.
struct Raw;

impl Raw {
    /// From here on the terminal is restored however the program ends, short of a kill.
    fn enter() -> anyhow::Result<Self> {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            // First, so that what is said about the panic can be read.
            restore();
            before(panic);
        }));
        ctrlc::set_handler(|| {
            restore();
            process::exit(130);
        })?;
        enable_raw_mode()?;
        let raw = Self;
        execute!(io::stdout(), EnterAlternateScreen, DisableLineWrap, Hide)?;
        Ok(raw)
    }
}

impl Drop for Raw {
    fn drop(&mut self) {
        restore();
    }
}

/// Gives the terminal back as it was; does nothing where it was.
fn restore() {
    if is_raw_mode_enabled().unwrap_or(true) {
        // There is nobody left to tell that a terminal went away.
        let _ = execute!(io::stdout(), LeaveAlternateScreen, EnableLineWrap, Show);
        let _ = disable_raw_mode();
    }
}

#[cfg(test)]
mod tests {
    use super::fit;

    #[test]
    fn what_matters_most_stays_on_a_small_screen() {
        let lines = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let screen = |rows: usize| {
            let (title, board, legend) = (lines(&["name", "task"]), lines(&["##", "A#"]), lines(&["wall", "agent"]));
            fit(title, board, "keys".to_owned(), legend, rows).join(" ")
        };
        assert_eq!(screen(100), "name task  ## A#  keys wall agent");
        assert_eq!(screen(9), screen(100));
        assert_eq!(screen(8), "name task  ## A#  keys wall");
        assert_eq!(screen(7), "name task  ## A#  keys");
        assert_eq!(screen(6), "name  ## A#  keys");
        assert_eq!(screen(5), "name  ## A# keys");
        assert_eq!(screen(4), "name ## A# keys");
        assert_eq!(screen(3), "## A# keys");
        assert_eq!((screen(2), screen(0)), ("## A#".to_owned(), String::new()));
    }
}
