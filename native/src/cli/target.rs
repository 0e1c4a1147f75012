//! Files that somebody names for a command to write: never a run's own, and never what another program wrote.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use mcvl::runs::{RunsError, check_target};

use super::usage;

/// What to do about a file that is in the way of one that can be written again.
pub const ADVICE: &str = "--overwrite replaces it, -o writes elsewhere";

/// How much of a file is looked at to tell what it is, at its beginning and at its end.
const LOOK: usize = 1 << 16;

/// What mcvl writes where it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A picture as SVG.
    Svg,
    /// A picture as PNG.
    Png,
    /// A report.
    Report,
    /// The page.
    Page,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Svg => "SVG picture",
            Kind::Png => "PNG picture",
            Kind::Report => "report",
            Kind::Page => "page",
        }
    }

    /// Whether a file with this beginning and this end is one of those.
    fn is_of(self, head: &[u8], tail: &[u8]) -> bool {
        let has = |part: &[u8], words: &str| part.windows(words.len()).any(|window| window == words.as_bytes());
        match self {
            Kind::Svg => head.starts_with(b"<svg xmlns=\"http://www.w3.org/2000/svg\" font-family=\"'DejaVu Sans'"),
            Kind::Png => head.starts_with(b"\x89PNG\r\n\x1a\n"),
            Kind::Report => head.starts_with(b"<!doctype html>") && has(tail, "Written by <code>mcvl report</code>."),
            Kind::Page => head.starts_with(b"<!doctype html>") && has(head, "<title>mcvl: a learner that refuses"),
        }
    }
}

/// Fails if what lies at `path` is a run's own, or something else than what is to replace it.
///
/// # Errors
/// That, with `advice` where it can be done nevertheless; or that the file cannot be read.
pub fn check(path: &Path, kind: Kind, advice: &str) -> anyhow::Result<()> {
    check_target(path)?;
    // A folder, or a place that is none, is for the writing to name.
    if path.is_file() && !is_one(path, kind).map_err(RunsError::io("read", path))? {
        usage!("{} is there already and is no {} of mcvl: {advice}", path.display(), kind.name());
    }
    Ok(())
}

fn is_one(path: &Path, kind: Kind) -> std::io::Result<bool> {
    let mut file = File::open(path)?;
    let mut head = Vec::new();
    file.by_ref().take(LOOK as u64).read_to_end(&mut head)?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(LOOK as u64)))?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail)?;
    Ok(kind.is_of(&head, &tail))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mcvl::runs::RunSet;
    use mcvl_core::config::{Config, Preset};

    #[test]
    fn what_mcvl_writes_is_told_from_what_others_do() {
        let config = Config::new("box-moving", Preset::Paper).unwrap();
        let set = RunSet { path: "run".into(), config, planned: Vec::new(), seeds: Vec::new() };
        let ours = [
            (Kind::Svg, mcvl::report::plot::curves(&set).svg().into_bytes()),
            (Kind::Page, mcvl::page::whole(None, None).into_bytes()),
            (Kind::Report, mcvl::report::html::html(&[], &|_, _| None, &|_, _| None).into_bytes()),
        ];
        let look = |kind: Kind, bytes: &[u8]| {
            kind.is_of(&bytes[..bytes.len().min(LOOK)], &bytes[bytes.len().saturating_sub(LOOK)..])
        };
        for (kind, bytes) in &ours {
            for (other, _) in &ours {
                assert_eq!(look(*other, bytes), kind == other, "{kind:?} as {other:?}");
            }
        }
        for foreign in ["", "mine", "<svg xmlns=\"http://www.w3.org/2000/svg\"/>", "<!doctype html><title>mcvl</title>"]
        {
            assert!(
                ![Kind::Svg, Kind::Png, Kind::Report, Kind::Page].iter().any(|kind| look(*kind, foreign.as_bytes()))
            );
        }
    }
}
