//! Tells the program what it was built from, for manifests and `mcvl doctor`.

use std::env;
use std::process::Command;

/// What a command prints, if it runs and says anything.
fn output(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}

fn main() {
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
