//! Tells the program what it was built from, for manifests and `mcvl doctor`, and where MuJoCo's library is.

use std::env;
use std::path::Path;
use std::process::Command;

/// What a command prints, if it runs and says anything.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}

/// Writes into the program where MuJoCo's library is, so that it finds it without a variable: in the folder
/// that `.cargo/config.toml` names and `cargo xtask setup` fills, or beside the program.
fn find_mujoco() {
    const FOLDER: &str = "MUJOCO_DYNAMIC_LINK_DIR";
    println!("cargo::rerun-if-env-changed={FOLDER}");
    let folder = env::var(FOLDER).unwrap_or_default();
    let library = Path::new(&folder).join("libmujoco.so");
    println!("cargo::rerun-if-changed={}", library.display());
    if !library.is_file() {
        println!(
            "cargo::error=there is no MuJoCo in `{folder}`: `cargo xtask setup` fetches it (run cargo from inside \
             the repository, which sets {FOLDER})"
        );
        return;
    }
    println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
    println!("cargo::rustc-link-arg-bins=-Wl,-rpath,$ORIGIN");
}

fn main() {
    if env::var_os("CARGO_FEATURE_MUJOCO").is_some() {
        find_mujoco();
    }
    let compiler = output(&env::var("RUSTC").expect("cargo sets it"), &["--version"]);
    println!("cargo::rustc-env=MCVL_BUILD_COMPILER={}", compiler.as_deref().unwrap_or("unknown"));
    println!("cargo::rustc-env=MCVL_BUILD_TARGET={}", env::var("TARGET").expect("cargo sets it"));
    // Empty where the sources came without their history.
    let commit = output("git", &["rev-parse", "HEAD"]).unwrap_or_default();
    println!("cargo::rustc-env=MCVL_BUILD_COMMIT={commit}");
    println!("cargo::rerun-if-changed=build.rs");
    // The log of HEAD changes with every commit, HEAD itself only with the branch.
    if let Some(log) = output("git", &["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo::rerun-if-changed={log}");
    }
}
