//! What one line of a Grbl 1.1 firmware means (`doc/markdown/interface.md` of Grbl).
//!
//! Answers are `ok` and `error:N`, one for each line sent. All else is pushed and answers nothing.

/// The machine state in a status report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum State {
    /// At rest, takes commands.
    Idle,
    /// Moving, or dwelling with moves in the buffer.
    Run,
    /// Feed hold; 0 = at rest, 1 = still slowing down.
    Hold(u8),
    /// Jogging.
    Jog,
    /// Locked until homed or unlocked.
    Alarm,
    /// Safety door; 0 = closed, can resume; 1 = open; 2 = stopping; 3 = resuming.
    Door(u8),
    /// G-code check mode: parses, does not move.
    Check,
    /// Homing.
    Home,
    /// Asleep: only a reset wakes it.
    Sleep,
}

impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hold(n) => write!(f, "Hold:{n}"),
            Self::Door(n) => write!(f, "Door:{n}"),
            other => write!(f, "{other:?}"),
        }
    }
}

impl State {
    fn parse(text: &str) -> Option<Self> {
        let (name, sub) = match text.split_once(':') {
            Some((name, sub)) => (name, Some(sub.parse::<u8>().ok()?)),
            None => (text, None),
        };
        Some(match (name, sub) {
            ("Idle", None) => Self::Idle,
            ("Run", None) => Self::Run,
            ("Hold", Some(n @ 0..=1)) => Self::Hold(n),
            ("Jog", None) => Self::Jog,
            ("Alarm", None) => Self::Alarm,
            ("Door", Some(n @ 0..=3)) => Self::Door(n),
            ("Check", None) => Self::Check,
            ("Home", None) => Self::Home,
            ("Sleep", None) => Self::Sleep,
            _ => return None,
        })
    }

    /// Whether the arm may be in motion.
    #[must_use]
    pub fn moving(self) -> bool {
        matches!(self, Self::Run | Self::Jog | Self::Home | Self::Hold(1) | Self::Door(2 | 3))
    }
}

/// A status report `<…>`.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Machine state.
    pub state: State,
    /// Machine position (`MPos`), where reported.
    pub machine: Option<[f64; 3]>,
    /// Work position (`WPos`), where reported.
    pub work: Option<[f64; 3]>,
    /// Work coordinate offset (`WCO`), sent now and then.
    pub offset: Option<[f64; 3]>,
    /// Real-time feed in units a minute and spindle speed (`FS`, or `F` alone).
    pub feed: Option<f64>,
    /// Spindle speed: the LED's brightness.
    pub spindle: Option<f64>,
    /// Free planner blocks and receive bytes (`Bf`).
    pub buffer: Option<(u32, u32)>,
    /// Feed, rapid and spindle override in percent (`Ov`).
    pub overrides: Option<[u32; 3]>,
    /// Letters of the active input pins (`Pn`), empty where none.
    pub pins: String,
    /// Letters of active accessories (`A`): S or C spindle, F or M coolant.
    pub accessories: String,
}

/// One line from the firmware.
#[derive(Clone, Debug, PartialEq)]
pub enum Line {
    /// An empty line.
    Empty,
    /// The line was taken.
    Ok,
    /// The line was refused.
    Error(u8),
    /// The firmware locked itself.
    Alarm(u8),
    /// `Grbl 1.1h ['$' for help]`: it has (re)started; the version.
    Banner(String),
    /// A status report.
    Status(Status),
    /// `$n=v`.
    Setting(u16, f64),
    /// `[TAG:text]`.
    Message {
        /// MSG, GC, G54, VER, OPT, …
        tag: String,
        /// What follows the first colon.
        text: String,
    },
    /// Nothing a Grbl 1.1 sends whole: garbled, cut, or another program.
    Garbled,
}

/// Reads one line (without its end). Never fails: what can't be read is [`Line::Garbled`].
#[must_use]
pub fn parse(line: &[u8]) -> Line {
    if line.is_empty() {
        return Line::Empty;
    }
    if !line.iter().all(|b| (0x20..0x7f).contains(b)) {
        return Line::Garbled;
    }
    let Ok(text) = std::str::from_utf8(line) else { return Line::Garbled };
    parse_text(text).unwrap_or(Line::Garbled)
}

fn parse_text(text: &str) -> Option<Line> {
    if text == "ok" {
        return Some(Line::Ok);
    }
    if let Some(code) = text.strip_prefix("error:") {
        return Some(Line::Error(whole(code)?));
    }
    if let Some(code) = text.strip_prefix("ALARM:") {
        return Some(Line::Alarm(whole(code)?));
    }
    if let Some(body) = text.strip_prefix('<').and_then(|t| t.strip_suffix('>')) {
        return status(body).map(Line::Status);
    }
    if let Some(rest) = text.strip_prefix("Grbl ") {
        let version = rest.split(' ').next().filter(|v| v.starts_with(|c: char| c.is_ascii_digit()))?;
        return rest.ends_with("['$' for help]").then(|| Line::Banner(version.into()));
    }
    if let Some(setting) = text.strip_prefix('$') {
        let (n, value) = setting.split_once('=')?;
        return Some(Line::Setting(whole(n)?, number(value)?));
    }
    let (tag, body) = text.strip_prefix('[')?.strip_suffix(']')?.split_once(':')?;
    let plain = !tag.is_empty() && tag.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit());
    plain.then(|| Line::Message { tag: tag.into(), text: body.into() })
}

/// Digits only: `str::parse` would also take a sign.
fn whole<T: std::str::FromStr>(text: &str) -> Option<T> {
    text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?
}

/// A plain decimal number; Rust's own parser would also take `inf`, `nan` and exponents.
fn number(text: &str) -> Option<f64> {
    let plain = text.bytes().all(|b| b.is_ascii_digit() || b == b'.' || b == b'-');
    plain.then(|| text.parse::<f64>().ok())?.filter(|v| v.is_finite())
}

fn triple(text: &str) -> Option<[f64; 3]> {
    let mut parts = text.split(',').map(number);
    let three = [parts.next()??, parts.next()??, parts.next()??];
    parts.next().is_none().then_some(three)
}

fn status(body: &str) -> Option<Status> {
    let mut fields = body.split('|');
    let mut s = Status {
        state: State::parse(fields.next()?)?,
        machine: None,
        work: None,
        offset: None,
        feed: None,
        spindle: None,
        buffer: None,
        overrides: None,
        pins: String::new(),
        accessories: String::new(),
    };
    for field in fields {
        let (name, value) = field.split_once(':')?;
        match name {
            "MPos" => s.machine = Some(triple(value)?),
            "WPos" => s.work = Some(triple(value)?),
            "WCO" => s.offset = Some(triple(value)?),
            "FS" => {
                let (f, speed) = value.split_once(',')?;
                (s.feed, s.spindle) = (Some(number(f)?), Some(number(speed)?));
            }
            "F" => s.feed = Some(number(value)?),
            "Bf" => {
                let (blocks, bytes) = value.split_once(',')?;
                s.buffer = Some((whole(blocks)?, whole(bytes)?));
            }
            "Ov" => {
                let mut parts = value.split(',').map(whole::<u32>);
                let three = [parts.next()??, parts.next()??, parts.next()??];
                s.overrides = parts.next().is_none().then_some(three);
                s.overrides?;
            }
            "Pn" => s.pins = letters(value)?,
            "A" => s.accessories = letters(value)?,
            "Ln" => _ = whole::<u32>(value)?,
            _ => return None,
        }
    }
    // Grbl never leaves the position out: a report without one was cut.
    (s.machine.is_some() || s.work.is_some()).then_some(s)
}

fn letters(text: &str) -> Option<String> {
    (!text.is_empty() && text.bytes().all(|b| b.is_ascii_uppercase())).then(|| text.into())
}

/// Longest line kept: Grbl's own are shorter than 128 bytes.
const LONGEST: usize = 256;

/// Cuts a byte stream into lines at `\n` or `\r\n`, wherever the pieces were split.
#[derive(Clone, Debug, Default)]
pub struct Splitter {
    partial: Vec<u8>,
    overflow: bool,
}

impl Splitter {
    /// Feeds bytes; `each` gets every whole line, without its end. A line longer than any of Grbl's is given cut,
    /// and parses as garbled.
    pub fn feed(&mut self, bytes: &[u8], mut each: impl FnMut(&[u8])) {
        for &b in bytes {
            if b == b'\n' {
                if self.partial.last() == Some(&b'\r') {
                    self.partial.pop();
                }
                if self.overflow {
                    self.partial.push(0xff); // never parses
                }
                each(&self.partial);
                self.partial.clear();
                self.overflow = false;
            } else if self.partial.len() < LONGEST {
                self.partial.push(b);
            } else {
                self.overflow = true;
            }
        }
    }

    /// Forgets a line that has begun.
    pub fn clear(&mut self) {
        self.partial.clear();
        self.overflow = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_what_stock_grbl_sends() {
        assert_eq!(parse(b"ok"), Line::Ok);
        assert_eq!(parse(b"error:9"), Line::Error(9));
        assert_eq!(parse(b"ALARM:3"), Line::Alarm(3));
        assert_eq!(parse(b"Grbl 1.1h ['$' for help]"), Line::Banner("1.1h".into()));
        assert_eq!(parse(b"$110=500.000"), Line::Setting(110, 500.0));
        let Line::Status(s) =
            parse(b"<Run|MPos:-1.000,2.500,0.000|Bf:15,128|FS:500,800|Pn:XH|WCO:0.000,0.000,0.000>")
        else {
            panic!("status")
        };
        assert_eq!((s.state, s.machine, s.spindle), (State::Run, Some([-1.0, 2.5, 0.0]), Some(800.0)));
        assert_eq!((s.buffer, s.pins.as_str(), s.offset), (Some((15, 128)), "XH", Some([0.0; 3])));
        let Line::Status(s) = parse(b"<Hold:1|WPos:0.000,0.000,0.000|FS:0,0|Ov:100,100,100|A:SF>") else {
            panic!("status")
        };
        assert_eq!((s.state, s.accessories.as_str()), (State::Hold(1), "SF"));
        assert_eq!(
            parse(b"[MSG:'$H'|'$X' to unlock]"),
            Line::Message { tag: "MSG".into(), text: "'$H'|'$X' to unlock".into() }
        );
    }

    #[test]
    fn what_is_cut_or_garbled_answers_nothing() {
        for bad in [
            &b"o"[..],
            b"okk",
            b" ok",
            b"error:",
            b"error:9x",
            b"error:256",
            b"ALARM:",
            b"<Idle|MPos:0.000,0.000",
            b"<Idle>",
            b"<Idle|MPos:0.000,0.000>",
            b"<Idle|MPos:nan,0,0>",
            b"$1",
            b"$x=3",
            b"[MSG:",
            b"Grbl",
            b"ok\xff",
            b"<Idle|MPos:1,2,3|FS:0>",
            b"error:+9",
            b"Grbl 1.1h",
            b"$110=inf",
        ] {
            assert_eq!(parse(bad), Line::Garbled, "{}", String::from_utf8_lossy(bad));
        }
    }

    proptest! {
        #[test]
        fn never_panics_and_splitting_does_not_matter(bytes in proptest::collection::vec(any::<u8>(), 0..600), cut in 0usize..600) {
            let lines = |pieces: &[&[u8]]| {
                let mut splitter = Splitter::default();
                let mut out = Vec::new();
                for piece in pieces {
                    splitter.feed(piece, |l| out.push(parse(l)));
                }
                out
            };
            let cut = cut.min(bytes.len());
            prop_assert_eq!(lines(&[&bytes]), lines(&[&bytes[..cut], &bytes[cut..]]));
        }

        #[test]
        fn a_status_survives_the_trip(x in -400.0f64..400.0, y in -100.0f64..100.0, speed in 0u32..1000) {
            let text = format!("<Run|MPos:{x:.3},{y:.3},0.000|FS:500,{speed}>");
            let Line::Status(s) = parse(text.as_bytes()) else { panic!("{text}") };
            let m = s.machine.unwrap();
            prop_assert!((m[0] - x).abs() <= 5.1e-4 && (m[1] - y).abs() <= 5.1e-4);
            prop_assert_eq!(s.spindle, Some(f64::from(speed)));
        }

        /// A cut line is never taken for another answer, but for a code that lost digits.
        #[test]
        fn a_cut_line_is_no_ok(text in "(error:[1-9][0-9]?|ALARM:[1-9]|<Idle\\|MPos:[0-9]\\.000,0\\.000,0\\.000\\|FS:0,0>|\\[MSG:Check Door\\])", cut in 0usize..40) {
            let cut = cut.min(text.len() - 1);
            prop_assert_ne!(parse(&text.as_bytes()[..cut]), Line::Ok);
            prop_assert_ne!(parse(&text.as_bytes()[text.len() - cut..]), Line::Ok);
        }
    }
}
