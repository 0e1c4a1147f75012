//! The updates of the benchmarks as a program that others start: `compare.py` times it beside JAX and PyTorch, natively
//! and as wasm.
//!
//! A line of its input is a command, a line of its output the answer: `cases` (their names), `prepare CASE` (from the
//! same beginning each time; answered `ready`), `run COUNT` (updates of that case; answered with a digest of their
//! losses).

mod cases;

use cases::{CASES, Update, update};
use std::io::{self, BufRead as _, Write as _};

fn main() -> io::Result<()> {
    let mut prepared: Option<Update> = None;
    for line in io::stdin().lock().lines() {
        let line = line?;
        let (command, argument) = line.split_once(' ').unwrap_or((&line, ""));
        let answer = match command {
            "cases" => CASES.map(|(name, _)| name).join(" "),
            "prepare" => match CASES.into_iter().find(|(name, _)| *name == argument) {
                Some((_, case)) => {
                    prepared = Some(update(case).1);
                    "ready".into()
                }
                None => format!("error: `{argument}` is no case"),
            },
            "run" => match (argument.parse::<u32>(), &mut prepared) {
                (Ok(count), Some(once)) => {
                    let digest = (0..count).fold(0, |digest: u32, _| digest.rotate_left(5) ^ once().to_bits());
                    digest.to_string()
                }
                (Err(error), _) => format!("error: `{argument}`: {error}"),
                (_, None) => "error: no case is prepared".into(),
            },
            _ => format!("error: `{command}` is none of cases, prepare and run"),
        };
        println!("{answer}");
        io::stdout().flush()?;
    }
    Ok(())
}
