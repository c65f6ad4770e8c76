//! The page's WebAssembly modules: what they are, how they are built, what became of each.

use anyhow::{Context, bail, ensure};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

const TARGET: &str = "wasm32-unknown-unknown";
/// Lines of cargo's output kept for the page to show when a build fails.
const LOG_LINES: usize = 40;
/// What lies in `www/` for developers only.
const NOT_SERVED: [&str; 6] =
    ["node_modules", "tests", "package.json", "package-lock.json", "tsconfig.json", "test-results"];

/// One WebAssembly module: the crate's library with some of its features.
pub struct Module {
    /// Its folder under `pkg/`.
    pub name: &'static str,
    features: &'static str,
    /// Cargo profile. Modules have different ones, so that they never overwrite each other's output.
    profile: &'static str,
    /// The page cannot start without it.
    pub needed_at_once: bool,
}

/// All modules of the page, in the order in which they are built.
pub const MODULES: [Module; 2] = [
    Module { name: "core", features: "render", profile: "wasm", needed_at_once: true },
    // The core once more, with the runtime of learned planners: large, so fetched when the first of them is used.
    Module { name: "policy", features: "render,policy", profile: "release", needed_at_once: false },
];

/// Names of [`MODULES`], for the command line.
pub fn module_names() -> Vec<&'static str> {
    MODULES.iter().map(|module| module.name).collect()
}

/// What became of one module's build, as the page reads it in `build-status.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "state", rename_all = "lowercase")]
pub enum State {
    /// Its turn has not come.
    Waiting,
    /// Being compiled for so many seconds; so many crates were begun, the latest line of cargo's output.
    Building { seconds: u64, crates: usize, line: String },
    /// Served under `pkg/`; size of the `.wasm` in bytes.
    Ready { bytes: u64 },
    /// Not built: why, and the end of cargo's output.
    Failed { message: String, log: String },
}

/// The states of all modules, shared between the builds and the server.
#[derive(Default)]
pub struct Board(Mutex<BTreeMap<&'static str, State>>);

impl Board {
    /// Replaces the state of the module `name`.
    pub fn set(&self, name: &'static str, state: State) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(name, state);
    }

    /// `{"modules": {"core": {"state": "ready", "bytes": 1}, …}}`
    pub fn to_json(&self) -> String {
        let modules = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        serde_json::json!({ "modules": &*modules }).to_string()
    }
}

/// Builds the modules of one checkout.
pub struct Builder {
    root: PathBuf,
    target: PathBuf,
}

impl Builder {
    /// # Errors
    /// `root` holds no checkout with the page in it.
    pub fn new(root: PathBuf) -> anyhow::Result<Self> {
        ensure!(
            root.join("www/index.html").is_file(),
            "no www/index.html in {}: coil serve builds the page from a checkout; name it with --root",
            root.display()
        );
        let root = root.canonicalize().with_context(|| format!("cannot resolve {}", root.display()))?;
        let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
        Ok(Self { root, target: std::path::absolute(target)? })
    }

    /// Where built files go; with [`Self::write_static_site`] a complete static site.
    pub fn page_dir(&self) -> PathBuf {
        self.target.join("page")
    }

    /// Where the server looks for a file, in turn: the sources first, so that an edit needs only a reload.
    pub fn served_folders(&self) -> Vec<PathBuf> {
        vec![self.root.join("www"), self.page_dir()]
    }

    /// What lies in the page folder from an earlier build.
    pub fn state_on_disk(&self, module: &Module) -> State {
        match fs::metadata(self.packed(module)) {
            Ok(file) => State::Ready { bytes: file.len() },
            Err(_) => State::Failed { message: "not built".into(), log: String::new() },
        }
    }

    /// Builds `module` if it is stale; cargo's progress goes to the terminal.
    pub fn build(&self, module: &Module, board: &Board) -> anyhow::Result<()> {
        eprintln!("building the module {} ({TARGET})", module.name);
        let mut cargo = self.cargo_build(module)?;
        let status = cargo.status().context("cannot start cargo")?;
        ensure!(status.success(), "cargo could not build the module {}", module.name);
        self.pack(module)?;
        board.set(module.name, self.state_on_disk(module));
        Ok(())
    }

    /// Builds `module` if it is stale; progress and failure go to `board`.
    pub fn build_quietly(&self, module: &Module, board: &Board) -> anyhow::Result<()> {
        let mut log = VecDeque::new();
        let result = self.build_logged(module, &mut log, |state| board.set(module.name, state));
        board.set(
            module.name,
            match &result {
                Ok(()) => self.state_on_disk(module),
                Err(error) => State::Failed { message: format!("{error:#}"), log: Vec::from(log).join("\n") },
            },
        );
        result
    }

    fn build_logged(
        &self,
        module: &Module,
        log: &mut VecDeque<String>,
        report: impl Fn(State),
    ) -> anyhow::Result<()> {
        let (start, mut crates) = (Instant::now(), 0);
        let building = |crates, line: &str| State::Building {
            seconds: start.elapsed().as_secs(),
            crates,
            line: line.into(),
        };
        report(building(0, "starting cargo"));
        let mut cargo =
            self.cargo_build(module)?.stderr(Stdio::piped()).spawn().context("cannot start cargo")?;
        let output = cargo.stderr.take().context("cargo has no output")?;
        for line in BufReader::new(output).lines() {
            let line = line.context("cannot read cargo's output")?;
            crates += usize::from(line.trim_start().starts_with("Compiling "));
            report(building(crates, line.trim()));
            if log.len() == LOG_LINES {
                log.pop_front();
            }
            log.push_back(line);
        }
        ensure!(cargo.wait()?.success(), "cargo could not build the module {}", module.name);
        report(building(crates, "writing the JavaScript side"));
        self.pack(module)
    }

    fn cargo_build(&self, module: &Module) -> anyhow::Result<Command> {
        let mut cargo = Command::new("cargo");
        cargo.current_dir(&self.root).stdin(Stdio::null());
        cargo.args(["build", "--lib", "--target", TARGET, "--profile", module.profile]);
        cargo.args(["--no-default-features", "--features", module.features]);
        // its own folder: a long build must not hold the lock that other cargo commands wait for
        cargo.arg("--target-dir").arg(self.target.join("wasm"));
        if let Some(toolchain) = self.wasm_toolchain()? {
            cargo.env("RUSTUP_TOOLCHAIN", toolchain);
        }
        Ok(cargo)
    }

    /// The toolchain to use where the active one has no wasm32 target (see `setup/wasm-target.sh`).
    fn wasm_toolchain(&self) -> anyhow::Result<Option<String>> {
        if cfg!(windows) {
            return Ok(None); // cargo says which target to add
        }
        let script = self.root.join("setup/wasm-target.sh");
        let output = Command::new(&script)
            .stderr(Stdio::inherit())
            .output()
            .with_context(|| format!("cannot run {}", script.display()))?;
        ensure!(output.status.success(), "no {TARGET} target (see the messages above)");
        let toolchain = String::from_utf8(output.stdout)?.trim().to_owned();
        Ok((!toolchain.is_empty()).then_some(toolchain))
    }

    /// Writes the JavaScript side of a compiled module into the page folder, unless it is newer.
    fn pack(&self, module: &Module) -> anyhow::Result<()> {
        let compiled = self.target.join("wasm").join(TARGET).join(module.profile).join("coil_ps.wasm");
        let packed = self.packed(module);
        self.copy_models()?;
        if modified(&packed).is_some_and(|time| Some(time) > modified(&compiled)) {
            return Ok(());
        }
        let out_dir = packed.parent().context("no parent folder")?;
        let status = Command::new("cargo")
            .current_dir(&self.root)
            .args(["run", "--quiet", "--package", "pack", "--profile", "tool", "--target-dir"])
            .arg(&self.target)
            .args([OsStr::new("--"), compiled.as_ref(), out_dir.as_ref(), "coil_ps".as_ref()])
            .status()
            .context("cannot start cargo")?;
        ensure!(status.success(), "pack could not write the JavaScript side of {}", module.name);
        Ok(())
    }

    /// Puts the trained networks beside the modules that run them: the pixel solver's, and the planners' with a list of
    /// those there are.
    fn copy_models(&self) -> anyhow::Result<()> {
        let to = self.page_dir().join("models");
        fs::create_dir_all(&to).with_context(|| format!("cannot make {}", to.display()))?;
        let pixel = self.root.join("models/pixel.onnx");
        fs::copy(&pixel, to.join("pixel.onnx"))
            .with_context(|| format!("cannot copy {}", pixel.display()))?;
        let mut names = Vec::new();
        for entry in fs::read_dir(self.root.join("models")).context("cannot list models/")? {
            let folder = entry?.path();
            let Some(name) = folder.file_name().filter(|_| folder.join("step.onnx").is_file()) else {
                continue;
            };
            fs::create_dir_all(to.join(name)).with_context(|| format!("cannot make {}", to.display()))?;
            for file in ["encoder.onnx", "step.onnx"] {
                let (source, copy) = (folder.join(file), to.join(name).join(file));
                fs::copy(&source, &copy).with_context(|| format!("cannot copy {}", source.display()))?;
            }
            names.push(name.to_string_lossy().into_owned());
        }
        let index = to.join("index.json");
        let json = serde_json::json!({ "models": names }).to_string();
        fs::write(&index, json).with_context(|| format!("cannot write {}", index.display()))
    }

    fn packed(&self, module: &Module) -> PathBuf {
        self.page_dir().join("pkg").join(module.name).join("coil_ps_bg.wasm")
    }

    /// Completes the page folder with the sources and `build-status.json`.
    pub fn write_static_site(&self, board: &Board) -> anyhow::Result<()> {
        let page = self.page_dir();
        copy_page_sources(&self.root.join("www"), &page)?;
        let status = page.join("build-status.json");
        fs::write(&status, board.to_json()).with_context(|| format!("cannot write {}", status.display()))
    }
}

fn modified(path: &Path) -> Option<std::time::SystemTime> {
    fs::metadata(path).ok()?.modified().ok()
}

fn copy_page_sources(from: &Path, to: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in fs::read_dir(from).with_context(|| format!("cannot list {}", from.display()))? {
        let entry = entry?;
        let name = entry.file_name();
        if NOT_SERVED.iter().any(|&skipped| name == skipped) {
            continue;
        }
        let (source, copy) = (entry.path(), to.join(&name));
        if source.is_dir() {
            copy_page_sources(&source, &copy)?;
        } else if source.is_file() {
            fs::copy(&source, &copy).with_context(|| format!("cannot copy {}", source.display()))?;
        } else {
            bail!("{} is neither a file nor a folder", source.display());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn board_is_the_json_that_the_page_reads() {
        let board = Board::default();
        board.set("core", State::Ready { bytes: 7 });
        board.set("policy", State::Building { seconds: 3, crates: 2, line: "Compiling tract".into() });
        let json: serde_json::Value = serde_json::from_str(&board.to_json()).unwrap();
        assert_eq!(
            json,
            serde_json::json!({"modules": {
                "core": {"state": "ready", "bytes": 7},
                "policy": {"state": "building", "seconds": 3, "crates": 2, "line": "Compiling tract"},
            }})
        );
    }

    #[test]
    fn a_folder_without_the_page_is_refused_by_name() {
        let error = Builder::new("/nonexistent-checkout".into()).err().unwrap().to_string();
        assert!(error.contains("/nonexistent-checkout") && error.contains("--root"), "{error}");
    }

    #[test]
    fn modules_have_profiles_of_their_own() {
        let profiles: std::collections::HashSet<_> = MODULES.iter().map(|module| module.profile).collect();
        assert_eq!(profiles.len(), MODULES.len());
    }
}
