//! Builds the page's modules: one source, compiled without and with SIMD, each with its glue.

use std::env;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::thread;

use anyhow::{Context, Result, bail};
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest as _, Sha256};

use crate::process;
use crate::setup::WASM;

/// The two modules: name and compiler flags. Relaxed SIMD is never on: its results differ between machines.
const MODULES: &[(&str, &[&str])] = &[("scalar", &[]), ("simd", &["-Ctarget-feature=+simd128"])];

/// Largest file over the wire by the end of its name, bytes of gzip; the first that fits counts.
const BUDGETS: &[(&str, u64)] = &[
    (".wasm", 250_000),
    ("page.js", 11_000),
    (".js", 4_600),
    (".html", 7_500),
    (".css", 4_000),
    // It comes before the first frame; other recordings come when they are asked for.
    ("www/tape.json", 3_000),
    (".json", 16_000),
];
/// Scripts of panels that are loaded when somebody asks for them.
const LATER: &[&str] = &["compare.js", "drive.js", "redteam.js", "trap.js", "vote.js"];
/// Largest sum of the markup, style sheets and scripts that every visit loads, bytes of gzip. Of the glue of the two
/// modules a visit takes one.
const VISIT_BUDGET: u64 = 60_000;
/// ... and of those that are loaded later.
const LATER_BUDGET: u64 = 15_000;

/// Where the name of the build lies in `www`; the service worker imports it.
const NAME: &str = "pkg/build.js";

/// Builds both modules into `www/pkg`, names the build, and compares their sizes with the page's budgets.
pub fn build() -> Result<()> {
    // At once: each is linked as one piece, on one core.
    let (glue, modules) = thread::scope(|scope| {
        let modules: Vec<_> = MODULES.iter().map(|(name, flags)| scope.spawn(|| compile(name, flags))).collect();
        let join = |module: thread::ScopedJoinHandle<'_, _>| module.join().expect("compiling reports what goes wrong");
        (build_glue(), modules.into_iter().map(join).collect::<Vec<_>>())
    });
    let (glue, folder) = (glue?, process::root().join("www/pkg"));
    for ((name, _), module) in MODULES.iter().zip(modules) {
        process::run(process::command(&glue).arg(module?).arg(&folder).arg(name))?;
    }
    let www = process::root().join("www");
    name_build(&www)?;
    report(&www)
}

/// Names the build by all that it consists of, so that a browser that kept another one keeps this one.
pub fn name_build(www: &Path) -> Result<()> {
    let mut digest = Sha256::new();
    for file in files(www)?.into_iter().filter(|file| !file.ends_with(NAME)) {
        digest.update(fs::read(&file).with_context(|| format!("{} cannot be read", file.display()))?);
    }
    let name: String = digest.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let file = www.join(NAME);
    fs::write(&file, format!("self.build = \"{name}\";\n"))
        .with_context(|| format!("{} cannot be written", file.display()))
}

/// Compiles the program that makes the glue.
fn build_glue() -> Result<PathBuf> {
    process::run(process::cargo().args(["build", "--quiet", "--package", "xtask-glue"]))?;
    Ok(process::program("debug", "xtask-glue"))
}

/// Compiles one module, in a folder of its own: the flags are part of what it is.
fn compile(name: &str, flags: &[&str]) -> Result<PathBuf> {
    let target = process::target().join("web").join(name);
    let mut flags: Vec<String> = flags.iter().map(ToString::to_string).collect();
    // Panic messages name source files: the same ones wherever it was built.
    let home = env::var_os("CARGO_HOME").map(PathBuf::from).or_else(|| Some(env::home_dir()?.join(".cargo")));
    for (folder, alias) in [(home, "cargo"), (Some(process::root()), "mcvl")] {
        flags.extend(folder.map(|folder| format!("--remap-path-prefix={}={alias}", folder.display())));
    }
    let mut cargo = process::cargo();
    cargo.args(["build", "--package", "mcvl-web", "--profile", "web", "--target", WASM]);
    process::run(cargo.env("CARGO_TARGET_DIR", &target).env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}")))?;
    Ok(target.join(WASM).join("web").join("mcvl_web.wasm"))
}

/// Prints the size of every file of the page and fails where a budget is exceeded.
fn report(www: &Path) -> Result<()> {
    println!("{:<28} {:>9} {:>9}", "file", "bytes", "gzip");
    let (mut sums, mut excess) = ([0; 2], Vec::new());
    let folder = www.parent().unwrap_or(www);
    for file in files(www)? {
        let shown = file.strip_prefix(folder).unwrap_or(&file).display().to_string();
        let (plain, packed) = (fs::metadata(&file)?.len(), gzip_size(&file)?);
        println!("{shown:<28} {plain:>9} {packed:>9}");
        match BUDGETS.iter().find(|(end, _)| shown.ends_with(end)) {
            Some((_, budget)) if packed <= *budget => {}
            Some((_, budget)) => excess.push(format!("{shown} has {packed} bytes, its budget is {budget}")),
            None => excess.push(format!("{shown} has no budget")),
        }
        let later = LATER.iter().any(|name| shown.ends_with(name));
        if [".html", ".css", ".js"].iter().any(|end| shown.ends_with(end)) && !shown.ends_with("pkg/scalar.js") {
            sums[usize::from(later)] += packed;
        }
    }
    let names = ["markup, style sheets and scripts of every visit", "scripts that are loaded when they are asked for"];
    for ((sum, budget), name) in sums.into_iter().zip([VISIT_BUDGET, LATER_BUDGET]).zip(names) {
        println!("{name}: {sum} of {budget} (gzip)");
        if sum > budget {
            excess.push(format!("{name}: {sum} bytes, the budget is {budget}"));
        }
    }
    if excess.is_empty() { Ok(()) } else { bail!("the page is too large over the wire: {}", excess.join("; ")) }
}

/// Every file below a folder, sorted.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("{} cannot be read", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() { found.extend(files(&path)?) } else { found.push(path) }
    }
    found.sort();
    Ok(found)
}

/// Size of a file as a server sends it.
fn gzip_size(file: &Path) -> Result<u64> {
    let mut encoder = GzEncoder::new(Count(0), Compression::best());
    io::copy(&mut File::open(file)?, &mut encoder)?;
    Ok(encoder.finish()?.0)
}

/// Counts what is written to it.
struct Count(u64);

impl io::Write for Count {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
