//! Zip archives as [`Files`]: read from memory, with limits, and nothing whose name leads elsewhere.

use super::{DatasetError, Files, Limits, check_name};
use std::io::{Cursor, Read};
use std::path::Path;
use std::sync::Arc;
use zip::ZipArchive;

/// A file of at least this size that shrank by more than [`RATIO`] is refused. Deflate reaches 1000:1, but
/// only on data that say nothing; PNG files do not shrink at all, text by 10:1.
const LARGE: u64 = 1 << 20;
const RATIO: u64 = 200;

/// Bytes that many readers share without a copy.
#[derive(Clone, Debug)]
struct Shared(Arc<Vec<u8>>);

impl AsRef<[u8]> for Shared {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// The files of a zip archive in memory.
#[derive(Clone, Debug)]
pub struct Zip {
    /// The archive's own name, without ".zip".
    stem: String,
    archive: ZipArchive<Cursor<Shared>>,
    /// Sorted; the entry number of each is in `entries`.
    names: Vec<String>,
    entries: Vec<usize>,
    limits: Limits,
}

impl Zip {
    /// Opens the archive and checks its directory. `file` is its name, for messages and for an object at its root.
    ///
    /// # Errors
    /// [`DatasetError::Unreadable`] for what is no zip, is encrypted or damaged; [`DatasetError::UnsafeName`],
    /// [`DatasetError::ZipBomb`], [`DatasetError::Limit`].
    pub fn new(bytes: Vec<u8>, file: &str, limits: &Limits) -> Result<Self, DatasetError> {
        let unreadable = |problem: String| DatasetError::Unreadable { file: file.into(), problem };
        let damaged = |e: zip::result::ZipError| unreadable(format!("not a readable zip archive: {e}"));
        let mut archive = ZipArchive::new(Cursor::new(Shared(Arc::new(bytes)))).map_err(damaged)?;
        if archive.has_duplicate_names() {
            return Err(unreadable("two files of the archive have the same name".into()));
        }
        if archive.has_overlapping_entries().map_err(damaged)? {
            return Err(bomb(file, "files of the archive overlap".into()));
        }
        let mut found = Vec::new();
        let mut total = 0u64;
        for i in 0..archive.len() {
            let entry = archive.by_index_data(i).map_err(damaged)?;
            let name = entry.name().map_err(damaged)?.into_owned();
            check_name(file, name.strip_suffix('/').unwrap_or(&name))?;
            if !entry.is_file() {
                continue; // folders, and links, which are not followed
            }
            let inside = format!("{file}/{name}");
            if entry.encrypted() {
                return Err(DatasetError::Unreadable { file: inside, problem: "it is encrypted".into() });
            }
            let (size, packed) = (entry.size(), entry.compressed_size());
            if size >= LARGE && size / RATIO > packed {
                return Err(bomb(&inside, format!("{packed} bytes claim to hold {size}")));
            }
            total = total.saturating_add(size);
            found.push((name, i));
        }
        if total > limits.archive_bytes {
            let (what, limit) = ("bytes when unpacked", limits.archive_bytes);
            return Err(DatasetError::Limit { file: file.into(), found: total, what, limit });
        }
        found.sort_unstable();
        let (names, entries) = found.into_iter().unzip();
        let stem = Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { stem, archive, names, entries, limits: *limits })
    }
}

fn bomb(file: &str, problem: String) -> DatasetError {
    DatasetError::ZipBomb { file: file.into(), problem }
}

impl Files for Zip {
    fn names(&self) -> &[String] {
        &self.names
    }

    fn root(&self) -> &str {
        &self.stem
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, DatasetError> {
        let Ok(at) = self.names.binary_search_by(|n| n.as_str().cmp(name)) else {
            let needed = "it is not in the archive".into();
            return Err(DatasetError::Missing { file: name.into(), needed });
        };
        let unreadable = |e: &dyn std::fmt::Display| DatasetError::Unreadable {
            file: name.into(),
            problem: format!("damaged in the archive: {e}"),
        };
        // A clone shares the bytes and the directory: many threads may read.
        let mut archive = self.archive.clone();
        let entry = archive.by_index(self.entries[at]).map_err(|e| unreadable(&e))?;
        let (size, limit) = (entry.size(), self.limits.file_bytes);
        if size > limit {
            return Err(DatasetError::Limit { file: name.into(), found: size, what: "bytes", limit });
        }
        let mut bytes = Vec::new();
        entry.take(size + 1).read_to_end(&mut bytes).map_err(|e| unreadable(&e))?;
        if bytes.len() as u64 != size {
            return Err(bomb(name, format!("it does not hold the {size} bytes that it claims")));
        }
        Ok(bytes)
    }
}

/// A zip archive of the given files, stored without compression (PNG files do not shrink). The same files
/// always give the same bytes.
///
/// # Errors
/// [`DatasetError::UnsafeName`], [`DatasetError::Unreadable`] for a name that stands twice.
pub fn write_zip(files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, DatasetError> {
    use std::io::Write;
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in files {
        check_name("archive", name)?;
        let failed = |e: &dyn std::fmt::Display| DatasetError::Unreadable {
            file: name.clone(),
            problem: format!("can't be put into the archive: {e}"),
        };
        zip.start_file(name.as_str(), options).map_err(|e| failed(&e))?;
        zip.write_all(bytes).map_err(|e| failed(&e))?;
    }
    let done = zip.finish();
    done.map(Cursor::into_inner)
        .map_err(|e| DatasetError::Unreadable { file: "archive".into(), problem: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use zip::write::SimpleFileOptions;

    fn open(bytes: Vec<u8>) -> Result<Zip, DatasetError> {
        Zip::new(bytes, "a.zip", &Limits::default())
    }

    /// A deflated archive, with names that `write_zip` would refuse.
    fn make(files: &[(&str, &[u8])]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in files {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn files_round_trip() {
        let files = vec![("b/2.txt".to_string(), vec![7; 1000]), ("a.txt".to_string(), b"text".to_vec())];
        let zip = open(write_zip(&files).unwrap()).unwrap();
        assert_eq!(zip.names(), ["a.txt", "b/2.txt"]);
        assert_eq!(zip.read("b/2.txt").unwrap(), files[0].1);
        assert_eq!(zip.read("a.txt").unwrap(), b"text");
        assert!(zip.read("c").is_err());
        assert!(write_zip(&[("../a".into(), vec![])]).is_err());
        let deflated = open(make(&[("x", &[1; 5000])])).unwrap();
        assert_eq!(deflated.read("x").unwrap(), [1; 5000]);
    }

    #[test]
    fn path_tricks_are_refused() {
        for name in ["../evil", "a/../../evil", "/etc/passwd", "C:\\evil", "a\\b", "c:evil"] {
            assert!(matches!(open(make(&[(name, b"x")])), Err(DatasetError::UnsafeName { .. })), "{name}");
        }
    }

    #[test]
    fn bombs_are_refused() {
        let zeros = vec![0; 4 << 20];
        assert!(matches!(open(make(&[("zeros", &zeros)])), Err(DatasetError::ZipBomb { .. })));
        // A directory that lies: 1000 bytes that claim to be 10.
        let mut bytes = make(&[("zeros", &vec![7; 1000])]);
        let at = bytes.windows(4).rposition(|w| w == b"PK\x01\x02").unwrap();
        bytes[at + 24..at + 28].copy_from_slice(&10u32.to_le_bytes());
        let error = open(bytes).and_then(|zip| zip.read("zeros")).unwrap_err();
        assert!(matches!(error, DatasetError::ZipBomb { .. } | DatasetError::Unreadable { .. }), "{error}");
        let limits = Limits { archive_bytes: 999, ..Limits::default() };
        let many = make(&[("a", &[1; 500]), ("b", &[2; 500])]);
        assert!(matches!(Zip::new(many, "a.zip", &limits), Err(DatasetError::Limit { found: 1000, .. })));
    }

    #[test]
    fn what_is_no_zip_is_named() {
        assert!(
            open(b"PK\x03\x04 and nothing".to_vec())
                .unwrap_err()
                .to_string()
                .contains("a.zip: not a readable")
        );
        let good = make(&[("x", &[1; 50])]);
        for end in 0..good.len() {
            assert!(open(good[..end].to_vec()).is_err(), "{end}");
        }
    }
}
