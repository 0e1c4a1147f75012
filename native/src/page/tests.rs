//! The file is whole, asks for nothing, and its policy fits what stands in it.

use std::collections::BTreeSet;
use std::io::Read as _;

use flate2::read::GzDecoder;

use super::*;

/// What stands between two texts, every time.
fn between<'a>(page: &'a str, before: &'a str, after: &'a str) -> impl Iterator<Item = &'a str> {
    page.split(before).skip(1).map(move |rest| rest.split(after).next().unwrap_or_default())
}

/// The files in a page.
fn files(page: &str) -> Vec<(String, Vec<u8>)> {
    let blocks = between(page, "<script type=\"text/plain\" data-file=\"", "</script>");
    let open = |block: &str| {
        let (name, packed) = block.split_once("\">").unwrap();
        let mut bytes = Vec::new();
        GzDecoder::new(&BASE64_STANDARD.decode(packed).unwrap()[..]).read_to_end(&mut bytes).unwrap();
        (name.to_owned(), bytes)
    };
    blocks.map(open).collect()
}

#[test]
fn every_file_of_the_page_is_in_it() {
    let www = concat!(env!("CARGO_MANIFEST_DIR"), "/../www");
    let names = |folder: &str| -> Vec<String> {
        let entries = fs::read_dir(format!("{www}/{folder}")).unwrap();
        entries.map(|entry| folder.to_owned() + &entry.unwrap().file_name().into_string().unwrap()).collect()
    };
    let mut there: BTreeSet<String> = names("").into_iter().chain(names("tapes/")).collect();
    // These are folders, made by the build, or of no use in one file.
    for name in ["early.js", "files.js", "pkg", "sw.js", "tapes"] {
        there.remove(name);
    }
    let content = || SCRIPTS.iter().chain(RECORDINGS);
    let listed = content().chain(STYLES).map(|(name, _)| (*name).to_owned());
    let listed: BTreeSet<String> = listed.chain(["index.html".to_owned()]).collect();
    let missing: Vec<_> = there.difference(&listed).collect();
    assert!(missing.is_empty(), "native/src/page/mod.rs lists the files of www, but not {missing:?}");
    let expected: Vec<_> = content().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())).collect();
    assert_eq!(files(&whole(None, None)), expected);
}

#[test]
fn modules_import_what_the_file_has() {
    let known: Vec<&str> = SCRIPTS.iter().map(|(name, _)| *name).chain(["files.js"]).collect();
    for (name, text) in SCRIPTS {
        let imported = between(text, " from ", ";").chain(between(text, "import(", ")"));
        for other in imported.filter(|other| other.starts_with(['"', '`', '\''])) {
            let file = other.strip_prefix("\"./").and_then(|rest| rest.strip_suffix('"'));
            assert!(file.is_some_and(|file| known.contains(&file)), "{name} imports {other}");
        }
        for call in ["fetch(", "new Worker(", "import.meta"] {
            assert!(!text.contains(call), "{name}: {call} stands in files.js, so that one file can do it otherwise");
        }
    }
}

#[test]
fn the_module_of_files_says_what_the_one_beside_the_page_says() {
    let beside = include_str!("../../../www/files.js");
    let said = |line: &str| {
        let rest = ["export const ", "export function "].iter().find_map(|start| line.strip_prefix(start))?;
        rest.split([' ', '(']).next().map(str::to_owned)
    };
    let names: Vec<String> = beside.lines().filter_map(said).collect();
    assert!(BOOT.contains(&format!("export const {{ {} }} = globalThis.files;", names.join(", "))), "{names:?}");
}

#[test]
fn the_policy_names_what_stands_in_the_file() {
    let page = whole(None, None);
    let policy = between(&page, "Content-Security-Policy\" content=\"", "\"").next().unwrap();
    let scripts: Vec<&str> = between(&page, "<script>", "</script>").collect();
    assert_eq!(scripts, [BOOT]);
    assert!(policy.contains(&format!("script-src {} blob: 'wasm-unsafe-eval';", digest(scripts[0]))), "{policy}");
    let styles: Vec<String> = between(&page, "<style>", "</style>").map(digest).collect();
    assert_eq!(styles.len(), STYLES.len());
    assert!(policy.contains(&format!("style-src {};", styles.join(" "))), "{policy}");
    for allowed in ["'self'", "unsafe-inline", "'unsafe-eval'", "http", "data: blob:", "connect-src"] {
        assert!(!policy.contains(allowed), "{policy}");
    }
    for asked in ["src=", "rel=\"stylesheet\"", "preload", "@import"] {
        assert!(!page.contains(asked), "{asked} asks for another file");
    }
    let pictures: Vec<&str> = between(&page, "url(", ":").collect();
    assert!(pictures.iter().all(|scheme| *scheme == "\"data"), "{pictures:?}");
}

#[test]
fn a_tape_comes_first_and_modules_last() {
    let tape = Tape { name: "run/seed-3.json".into(), text: "{\"a\":1}".into() };
    let packed = (tape.name.clone(), tape.text.clone().into_bytes());
    let modules = Modules("<!-- modules -->\n".to_owned());
    let page = whole(Some(&modules), Some(&tape));
    assert!(page.contains("<html lang=\"en\" data-link=\"tape=run/seed-3.json\">"));
    assert_eq!(files(&page).last(), Some(&packed));
    assert!(page.contains("<!-- modules -->\n<script>"));
    assert!(!whole(None, None).contains("data-link"));

    let page = embedded(None, &tape, 2);
    assert!(page.contains("data-link=\"tape=run/seed-3.json&amp;check=2&amp;embed=1\">"));
    assert_eq!(files(&page).len(), SCRIPTS.len() + 1, "no other recordings");
    assert_eq!(files(&page).last(), Some(&packed));
}

#[test]
fn a_folder_without_modules_is_named() {
    let folder = mcvl_tests::scratch();
    let why = |folder: &Path| Modules::read(folder).err().unwrap().to_string();
    assert!(why(folder.path()).contains("scalar.js is missing; `cargo xtask web` builds them"));
    assert!(!Modules::are_in(folder.path()));
    for name in MODULES {
        fs::write(folder.path().join(name), name).unwrap();
    }
    assert!(Modules::are_in(folder.path()));
    let page = whole(Some(&Modules::read(folder.path()).unwrap()), None);
    assert!(files(&page).contains(&("pkg/simd_bg.wasm".to_owned(), b"simd_bg.wasm".to_vec())));
}
