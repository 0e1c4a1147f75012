//! Makes the ES-module glue of a compiled WebAssembly module: `xtask-glue INPUT.wasm OUTPUT_FOLDER NAME`.
//! `cargo xtask web` calls it.

use std::env;
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
    bindgen.generate(&folder).with_context(|| format!("{}: no glue could be made of this module", input.display()))
}
