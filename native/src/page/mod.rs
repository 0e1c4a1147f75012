//! The page of `www` as one HTML file that opens from disk: style sheets, modules, a run's tape and, where they were
//! built, the modules that train are part of it, and it asks nobody for anything.
//!
//! Style sheets stand in the file as they are. Everything else is compressed and lies in blocks that no browser runs;
//! `boot.js` takes them out and makes modules and workers of them. The policy of the file names that script and the
//! style sheets by their digests and allows, besides, only what the script makes (`blob:`).

use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::Path;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest as _, Sha256};

use crate::runs::RunsError;

/// Lists files of `www` with their content.
macro_rules! www {
    ($($name:literal),* $(,)?) => { &[$(($name, include_str!(concat!("../../../www/", $name)))),*] };
}

const INDEX: &str = include_str!("../../../www/index.html");
const BOOT: &str = include_str!("boot.js");

/// The style sheets, in the order in which the page names them.
const STYLES: &[(&str, &str)] = www!["style.css", "panels.css"];

/// Its scripts, but for `early.js` and `files.js`, in whose place the file brings its own, and the service worker: whoever
/// has the file needs nothing kept.
const SCRIPTS: &[(&str, &str)] = www![
    "board.js",
    "compare.js",
    "computer.js",
    "controls.js",
    "curves.js",
    "dom.js",
    "drive.js",
    "explain.js",
    "film.js",
    "hands.js",
    "ledger.js",
    "link.js",
    "module.js",
    "moment.js",
    "page.js",
    "record.js",
    "recorded.js",
    "redteam.js",
    "tape.js",
    "trap.js",
    "vote.js",
    "worker.js",
];

/// What was recorded for it.
const RECORDINGS: &[(&str, &str)] = www![
    "bands.json",
    "tape.json",
    "tapes/absent-supervisor.json",
    "tapes/dead-model.json",
    "tapes/late-hack.json",
    "tapes/no-reset.json",
    "tapes/no-upbringing.json",
    "tapes/open-walls.json",
    "tapes/reacher.json",
    "tapes/rocks-and-diamonds.json",
    "tapes/short-forecast.json",
    "tapes/short-rollouts.json",
    "tapes/small-bait.json",
    "tapes/tomato-watering.json",
    "tapes/twelve-supervisors.json",
    "tapes/wrong-refusal.json",
];

/// Files of the folder that `cargo xtask web` fills: each module with its glue.
const MODULES: [&str; 4] = ["scalar.js", "scalar_bg.wasm", "simd.js", "simd_bg.wasm"];

/// The modules that train, ready to be part of pages.
pub struct Modules(String);

impl Modules {
    /// Reads the modules of a folder.
    ///
    /// # Errors
    /// If one of them is missing or cannot be read.
    pub fn read(folder: &Path) -> Result<Self, RunsError> {
        let mut blocks = String::new();
        for name in MODULES {
            let path = folder.join(name);
            let bytes = fs::read(&path).map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => RunsError::Request(format!(
                    "there are no modules in {}: {name} is missing; `cargo xtask web` builds them in the repository, \
                     under www/pkg",
                    folder.display()
                )),
                _ => RunsError::io("read", &path)(error),
            })?;
            blocks += &block(&format!("pkg/{name}"), &bytes);
        }
        Ok(Self(blocks))
    }

    /// Whether a folder has modules.
    pub fn are_in(folder: &Path) -> bool {
        MODULES.iter().all(|name| folder.join(name).is_file())
    }
}

/// A tape that a page shows first.
pub struct Tape {
    /// Its name in links of the page.
    pub name: String,
    /// The tape.
    pub text: String,
}

/// The page as one file, with all that was recorded for it; a tape comes first.
pub fn whole(modules: Option<&Modules>, tape: Option<&Tape>) -> String {
    html(RECORDINGS, modules, tape, "")
}

/// The page as one file for a frame that opens at a check of a tape: no other recordings, no panels beside it.
pub fn embedded(modules: Option<&Modules>, tape: &Tape, check: u32) -> String {
    html(&[], modules, Some(tape), &format!("&check={check}&embed=1"))
}

/// The page as one file; `view` stands in the link behind the tape.
fn html(recordings: &[(&str, &str)], modules: Option<&Modules>, tape: Option<&Tape>, view: &str) -> String {
    let styles: String = STYLES.iter().map(|(_, text)| format!("<style>{text}</style>\n")).collect();
    let files = SCRIPTS.iter().chain(recordings);
    let mut files: String = files.map(|(name, text)| block(name, text.as_bytes())).collect();
    let mut root = "<html lang=\"en\">".to_owned();
    if let Some(Tape { name, text }) = tape {
        files += &block(name, text.as_bytes());
        root = format!("<html lang=\"en\" data-link=\"{}\">", escape(&format!("tape={name}{view}")));
    }
    files += modules.map_or("", |modules| &modules.0);

    let mut page = String::new();
    for line in INDEX.lines() {
        if line == "<html lang=\"en\">" {
            page += &root;
        } else if line.starts_with("<meta http-equiv=\"Content-Security-Policy\"") {
            let styles: String = STYLES.iter().map(|(_, text)| format!(" {}", digest(text))).collect();
            let _ = write!(
                page,
                "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; {}; style-src{styles}; \
                 base-uri 'none'; form-action 'none'\">",
                policy()
            );
        } else if line == "</head>" {
            page += &styles;
            page += line;
        } else if line == "</body>" {
            let _ = write!(page, "{files}<script>{BOOT}</script>\n{line}");
        } else if line.starts_with("<link rel=\"icon\"")
            || !["<link ", "<script "].iter().any(|tag| line.starts_with(tag))
        {
            page += line;
        } else {
            // It names a file that is part of this one.
            continue;
        }
        page.push('\n');
    }
    page
}

/// What the page has to be allowed, but for its style sheets: a document with the page in a frame allows it too.
pub fn policy() -> String {
    let boot = digest(BOOT);
    format!("script-src {boot} blob: 'wasm-unsafe-eval'; worker-src blob:; img-src data:")
}

/// The page for a frame of another document, as the value of `srcdoc`.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
}

/// A file, compressed, in a block that no browser runs.
fn block(name: &str, bytes: &[u8]) -> String {
    let mut packed = GzEncoder::new(Vec::new(), Compression::best());
    packed.write_all(bytes).expect("memory takes what is written");
    let packed = packed.finish().expect("memory takes what is written");
    format!("<script type=\"text/plain\" data-file=\"{name}\">{}</script>\n", BASE64_STANDARD.encode(packed))
}

/// The digest by which a policy names what stands in an element.
fn digest(text: &str) -> String {
    format!("'sha256-{}'", BASE64_STANDARD.encode(Sha256::digest(text)))
}

#[cfg(test)]
mod tests;
