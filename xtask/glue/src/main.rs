//! Makes the ES-module glue of a compiled WebAssembly module: `xtask-glue INPUT.wasm OUTPUT_FOLDER NAME`.
//! `cargo xtask web` calls it.

use std::env;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use wasm_bindgen_cli_support::Bindgen;

fn main() -> Result<()> {
    let arguments: Vec<_> = env::args_os().skip(1).collect();
    let [input, folder, name] = arguments.as_slice() else {
        bail!("usage: xtask-glue INPUT.wasm OUTPUT_FOLDER NAME; `cargo xtask web` calls it");
    };
    let (input, folder) = (PathBuf::from(input), PathBuf::from(folder));
    let name = name.to_str().context("the name of the module is not UTF-8")?;

    let mut bindgen = Bindgen::new();
    bindgen.input_path(&input).out_name(name).typescript(false).remove_name_section(true);
    bindgen.remove_producers_section(true).web(true)?;
    let failed = || format!("{}: no glue could be made of this module", input.display());
    bindgen.generate(&folder).with_context(failed)?;
    let file = folder.join(name).with_extension("js");
    fs::write(&file, shortened(&fs::read_to_string(&file)?)).with_context(|| format!("{}", file.display()))
}

/// The glue without its comments and indentation, which are in the source for those who read it: a third of what
/// goes over the wire. Comments of wasm-bindgen begin and end with a line; none of its texts spans lines.
fn shortened(glue: &str) -> String {
    let mut short = String::new();
    let mut comment = false;
    for line in glue.lines().map(str::trim) {
        comment |= line.starts_with("/*");
        if !comment && !line.is_empty() && !line.starts_with("//") {
            short.push_str(line);
            short.push('\n');
        }
        comment &= !line.ends_with("*/");
    }
    short
}
