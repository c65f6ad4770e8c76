//! PNG images as code values: bytes in, bytes out.
//!
//! Code values are what the file stores: gamma, colour profile and alpha are ignored. Grey images
//! have three equal channels.

use crate::stack::BitDepth;
use std::io::Cursor;

/// ITU-R BT.601 luma, as MATLAB's rgb2gray: the official protocol's grey.
#[inline]
#[must_use]
pub fn luma(rgb: [f32; 3]) -> f32 {
    0.2989 * rgb[0] + 0.5870 * rgb[1] + 0.1140 * rgb[2]
}

/// A whole image of code values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bits a channel.
    pub bits: BitDepth,
    /// RGB code values, row-major.
    pub rgb: Vec<[u16; 3]>,
}

/// What a PNG says about itself before any pixel is decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PngInfo {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Bits a channel of the decoded values (palettes and depths below 8 are widened to 8).
    pub bits: BitDepth,
}

/// Why an image can't be read or written.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
pub enum ImageError {
    /// Another file format, or nothing.
    #[error("not a PNG file (it starts with {0}): save the image as PNG with 8 or 16 bits a channel")]
    NotPng(String),
    /// The file ends too early.
    #[error("the PNG ends too early, after {0} bytes: it is truncated, copy or download it again")]
    Truncated(usize),
    /// It claims more pixels than the limit.
    #[error("{width}×{height} pixels, more than the limit of {limit}: crop or scale the image")]
    TooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Largest number of pixels.
        limit: usize,
    },
    /// Damaged or not supported.
    #[error("damaged PNG: {0}")]
    Damaged(String),
    /// Pixels to encode do not fill the image.
    #[error("{found} values for a {width}×{height} image")]
    Length {
        /// Number of values.
        found: usize,
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
}

const SIGNATURE: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// Checks length and checksum of every chunk, so that rows which nobody needs can be left undecoded.
fn check_chunks(bytes: &[u8]) -> Result<(), ImageError> {
    let truncated = ImageError::Truncated(bytes.len());
    let word = |b: &[u8]| u32::from_be_bytes([b[0], b[1], b[2], b[3]]);
    let mut rest = bytes.get(SIGNATURE.len()..).ok_or(truncated.clone())?;
    loop {
        let (length, body) = rest.split_at_checked(4).ok_or(truncated.clone())?;
        // Type and data, then the checksum of both.
        let (chunk, tail) =
            body.split_at_checked((word(length) as usize).saturating_add(4)).ok_or(truncated.clone())?;
        let (sum, next) = tail.split_at_checked(4).ok_or(truncated.clone())?;
        let mut crc = flate2::Crc::new();
        crc.update(chunk);
        let kind = &chunk[..4];
        if crc.sum() != word(sum) {
            return Err(ImageError::Damaged(format!("wrong checksum of chunk {}", kind.escape_ascii())));
        }
        if kind == b"IEND" {
            return Ok(());
        }
        rest = next;
    }
}

fn error(e: &png::DecodingError, bytes: &[u8]) -> ImageError {
    match e {
        png::DecodingError::IoError(io) if io.kind() == std::io::ErrorKind::UnexpectedEof => {
            ImageError::Truncated(bytes.len())
        }
        other => ImageError::Damaged(other.to_string()),
    }
}

/// A PNG whose header has been read and found within the limits.
pub struct PngReader<'a> {
    bytes: &'a [u8],
    reader: png::Reader<Cursor<&'a [u8]>>,
    info: PngInfo,
    samples: usize,
}

impl<'a> PngReader<'a> {
    /// Reads the header and checks that the file is whole. At most 2³² − 1 pixels are read, whatever `limit` is.
    ///
    /// # Errors
    /// [`ImageError`], also for an image of more than `limit` pixels.
    pub fn new(bytes: &'a [u8], limit: usize) -> Result<Self, ImageError> {
        if !bytes.starts_with(&SIGNATURE) {
            if !bytes.is_empty() && SIGNATURE.starts_with(bytes) {
                return Err(ImageError::Truncated(bytes.len()));
            }
            let start: String = bytes.iter().take(8).map(|b| b.escape_ascii().to_string()).collect();
            let start = if start.is_empty() { "nothing: it is empty".into() } else { format!("\"{start}\"") };
            return Err(ImageError::NotPng(start));
        }
        check_chunks(bytes)?;
        let mut decoder = png::Decoder::new(Cursor::new(bytes));
        decoder.ignore_checksums(true); // just checked
        decoder.set_transformations(png::Transformations::EXPAND);
        decoder.set_ignore_text_chunk(true);
        decoder.set_ignore_iccp_chunk(true);
        let header = decoder.read_header_info().map_err(|e| error(&e, bytes))?;
        let (width, height) = (header.width, header.height);
        let limit = limit.min(u32::MAX as usize); // positions are u32
        if u64::from(width) * u64::from(height) > limit as u64 {
            return Err(ImageError::TooLarge { width, height, limit });
        }
        // Deflate packs at most 1032:1: what claims more is refused before anything is allocated.
        let bits = header.color_type.samples() as u64 * u64::from(header.bit_depth as u8);
        if u64::from(width) * u64::from(height) * bits / 8 / 1100 > bytes.len() as u64 {
            return Err(ImageError::Truncated(bytes.len()));
        }
        let reader = decoder.read_info().map_err(|e| error(&e, bytes))?;
        let (color, depth) = reader.output_color_type();
        let bits = if depth == png::BitDepth::Sixteen { BitDepth::Sixteen } else { BitDepth::Eight };
        let info = PngInfo { width, height, bits };
        Ok(Self { bytes, reader, info, samples: color.samples() })
    }

    /// Size and depth.
    #[must_use]
    pub fn info(&self) -> PngInfo {
        self.info
    }

    /// Hands the pixels at row-major positions `indices` (ascending) to `each`, in order.
    ///
    /// Rows below the last one needed are not decoded; that the file is whole was checked by [`new`](Self::new).
    ///
    /// # Errors
    /// [`ImageError`] for a truncated or damaged file.
    pub fn pixels(
        mut self,
        indices: impl IntoIterator<Item = u32>,
        mut each: impl FnMut([u16; 3]),
    ) -> Result<(), ImageError> {
        let bytes = self.bytes;
        let (color, wide, samples) = (self.samples >= 3, self.info.bits == BitDepth::Sixteen, self.samples);
        let pixel = move |row: &[u8], x: usize| {
            let sample = |c: usize| {
                let i = x * samples + c;
                if wide { u16::from_be_bytes([row[2 * i], row[2 * i + 1]]) } else { u16::from(row[i]) }
            };
            if color { [sample(0), sample(1), sample(2)] } else { [sample(0); 3] }
        };
        let width = self.info.width as usize;
        if self.reader.info().interlaced {
            let size = self.reader.output_buffer_size().ok_or(ImageError::Damaged("too large".into()))?;
            let mut whole = vec![0; size];
            self.reader.next_frame(&mut whole).map_err(|e| error(&e, bytes))?;
            indices.into_iter().for_each(|i| each(pixel(&whole, i as usize)));
            return Ok(());
        }
        let mut row = vec![0; self.reader.output_line_size(self.info.width).unwrap_or(0)];
        let mut decoded = 0; // rows
        for i in indices {
            let (x, y) = (i as usize % width, i as usize / width);
            while decoded <= y {
                if self.reader.read_row(&mut row).map_err(|e| error(&e, bytes))?.is_none() {
                    return Err(ImageError::Truncated(bytes.len()));
                }
                decoded += 1;
            }
            each(pixel(&row, x));
        }
        Ok(())
    }
}

/// Decodes a whole PNG of at most `limit` pixels: grey, RGB, palette, with or without alpha, up to 16 bits.
///
/// # Errors
/// [`ImageError`].
pub fn decode_png(bytes: &[u8], limit: usize) -> Result<Image, ImageError> {
    let reader = PngReader::new(bytes, limit)?;
    let PngInfo { width, height, bits } = reader.info();
    let count = width * height; // within `limit`, see `PngReader::new`
    let mut rgb = Vec::with_capacity(count as usize);
    reader.pixels(0..count, |p| rgb.push(p))?;
    Ok(Image { width, height, bits, rgb })
}

/// Encodes RGB code values (row-major) with 8 or 16 bits a channel; at 8 bits the values must be ≤ 255.
///
/// # Errors
/// [`ImageError::Length`] where `rgb` does not fill the image, or it has no pixel.
pub fn encode_rgb(width: u32, height: u32, bits: BitDepth, rgb: &[[u16; 3]]) -> Result<Vec<u8>, ImageError> {
    check_length(width, height, rgb.len())?;
    let values = rgb.iter().flatten();
    let data: Vec<u8> = match bits {
        BitDepth::Eight => values.map(|&v| v.min(255) as u8).collect(),
        BitDepth::Sixteen => values.flat_map(|v| v.to_be_bytes()).collect(),
    };
    encode(width, height, png::ColorType::Rgb, bits, &data)
}

/// Encodes 8-bit grey values (row-major).
///
/// # Errors
/// [`ImageError::Length`] where `grey` does not fill the image, or it has no pixel.
pub fn encode_grey(width: u32, height: u32, grey: &[u8]) -> Result<Vec<u8>, ImageError> {
    check_length(width, height, grey.len())?;
    encode(width, height, png::ColorType::Grayscale, BitDepth::Eight, grey)
}

fn check_length(width: u32, height: u32, found: usize) -> Result<(), ImageError> {
    if found > 0 && found as u64 == u64::from(width) * u64::from(height) {
        Ok(())
    } else {
        Err(ImageError::Length { found, width, height })
    }
}

fn encode(
    width: u32,
    height: u32,
    color: png::ColorType,
    bits: BitDepth,
    data: &[u8],
) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(if bits == BitDepth::Sixteen { png::BitDepth::Sixteen } else { png::BitDepth::Eight });
    let damaged = |e: png::EncodingError| ImageError::Damaged(e.to_string());
    let mut writer = encoder.write_header().map_err(damaged)?;
    writer.write_image_data(data).map_err(damaged)?;
    writer.finish().map_err(damaged)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(bits: BitDepth) -> Vec<[u16; 3]> {
        let scale = if bits == BitDepth::Eight { 1 } else { 257 };
        (0..63).map(|i| [i * scale, (200 - i) * scale, 255 * scale]).collect()
    }

    #[test]
    fn rgb_round_trips_at_both_depths() {
        for bits in [BitDepth::Eight, BitDepth::Sixteen] {
            let bytes = encode_rgb(9, 7, bits, &ramp(bits)).unwrap();
            assert_eq!(decode_png(&bytes, 63), Ok(Image { width: 9, height: 7, bits, rgb: ramp(bits) }));
        }
    }

    #[test]
    fn every_colour_type_is_read() {
        use png::{BitDepth as D, ColorType as C};
        let make = |color, depth, data: &[u8]| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
            encoder.set_color(color);
            encoder.set_depth(depth);
            encoder.set_palette(&[9u8, 8, 7, 1, 2, 3][..]);
            encoder.write_header().unwrap().write_image_data(data).unwrap();
            decode_png(&bytes, 2).unwrap().rgb
        };
        assert_eq!(make(C::Grayscale, D::Eight, &[5, 6]), [[5; 3], [6; 3]]);
        assert_eq!(make(C::Grayscale, D::One, &[0b0100_0000]), [[0; 3], [255; 3]]);
        assert_eq!(make(C::Grayscale, D::Sixteen, &[1, 0, 0, 2]), [[256; 3], [2; 3]]);
        assert_eq!(make(C::GrayscaleAlpha, D::Eight, &[5, 0, 6, 0]), [[5; 3], [6; 3]]);
        assert_eq!(make(C::Rgba, D::Eight, &[1, 2, 3, 0, 4, 5, 6, 9]), [[1, 2, 3], [4, 5, 6]]);
        assert_eq!(make(C::Indexed, D::Eight, &[0, 1]), [[9, 8, 7], [1, 2, 3]]);
    }

    #[test]
    fn only_the_rows_that_are_needed_are_decoded_but_truncation_is_seen() {
        let bytes = encode_rgb(9, 7, BitDepth::Sixteen, &ramp(BitDepth::Sixteen)).unwrap();
        let first_row = |bytes: &[u8]| {
            let mut got = Vec::new();
            PngReader::new(bytes, 100)?.pixels([1, 4], |p| got.push(p))?;
            Ok(got)
        };
        assert_eq!(first_row(&bytes), Ok(vec![ramp(BitDepth::Sixteen)[1], ramp(BitDepth::Sixteen)[4]]));
        for end in 1..bytes.len() {
            assert!(matches!(first_row(&bytes[..end]), Err(ImageError::Truncated(n)) if n == end), "{end}");
        }
        let mut trailing = bytes.clone();
        trailing.extend(b"junk after the end");
        assert!(first_row(&trailing).is_ok());
    }

    #[test]
    fn what_is_no_png_or_too_large_is_named() {
        assert!(matches!(decode_png(b"", 9), Err(ImageError::NotPng(_))));
        assert!(matches!(decode_png(b"\xff\xd8\xff\xe0 a jpeg", 9), Err(ImageError::NotPng(_))));
        let bytes = encode_grey(3, 3, &[0; 9]).unwrap();
        assert_eq!(
            decode_png(&bytes, 8).unwrap_err(),
            ImageError::TooLarge { width: 3, height: 3, limit: 8 }
        );
        // 60000×60000 in a header of a few bytes: refused before anything is allocated.
        let mut huge = bytes.clone();
        huge[16..24].copy_from_slice(&[0, 0, 0xea, 0x60, 0, 0, 0xea, 0x60]);
        let crc = {
            let mut crc = flate2::Crc::new();
            crc.update(&huge[12..29]);
            crc.sum()
        };
        huge[29..33].copy_from_slice(&crc.to_be_bytes());
        assert!(matches!(decode_png(&huge, 1 << 26), Err(ImageError::TooLarge { width: 60000, .. })));
        assert!(matches!(decode_png(&huge, usize::MAX), Err(ImageError::Truncated(_))));
        assert!(encode_grey(3, 3, &[0; 8]).is_err() && encode_grey(0, 3, &[]).is_err());
    }

    #[test]
    fn damage_is_an_error() {
        let mut bytes = encode_rgb(9, 7, BitDepth::Eight, &ramp(BitDepth::Eight)).unwrap();
        bytes[60] ^= 0x40;
        assert!(matches!(decode_png(&bytes, 63), Err(ImageError::Damaged(_))));
    }
}
