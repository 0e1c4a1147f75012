//! Harness of the tests that need more than one room: where things lie, the `mcvl` program, Node,
//! recorded episodes.
#![forbid(unsafe_code)]

pub mod golden;
pub mod reacher;
pub mod source;

use std::env;
use std::io::{BufRead as _, BufReader, Read as _, Seek as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

/// The root of the repository.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the package lies in the repository")
}

/// Recorded data of the tests.
pub fn data() -> PathBuf {
    root().join("tests/data")
}

/// A folder that disappears at the end of the test.
///
/// # Panics
/// If the machine's temporary folder cannot be written to.
pub fn scratch() -> TempDir {
    tempfile::Builder::new().prefix("mcvl-").tempdir().expect("the temporary folder can be written to")
}

/// The `mcvl` program: the one that `MCVL_BIN` names, else built here, once per test process.
///
/// # Panics
/// If it is not there and cannot be built.
pub fn mcvl() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| match env::var_os("MCVL_BIN") {
        Some(path) => {
            let path = PathBuf::from(path);
            assert!(path.is_file(), "MCVL_BIN names {}, which is no file: `cargo build` makes it", path.display());
            path
        }
        None => build_mcvl().expect("mcvl can be built"),
    })
}

fn build_mcvl() -> Result<PathBuf> {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.args(["build", "--package", "mcvl-native", "--message-format=json-render-diagnostics"]).current_dir(root());
    let messages = run(&mut cargo)?;
    let built = messages.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let program = built.filter_map(|message| message["executable"].as_str().map(PathBuf::from)).next_back();
    program.context("cargo named no program")
}

/// `mcvl serve` on a free port, until it is dropped.
pub struct Server {
    process: Child,
    /// Held open: the server may say more.
    _stdout: BufReader<ChildStdout>,
    /// Where the page is, as `mcvl serve` says it: with the query that opens a run.
    pub link: String,
}

impl Server {
    /// Serves the page, and a run if there is one.
    ///
    /// # Panics
    /// If the server does not start.
    pub fn start(run: Option<&Path>) -> Self {
        Self::start_page(Path::new("www"), run)
    }

    /// Serves the page that lies in this folder, and a run if there is one.
    ///
    /// # Panics
    /// If the server does not start.
    pub fn start_page(page: &Path, run: Option<&Path>) -> Self {
        let mut command = Command::new(mcvl());
        command.args(["serve", "--port", "0", "--page"]).arg(page);
        command.args(run).current_dir(root()).stdout(Stdio::piped());
        let mut process = command.spawn().expect("mcvl can be started");
        let mut stdout = BufReader::new(process.stdout.take().expect("stdout is a pipe"));
        let mut line = String::new();
        // The page itself comes first, the run on it second.
        for _ in 0..=usize::from(run.is_some()) {
            line.clear();
            stdout.read_line(&mut line).expect("the server's output can be read");
        }
        let link = line.split_whitespace().next().expect("the server says its address").to_owned();
        Self { process, _stdout: stdout, link }
    }

    /// What it answers to a request for a path: the head in lower case, and the body.
    ///
    /// # Panics
    /// If it does not answer in 20 seconds.
    pub fn get(&self, path: &str) -> (String, String) {
        let address = self.origin().strip_prefix("http://").expect("pages are served without encryption");
        let mut stream = TcpStream::connect(address).expect("the server listens");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("20 seconds are a time");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").expect("it reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("it answers with text");
        let (head, body) = answer.split_once("\r\n\r\n").expect("an answer has a head");
        (head.to_lowercase(), body.to_owned())
    }

    /// Its process, for tests in which it goes away.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// Scheme, host and port.
    pub fn origin(&self) -> &str {
        self.link.split_once("/?").map_or(self.link.trim_end_matches('/'), |(origin, _)| origin)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself; then there is nothing to stop.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Runs a JavaScript module of `tests/node` and returns what it prints.
///
/// # Errors
/// If Node is not installed or the script fails.
pub fn node(script: &str, arguments: &[&str]) -> Result<String> {
    let path = root().join("tests/node").join(script);
    run(Command::new("node").arg(path).args(arguments))
}

/// Runs a JavaScript module of `tests/node` that reads its standard input, and returns what it prints.
///
/// # Errors
/// If Node is not installed or the script fails.
pub fn node_reading(script: &str, input: &str) -> Result<String> {
    let path = root().join("tests/node").join(script);
    let mut file = tempfile::tempfile()?;
    file.write_all(input.as_bytes())?;
    file.rewind()?;
    run(Command::new("node").arg(path).stdin(file))
}

/// Runs a command and returns what it prints.
///
/// # Errors
/// If it cannot be started or fails; the message has what it said.
pub fn run(command: &mut Command) -> Result<String> {
    let Output { status, stdout, stderr } = command
        .output()
        .with_context(|| format!("{command:?} cannot be started; `cargo xtask setup` installs what tests need"))?;
    if !status.success() {
        bail!("{command:?} ended with {status}:\n{}", String::from_utf8_lossy(&stderr));
    }
    Ok(String::from_utf8(stdout)?)
}
