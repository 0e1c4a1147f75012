//! What runs say to people: statistics, claims, figures, films of both futures and the report page.
//!
//! Everything here reads a finished [`RunSet`](crate::runs::RunSet) and returns text or bytes: nothing
//! touches a file, a clock or a terminal, so the same runs always give the same report.

pub mod claims;
pub mod expression;
pub mod film;
pub mod html;
pub mod plot;
pub mod statistics;
mod svg;

#[cfg(test)]
pub(crate) mod samples;

/// A field of a CSV file.
pub(crate) fn csv_field(text: &str) -> String {
    if text.contains(['"', ',', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
