//! MATLAB MAT files, version 5 (what `save -v6` and `-v7` write): one numeric array by name.
//!
//! Format: "MAT-File Format", The MathWorks, chapter 1. Read here rather than by a crate because the
//! bytes come from strangers: nothing is allocated that the file does not really hold.

use flate2::read::{ZlibDecoder, ZlibEncoder};
use std::io::Read;

/// A real numeric array as MATLAB stores it.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Size along each dimension, at least two.
    pub dims: Vec<usize>,
    /// The values, column-major (the first index runs fastest).
    pub values: Vec<f64>,
}

/// Why an array can't be read.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
pub enum MatError {
    /// Another file format.
    #[error("not a MAT file of version 5: save it with `save(…, '-v7')`")]
    NotMat,
    /// MAT 7.3, which is HDF5.
    #[error("MAT version 7.3 (HDF5) is not read: save it with `save(…, '-v7')`")]
    Hdf5,
    /// The file ends too early.
    #[error("the file ends too early, in the element at byte {0}: it is truncated")]
    Truncated(usize),
    /// An element that is not what the format allows.
    #[error("damaged element at byte {at}: {problem}")]
    Damaged {
        /// Where the element starts in the file.
        at: usize,
        /// What is wrong with it.
        problem: String,
    },
    /// The variable is not there.
    #[error("no variable '{wanted}': the file holds {found}")]
    NoVariable {
        /// The variable that was asked for.
        wanted: String,
        /// Those that are there.
        found: String,
    },
    /// A cell, struct, sparse, text or complex variable.
    #[error("variable '{0}' is not a full array of real numbers")]
    NotNumeric(String),
    /// More values than the limit.
    #[error("variable '{name}' has {found} values, more than the limit of {limit}")]
    TooLarge {
        /// The variable.
        name: String,
        /// Number of values it claims.
        found: u64,
        /// Largest number of values.
        limit: usize,
    },
}

const HEADER: usize = 128;
const MATRIX: u32 = 14;
const COMPRESSED: u32 = 15;
/// Enough for flags, dimensions and name of any variable (names have at most 63 characters).
const PREFIX: u64 = 4096;

/// Reads variable `name`, of at most `limit` values, from the bytes of a MAT file.
///
/// # Errors
/// [`MatError`].
pub fn read_array(bytes: &[u8], name: &str, limit: usize) -> Result<Array, MatError> {
    let big_endian = match bytes.get(HEADER - 2..HEADER) {
        _ if bytes.starts_with(b"MATLAB 7.3") || bytes.starts_with(b"\x89HDF") => return Err(MatError::Hdf5),
        Some(b"IM") => false,
        Some(b"MI") => true,
        _ => return Err(MatError::NotMat),
    };
    let mut found = Vec::new();
    let mut file = Elements { bytes, at: HEADER, base: 0, big_endian };
    while file.at < bytes.len() {
        let start = file.at;
        let (kind, data) = file.next_whole()?;
        let parse = |data: &[u8]| Elements { bytes: data, at: 0, base: start, big_endian }.header();
        let header = match kind {
            MATRIX => parse(data)?,
            COMPRESSED => {
                let prefix = inflate(data, PREFIX, start)?;
                let mut inner = Elements { bytes: &prefix, at: 0, base: start, big_endian };
                let (kind, _) = inner.tag()?;
                if kind != MATRIX {
                    continue;
                }
                parse(&prefix[inner.at..])?
            }
            _ => continue,
        };
        if header.name != name {
            found.push(header.name);
            continue;
        }
        let count = header.check(limit)?;
        return match kind {
            MATRIX => header.values(data, count, start, big_endian),
            _ => {
                // Every value takes at most 8 bytes, the rest is header and padding.
                let whole = inflate(data, 8 * count as u64 + PREFIX, start)?;
                let mut inner = Elements { bytes: &whole, at: 0, base: start, big_endian };
                inner.tag()?;
                header.values(&whole[inner.at..], count, start, big_endian)
            }
        };
    }
    let found = if found.is_empty() { "none".into() } else { found.join(", ") };
    Err(MatError::NoVariable { wanted: name.into(), found })
}

fn inflate(data: &[u8], limit: u64, at: usize) -> Result<Vec<u8>, MatError> {
    let mut out = Vec::new();
    ZlibDecoder::new(data)
        .take(limit)
        .read_to_end(&mut out)
        .map_err(|e| MatError::Damaged { at, problem: format!("its compressed data are broken ({e})") })?;
    Ok(out)
}

/// What stands before the values of a matrix.
struct Header {
    class: u8,
    complex: bool,
    dims: Vec<usize>,
    name: String,
    /// Where the values' element starts, from the start of the matrix.
    values_at: usize,
}

impl Header {
    fn check(&self, limit: usize) -> Result<usize, MatError> {
        // mxDOUBLE_CLASS 6 ... mxUINT64_CLASS 15.
        if self.complex || !(6..=15).contains(&self.class) {
            return Err(MatError::NotNumeric(self.name.clone()));
        }
        let found = self.dims.iter().fold(1u64, |n, &d| n.saturating_mul(d as u64));
        if found > limit as u64 {
            return Err(MatError::TooLarge { name: self.name.clone(), found, limit });
        }
        Ok(found as usize)
    }

    fn values(self, matrix: &[u8], count: usize, at: usize, big_endian: bool) -> Result<Array, MatError> {
        let mut elements = Elements { bytes: matrix, at: self.values_at, base: at, big_endian };
        let (kind, data) = elements.next()?;
        let values: Vec<f64> = match kind {
            1 => data.iter().map(|&b| f64::from(b as i8)).collect(),
            2 => data.iter().map(|&b| f64::from(b)).collect(),
            3 => numbers(data, big_endian, |b| f64::from(i16::from_le_bytes(b))),
            4 => numbers(data, big_endian, |b| f64::from(u16::from_le_bytes(b))),
            5 => numbers(data, big_endian, |b| f64::from(i32::from_le_bytes(b))),
            6 => numbers(data, big_endian, |b| f64::from(u32::from_le_bytes(b))),
            7 => numbers(data, big_endian, |b| f64::from(f32::from_le_bytes(b))),
            9 => numbers(data, big_endian, f64::from_le_bytes),
            12 => numbers(data, big_endian, |b| i64::from_le_bytes(b) as f64),
            13 => numbers(data, big_endian, |b| u64::from_le_bytes(b) as f64),
            other => return Err(elements.damaged(format!("{other} is no type of numbers"))),
        };
        if values.len() != count {
            return Err(elements.damaged(format!("{} values where its size needs {count}", values.len())));
        }
        Ok(Array { dims: self.dims, values })
    }
}

fn numbers<const N: usize>(data: &[u8], big_endian: bool, value: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    data.as_chunks::<N>()
        .0
        .iter()
        .map(|&chunk| {
            let mut chunk = chunk;
            if big_endian {
                chunk.reverse();
            }
            value(chunk)
        })
        .collect()
}

/// A run of data elements: each a type, a length, data, padding to 8 bytes.
struct Elements<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Where the run stands in the file, for messages.
    base: usize,
    big_endian: bool,
}

impl<'a> Elements<'a> {
    fn damaged(&self, problem: String) -> MatError {
        MatError::Damaged { at: self.base, problem }
    }

    fn word(&mut self) -> Result<u32, MatError> {
        let bytes = self.bytes.get(self.at..self.at + 4).ok_or(MatError::Truncated(self.base))?;
        self.at += 4;
        let word = [bytes[0], bytes[1], bytes[2], bytes[3]];
        Ok(if self.big_endian { u32::from_be_bytes(word) } else { u32::from_le_bytes(word) })
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], MatError> {
        let end = self.at.checked_add(length).ok_or(MatError::Truncated(self.base))?;
        let data = self.bytes.get(self.at..end).ok_or(MatError::Truncated(self.base))?;
        self.at = end;
        Ok(data)
    }

    /// Type and length of the next element, which is not of the small form.
    fn tag(&mut self) -> Result<(u32, usize), MatError> {
        Ok((self.word()?, self.word()? as usize))
    }

    /// The next element of a file: no small form; compressed ones are not padded.
    fn next_whole(&mut self) -> Result<(u32, &'a [u8]), MatError> {
        self.base = self.at;
        let (kind, length) = self.tag()?;
        Ok((kind, self.take(length)?))
    }

    /// The next element of a matrix.
    fn next(&mut self) -> Result<(u32, &'a [u8]), MatError> {
        let first = self.word()?;
        if first >> 16 != 0 {
            // Small form: length and type share a word, up to four bytes of data follow.
            let length = (first >> 16) as usize;
            if length > 4 {
                return Err(self.damaged(format!("a small element of {length} bytes")));
            }
            let data = self.take(4)?;
            return Ok((first & 0xffff, &data[..length]));
        }
        let length = self.word()? as usize;
        let data = self.take(length)?;
        // The last element's padding may be missing.
        self.at = self.at.next_multiple_of(8).min(self.bytes.len());
        Ok((first, data))
    }

    fn header(&mut self) -> Result<Header, MatError> {
        let (_, flags) = self.next()?;
        let &[a, b, c, d, ..] = flags else { return Err(self.damaged("no array flags".into())) };
        let flags = if self.big_endian { [d, c] } else { [a, b] };
        let (kind, dims) = self.next()?;
        if kind != 5 || dims.len() < 8 || dims.len() > 4 * 32 {
            return Err(self.damaged("no dimensions".into()));
        }
        let dims = numbers(dims, self.big_endian, |b| f64::from(i32::from_le_bytes(b)));
        if dims.iter().any(|&d| d < 0.0) {
            return Err(self.damaged("a negative dimension".into()));
        }
        let (_, name) = self.next()?;
        Ok(Header {
            class: flags[0],
            complex: flags[1] & 0x08 != 0,
            dims: dims.iter().map(|&d| d as usize).collect(),
            name: String::from_utf8_lossy(name).into_owned(),
            values_at: self.at,
        })
    }
}

/// The bytes of a MAT file (version 5, compressed) with one array of doubles, column-major.
///
/// The same array always gives the same bytes: the header carries no date.
#[must_use]
pub fn write_array(name: &str, array: &Array) -> Vec<u8> {
    let mut matrix = Vec::with_capacity(array.values.len() * 8 + 128);
    element(&mut matrix, 6, &[6, 0, 0, 0, 0, 0, 0, 0]); // mxDOUBLE_CLASS, real
    let dims: Vec<u8> = array.dims.iter().flat_map(|&d| (d as i32).to_le_bytes()).collect();
    element(&mut matrix, 5, &dims);
    element(&mut matrix, 1, name.as_bytes());
    let values: Vec<u8> = array.values.iter().flat_map(|v| v.to_le_bytes()).collect();
    element(&mut matrix, 9, &values);
    let mut inner = Vec::with_capacity(matrix.len() + 8);
    element(&mut inner, MATRIX, &matrix);

    let mut deflated = Vec::new();
    ZlibEncoder::new(&inner[..], flate2::Compression::default())
        .read_to_end(&mut deflated)
        .expect("reading from memory does not fail");
    let mut bytes = format!("{:116}", "MATLAB 5.0 MAT-file, written by coil-ps").into_bytes();
    bytes.extend([0; 8]);
    bytes.extend(*b"\0\x01IM");
    bytes.extend(COMPRESSED.to_le_bytes());
    bytes.extend((deflated.len() as u32).to_le_bytes());
    bytes.extend(deflated);
    bytes
}

fn element(out: &mut Vec<u8>, kind: u32, data: &[u8]) {
    out.extend(kind.to_le_bytes());
    out.extend((data.len() as u32).to_le_bytes());
    out.extend(data);
    out.resize(out.len().next_multiple_of(8), 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array() -> Array {
        Array { dims: vec![2, 3, 2], values: (0..12).map(|i| f64::from(i) / 7.0 - 0.5).collect() }
    }

    #[test]
    fn arrays_round_trip() {
        let bytes = write_array("Normal_gt", &array());
        assert_eq!(read_array(&bytes, "Normal_gt", 12), Ok(array()));
        assert_eq!(bytes, write_array("Normal_gt", &array()));
    }

    #[test]
    fn another_implementation_reads_and_writes_the_same() {
        let path = std::env::temp_dir().join(format!("coil-ps-{}.mat", std::process::id()));
        std::fs::write(&path, write_array("Normal_gt", &array())).unwrap();
        let theirs = matrw::load_matfile(path.to_str().unwrap()).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(theirs["Normal_gt"].dim(), [2, 3, 2]);
        assert_eq!(theirs["Normal_gt"].to_vec_f64().unwrap(), array().values);
    }

    /// An uncompressed file by hand, as `save -v6` writes it.
    fn by_hand(big: bool, class: u8, complex: u8, kind: u32, data: &[u8]) -> Vec<u8> {
        let word = |w: u32| if big { w.to_be_bytes() } else { w.to_le_bytes() };
        let mut m = [word(6), word(8), word(u32::from(class) | u32::from(complex) << 8), word(0)].concat();
        m.extend([word(5), word(8), word(2), word(2)].concat());
        m.extend([word(1 << 16 | 1), *b"N\0\0\0"].concat()); // small form
        m.extend([word(kind), word(data.len() as u32)].concat());
        m.extend(data);
        m.resize(m.len().next_multiple_of(8), 0);
        let mut bytes = vec![b' '; 124];
        bytes.extend(if big { *b"\x01\0MI" } else { *b"\0\x01IM" });
        bytes.extend([word(MATRIX), word(m.len() as u32)].concat());
        bytes.extend(m);
        bytes
    }

    #[test]
    fn every_number_type_and_byte_order_is_read() {
        let read =
            |big, kind, data: &[u8]| read_array(&by_hand(big, 6, 0, kind, data), "N", 4).unwrap().values;
        assert_eq!(read(false, 1, &[1, 255, 3, 4]), [1.0, -1.0, 3.0, 4.0]);
        assert_eq!(read(false, 2, &[1, 255, 3, 4]), [1.0, 255.0, 3.0, 4.0]);
        assert_eq!(read(true, 4, &[0, 1, 1, 0, 0, 2, 0, 3]), [1.0, 256.0, 2.0, 3.0]);
        let floats: Vec<u8> = [0.5f32, -1.0, 2.0, 0.0].iter().flat_map(|v| v.to_be_bytes()).collect();
        assert_eq!(read(true, 7, &floats), [0.5, -1.0, 2.0, 0.0]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let good = write_array("Normal_est", &array());
        assert_eq!(
            read_array(&good, "Normal_gt", 99),
            Err(MatError::NoVariable { wanted: "Normal_gt".into(), found: "Normal_est".into() })
        );
        assert!(matches!(read_array(&good, "Normal_est", 11), Err(MatError::TooLarge { found: 12, .. })));
        assert_eq!(read_array(b"MATLAB 7.3 MAT-file", "N", 9), Err(MatError::Hdf5));
        assert_eq!(read_array(b"a text", "N", 9), Err(MatError::NotMat));
        let with = |class, complex, data: &[u8]| read_array(&by_hand(false, class, complex, 2, data), "N", 9);
        assert_eq!(with(1, 0, &[0; 4]), Err(MatError::NotNumeric("N".into()))); // a cell
        assert_eq!(with(6, 8, &[0; 4]), Err(MatError::NotNumeric("N".into())));
        assert!(matches!(with(6, 0, &[0; 3]), Err(MatError::Damaged { .. })));
        for end in 0..good.len() {
            assert!(read_array(&good[..end], "Normal_est", 99).is_err(), "{end}");
        }
    }

    #[test]
    fn a_small_file_cannot_make_a_large_array() {
        // 1 GiB of zeros in about 1 MB: refused by the size it states, or cut off by what that size needs.
        let mut bytes = write_array("N", &Array { dims: vec![1 << 14, 1 << 6], values: vec![0.0; 1 << 20] });
        assert!(bytes.len() < 1 << 14);
        assert!(matches!(read_array(&bytes, "N", 1 << 16), Err(MatError::TooLarge { .. })));
        bytes.truncate(HEADER);
        assert!(read_array(&bytes, "N", 1 << 16).is_err());
    }
}
