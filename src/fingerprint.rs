//! Fingerprints of bytes: FNV-1a (Fowler, Noll, Vo), 64 bits. They tell damage and difference, not forgery.

/// A fingerprint in the making.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fingerprint {
    /// That of all bytes together.
    pub fn of(bytes: impl IntoIterator<Item = u8>) -> Self {
        let mut print = Self::default();
        print.add(bytes);
        print
    }

    /// Takes in more bytes.
    pub fn add(&mut self, bytes: impl IntoIterator<Item = u8>) {
        for b in bytes {
            self.0 = (self.0 ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    /// As a number.
    #[must_use]
    pub fn value(self) -> u64 {
        self.0
    }
}

/// 16 hexadecimal digits.
impl std::fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_values_come_out() {
        assert_eq!(Fingerprint::of([]).value(), 0xcbf2_9ce4_8422_2325);
        assert_eq!(Fingerprint::of(*b"foobar").to_string(), "85944171f73967e8");
        let mut parts = Fingerprint::of(*b"foo");
        parts.add(*b"bar");
        assert_eq!(parts, Fingerprint::of(*b"foobar"));
    }
}
