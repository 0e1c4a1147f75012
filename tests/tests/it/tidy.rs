//! Rules of the repository, as tests: where things may be named, what core may not touch, what no file
//! may contain.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use mcvl_tests::source::{SourceFile, files};
use mcvl_tests::{root, run};
use serde_json::Value;

/// Lines of code that break a rule, as `path:line: text`.
fn violations<'a>(
    files: impl IntoIterator<Item = &'a SourceFile>,
    breaks: impl Fn(&SourceFile, &str) -> bool,
) -> Vec<String> {
    let mut found = Vec::new();
    for file in files {
        for (number, line) in file.code() {
            if breaks(file, line) {
                found.push(format!("{}:{number}: {}", file.path, line.trim()));
            }
        }
    }
    found
}

#[track_caller]
fn assert_none(found: &[String], rule: &str) {
    assert!(found.is_empty(), "{rule}\n{}", found.join("\n"));
}

/// Whether `word` stands in `text` with no letter, digit or underscore beside it.
fn has_word(text: &str, word: &str) -> bool {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word).any(|(start, _)| {
        !text[..start].chars().next_back().is_some_and(part)
            && !text[start + word.len()..].chars().next().is_some_and(part)
    })
}

/// Rust files below a folder.
fn rust<'a>(files: &'a [SourceFile], folder: &str) -> impl Iterator<Item = &'a SourceFile> {
    files.iter().filter(move |file| file.is(&["rs"]) && file.path.starts_with(folder))
}

/// The workspace's packages, as cargo describes them.
fn packages() -> Vec<Value> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["metadata", "--no-deps", "--format-version=1"]).current_dir(root());
    let metadata: Value = serde_json::from_str(&run(&mut cargo).unwrap()).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

/// Names of the normal dependencies of a package.
fn dependencies(package: &str) -> BTreeSet<String> {
    let packages = packages();
    let found = packages.iter().find(|candidate| candidate["name"] == package).expect("a package of this name");
    let normal = found["dependencies"].as_array().unwrap().iter().filter(|dependency| dependency["kind"].is_null());
    normal.map(|dependency| dependency["name"].as_str().unwrap().to_owned()).collect()
}

/// The version of a package in `Cargo.lock`.
fn locked(package: &str) -> String {
    let lock = fs::read_to_string(root().join("Cargo.lock")).unwrap();
    let start = lock.find(&format!("name = \"{package}\"\n")).unwrap_or_else(|| panic!("{package} is not locked"));
    let line = lock[start..].lines().nth(1).unwrap();
    line.trim_start_matches("version = ").trim_matches('"').to_owned()
}

#[test]
fn core_is_pure() {
    let files = files();
    let library = files.iter().find(|file| file.path == "core/src/lib.rs").unwrap();
    assert!(library.text.lines().any(|line| line == "#![no_std]"), "core/src/lib.rs has to say #![no_std]");
    let outside = ["std", "println", "eprintln", "Instant", "SystemTime", "spawn", "HashMap", "HashSet"];
    let found = violations(rust(&files, "core/src/"), |_, line| outside.iter().any(|word| has_word(line, word)));
    assert_none(&found, "core performs no I/O, reads no clock, spawns nothing and iterates over no hash map");
}

#[test]
fn core_has_only_allowed_dependencies() {
    let allowed =
        ["arrayvec", "base64", "cpufeatures", "libm", "ndarray", "postcard", "serde", "sha2"].map(String::from);
    let unexpected: Vec<_> = dependencies("mcvl-core").into_iter().filter(|name| !allowed.contains(name)).collect();
    assert_none(&unexpected, "core depends on something that is not on its list:");
}

#[test]
fn core_calls_no_mathematics_of_the_platform() {
    let banned = [
        ".tanh()",
        ".exp()",
        ".ln()",
        ".sin()",
        ".cos()",
        ".tan()",
        ".atan2(",
        ".powf(",
        ".powi(",
        ".mul_add(",
        ".dot(",
    ];
    let found = violations(rust(&files(), "core/src/"), |_, line| {
        banned.iter().any(|call| line.replace("libm::", "").contains(call))
    });
    assert_none(&found, "these give other bits on other targets: use libm, and core's own matrix product");
}

#[test]
fn core_reduces_before_it_casts() {
    let found = violations(rust(&files(), "core/src/"), |_, line| line.contains("as usize) %"));
    assert_none(&found, "the cast truncates on 32-bit targets: take the remainder in u64, then cast");
}

#[test]
fn only_the_trainer_writes_the_replay_buffer() {
    // The proof of exactness makes a buffer of its own, and practice fills a copy: they train nothing live.
    // Neither do tests.
    let may = ["core/src/trainer.rs", "core/src/exact.rs", "core/src/forecast/practice.rs"];
    let files = files();
    let library = rust(&files, "core/src/").filter(|file| !file.path.ends_with("/tests.rs"));
    let found = violations(library, |file, line| has_word(line, "replay.push") && !may.contains(&file.path.as_str()));
    assert_none(&found, "only the trainer pushes to the replay buffer");
}

#[test]
fn performance_reaches_no_learner() {
    let learners = ["core/src/agent/", "core/src/nn/", "core/src/forecast/", "core/src/replay.rs"];
    let files = files();
    let learners = learners.iter().flat_map(|folder| rust(&files, folder));
    let found = violations(learners, |_, line| has_word(line, "performance"));
    assert_none(&found, "performance is never an input to an agent, a reward model or a forecast");
}

#[test]
fn web_and_page_only_show() {
    let files = files();
    let modules = ["agent", "check", "forecast", "nn", "replay", "rng", "trainer"];
    let found = violations(rust(&files, "web/"), |_, line| {
        modules
            .iter()
            .any(|module| has_word(line, &format!("mcvl_core::{module}")) || has_word(line, &format!("{{{module}")))
    });
    assert_none(&found, "web holds a run and reads what it says: these modules of core decide something");

    let words = [
        "adam",
        "backprop",
        "bellman",
        "bonus",
        "epsilon",
        "gamma",
        "gradient",
        "learning_rate",
        "learningrate",
        "math.random",
        "minibatch",
        "replay_buffer",
        "replaybuffer",
        "reward +=",
        "reward -=",
        "reward =",
        "softmax",
        "threshold =",
    ];
    let shown = files.iter().filter(|file| {
        (file.path.starts_with("web/src/") || file.path.starts_with("www/")) && file.is(&["rs", "js", "mjs"])
    });
    let shown: Vec<_> = shown.collect();
    assert!(shown.len() >= 2, "the rule reads web and www");
    let found = violations(shown, |_, line| words.iter().any(|word| has_word(&line.to_lowercase(), word)));
    assert_none(&found, "web and www contain no training logic, no reward rule, no schedule");
}

#[test]
fn heavy_crates_stay_in_their_rooms() {
    let rooms = [(concat!("mujoco", "_rs"), "native/src/mujoco/"), (concat!("w", "gpu"), "native/src/gpu/")];
    let files = files();
    for (name, room) in rooms {
        let found = violations(rust(&files, ""), |file, line| !file.path.starts_with(room) && has_word(line, name));
        assert_none(&found, &format!("{name} is named only under {room}"));
    }
}

#[test]
fn a_plain_build_needs_no_mujoco() {
    let mut found = Vec::new();
    for package in packages() {
        let mujoco = |dependency: &&Value| dependency["name"] == "mujoco-rs";
        for dependency in package["dependencies"].as_array().unwrap().iter().filter(mujoco) {
            found.push((
                package["name"].clone(),
                dependency["optional"].clone(),
                package["features"]["default"].clone(),
            ));
        }
    }
    // One package, where it is optional; of its features only graphics cards are on by default.
    assert_eq!(found, [("mcvl-native".into(), true.into(), serde_json::json!(["gpu"]))]);
}

#[test]
fn every_kernel_has_its_twin() {
    let files = files();
    // What has no entry point stands in front of others.
    let kernels: Vec<_> = files.iter().filter(|file| file.is(&["wgsl"]) && file.text.contains("@compute")).collect();
    assert!(kernels.len() > 3, "the rule reads kernels");
    for kernel in kernels {
        assert!(kernel.path.starts_with("native/src/gpu/"), "{}", kernel.path);
        let name = kernel.path.rsplit('/').next().unwrap().trim_end_matches(".wgsl");
        // A file of the same name, or a function of it; of a kernel that tries a device, what compares it.
        let twin = |file: &&SourceFile| {
            (file.path.starts_with("core/src/") || name == "arithmetic" && file.path.starts_with("native/src/gpu/"))
                && (file.path.ends_with(&format!("/{name}.rs"))
                    || ['(', '<'].iter().any(|next| file.text.contains(&format!("fn {name}_body{next}"))))
                && kernel.text.contains(&file.path)
        };
        assert!(files.iter().any(|file| twin(&file)), "{} names no twin", kernel.path);
    }
}

#[test]
fn unsafe_code_has_its_places() {
    let begins = [" {", " fn", " impl", " trait", " extern", "("].map(|rest| format!("{}{rest}", "unsafe"));
    let found = violations(rust(&files(), ""), |file, line| {
        // Vector units of processors, and kernels that pass by wgpu's writer.
        !["core/src/nn/isa.rs", "native/src/gpu/enabled/device.rs"].contains(&&*file.path)
            && begins.iter().any(|begin| line.contains(begin))
    });
    assert_none(
        &found,
        "unsafe stands only in core/src/nn/isa.rs and native/src/gpu/enabled/device.rs, with its proof",
    );
}

#[test]
fn every_file_says_what_it_is() {
    let files = files();
    let silent = rust(&files, "").filter(|file| !file.text.starts_with("//! ")).map(|file| file.path.clone());
    assert_none(&silent.collect::<Vec<_>>(), "these files do not begin with `//! ` and a sentence:");
}

#[test]
fn files_are_rooms() {
    let files = files();
    let vague = ["utils", "util", "common", "types", "prelude", "helpers", "misc"];
    let named = files.iter().filter(|file| {
        let stem = |part: &str| part.split('.').next().unwrap_or_default().to_lowercase();
        file.path.split('/').any(|part| vague.contains(&stem(part).as_str()))
    });
    assert_none(&named.map(|file| file.path.clone()).collect::<Vec<_>>(), "a name says what is inside:");

    let written = ["rs", "js", "mjs", "css", "html", "wgsl"];
    let long = files.iter().filter(|file| file.is(&written)).map(|file| (file.text.lines().count(), file));
    let long: Vec<_> =
        long.filter(|(lines, _)| *lines > 800).map(|(lines, file)| format!("{}: {lines}", file.path)).collect();
    assert_none(&long, "more than 800 lines are several rooms:");
}

#[test]
fn nothing_is_unfinished() {
    let marks = [
        concat!("to", "do!("),
        concat!("unimpl", "emented!("),
        concat!("db", "g!("),
        concat!("#[ign", "ore"),
        concat!("FIX", "ME"),
        concat!("XX", "X"),
    ];
    let files = files();
    let mut found = Vec::new();
    for file in files.iter().filter(|file| file.is(&["rs", "js", "mjs", "css", "html", "toml", "md"])) {
        for (line, number) in file.text.lines().zip(1..) {
            if marks.iter().any(|mark| line.contains(mark)) {
                found.push(format!("{}:{number}: {}", file.path, line.trim()));
            }
        }
    }
    assert_none(&found, "unfinished:");
}

#[test]
fn no_file_names_a_machine() {
    // Put together, so that this list does not find itself.
    let folders = ["home", "root", "work", "Users"].map(|name| format!("/{name}/"));
    let hosts = [
        concat!("artifact", "ory"),
        concat!("index.crates", ".io"),
        concat!("registry.npm", "js"),
        concat!("pypi", ".org"),
    ];
    let files = files();
    let mut found = Vec::new();
    for file in &files {
        for (line, number) in file.text.lines().zip(1..) {
            // A folder counts where a path begins, not inside a longer one.
            let path = folders.iter().any(|folder| {
                line.match_indices(folder.as_str())
                    .any(|(start, _)| !line[..start].ends_with(|c: char| c.is_alphanumeric() || "._-*/}".contains(c)))
            });
            if path || hosts.iter().any(|host| line.contains(host)) {
                found.push(format!("{}:{number}: {}", file.path, line.trim()));
            }
        }
    }
    assert_none(&found, "paths of one machine, or hosts of one registry:");

    let lock = files.iter().find(|file| file.path == "Cargo.lock").expect("Cargo.lock is committed");
    let public = "source = \"registry+https://github.com/rust-lang/crates.io-index\"";
    let other = lock.text.lines().filter(|line| line.starts_with("source = ") && *line != public);
    assert_none(&other.map(String::from).collect::<Vec<_>>(), "Cargo.lock names other sources than crates.io:");
}

#[test]
fn glue_and_module_have_one_version() {
    let version = locked("wasm-bindgen");
    assert_eq!(locked("wasm-bindgen-cli-support"), version, "both are pinned in the root Cargo.toml");
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    for package in ["wasm-bindgen", "wasm-bindgen-cli-support"] {
        let pin = format!("{package} = \"={version}\"");
        assert!(manifest.lines().any(|line| line == pin), "the root Cargo.toml has to say `{pin}`");
    }
}

/// Text between back-ticks, outside fenced blocks.
fn quoted(text: &str) -> Vec<String> {
    let mut fenced = false;
    let mut found = Vec::new();
    for line in text.lines() {
        fenced ^= line.trim_start().starts_with("```");
        if !fenced {
            found.extend(line.split('`').skip(1).step_by(2).map(String::from));
        }
    }
    found
}

#[test]
fn architecture_names_what_exists() {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md describes the repository");
    let rooms = ["core", "native", "web", "www", "tests", "xtask"];
    let mut missing = Vec::new();
    for name in quoted(&text) {
        let path = name.trim_end_matches('/');
        let in_room = rooms.iter().any(|room| path.strip_prefix(room).is_some_and(|rest| rest.starts_with('/')));
        let plain = path.chars().all(|c| c.is_alphanumeric() || "/._-".contains(c));
        // What is built is named too, and is not there before it is built.
        if in_room && plain && !path.starts_with("www/pkg") && !root().join(path).exists() {
            missing.push(name);
        }
    }
    assert_none(&missing, "ARCHITECTURE.md names paths that do not exist:");
}

#[test]
fn every_invariant_has_its_test() {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md describes the repository");
    let section = text.split("\n## ").find(|section| section.starts_with("Invariants"));
    let section = section.expect("ARCHITECTURE.md has a section `## Invariants`");
    // Items begin `1. ` and go on over further lines.
    let mut items: Vec<String> = Vec::new();
    for line in section.lines() {
        let numbered = line.split_once(". ").is_some_and(|(number, _)| number.parse::<u32>().is_ok());
        match items.last_mut() {
            _ if numbered => items.push(line.to_owned()),
            Some(item) if line.starts_with(' ') => item.push_str(line),
            _ => {}
        }
    }
    assert!(!items.is_empty(), "the section `## Invariants` of ARCHITECTURE.md has no numbered list");

    let files = files();
    let is_test = |name: &str| {
        let head = format!("fn {name}(");
        rust(&files, "").any(|file| {
            let mut attributed = false;
            file.text.lines().any(|line| {
                let line = line.trim();
                let found = attributed && line.contains(&head);
                attributed = line.starts_with("#[test]") || (attributed && line.starts_with("#["));
                // Properties are tests whose arguments are drawn: `fn name(` stands under `#[test]` too.
                found
            })
        })
    };
    let mut wrong = Vec::new();
    for item in items {
        let names: Vec<_> =
            quoted(&item).into_iter().filter(|name| name.contains("::") && !name.contains(' ')).collect();
        if names.is_empty() {
            wrong.push(format!("names no test: {item}"));
        }
        let unknown = names.iter().filter(|name| !is_test(name.rsplit("::").next().unwrap_or(name)));
        wrong.extend(unknown.map(|name| format!("there is no test `{name}`: {item}")));
    }
    assert_none(
        &wrong,
        "every invariant of ARCHITECTURE.md ends with the tests that hold it, like `it::tidy::core_is_pure`",
    );
}

#[test]
fn licences_and_sources_follow_the_policy() {
    let policy = fs::read_to_string(root().join("deny.toml")).expect("deny.toml is the policy");
    let list = policy.split_once("[licenses]\nallow = [").and_then(|(_, rest)| rest.split_once(']'));
    let allowed: Vec<_> = list.expect("deny.toml lists the licences").0.split('"').skip(1).step_by(2).collect();
    // Alternatives stand between OR, or in an older way of writing, a slash. Without its parentheses an expression
    // asks for more than with them, never for less.
    let fits = |licence: &str| {
        let licence = licence.replace(['(', ')'], "").replace('/', " OR ");
        licence.split(" AND ").all(|part| part.split(" OR ").any(|one| allowed.contains(&one)))
    };
    // Those of a plain build on this machine, which are here; the others would have to be fetched first.
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["metadata", "--locked", "--filter-platform=host-tuple", "--format-version=1"]).current_dir(root());
    let metadata: Value = serde_json::from_str(&run(&mut cargo).unwrap()).unwrap();
    let registry = "registry+https://github.com/rust-lang/crates.io-index";
    let mut wrong = Vec::new();
    for package in metadata["packages"].as_array().unwrap() {
        let (name, licence, source) = (&package["name"], &package["license"], &package["source"]);
        if !licence.as_str().is_some_and(fits) || !source.is_null() && source != registry {
            wrong.push(format!("{name}: {licence}, from {source}"));
        }
    }
    assert_none(&wrong, "deny.toml allows none of these licences, or the package is not from crates.io:");
    // The policy's own program says more. It is no part of the set-up: it takes minutes to compile, and advisories
    // need a network.
    let installed = Command::new("cargo-deny").arg("--version").output().is_ok_and(|output| output.status.success());
    if installed {
        run(Command::new("cargo-deny").args(["--offline", "check", "licenses", "bans", "sources"]).current_dir(root()))
            .unwrap();
    }
}
