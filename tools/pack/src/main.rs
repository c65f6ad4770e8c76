//! `pack MODULE.wasm OUT_DIR NAME`: what `wasm-bindgen --target web` does, without installing it.
//!
//! Writes `NAME.js`, `NAME.d.ts` and `NAME_bg.wasm` (no debug names) into `OUT_DIR`. The version
//! is the one in Cargo.lock, so it always matches the module. A package of its own, because a
//! binary of coil-ps would have to compile the library first.
#![forbid(unsafe_code)]

use anyhow::{Context, bail};
use wasm_bindgen_cli_support::Bindgen;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [module, out_dir, name] = args.as_slice() else {
        bail!("usage: pack MODULE.wasm OUT_DIR NAME");
    };
    let mut bindgen = Bindgen::new();
    bindgen
        .input_path(module)
        .out_name(name)
        .web(true)?
        .typescript(true)
        .remove_name_section(true)
        .remove_producers_section(true);
    bindgen.generate(out_dir).with_context(|| format!("cannot make JavaScript bindings for {module}"))
}
