//! A session on disk, in DiLiGenT's layout plus `session.json`, written as it goes.
//!
//! After every light the image comes first, then the lists, then `session.json`: the record that counts. Each file
//! replaces its former self as a whole ([`Write`]), so a session that is cut off at any byte holds every image
//! before the one in flight. Images are 16-bit PNG of the merged values over their largest, which stands as the light's
//! intensity: `png / 65535 / intensity` is the merged value again, for any reader of the layout.

use super::calibration::Sighting;
use super::hdr::{Crop, Quality};
use super::sphere::Circle;
use crate::arm::Joints;
use crate::arm::kinematics::Arm;
use crate::camera::Observation;
use crate::dataset::Limits;
use crate::dataset::diligent::{decode_pixels, encode_pixels};
use crate::dataset::lp::write_lp;
use crate::image;
use crate::stack::{BitDepth, Mask, flags};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Name of the record.
pub const RECORD: &str = "session.json";
const FORMAT: u32 = 1;

/// Replaces the file `name` (relative to the session's folder) as a whole, or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Write {
    /// Name, without folders.
    pub name: String,
    /// Its new content.
    pub bytes: Vec<u8>,
}

/// How long the steps of one light took, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Timings {
    /// Planner.
    pub plan: f64,
    /// Move, until the firmware said that it has ended.
    pub r#move: f64,
    /// Settling.
    pub settle: f64,
    /// All exposures with their read-out.
    pub expose: f64,
    /// Merge and encoding.
    pub merge: f64,
    /// Normals.
    pub solve: f64,
}

/// One light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// Image file.
    pub file: String,
    /// What the planner asked for.
    pub requested: Vec3,
    /// What the arm was sent to: the nearest it can reach.
    pub commanded: Vec3,
    /// Angle between the two, degrees.
    pub projected: f64,
    /// What the mirror sphere showed, where there is one.
    pub measured: Option<Vec3>,
    /// Standard uncertainty of `measured`, degrees.
    pub uncertainty: Option<f64>,
    /// Joint angles sent.
    pub joints: Joints,
    /// Joint angles that the firmware reported.
    pub reported: Option<Joints>,
    /// Exposure times, seconds.
    pub exposures: Vec<f64>,
    /// Largest merged value: what 65535 in the image stands for.
    pub scale: f32,
    /// Saturation and noise.
    pub quality: Quality,
    /// CRC-32 of the image file.
    pub crc32: u32,
    /// How long it took.
    pub timings: Timings,
}

impl Shot {
    /// The direction for the solver: measured where there is one, else commanded.
    #[must_use]
    pub fn light(&self) -> Vec3 {
        self.measured.unwrap_or(self.commanded)
    }
}

/// Everything about a session but its pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Version of this format.
    pub format: u32,
    /// Name of the object.
    pub object: String,
    /// Planner.
    pub planner: String,
    /// Hash of the planner's model, where it has one.
    pub model: Option<String>,
    /// Seed.
    pub seed: u64,
    /// Number of lights, T.
    pub lights: usize,
    /// Firmware, as "Grbl 1.1h".
    pub firmware: String,
    /// Camera.
    pub camera: String,
    /// Part of the sensor.
    pub crop: Option<Crop>,
    /// Outline of the mirror sphere in the whole picture, where there is one.
    #[serde(default)]
    pub sphere: Option<Circle>,
    /// The arm.
    pub arm: Arm,
    /// Exposure at which a merged value of 1 is full scale, seconds: the shortest of the bracket.
    pub unit_exposure: f64,
    /// LED brightness, spindle speed S.
    #[serde(default)]
    pub brightness: Option<f64>,
    /// Largest slant that the planner may ask for, degrees.
    #[serde(default)]
    pub reach: Option<f32>,
    /// By how much a light may be moved to save travel, degrees.
    #[serde(default)]
    pub nearby: Option<f32>,
    /// Code value of black of the camera's files, where it saves some.
    #[serde(default)]
    pub black: Option<u16>,
    /// Code value at which they saturate; none for the largest of the file.
    #[serde(default)]
    pub white: Option<u16>,
    /// Whether exposures with the LED off are subtracted.
    #[serde(default)]
    pub dark: Option<bool>,
    /// Lights so far, in order.
    pub shots: Vec<Shot>,
    /// Faults and what was done, in order.
    pub notes: Vec<String>,
}

/// Why a session can't be written or read.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum StoreError {
    /// No record, or not one of ours.
    #[error("session.json: {0}")]
    Record(String),
    /// A later format.
    #[error("session.json has format {0}, this program knows {FORMAT}: use a newer one")]
    Format(u32),
    /// The mask can't be read.
    #[error("mask.png: {0}")]
    Mask(String),
    /// An image can't be encoded.
    #[error(transparent)]
    Image(#[from] image::ImageError),
}

/// A session that was read back.
#[derive(Clone, Debug)]
pub struct Resumed {
    /// Its record, with the shots whose images are whole.
    pub record: Record,
    /// The object's pixels.
    pub mask: Mask,
    /// One observation a shot.
    pub seen: Vec<Observation>,
    /// Shots that were recorded but whose image is damaged or gone, by file name.
    pub damaged: Vec<String>,
}

/// CRC-32 (IEEE), as in PNG and zip.
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// What only a saturated pixel has.
const SATURATED: u16 = u16::MAX;

/// 16-bit codes of the mask pixels' merged values, and the scale. The largest code is kept for pixels that are saturated
/// in every exposure: their brightest channel has it.
#[must_use]
pub fn quantise(rgb: &[[f32; 3]], saturated: &[bool]) -> (Vec<[u16; 3]>, f32) {
    let brightest = rgb.iter().flatten().copied().fold(0.0f32, f32::max).max(1e-6);
    let top = f32::from(SATURATED - 1);
    let code = |v: f32| (v / brightest * top + 0.5).clamp(0.0, top) as u16;
    let mut codes: Vec<[u16; 3]> = rgb.iter().map(|c| c.map(code)).collect();
    for (code, _) in codes.iter_mut().zip(saturated).filter(|(_, s)| **s) {
        let most = *code.iter().max().unwrap_or(&0);
        *code = code.map(|c| if c == most { SATURATED } else { c });
    }
    (codes, brightest * (f32::from(SATURATED) / top))
}

/// The picture as it will be read back, so that a continued session is the same as one that never stopped.
#[must_use]
pub fn observation(requested: Vec3, light: Vec3, codes: &[[u16; 3]], scale: f32) -> Observation {
    let value = |v: u16| f32::from(v) / 65535.0 * scale;
    let rgb: Vec<[f32; 3]> = codes.iter().map(|c| c.map(value)).collect();
    let grey = rgb.iter().map(|c| (c[0] + c[1] + c[2]) / 3.0).collect();
    let saturated = flags(codes.iter().map(|c| c.contains(&SATURATED)));
    Observation { saturated, ..Observation::new(requested, light, grey, rgb) }
}

/// The image of a shot as a file, and its CRC.
///
/// # Errors
/// [`StoreError::Image`].
pub fn encode_shot(number: usize, codes: &[[u16; 3]], mask: &Mask) -> Result<(Write, u32), StoreError> {
    let bytes = encode_pixels(codes, BitDepth::Sixteen, mask)?;
    let crc = crc32(&bytes);
    Ok((Write { name: format!("{number:03}.png"), bytes }, crc))
}

impl Record {
    /// Whether both are of the same session, one perhaps some lights further: the same plan, and the images of one are
    /// the first ones of the other.
    #[must_use]
    pub fn same_session(&self, other: &Self) -> bool {
        (&self.object, &self.planner, self.seed, self.lights)
            == (&other.object, &other.planner, other.seed, other.lights)
            && self.shots.iter().zip(&other.shots).all(|(a, b)| a.crc32 == b.crc32)
    }

    /// What the mirror sphere showed, for [`super::calibration::fit_mount`].
    #[must_use]
    pub fn sightings(&self) -> Vec<Sighting> {
        let sighting = |s: &Shot| {
            Some(Sighting { joints: s.joints, measured: s.measured?, uncertainty: s.uncertainty? })
        };
        self.shots.iter().filter_map(sighting).collect()
    }

    /// A record of a session that begins.
    #[must_use]
    pub fn new(object: &str, planner: &str, seed: u64, lights: usize, arm: Arm) -> Self {
        Self {
            format: FORMAT,
            object: object.into(),
            planner: planner.into(),
            model: None,
            seed,
            lights,
            firmware: String::new(),
            camera: String::new(),
            crop: None,
            sphere: None,
            arm,
            unit_exposure: 0.0,
            brightness: None,
            reach: None,
            nearby: None,
            black: None,
            white: None,
            dark: None,
            shots: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The lists and the record, in the order in which they must be written; after a shot's image.
    #[must_use]
    pub fn writes(&self) -> Vec<Write> {
        let file = |name: &str, text: String| Write { name: name.into(), bytes: text.into_bytes() };
        let lines = |each: &dyn Fn(&Shot) -> String| self.shots.iter().map(each).collect::<String>();
        vec![
            file("filenames.txt", lines(&|s| format!("{}\n", s.file))),
            file(
                "light_directions.txt",
                lines(&|s| {
                    let l = s.light();
                    format!("{} {} {}\n", l.x, l.y, l.z)
                }),
            ),
            file(
                "light_intensities.txt",
                lines(&|s| {
                    let i = 1.0 / s.scale;
                    format!("{i} {i} {i}\n")
                }),
            ),
            file("lights.lp", write_lp(self.shots.iter().map(|s| (s.file.as_str(), s.light())))),
            file(RECORD, format!("{}\n", serde_json::to_string_pretty(self).unwrap_or_default())),
        ]
    }

    /// The mask as a file: written once, before the first shot.
    ///
    /// # Errors
    /// [`StoreError::Image`].
    pub fn mask_file(mask: &Mask) -> Result<Write, StoreError> {
        let inside = mask.scatter(&vec![255; mask.len()], 0);
        let bytes = image::encode_grey(mask.width(), mask.height(), &inside)?;
        Ok(Write { name: "mask.png".into(), bytes })
    }
}

/// Reads a session back. `read` gives the bytes of a file of its folder.
///
/// # Errors
/// [`StoreError`] where there is no session; a damaged image is not an error but left out and named.
pub fn resume(mut read: impl FnMut(&str) -> Option<Vec<u8>>) -> Result<Resumed, StoreError> {
    let bytes =
        read(RECORD).ok_or_else(|| StoreError::Record("not there: this folder holds no session".into()))?;
    let mut record: Record = serde_json::from_slice(&bytes).map_err(|e| StoreError::Record(e.to_string()))?;
    if record.format != FORMAT {
        return Err(StoreError::Format(record.format));
    }
    record.arm.check().map_err(|e| StoreError::Record(format!("arm: {e}")))?;
    let mask = read("mask.png").ok_or_else(|| StoreError::Mask("not there".into()))?;
    let mask =
        image::decode_png(&mask, Limits::default().pixels).map_err(|e| StoreError::Mask(e.to_string()))?;
    let mask = Mask::from_image(&mask).map_err(|e| StoreError::Mask(e.to_string()))?;
    let (mut seen, mut damaged, mut kept) = (Vec::new(), Vec::new(), Vec::new());
    for shot in std::mem::take(&mut record.shots) {
        let plain = shot.file.len() < 64 && shot.file.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'.');
        let unit = |v: Vec3| (v.length() - 1.0).abs() < 1e-3;
        let usable =
            plain && unit(shot.light()) && unit(shot.requested) && shot.scale > 0.0 && shot.scale.is_finite();
        let pixels = usable
            .then(|| read(&shot.file))
            .flatten()
            .filter(|b| crc32(b) == shot.crc32)
            .and_then(|b| decode_pixels(&b, &mask, &shot.file).ok())
            .filter(|p| p.rgb.len() == mask.len());
        match pixels {
            Some(p) => {
                seen.push(observation(shot.requested, shot.light(), &p.rgb, shot.scale));
                kept.push(shot);
            }
            None => damaged.push(shot.file),
        }
    }
    record.shots = kept;
    Ok(Resumed { record, mask, seen, damaged })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Files as _, Memory, read_object};
    use crate::light::fibonacci_cap;
    use std::collections::BTreeMap;

    fn shot(number: usize, light: Vec3, codes: &[[u16; 3]], mask: &Mask, scale: f32) -> (Shot, Write) {
        let (write, crc32) = encode_shot(number, codes, mask).unwrap();
        let shot = Shot {
            file: write.name.clone(),
            requested: light,
            commanded: light,
            projected: 0.0,
            measured: None,
            uncertainty: None,
            joints: Joints::default(),
            reported: None,
            exposures: vec![0.001],
            scale,
            quality: Quality::default(),
            crc32,
            timings: Timings::default(),
        };
        (shot, write)
    }

    #[test]
    fn the_largest_code_is_for_saturated_pixels() {
        let rgb = [[0.5, 1.0, 0.2], [0.9, 0.1, 0.1], [0.3; 3]];
        let (codes, scale) = quantise(&rgb, &[]);
        assert!(observation(Vec3::Z, Vec3::Z, &codes, scale).saturated.is_empty());
        let (codes, scale) = quantise(&rgb, &[true, false, false]);
        let picture = observation(Vec3::Z, Vec3::Z, &codes, scale);
        assert_eq!(picture.saturated, [true, false, false]);
        for (found, given) in picture.rgb.iter().flatten().zip(rgb.as_flattened()) {
            assert!((found - given).abs() < 3e-5, "{found} {given}");
        }
    }

    /// All writes of a session of five lights, in order.
    fn session() -> (Vec<Write>, Mask, Vec<Observation>) {
        let mask =
            Mask::new(4, 3, &[true, true, false, true, true, true, true, true, true, false, true, true])
                .unwrap();
        let mut record = Record::new("thing", "random", 1, 5, Arm::default());
        let mut writes = vec![Record::mask_file(&mask).unwrap()];
        writes.extend(record.writes());
        let mut seen = Vec::new();
        for (k, light) in fibonacci_cap(5, 1.0).into_iter().enumerate() {
            let rgb: Vec<[f32; 3]> = (0..mask.len()).map(|p| [0.01 * (p + k) as f32, 0.2, 0.05]).collect();
            let (codes, scale) = quantise(&rgb, &[]);
            seen.push(observation(light, light, &codes, scale));
            let (shot, image) = shot(k + 1, light, &codes, &mask, scale);
            record.shots.push(shot);
            writes.push(image);
            writes.extend(record.writes());
        }
        (writes, mask, seen)
    }

    #[test]
    fn killed_at_any_byte_loses_at_most_the_image_in_flight() {
        let (writes, mask, seen) = session();
        let total: usize = writes.iter().map(|w| w.bytes.len()).sum();
        let mut disk = BTreeMap::<String, Vec<u8>>::new();
        let (mut done, mut shots) = (0, 0);
        let mut checked = 0;
        for w in &writes {
            for cut in 0..w.bytes.len() {
                // The temporary file is torn, the one with the name is not replaced yet.
                let at = done + cut;
                if at % 7 != 0 && cut != w.bytes.len() - 1 {
                    continue;
                }
                let mut disk = disk.clone();
                disk.insert(format!("{}.tmp", w.name), w.bytes[..cut].to_vec());
                match resume(|n| disk.get(n).cloned()) {
                    Ok(r) => {
                        assert_eq!((r.seen.len(), r.damaged.len(), &r.mask), (shots, 0, &mask));
                        for (a, b) in r.seen.iter().zip(&seen) {
                            assert_eq!((&a.grey, a.light), (&b.grey, b.light));
                        }
                    }
                    Err(_) => assert_eq!(shots, 0, "byte {at} of {total}"),
                }
                checked += 1;
            }
            done += w.bytes.len();
            disk.insert(w.name.clone(), w.bytes.clone());
            if w.name == RECORD {
                shots = resume(|n| disk.get(n).cloned()).unwrap().seen.len();
            }
        }
        assert!(shots == 5 && checked > 1000);
    }

    #[test]
    fn any_diligent_reader_opens_it() {
        let (writes, mask, seen) = session();
        let mut files = Memory::new();
        let mut disk = BTreeMap::new();
        for w in writes {
            disk.insert(w.name, w.bytes);
        }
        for (name, bytes) in disk {
            files.insert(&format!("thing/{name}"), bytes).unwrap();
        }
        assert!(files.has("thing/lights.lp"));
        let (stack, _) = read_object(&files, "thing", &crate::dataset::Limits::default()).unwrap();
        assert_eq!((stack.mask, stack.images.len()), (mask, 5));
        for (k, o) in seen.iter().enumerate() {
            assert!((stack.lights[k] - o.light).length() < 1e-6);
            for (code, value) in stack.images[k].iter().zip(&o.rgb) {
                assert!((f32::from(code[1]) / 65535.0 / stack.intensities[k][1] - value[1]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_session_is_known_again_further_on() {
        let (writes, ..) = session();
        let records: Vec<Record> = writes
            .iter()
            .filter(|w| w.name == RECORD)
            .map(|w| serde_json::from_slice(&w.bytes).unwrap())
            .collect();
        let (first, last) = (&records[1], records.last().unwrap());
        assert!(first.same_session(last) && last.same_session(first) && records[0].same_session(last));
        let mut other = last.clone();
        other.shots[2].crc32 ^= 1;
        assert!(first.same_session(&other) && !last.same_session(&other));
        other = Record { seed: 2, ..last.clone() };
        assert!(!last.same_session(&other));
    }

    #[test]
    fn damage_is_named_and_the_rest_goes_on() {
        let (writes, ..) = session();
        let mut disk: BTreeMap<String, Vec<u8>> = writes.into_iter().map(|w| (w.name, w.bytes)).collect();
        disk.get_mut("002.png").unwrap()[40] ^= 1;
        disk.remove("004.png");
        let r = resume(|n| disk.get(n).cloned()).unwrap();
        assert_eq!((r.seen.len(), r.damaged), (3, vec!["002.png".to_string(), "004.png".into()]));
        assert!(resume(|_| None).unwrap_err().to_string().contains("no session"));
    }
}
