//! MuJoCo's shared library: fetched once from its Python package, checked, and put into the folder that
//! `.cargo/config.toml` names to the linker.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use sha2::{Digest as _, Sha256};

use crate::process;

/// The version that `native` is bound to.
const VERSION: &str = "3.17.0";
/// The library's file, which programs ask for when they start.
const LIBRARY: &str = "libmujoco.so.3.17.0";
/// The name that the linker asks for.
const LINK: &str = "libmujoco.so";
/// SHA-256 of the library: the same in the package for every version of Python.
const DIGEST: &str = "23496b023ee80fb61ab71167e94bc649f9941710fde96b18bb8204fb332523ad";
/// Switches the feature on in builds of the whole workspace and of `mcvl-native`.
const FEATURE: [&str; 2] = ["--features", "mcvl-native/mujoco"];

/// Whether the library is known for this machine.
pub fn supported() -> bool {
    cfg!(all(target_os = "linux", target_arch = "x86_64"))
}

fn folder() -> PathBuf {
    process::root().join("third_party/mujoco/lib")
}

/// Whether the right library is where the linker looks.
pub fn present() -> bool {
    folder().join(LINK).is_file() && digest(&folder().join(LIBRARY)).is_ok_and(|digest| digest == DIGEST)
}

/// What cargo is told in addition, so that what it builds has MuJoCo where its library is.
pub fn features() -> &'static [&'static str] {
    if present() { &FEATURE } else { &[] }
}

fn digest(file: &Path) -> Result<String> {
    let bytes = fs::read(file).with_context(|| format!("{} cannot be read", file.display()))?;
    Ok(Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Fetches the library with pip, which the machine has to have.
pub fn fetch() -> Result<()> {
    let scratch = process::target().join("mujoco-package");
    // What an interrupted attempt left.
    let _ = fs::remove_dir_all(&scratch);
    let got = download(&scratch).and_then(|()| install(&scratch));
    // It has served its purpose, and another attempt begins with removing it.
    let _ = fs::remove_dir_all(&scratch);
    got
}

/// Downloads the Python package, which is a zip archive, and unpacks it.
fn download(scratch: &Path) -> Result<()> {
    let python = || process::command("python3");
    let package = format!("mujoco=={VERSION}");
    // Said in full, so that it does not matter which Python is installed.
    let platform = ["--platform", "manylinux_2_28_x86_64", "--python-version", "3.12", "--only-binary=:all:"];
    let mut pip = python();
    pip.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]);
    pip.args(platform).arg("--dest").arg(scratch).arg(&package);
    if process::run(&mut pip).is_err() {
        bail!(
            "MuJoCo's library is missing: type `cargo xtask setup` where there is network access (it takes the \
             library from the Python package {package}). Without it `cargo build` works, and Reacher has its \
             closed form"
        );
    }
    let files = fs::read_dir(scratch).with_context(|| format!("{} cannot be read", scratch.display()))?;
    let paths = files.filter_map(Result::ok).map(|entry| entry.path());
    let wheel = paths.into_iter().find(|path| path.extension().is_some_and(|extension| extension == "whl"));
    let wheel = wheel.with_context(|| format!("pip left no package in {}", scratch.display()))?;
    process::run(python().args(["-m", "zipfile", "--extract"]).arg(wheel).arg(scratch))
}

/// Puts the library of an unpacked package, with its licences, into its folder.
fn install(package: &Path) -> Result<()> {
    let library = package.join("mujoco").join(LIBRARY);
    let found = digest(&library)?;
    if found != DIGEST {
        bail!("the library in the Python package has SHA-256 {found} instead of {DIGEST}: it is not installed");
    }
    let folder = folder();
    let cannot = || format!("{} cannot be written", folder.display());
    fs::create_dir_all(&folder).with_context(cannot)?;
    for licence in ["LICENSE", "LICENSES_THIRD_PARTY.md"] {
        let file = package.join(format!("mujoco-{VERSION}.dist-info/licenses")).join(licence);
        fs::copy(file, folder.join(licence)).with_context(cannot)?;
    }
    // Under its name only when it is whole.
    let part = folder.join("part");
    fs::copy(&library, &part).and_then(|_| fs::rename(&part, folder.join(LIBRARY))).with_context(cannot)?;
    link(&folder).with_context(cannot)
}

#[cfg(unix)]
fn link(folder: &Path) -> std::io::Result<()> {
    let link = folder.join(LINK);
    if link.symlink_metadata().is_ok() {
        fs::remove_file(&link)?;
    }
    std::os::unix::fs::symlink(LIBRARY, link)
}

#[cfg(not(unix))]
fn link(folder: &Path) -> std::io::Result<()> {
    fs::copy(folder.join(LIBRARY), folder.join(LINK)).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_is_sha_256() {
        let file = std::env::temp_dir().join(format!("mcvl-xtask-digest-{}", std::process::id()));
        fs::write(&file, b"abc").unwrap();
        let of_abc = digest(&file);
        fs::remove_file(&file).unwrap();
        assert_eq!(of_abc.unwrap(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert!(digest(&file).is_err());
    }

    #[test]
    fn another_library_is_not_installed() {
        let package = std::env::temp_dir().join(format!("mcvl-xtask-package-{}", std::process::id()));
        fs::create_dir_all(package.join("mujoco")).unwrap();
        fs::write(package.join("mujoco").join(LIBRARY), b"something else").unwrap();
        let refused = install(&package);
        fs::remove_dir_all(&package).unwrap();
        let text = refused.unwrap_err().to_string();
        assert!(text.contains(DIGEST) && text.contains("not installed"), "{text}");
    }

    #[test]
    fn the_linker_and_the_bindings_know_this_version_and_place() {
        let read = |path: &str| fs::read_to_string(process::root().join(path)).unwrap();
        assert!(read(".cargo/config.toml").contains("value = \"third_party/mujoco/lib\", relative = true"));
        assert!(read("Cargo.lock").contains(&format!("name = \"mujoco-rs\"\nversion = \"7.0.0+mj-{VERSION}\"")));
        assert!(read("native/src/mujoco/mod.rs").contains(&format!("VERSION: &str = \"{VERSION}\"")));
        assert!(LIBRARY.ends_with(VERSION));
    }
}
