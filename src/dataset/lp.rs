//! Light positions of RTI software: a `.lp` file has a line with the number of images, then for each
//! image a line `name x y z` with the direction towards the light.

use super::text;
use super::{DatasetError, check_name};
use glam::{DVec3, Vec3};

/// Names and unit light directions of the text of a `.lp` file. `file` is its name, for messages.
///
/// # Errors
/// [`DatasetError`] with the line for a wrong count, a name that leads out of the folder, a vector that is not unit.
pub fn read_lp(bytes: &[u8], file: &str) -> Result<Vec<(String, Vec3)>, DatasetError> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text::lines(&text);
    let (line, first) =
        lines.next().ok_or(DatasetError::Missing { file: file.into(), needed: "it is empty".into() })?;
    let expected: usize = first.parse().map_err(|_| DatasetError::NotANumber {
        file: file.into(),
        line,
        text: first.chars().take(40).collect(),
    })?;
    let mut lights = Vec::new();
    for (line, text) in lines {
        // The name may have spaces: the vector is the last three fields.
        let Some((name, vector)) = last_fields(text) else {
            let found = text.split_whitespace().count();
            return Err(DatasetError::Columns { file: file.into(), line, found, expected: "a name and 3" });
        };
        // Folders of the machine that wrote the file mean nothing here.
        let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
        check_name(&format!("{file}:{line}"), name)?;
        let v: DVec3 = text::row(file, line, vector)?.vector(file, line)?;
        lights.push((name.to_string(), text::light_direction(v, file, line)?));
    }
    if lights.len() != expected {
        let found = lights.len();
        return Err(DatasetError::Count {
            file: file.into(),
            found,
            expected,
            of: "images on its first line",
        });
    }
    Ok(lights)
}

/// Unit light directions of a text file, `x y z` a line, as people write them: of any length, also in between commas.
/// `file` is its name, for messages.
///
/// # Errors
/// [`DatasetError`] with the line for what are not three numbers, a vector of no length, a light behind the object.
pub fn read_directions(bytes: &[u8], file: &str) -> Result<Vec<Vec3>, DatasetError> {
    let mut lights = Vec::new();
    text::rows(file, bytes, |line, row| {
        let v = row.vector(file, line)?;
        let length = v.length();
        // Too short or too long to be told which way it points.
        let unit = if length > 1e-6 && length.is_finite() { v / length } else { v };
        lights.push(text::light_direction(unit, file, line)?);
        Ok(())
    })?;
    Ok(lights)
}

/// Splits a line before the last three of its fields; both parts are not empty.
fn last_fields(line: &str) -> Option<(&str, &str)> {
    let mut name = line;
    for _ in 0..3 {
        name = name.trim_end().rsplit_once(char::is_whitespace)?.0;
    }
    let vector = &line[name.len()..];
    Some((name.trim(), vector)).filter(|(name, _)| !name.is_empty())
}

/// The text of a `.lp` file.
#[must_use]
pub fn write_lp<'a>(lights: impl IntoIterator<Item = (&'a str, Vec3)>) -> String {
    let lines: Vec<String> =
        lights.into_iter().map(|(name, l)| format!("{name} {} {} {}\n", l.x, l.y, l.z)).collect();
    format!("{}\n{}", lines.len(), lines.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::fibonacci_hemisphere;

    #[test]
    fn lights_round_trip() {
        let lights = fibonacci_hemisphere(50);
        let names: Vec<String> = (0..50).map(|k| format!("image {k}.png")).collect();
        let text = write_lp(names.iter().map(String::as_str).zip(lights.iter().copied()));
        let read = read_lp(text.as_bytes(), "a.lp").unwrap();
        assert_eq!(read, names.into_iter().zip(lights).collect::<Vec<_>>());
    }

    #[test]
    fn files_of_other_programs_are_read() {
        let text = "2\r\nC:\\rti\\img_01.jpg\t0.0\t0.6\t0.8\r\n/home/x/b c.jpg   0  0\t 1\r\n\r\n";
        let read = read_lp(text.as_bytes(), "a.lp").unwrap();
        assert_eq!(read, [("img_01.jpg".into(), Vec3::new(0.0, 0.6, 0.8)), ("b c.jpg".into(), Vec3::Z)]);
    }

    #[test]
    fn directions_are_read_from_any_system() {
        let text = "\u{feff}0, 0, 1\r\n\r\n0\t3 ,4\r\n";
        let read = read_directions(text.as_bytes(), "lights.txt").unwrap();
        assert_eq!(read, [Vec3::Z, Vec3::new(0.0, 0.6, 0.8)]);
        let message = |text: &str| read_directions(text.as_bytes(), "lights.txt").unwrap_err().to_string();
        assert!(message("0 0 1\n0 1\n").starts_with("lights.txt:2: 2 numbers"));
        assert!(message("0 0 0\n").contains("unit vector"));
        assert!(message("1e200 1e200 1\n").contains("unit vector"));
        assert!(message("0 1 -1\n").contains("behind"));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        let message = |text: &str| read_lp(text.as_bytes(), "a.lp").unwrap_err().to_string();
        assert_eq!(message("two\n"), "a.lp:1: 'two' is not a number");
        assert_eq!(message("1\n\na.png 0 0.8\n"), "a.lp:3: 3 numbers where a name and 3 are needed");
        assert!(message("1\na 0 0 1\nb 0 0 1\n").starts_with("a.lp: 2 lines for 1 images"));
        assert!(message("1\na 0 0 1.2\n").contains("20.0 % off"));
        assert!(message("1\na 0 nan 1\n").contains("a.lp:2: nan is not finite"));
        assert!(message("1\na 0 0 -1\n").contains("behind"));
        assert!(message("1\n.. 0 0 1\n").contains("unsafe"));
    }
}
