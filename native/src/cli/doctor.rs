//! `mcvl doctor`: what this machine offers, and whether its arithmetic is the promised one.

use std::io::{IsTerminal as _, Write as _};
use std::path::Path;
use std::{fs, io, process};

use clap::Args;
use mcvl::runs::Manifest;
use mcvl::{gpu, mujoco};
use mcvl_core::exact;
use serde_json::json;

use super::Done;
use super::terminal::Terminal;

/// Arguments of `mcvl doctor`.
#[derive(Args)]
pub struct DoctorArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Colours of what is said.
const PLAIN: u8 = 0;
const BAD: u8 = 31;
const GOOD: u8 = 32;

/// Looks at the machine. Exit code 4 if its arithmetic is not exact.
pub fn doctor(arguments: &DoctorArgs, terminal: &mut Terminal) -> anyhow::Result<Done> {
    let about = Manifest::begin();
    let different = different_stages();
    let disk = writable(Path::new("."));
    let mujoco = mujoco::library();
    let adapters = gpu::adapters();
    let stderr = io::stderr().is_terminal();
    if arguments.json {
        let value = json!({
            "version": about.version,
            "commit": about.commit,
            "compiler": about.compiler,
            "target": about.target,
            "cpu": about.cpu,
            "cores": about.cores,
            "vector": about.vector,
            "exact": different.is_empty(),
            "different": different,
            "stages": STAGES,
            "mujoco": {
                "version": mujoco.as_ref().ok().map(|library| &library.version),
                "file": mujoco.as_ref().ok().and_then(|library| library.file.as_ref()),
                "error": mujoco.as_ref().err().map(ToString::to_string),
            },
            "adapters": {
                "found": adapters.as_ref().ok().map(|found| {
                    let value = |a: &gpu::AdapterInfo| json!({ "name": a.name, "driver": a.driver, "software": a.software });
                    found.iter().map(value).collect::<Vec<_>>()
                }),
                "error": adapters.as_ref().err().map(ToString::to_string),
            },
            "disk": disk.as_ref().err().map(ToString::to_string),
            "terminal": { "stdout": io::stdout().is_terminal(), "stderr": stderr, "color": terminal.color },
        });
        writeln!(terminal.out, "{}", serde_json::to_string_pretty(&value)?)?;
    } else {
        let exactness = match &different[..] {
            [] => (GOOD, format!("all {STAGES} stages give the committed digests")),
            list => (BAD, format!("NOT EXACT in {} of {STAGES}: {}", list.len(), list.join(", "))),
        };
        let disk = match disk {
            Ok(()) => (PLAIN, "the current folder can be written to".to_owned()),
            Err(error) => (BAD, format!("the current folder cannot be written to ({error}): use -o elsewhere")),
        };
        let mujoco = match &mujoco {
            Ok(mujoco::Library { version, file }) => match file {
                Some(file) => format!("{version} ({file})"),
                None => version.clone(),
            },
            Err(error) => error.to_string(),
        };
        let graphics = match &adapters {
            Ok(found) if found.is_empty() => gpu::GpuError::NoAdapter { wanted: None, found: Vec::new() }.to_string(),
            Ok(found) => found.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "),
            Err(error) => error.to_string(),
        };
        let progress = if stderr { "progress as bars" } else { "no terminal: progress as plain lines" };
        let rows = [
            ("mcvl", (PLAIN, format!("{} ({})", about.version, about.commit.as_deref().unwrap_or("commit unknown")))),
            ("built", (PLAIN, format!("{} for {}", about.compiler, about.target))),
            ("processor", (PLAIN, format!("{}, {} cores", about.cpu, about.cores))),
            ("vectors", (PLAIN, format!("{} (speed only: every unit gives the same bits)", about.vector))),
            ("arithmetic", exactness),
            ("MuJoCo", (PLAIN, mujoco)),
            ("graphics", (PLAIN, graphics)),
            ("disk", disk),
            ("terminal", (PLAIN, progress.to_owned())),
        ];
        for (name, (color, value)) in rows {
            let line = terminal.listed(&format!("{name:<11}"), &value, color);
            write!(terminal.out, "{line}")?;
        }
    }
    Ok(if different.is_empty() { Done::Well } else { Done::Mismatch })
}

/// Stages of the self-test: those of every build of core, and TD3's.
const STAGES: usize = exact::COMMITTED.len() + 1;

/// Stages of the self-test whose digest is not the committed one.
fn different_stages() -> Vec<&'static str> {
    let td3 = (exact::td3() != exact::COMMITTED_TD3).then_some("td3");
    let digests = exact::digests();
    let expected = |name: &str| exact::COMMITTED.iter().find(|(stage, _)| *stage == name).map(|(_, digest)| *digest);
    digests
        .into_iter()
        .filter(|(name, digest)| expected(name) != Some(*digest))
        .map(|(name, _)| name)
        .chain(td3)
        .collect()
}

/// Whether runs can be written in a folder.
fn writable(folder: &Path) -> io::Result<()> {
    let path = folder.join(format!(".mcvl-doctor-{}", process::id()));
    fs::write(&path, b"test")?;
    fs::remove_file(&path)
}
