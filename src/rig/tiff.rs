//! Baseline TIFF as industrial cameras write it: grey or RGB, 8 or 16 bits, uncompressed strips, either byte order.

use crate::image::{Image, ImageError, decode_png};
use crate::stack::BitDepth;

/// Decodes a camera's file, PNG or TIFF, of at most `limit` pixels.
///
/// # Errors
/// [`ImageError`] for another format or a damaged file.
pub fn decode_frame(bytes: &[u8], limit: usize) -> Result<Image, ImageError> {
    match bytes {
        [b'I', b'I', 42, 0, ..] => decode_tiff(&Reader { bytes, little: true }, limit),
        [b'M', b'M', 0, 42, ..] => decode_tiff(&Reader { bytes, little: false }, limit),
        _ => decode_png(bytes, limit),
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    little: bool,
}

fn damaged(what: &str) -> ImageError {
    ImageError::Damaged(format!("TIFF: {what}"))
}

impl Reader<'_> {
    fn u16(&self, at: usize) -> Result<u16, ImageError> {
        let b = at
            .checked_add(2)
            .and_then(|end| self.bytes.get(at..end))
            .ok_or(ImageError::Truncated(self.bytes.len()))?;
        let b = [b[0], b[1]];
        Ok(if self.little { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) })
    }

    fn u32(&self, at: usize) -> Result<u32, ImageError> {
        let (a, b) = (u32::from(self.u16(at)?), u32::from(self.u16(at.saturating_add(2))?));
        Ok(if self.little { a | b << 16 } else { a << 16 | b })
    }

    /// The values of a directory entry (SHORT or LONG).
    fn values(&self, entry: usize) -> Result<Vec<u32>, ImageError> {
        let (kind, count) = (self.u16(entry + 2)?, self.u32(entry + 4)? as usize);
        let size = match kind {
            3 => 2,
            4 => 4,
            _ => return Err(damaged("a tag has a type other than SHORT and LONG")),
        };
        if count > self.bytes.len() / size {
            return Err(ImageError::Truncated(self.bytes.len()));
        }
        let start = if count * size <= 4 { entry + 8 } else { self.u32(entry + 8)? as usize };
        (0..count)
            .map(|k| {
                let at = start.saturating_add(k * size);
                if size == 2 { self.u16(at).map(u32::from) } else { self.u32(at) }
            })
            .collect()
    }
}

fn decode_tiff(r: &Reader, limit: usize) -> Result<Image, ImageError> {
    let directory = r.u32(4)? as usize;
    let entries = usize::from(r.u16(directory)?);
    let find = |tag: u16| -> Result<Option<Vec<u32>>, ImageError> {
        for k in 0..entries {
            let entry = directory.saturating_add(2 + 12 * k);
            if r.u16(entry)? == tag {
                return r.values(entry).map(Some);
            }
        }
        Ok(None)
    };
    let one = |tag: u16, default: Option<u32>| -> Result<u32, ImageError> {
        find(tag)?
            .and_then(|v| v.first().copied())
            .or(default)
            .ok_or_else(|| damaged("size or strips are missing"))
    };
    let (width, height) = (one(256, None)?, one(257, None)?);
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > limit as u64 {
        return Err(ImageError::TooLarge { width, height, limit });
    }
    let (bits, samples) = (one(258, Some(1))?, one(277, Some(1))? as usize);
    if one(259, Some(1))? != 1 {
        return Err(damaged("it is compressed: let the camera write uncompressed TIFF, or PNG"));
    }
    if !matches!(bits, 8 | 16) || !matches!(samples, 1 | 3 | 4) || (samples > 1 && one(284, Some(1))? != 1) {
        return Err(damaged("8 or 16 bits, grey or interleaved RGB are read"));
    }
    let inverted = one(262, Some(1))? == 0;
    let (offsets, counts) = (
        find(273)?.ok_or_else(|| damaged("it has no strips (tiles are not read)"))?,
        find(279)?.ok_or_else(|| damaged("strip lengths are missing"))?,
    );
    let bytes_each = bits as usize / 8;
    let needed = pixels as usize * samples * bytes_each;
    let mut data = Vec::with_capacity(needed.min(r.bytes.len()));
    for (start, length) in offsets.iter().zip(&counts) {
        // Thousands of strips may name the same bytes: more than the picture needs is not gathered.
        if data.len() >= needed {
            break;
        }
        let end = (*start as usize).saturating_add(*length as usize);
        let strip = r.bytes.get(*start as usize..end).ok_or(ImageError::Truncated(r.bytes.len()))?;
        data.extend_from_slice(&strip[..strip.len().min(needed - data.len())]);
    }
    if data.len() < needed {
        return Err(ImageError::Truncated(r.bytes.len()));
    }
    let samples_at = Reader { bytes: &data, little: r.little };
    let full = if bits == 8 { 255 } else { 65535 };
    let value = |k: usize| -> Result<u16, ImageError> {
        let v = if bytes_each == 1 { u16::from(data[k]) } else { samples_at.u16(2 * k)? };
        Ok(if inverted { full - v } else { v })
    };
    let mut rgb = Vec::with_capacity(pixels as usize);
    for p in 0..pixels as usize {
        let at = p * samples;
        rgb.push(if samples == 1 { [value(at)?; 3] } else { [value(at)?, value(at + 1)?, value(at + 2)?] });
    }
    let bits = if bits == 8 { BitDepth::Eight } else { BitDepth::Sixteen };
    Ok(Image { width, height, bits, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey 16-bit TIFF of two strips.
    fn tiff(little: bool) -> Vec<u8> {
        let u16b = |v: u16| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let u32b = |v: u32| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let mut out: Vec<u8> = if little { b"II*\0".to_vec() } else { b"MM\0*".to_vec() };
        out.extend(u32b(36)); // directory after the pixels and the strip lists
        for v in [100u16, 4095, 7, 8, 9, 65535] {
            out.extend(u16b(v));
        }
        for v in [8u32, 14, 6, 6] {
            out.extend(u32b(v));
        }
        let entries = [
            (256u16, 4u16, 1u32, 3u32),
            (257, 4, 1, 2),
            (258, 3, 1, 16),
            (259, 3, 1, 1),
            (262, 3, 1, 1),
            (273, 4, 2, 20),
            (277, 3, 1, 1),
            (279, 4, 2, 28),
        ];
        out.extend(u16b(entries.len() as u16));
        for (tag, kind, count, value) in entries {
            out.extend(u16b(tag));
            out.extend(u16b(kind));
            out.extend(u32b(count));
            if kind == 3 {
                out.extend(u16b(value as u16));
                out.extend([0, 0]);
            } else {
                out.extend(u32b(value));
            }
        }
        out
    }

    #[test]
    fn both_byte_orders() {
        for little in [true, false] {
            let image = decode_frame(&tiff(little), 100).unwrap();
            assert_eq!((image.width, image.height, image.bits), (3, 2, BitDepth::Sixteen));
            assert_eq!(image.rgb.iter().map(|c| c[0]).collect::<Vec<_>>(), [100, 4095, 7, 8, 9, 65535]);
            assert!(matches!(decode_frame(&tiff(little), 5), Err(ImageError::TooLarge { .. })));
        }
    }

    #[test]
    fn strips_that_say_the_same_bytes_again_and_again_are_not_gathered() {
        let mut bytes = tiff(true);
        // 100 000 strips, all of them the whole file so far.
        let (count, whole) = (100_000u32, bytes.len() as u32);
        let lists = bytes.len() as u32;
        bytes.extend(0u32.to_le_bytes().repeat(count as usize));
        bytes.extend(whole.to_le_bytes().repeat(count as usize));
        let entry = |k: usize| 36 + 2 + 12 * k;
        for (k, place) in [(5, lists), (7, lists + 4 * count)] {
            bytes[entry(k) + 4..entry(k) + 8].copy_from_slice(&count.to_le_bytes());
            bytes[entry(k) + 8..entry(k) + 12].copy_from_slice(&place.to_le_bytes());
        }
        let image = decode_frame(&bytes, 100).unwrap();
        assert_eq!(image.rgb.len(), 6);
    }
}
