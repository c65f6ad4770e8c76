//! What several test files share.
#![allow(dead_code)] // not every test file uses everything

pub mod parsers;

use coil_ps::dataset::{DatasetError, Limits, Memory, read_object, write_object};
use coil_ps::stack::RawStack;
use std::path::{Path, PathBuf};

/// The shared data: `$COIL_DATA`, else `../shared/data` beside the project. Where neither exists the
/// test is to return: it has said that it was skipped, and under CI it fails.
pub fn shared_data() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("COIL_DATA").map_or(beside, PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    assert!(
        std::env::var_os("CI").is_none_or(|v| v != "true"),
        "CI needs the shared data at {}",
        path.display()
    );
    eprintln!("SKIPPED: no shared data at {} (set COIL_DATA)", path.display());
    None
}

/// A DiLiGenT object of the shared data: "ball", "bear", "cat", "reading" (16 bit), "cow", "pot1" (8 bit).
pub fn diligent(name: &str) -> Option<RawStack> {
    let folder = diligent_folder(&shared_data()?, name);
    let stack = read_object(&folder_files(&folder), &format!("{name}PNG"), &Limits::default());
    Some(stack.unwrap_or_else(|e: DatasetError| panic!("{name}: {e}")).0)
}

/// Folder of an object in the shared data.
pub fn diligent_folder(data: &Path, name: &str) -> PathBuf {
    let set = match name {
        "ball" => "pmsData",
        "cow" | "pot1" => "pmsData_crop_8bit",
        _ => "pmsData_crop",
    };
    data.join("DiLiGenT").join(set).join(format!("{name}PNG"))
}

/// The files of one folder in memory, named "FOLDER/FILE" as a browser names them.
pub fn folder_files(folder: &Path) -> Memory {
    let root = folder.file_name().and_then(|n| n.to_str()).expect("a folder with a name");
    let mut files = Memory::new();
    for entry in std::fs::read_dir(folder).expect("the folder can be listed") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|n| n.to_str()).expect("a UTF-8 name");
        if path.is_file() {
            files.insert(&format!("{root}/{name}"), std::fs::read(&path).expect("a readable file")).unwrap();
        }
    }
    files
}

/// The files of a stack in DiLiGenT's layout, in folder "NAMEPNG".
pub fn object_files(stack: &RawStack) -> Memory {
    let mut files = Memory::new();
    for (name, bytes) in write_object(stack).expect("a valid stack") {
        files.insert(&format!("{}PNG/{name}", stack.name), bytes).unwrap();
    }
    files
}
