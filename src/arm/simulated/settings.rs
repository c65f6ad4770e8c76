//! The settings in the firmware's EEPROM, and how it prints and stores them.

use std::collections::BTreeMap;

/// `$n` of a Grbl 1.1h; an axis setting stands once for each axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings(BTreeMap<u8, f64>);

/// Those printed as whole numbers; the rest have three decimals, but for the spindle's.
const WHOLE: &[u8] = &[0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 30, 31, 32];
const SWITCHES: &[u8] = &[4, 5, 6, 13, 20, 21, 22, 32];

impl Default for Settings {
    /// Grbl's own (`DEFAULTS_GENERIC`).
    fn default() -> Self {
        let mut s = BTreeMap::from([
            (0, 10.0),
            (1, 25.0),
            (2, 0.0),
            (3, 0.0),
            (4, 0.0),
            (5, 0.0),
            (6, 0.0),
            (10, 1.0),
            (11, 0.01),
            (12, 0.002),
            (13, 0.0),
            (20, 0.0),
            (21, 0.0),
            (22, 0.0),
            (23, 0.0),
            (24, 25.0),
            (25, 500.0),
            (26, 250.0),
            (27, 1.0),
            (30, 1000.0),
            (31, 0.0),
            (32, 0.0),
        ]);
        for axis in 0..3 {
            s.extend([(100 + axis, 250.0), (110 + axis, 500.0), (120 + axis, 10.0), (130 + axis, 200.0)]);
        }
        Self(s)
    }
}

impl Settings {
    /// Those of the arm of the integration guide: degrees, homing, soft limits.
    #[must_use]
    pub fn arm() -> Self {
        let mut s = Self::default();
        s.0.extend([(1, 255.0), (20, 1.0), (22, 1.0), (24, 300.0), (25, 1800.0), (27, 2.0)]);
        s.0.extend([(100, 88.889), (101, 88.889), (110, 5400.0), (111, 3600.0), (112, 3600.0)]);
        s.0.extend([(120, 180.0), (121, 120.0), (122, 120.0), (130, 370.0), (131, 200.0), (132, 10.0)]);
        s
    }

    /// Value of `$n`; 0 for one there isn't.
    #[must_use]
    pub fn get(&self, n: u8) -> f64 {
        self.0.get(&n).copied().unwrap_or(0.0)
    }

    /// Whether the switch `$n` is on.
    #[must_use]
    pub fn on(&self, n: u8) -> bool {
        self.get(n) != 0.0
    }

    /// The three values of an axis setting (100 steps, 110 rate, 120 acceleration, 130 travel).
    #[must_use]
    pub fn axes(&self, base: u8) -> [f64; 3] {
        [self.get(base), self.get(base + 1), self.get(base + 2)]
    }

    /// Sets without the firmware's checks.
    pub fn set(&mut self, n: u8, value: f64) {
        self.0.insert(n, value);
    }

    /// Stores as `settings_store_global_setting` does.
    ///
    /// # Errors
    /// The firmware's error number.
    pub fn store(&mut self, n: u8, value: f64) -> Result<(), u8> {
        if value < 0.0 {
            return Err(4);
        }
        if !self.0.contains_key(&n) {
            return Err(3);
        }
        if n == 0 && value < 3.0 {
            return Err(6);
        }
        if n == 20 && value != 0.0 && !self.on(22) {
            return Err(10);
        }
        let value = match n {
            _ if SWITCHES.contains(&n) => f64::from(u8::from(value >= 1.0)),
            30 | 31 => value,
            _ if WHOLE.contains(&n) => value.trunc().min(255.0),
            _ => value,
        };
        self.set(n, value);
        if n == 22 && value == 0.0 {
            self.set(20, 0.0); // soft limits need homing
        }
        Ok(())
    }

    /// What `$$` prints.
    #[must_use]
    pub fn report(&self) -> String {
        self.0
            .iter()
            .map(
                |(n, v)| {
                    if WHOLE.contains(n) { format!("${n}={v:.0}\r\n") } else { format!("${n}={v:.3}\r\n") }
                },
            )
            .collect()
    }
}
