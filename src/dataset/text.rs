//! Text files of numbers and names, as people and programs of many systems write them: any line end,
//! tabs or commas, blank lines, a byte-order mark.

use super::DatasetError;
use glam::{DVec3, Vec3};

/// The numbers of one line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    values: [f64; 4],
    /// How many numbers the line has.
    pub count: usize,
    /// The first that is NaN or infinite, as written.
    not_finite: Option<&'a str>,
}

impl Row<'_> {
    /// The row itself, if all its numbers are finite.
    fn finite(self, file: &str, line: usize) -> Result<Self, DatasetError> {
        match self.not_finite {
            None => Ok(self),
            Some(text) => {
                let (line, text) = (line.to_string(), shown(text));
                Err(DatasetError::NotFinite { file: file.into(), line, text })
            }
        }
    }

    /// The numbers, at most four.
    pub fn values(&self) -> Option<&[f64]> {
        self.values.get(..self.count)
    }

    /// Three numbers.
    pub fn vector(&self, file: &str, line: usize) -> Result<DVec3, DatasetError> {
        match self.values() {
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            _ => Err(DatasetError::Columns { file: file.into(), line, found: self.count, expected: "3" }),
        }
    }
}

/// Lines that are not blank, without the space around them, with their numbers from 1.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    (1..).zip(lines).filter(|(_, line)| !line.is_empty())
}

fn shown(field: &str) -> String {
    field.chars().take(40).collect()
}

/// Hands each line of numbers to `each`, with its number.
pub(super) fn rows(
    file: &str,
    bytes: &[u8],
    mut each: impl FnMut(usize, Row) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    any_rows(file, bytes, |line, row| each(line, row.finite(file, line)?))
}

/// [`rows`], whose numbers may be NaN or infinite.
pub(super) fn any_rows(
    file: &str,
    bytes: &[u8],
    mut each: impl FnMut(usize, Row) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    for (line, text) in lines(&String::from_utf8_lossy(bytes)) {
        each(line, any_row(file, line, text)?)?;
    }
    Ok(())
}

/// The finite numbers of a line, separated by white space or commas.
pub(super) fn row<'a>(file: &str, line: usize, text: &'a str) -> Result<Row<'a>, DatasetError> {
    any_row(file, line, text)?.finite(file, line)
}

fn any_row<'a>(file: &str, line: usize, text: &'a str) -> Result<Row<'a>, DatasetError> {
    let mut row = Row { values: [0.0; 4], count: 0, not_finite: None };
    for field in text.split(|c: char| c.is_whitespace() || c == ',').filter(|f| !f.is_empty()) {
        let wrong = |_| DatasetError::NotANumber { file: file.into(), line, text: shown(field) };
        let value: f64 = field.parse().map_err(wrong)?;
        if !value.is_finite() {
            row.not_finite = row.not_finite.or(Some(field));
        }
        if let Some(v) = row.values.get_mut(row.count) {
            *v = value;
        }
        row.count += 1;
    }
    Ok(row)
}

/// The unit direction of a light: at most 1 % from unit length, not from behind the object.
pub(super) fn light_direction(v: DVec3, file: &str, line: usize) -> Result<Vec3, DatasetError> {
    let length = v.length();
    if (length - 1.0).abs() > 0.01 {
        return Err(DatasetError::NotUnit { file: file.into(), line, length });
    }
    if v.z < 0.0 {
        return Err(DatasetError::BehindObject { file: file.into(), line, z: v.z });
    }
    Ok(normalised(v))
}

/// `v` with unit length. What is unit to the precision of f32 stays as it is, so that a written vector is
/// read back the same; judged after rounding to f32, because that is what is written.
pub(super) fn normalised(v: DVec3) -> Vec3 {
    let rounded = v.as_vec3();
    let unit = (rounded.as_dvec3().length() - 1.0).abs() < 3e-7;
    if unit { rounded } else { (v / v.length()).as_vec3() }
}
