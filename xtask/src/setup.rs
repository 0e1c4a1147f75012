//! Installs what building and testing need. Says what before it does, skips what is there, and where
//! something cannot be had, says what to type.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::{mujoco, process};

/// Target of the page's modules.
pub const WASM: &str = "wasm32-unknown-unknown";
/// A target without operating system or standard library, on which core has to build alone.
pub const BARE: &str = "thumbv7em-none-eabihf";

/// What the set-up is for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Purpose {
    /// Building the page.
    Web,
    /// Running every test.
    Test,
    /// Also what makes work more comfortable.
    Comfort,
}

/// How a missing part is installed.
enum Source {
    /// A compilation target of the pinned toolchain.
    Target(&'static str),
    /// A package of a Debian-like distribution.
    Apt(&'static str),
    /// The packages that `package-lock.json` in a folder of the repository pins, one of them by name.
    Npm(&'static str, &'static str),
    /// A program from crates.io, compiled here.
    Crate(&'static str),
    /// MuJoCo's shared library, from its Python package.
    Mujoco,
    /// A driver of Vulkan: where there is no card, one that computes on the processor.
    Vulkan,
}

/// Something that has to be on the machine.
struct Part {
    /// What it is for, in words.
    why: &'static str,
    /// The least demanding purpose that needs it.
    purpose: Purpose,
    source: Source,
    /// Names under which its program may be installed.
    programs: &'static [&'static str],
}

const PARTS: &[Part] = &[
    Part { why: "the page's modules", purpose: Purpose::Web, source: Source::Target(WASM), programs: &[] },
    Part {
        why: "core builds without an operating system",
        purpose: Purpose::Test,
        source: Source::Target(BARE),
        programs: &[],
    },
    Part { why: "tests of the modules", purpose: Purpose::Test, source: Source::Apt("nodejs"), programs: &["node"] },
    Part {
        why: "tests of the page",
        purpose: Purpose::Test,
        source: Source::Apt("chromium"),
        programs: &["chromium", "chromium-browser", "google-chrome"],
    },
    Part {
        why: "tests of the page",
        purpose: Purpose::Test,
        source: Source::Apt("chromium-driver"),
        programs: &["chromedriver"],
    },
    Part { why: "installs axe", purpose: Purpose::Test, source: Source::Apt("npm"), programs: &["npm"] },
    Part {
        why: "tests of the page's accessibility",
        purpose: Purpose::Test,
        source: Source::Npm("tests/node", "axe-core"),
        programs: &[],
    },
    Part { why: "Reacher in MuJoCo", purpose: Purpose::Test, source: Source::Mujoco, programs: &[] },
    Part { why: "tests of graphics cards", purpose: Purpose::Test, source: Source::Vulkan, programs: &[] },
    Part {
        why: "a faster test runner; without it `cargo test` runs the same tests",
        purpose: Purpose::Comfort,
        source: Source::Crate("cargo-nextest"),
        programs: &["cargo-nextest"],
    },
];

impl Part {
    fn present(&self) -> bool {
        match self.source {
            Source::Target(target) => has_target(target),
            Source::Npm(folder, name) => process::root().join(folder).join("node_modules").join(name).is_dir(),
            Source::Apt(_) | Source::Crate(_) => process::exists(self.programs),
            // Elsewhere there is only the closed form.
            Source::Mujoco => mujoco::present() || !mujoco::supported(),
            Source::Vulkan => vulkan() || !cfg!(target_os = "linux"),
        }
    }

    /// Whether the program that adds it is there.
    fn can_be_added(&self) -> bool {
        match self.source {
            Source::Npm(..) => process::exists(&["npm"]),
            Source::Mujoco => has_pip(),
            _ => true,
        }
    }

    fn describe(&self) -> String {
        let what = match self.source {
            Source::Target(target) => format!("the compilation target {target} (rustup)"),
            Source::Apt(package) => format!("the package {package} (apt-get)"),
            Source::Npm(_, name) => format!("the package {name} (npm)"),
            Source::Crate(name) => format!("the program {name} (cargo install, compiles for some minutes)"),
            Source::Mujoco if !has_pip() => {
                "the package python3-pip (apt-get) and MuJoCo's shared library (pip, 26 MB)".to_owned()
            }
            Source::Mujoco => "MuJoCo's shared library (pip, 26 MB)".to_owned(),
            Source::Vulkan => format!("the packages {} (apt-get)", DRIVERS.join(" and ")),
        };
        format!("{what}: {}", self.why)
    }
}

/// Installs MuJoCo's library and nothing else but what fetches it.
pub fn mujoco_alone() -> Result<()> {
    if !mujoco::supported() {
        bail!("there is no library of MuJoCo for this platform here: Reacher moves by its own equations");
    }
    if !mujoco::present() {
        eprintln!("setup: will install MuJoCo's shared library (pip, 26 MB): Reacher in MuJoCo");
        add_mujoco()?;
    }
    eprintln!("setup: MuJoCo is there");
    Ok(())
}

/// Installs everything there is a use for.
pub fn everything() -> Result<()> {
    ensure(Purpose::Comfort)?;
    eprintln!("setup: everything is there");
    Ok(())
}

/// Installs what is missing for a purpose.
pub fn ensure(purpose: Purpose) -> Result<()> {
    let missing: Vec<&Part> = PARTS.iter().filter(|part| part.purpose <= purpose && !part.present()).collect();
    for part in &missing {
        eprintln!("setup: will install {}", part.describe());
    }
    // What others need comes first.
    let packages: Vec<&str> = missing
        .iter()
        .flat_map(|part| match part.source {
            Source::Apt(package) => vec![package],
            Source::Vulkan => DRIVERS.to_vec(),
            Source::Mujoco if !has_pip() => vec!["python3-pip"],
            _ => Vec::new(),
        })
        .collect();
    // What one part lacks, such as root, is no reason to go without the others.
    let mut failures = Vec::new();
    if !packages.is_empty() {
        failures.extend(add_packages(&packages).err());
    }
    for part in missing {
        let added = match part.source {
            Source::Target(target) => add_target(target),
            Source::Apt(_) | Source::Vulkan => Ok(()),
            // npm and pip come with the packages.
            Source::Npm(..) | Source::Mujoco if !failures.is_empty() && !part.can_be_added() => Ok(()),
            Source::Npm(folder, _) => add_locked(folder),
            Source::Crate(name) => add_crate(name),
            Source::Mujoco => add_mujoco(),
        };
        failures.extend(added.err());
    }
    match &failures[..] {
        [] => Ok(()),
        several => bail!("{}", several.iter().map(|error| format!("{error:#}")).collect::<Vec<_>>().join("; and ")),
    }
}

/// Vulkan's loader and Mesa's drivers, the one for processors among them.
const DRIVERS: &[&str] = &["libvulkan1", "mesa-vulkan-drivers"];

/// Whether there are a loader and a driver of Vulkan.
pub fn vulkan() -> bool {
    let has = |folder: &Path, wanted: &dyn Fn(&str) -> bool| {
        let names = fs::read_dir(folder).into_iter().flatten().flatten();
        names.into_iter().any(|entry| wanted(&entry.file_name().to_string_lossy()))
    };
    let drivers = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d"].map(Path::new);
    let libraries = fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    drivers.iter().any(|folder| has(folder, &|name| name.ends_with(".json")))
        && libraries
            .chain(["/usr/lib", "/usr/lib64", "/lib64"].map(PathBuf::from))
            .any(|folder| has(&folder, &|name| name.starts_with("libvulkan.so.1")))
}

/// Whether the compiler in use has a standard (or core) library for a target.
fn has_target(target: &str) -> bool {
    let mut rustc = process::command("rustc");
    let folder = process::output(rustc.args(["--print", "target-libdir", "--target", target]));
    folder.is_some_and(|folder| fs::read_dir(folder.trim()).is_ok_and(|mut files| files.next().is_some()))
}

fn add_target(target: &str) -> Result<()> {
    let toolchain = pinned_toolchain()?;
    let added = process::run(process::command("rustup").args(["target", "add", target, "--toolchain", &toolchain]));
    if added.is_ok() && has_target(target) {
        return Ok(());
    }
    if target == BARE {
        bail!("{target} could not be added to the toolchain {toolchain}: type `rustup target add {target}`");
    }
    bail!(
        "{target} could not be added to the toolchain {toolchain}. With network access, type `rustup target add \
         {target} --toolchain {toolchain}`. Without rustup, Debian has this target in the packages rustc-web, \
         cargo-web and rust-web-src (with lld): install them and build with that toolchain's -Zbuild-std"
    );
}

/// The toolchain that `rust-toolchain.toml` names.
fn pinned_toolchain() -> Result<String> {
    let file = process::root().join("rust-toolchain.toml");
    let text = fs::read_to_string(&file).with_context(|| format!("{} cannot be read", file.display()))?;
    let line = text.lines().find_map(|line| line.trim().strip_prefix("channel = "));
    let channel = line.with_context(|| format!("{} names no channel", file.display()))?;
    Ok(channel.trim_matches('"').to_owned())
}

/// Installs distribution packages where that is possible without asking for a password.
fn add_packages(packages: &[&str]) -> Result<()> {
    let typed = format!("apt-get install --no-install-recommends {}", packages.join(" "));
    if !process::exists(&["apt-get"]) {
        bail!("install {} with this system's package manager, then start again", packages.join(", "));
    }
    if process::output(process::command("id").arg("-u")).as_deref().map(str::trim) != Some("0") {
        bail!("installing packages needs root: type `sudo {typed}`, then start again");
    }
    let apt = |arguments: &[&str]| {
        process::run(process::command("apt-get").env("DEBIAN_FRONTEND", "noninteractive").args(arguments))
    };
    let install = [&["install", "--yes", "--no-install-recommends"], packages].concat();
    apt(&["update", "--quiet"])
        .and_then(|()| apt(&install))
        .with_context(|| format!("packages are missing: type `{typed}` where there is network access"))
}

/// Installs what a folder's `package-lock.json` pins.
fn add_locked(folder: &str) -> Result<()> {
    let npm = process::run(process::command("npm").args(["ci", "--no-audit", "--no-fund", "--prefix", folder]));
    if npm.is_ok() {
        return Ok(());
    }
    bail!("npm packages are missing: type `npm ci --prefix {folder}` where there is network access")
}

/// Installs MuJoCo where that is possible; a program without it does everything but Reacher in MuJoCo.
pub fn offer_mujoco() {
    if mujoco::present() || !mujoco::supported() {
        return;
    }
    eprintln!("setup: will install MuJoCo's shared library (pip, 26 MB): Reacher in MuJoCo");
    if let Err(error) = add_mujoco() {
        eprintln!("setup: MuJoCo is not installed ({error:#}); going on without it");
    }
}

/// Fetches MuJoCo's library with pip, and pip before it where there is none.
fn add_mujoco() -> Result<()> {
    if !has_pip() {
        eprintln!("setup: will install the package python3-pip (apt-get): fetches MuJoCo's library");
        add_packages(&["python3-pip"])?;
    }
    mujoco::fetch()
}

fn has_pip() -> bool {
    process::output(process::command("python3").args(["-m", "pip", "--version"])).is_some()
}

/// Installs a program from crates.io; going without one is no failure.
fn add_crate(name: &str) -> Result<()> {
    if let Err(error) = process::run(process::cargo().args(["install", "--locked", name])) {
        eprintln!("setup: {name} is not installed ({error:#}); going on without it");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pinned_toolchain_is_read() {
        let toolchain = pinned_toolchain().unwrap();
        assert!(toolchain.split('.').all(|part| part.parse::<u32>().is_ok()), "{toolchain}");
    }

    #[test]
    fn an_unknown_target_is_not_there() {
        assert!(!has_target("no-such-target"));
    }

    #[test]
    fn a_bigger_purpose_needs_no_less() {
        let count = |purpose| PARTS.iter().filter(|part| part.purpose <= purpose).count();
        assert!(count(Purpose::Web) < count(Purpose::Test) && count(Purpose::Test) < count(Purpose::Comfort));
        assert_eq!(count(Purpose::Comfort), PARTS.len());
    }
}
