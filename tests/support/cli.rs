//! The command line as a user runs it.
#![allow(dead_code)] // not every test file uses everything

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// `coil` with these arguments.
pub fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_coil"));
    command.args(args);
    command
}

/// What came of it.
pub fn coil(args: &[&str]) -> Output {
    command(args).output().expect("coil runs")
}

/// What it prints where all is well.
pub fn good(args: &[&str]) -> String {
    let out = coil(args);
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// What it says when it ends with that status.
pub fn bad(status: i32, args: &[&str]) -> String {
    let out = coil(args);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(status), "{args:?}: {said}");
    said
}

/// What it says when it refuses its arguments.
pub fn refused(args: &[&str]) -> String {
    bad(2, args)
}

/// A fresh folder of this name; those of different test files have different ones.
pub fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(env!("CARGO_CRATE_NAME")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
