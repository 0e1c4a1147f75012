//! Where output goes: results to stdout, buffered; messages to stderr.

use std::env;
use std::fmt::Display;
use std::io::{self, BufWriter, ErrorKind, IsTerminal as _, Stdout, Write};

use clap::ValueEnum;

use super::WIDTH;

/// When to use colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Color {
    /// On a terminal, unless NO_COLOR is set.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// stdout that may lose its reader, who has then seen enough: what is written after that is lost, and the command goes on
/// to its end and its exit code. Who streams results flushes them, and learns of it there.
pub struct Output {
    stdout: Stdout,
    lost: bool,
}

impl Output {
    fn new() -> Self {
        Self { stdout: io::stdout(), lost: false }
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.lost {
            return Ok(bytes.len());
        }
        match self.stdout.write(bytes) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                self.lost = true;
                Ok(bytes.len())
            }
            other => other,
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self.stdout.flush() {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => self.lost = true,
            other => other?,
        }
        if self.lost { Err(ErrorKind::BrokenPipe.into()) } else { Ok(()) }
    }
}

/// Where output goes and how it looks.
pub struct Terminal {
    /// Results.
    pub out: BufWriter<Output>,
    /// Whether results are coloured.
    pub color: bool,
    /// Only results and errors.
    pub quiet: bool,
    /// Every decision as well.
    pub verbose: bool,
}

impl Terminal {
    /// The terminal of this process.
    pub fn new(color: Color, quiet: bool, verbose: bool) -> Self {
        let color = match color {
            Color::Always => true,
            Color::Never => false,
            // An empty NO_COLOR counts as not set (no-color.org).
            Color::Auto => io::stdout().is_terminal() && env::var_os("NO_COLOR").is_none_or(|value| value.is_empty()),
        };
        Self { out: BufWriter::new(Output::new()), color, quiet, verbose }
    }

    /// A message for people, on stderr.
    pub fn note(&self, message: impl Display) {
        if !self.quiet {
            say(message);
        }
    }

    /// Text in a colour (an SGR code: 0 none, 1 bold, 31 red, 32 green, 2 faint).
    pub fn paint(&self, code: u8, text: impl Display) -> String {
        if self.color && code > 0 { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_string() }
    }

    /// A name and what is said of it, in as many lines as that takes, each painted by itself.
    pub fn listed(&self, name: &str, text: &str, color: u8) -> String {
        let indent = name.chars().count() + 1;
        let text = wrap(text, indent, WIDTH);
        let lines = text.lines().enumerate().map(|(number, line)| {
            let margin = if number == 0 { format!("{name} ") } else { " ".repeat(indent) };
            format!("{margin}{}\n", self.paint(color, &line[indent..]))
        });
        lines.collect()
    }
}

/// A line on stderr. A stderr that is closed must not stop a training run.
pub fn say(message: impl Display) {
    let _ = writeln!(io::stderr(), "{message}");
}

/// Words of `text` in lines of at most `width` characters, each after `indent` spaces.
pub fn wrap(text: &str, indent: usize, width: usize) -> String {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(format!("{:indent$}{word}", "")),
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::wrap;

    #[test]
    fn words_are_wrapped_and_never_cut() {
        assert_eq!(wrap("one two three", 2, 9), "  one two\n  three");
        assert_eq!(wrap("unbreakable word", 1, 5), " unbreakable\n word");
        assert_eq!(wrap("", 4, 10), "");
    }
}
