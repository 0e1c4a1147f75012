//! What somebody names for a command to write is never a run's own, and never another program's.

use std::fs;

use mcvl_tests::scratch;

use crate::cli::{copy, finished, ok};
use crate::cli_errors::check;

#[test]
fn the_files_of_a_run_are_written_by_training_only() {
    let folder = finished();
    let folder = folder.path();
    fs::create_dir(folder.join("links")).unwrap();
    std::os::unix::fs::symlink("../run/seed-0", folder.join("links/seed")).unwrap();
    let part = "is a place of the files that training wrote in";
    for target in ["run/seed-0/ledger.jsonl", "run/seed-3/new", "run/manifest.json", "run/curves.svg", "links/seed/new"]
    {
        for command in
            ["explain run#2 --svg", "explain run#2 --png", "report run -o", "page run -q -o", "page run --overwrite -o"]
        {
            check(folder, &format!("{command} {target}"), 2, &[target, part, "name another file"]);
        }
    }
    check(folder, "report run --overwrite -o run/summary.json", 2, &["run/summary.json", part]);
    check(folder, "export run --to csv --overwrite -o run/seed-0", 2, &["run/seed-0/evaluations.csv", part]);
    // A run may lie in a folder whose name is like that of a seed.
    fs::create_dir(folder.join("seed-7")).unwrap();
    ok(folder, "explain run#2 --svg seed-7/check.svg");
    ok(folder, "verify run");
}

#[test]
fn what_another_program_wrote_is_replaced_on_request_only() {
    let folder = finished();
    let folder = folder.path();
    for name in ["mine.svg", "mine.png", "mine.html", "mcvl.html"] {
        fs::write(folder.join(name), "mine").unwrap();
    }
    let name = "name another file";
    check(
        folder,
        "explain run#1 --svg mine.svg",
        2,
        &["mine.svg is there already and is no SVG picture of mcvl", name],
    );
    check(folder, "explain run#1 --svg a.svg --png mine.png", 2, &["mine.png is there already and is no PNG", name]);
    let advice = "--overwrite replaces it, -o writes elsewhere";
    check(folder, "page -q", 2, &["mcvl.html is there already and is no page of mcvl", advice]);
    check(folder, "page run -q -o mine.html", 2, &["mine.html is there already and is no page of mcvl", advice]);
    check(folder, "report run -o mine.html", 2, &["mine.html is there already and is no report of mcvl", advice]);
    ok(folder, "page run -q -o mine.html --overwrite");
    check(folder, "report run -o mine.html", 2, &["mine.html is there already and is no report of mcvl"]);
    ok(folder, "report run -o mine.html --overwrite");
    check(folder, "page run -q -o mine.html", 2, &["mine.html is there already and is no page of mcvl"]);
    // What mcvl wrote, it writes again.
    for command in ["page run -q", "page -q -o page.html", "report run", "explain run#1 --svg c.svg --png c.png"] {
        ok(folder, command);
        ok(folder, command);
    }
}

#[test]
fn a_report_replaces_its_own_curves_only() {
    let folder = finished();
    let folder = folder.path();
    fs::create_dir(folder.join("rep")).unwrap();
    fs::write(folder.join("rep/curves.png"), "mine").unwrap();
    let advice = "rep/curves.png is there already and is not of this report: --overwrite replaces it";
    check(folder, "report run -o rep/all.html", 2, &[advice]);
    assert_eq!(ok(folder, "report run -o rep/all.html --overwrite"), "rep/all.html\nrep/curves.svg\nrep/curves.png\n");
    let curves = fs::read(folder.join("rep/curves.svg")).unwrap();
    assert_eq!(fs::read(folder.join("run/curves.svg")).unwrap(), curves);
    // The same report of another run replaces what it wrote; another report does not.
    ok(folder, "train box-moving --quick --seed 5 -q -o other");
    ok(folder, "report other -o rep/all.html");
    assert_ne!(fs::read(folder.join("rep/curves.svg")).unwrap(), curves);
    ok(folder, "report run -o rep/all.html");
    assert_eq!(fs::read(folder.join("rep/curves.svg")).unwrap(), curves);
    check(folder, "report other -o rep/one.html", 2, &["rep/curves.svg is there already and is not of this report"]);
}

#[test]
fn runs_of_one_name_have_curves_of_their_own() {
    let folder = finished();
    let folder = folder.path();
    let nested = scratch();
    for place in ["a/x", "b/x", "c/x-2"] {
        copy(&folder.join("run"), &nested.path().join(place));
    }
    ok(nested.path(), "train box-moving --quick --seed 5 -q -o b/x --overwrite");
    let paths = ok(nested.path(), "report a/x b/x c/x-2 -o all.html");
    let names = ["curves-x", "curves-x-2", "curves-x-2-2"];
    let expected: String = names.iter().map(|name| format!("{name}.svg\n{name}.png\n")).collect();
    assert_eq!(paths, format!("all.html\n{expected}"));
    let read = |name: &str| fs::read(nested.path().join(name)).unwrap();
    assert_eq!(read("curves-x.svg"), read("a/x/curves.svg"));
    assert_eq!(read("curves-x-2.svg"), read("b/x/curves.svg"));
    assert!(ok(nested.path(), "report --help").contains("curves-NAME.svg"));
    // The report of a seed alone leaves the curves of its run.
    assert_eq!(
        ok(nested.path(), "report a/x/seed-3"),
        "a/x/report.html\na/x/curves-seed-3.svg\na/x/curves-seed-3.png\n"
    );
    ok(nested.path(), "verify a/x");
}
