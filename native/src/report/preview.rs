//! Writes what this folder draws to a folder, for a look at it: not a test of anything, so it is ignored.

use std::path::Path;

use mcvl_core::record::Verdict;

use super::samples::{self, Outcome};

#[test]
#[ignore = "writes pictures for a person to look at: set MCVL_PREVIEW to a folder"]
fn preview() {
    let folder = std::env::var_os("MCVL_PREVIEW").expect("MCVL_PREVIEW names a folder");
    let folder = Path::new(&folder);
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("the folder is writable");
    let (ten, few) = (samples::ten(), samples::set(&[Outcome::Missed, Outcome::Intended, Outcome::Missed]));
    let curves = super::plot::curves(&ten);
    write("curves.svg", curves.svg().as_bytes());
    write("curves.png", &curves.png(1.5).expect("a picture"));
    let sweep = super::plot::sweep(&[("100".into(), &few), ("300".into(), &ten), ("1000".into(), &ten)]);
    write("sweep.png", &sweep.png(1.5).expect("a picture"));
    let (check, spec) = (samples::check(17, true, Verdict::Refuse), samples::spec());
    let film = super::film::svg(&check, &spec);
    write("film.png", &super::plot::raster(&film, 1.5).expect("a picture"));
    write("film.txt", super::film::explain(&check, &spec, 80, false).as_bytes());
    let films = |seed: &crate::runs::SeedRun, number: u32| {
        let check = seed.checks.iter().find(|check| check.number == number)?;
        Some(samples::check(number, check.hack, check.verdict))
    };
    write("report.html", super::html::html(std::slice::from_ref(&ten), &films).as_bytes());
    write("several.html", super::html::html(&[few, ten.clone()], &films).as_bytes());
    write("summary.txt", super::claims::Summary::new(&ten).text().as_bytes());
}
