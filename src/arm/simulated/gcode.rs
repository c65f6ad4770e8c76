//! The firmware's G-code parser: one line to a list of actions, or the number of an error.
//!
//! Covers what Grbl 1.1h takes but for arcs (G2, G3) and probing (G38), which answer `error:20` here.

use super::settings::Settings;

/// What a line makes the firmware do, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Wait until the planner is empty and the arm rests.
    Sync,
    /// Wait this many steps of 50 ms, with real-time commands in between.
    Dwell(u32),
    /// Spindle (LED): on, and its speed.
    Spindle(bool, f64),
    /// Flood coolant (shutter).
    Coolant(bool),
    /// Queue a straight move to a machine position.
    Line { target: [f64; 3], feed: f64, rapid: bool, jog: bool },
    /// `M2`, `M30`: message and coolant, spindle off.
    ProgramEnd,
    /// `M0`: feed hold.
    Pause,
    /// `$SLP`.
    Sleep,
    /// Homing cycle.
    Home,
    /// The work offset was set: the next status report tells it.
    Offset,
    /// Time in which nothing else is done (parsing, EEPROM).
    Busy(u64),
    /// Answer the line.
    Reply(u8),
}

/// Modal state that lasts from line to line.
#[derive(Clone, Debug, PartialEq)]
pub struct Modal {
    /// G0, G1 or G80.
    pub motion: u16,
    /// G54 is 0.
    pub system: usize,
    /// G17, G18, G19.
    pub plane: u16,
    pub inches: bool,
    pub incremental: bool,
    pub inverse_time: bool,
    pub spindle: u16,
    pub flood: bool,
    pub feed: f64,
    pub speed: f64,
    pub tool: u8,
    /// End of the last move, machine coordinates.
    pub position: [f64; 3],
    pub g92: [f64; 3],
    pub tool_offset: f64,
}

impl Default for Modal {
    fn default() -> Self {
        Self {
            motion: 0,
            system: 0,
            plane: 17,
            inches: false,
            incremental: false,
            inverse_time: false,
            spindle: 5,
            flood: false,
            feed: 0.0,
            speed: 0.0,
            tool: 0,
            position: [0.0; 3],
            g92: [0.0; 3],
            tool_offset: 0.0,
        }
    }
}

impl Modal {
    /// What `$G` prints between its brackets.
    pub fn report(&self) -> String {
        format!(
            "GC:G{} G{} G{} G{} G{} G{} M{} M{} T{} F{:.0} S{:.0}",
            self.motion,
            54 + self.system,
            self.plane,
            if self.inches { 20 } else { 21 },
            90 + u16::from(self.incremental),
            if self.inverse_time { 93 } else { 94 },
            self.spindle,
            if self.flood { 8 } else { 9 },
            self.tool,
            self.feed,
            self.speed,
        )
    }
}

/// Coordinates in EEPROM.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coordinates {
    /// G54 to G59.
    pub systems: [[f64; 3]; 6],
    /// G28 and G30.
    pub stored: [[f64; 3]; 2],
}

/// Grbl's `read_float`: digits with an optional sign and point; no exponent. Advances `at`.
pub fn read_number(line: &[u8], at: &mut usize) -> Option<f64> {
    let start = *at;
    if matches!(line.get(*at), Some(b'-' | b'+')) {
        *at += 1;
    }
    let (mut digits, mut point) = (0, false);
    while let Some(&c) = line.get(*at) {
        match c {
            b'0'..=b'9' => digits += 1,
            b'.' if !point => point = true,
            _ => break,
        }
        *at += 1;
    }
    (digits > 0).then(|| std::str::from_utf8(&line[start..*at]).ok()?.trim_start_matches('+').parse().ok())?
}

const MILLIMETRES: f64 = 25.4;

/// What needs the axis words of the line.
#[derive(Clone, Copy, PartialEq)]
enum AxisCommand {
    None,
    NonModal(u32),
    Motion,
    ToolLength,
}

/// Parses and checks a line without spaces in capitals; `$J=` lines without that prefix and `jog` set.
pub fn parse(
    line: &[u8],
    jog: bool,
    modal: &mut Modal,
    coordinates: &mut Coordinates,
    settings: &Settings,
) -> Result<Vec<Action>, u8> {
    let mut m = modal.clone();
    if jog {
        m.motion = 1;
        m.inverse_time = false;
    }
    let mut groups = 0u32; // modal groups met
    let mut words = 0u32; // value words met, a bit a letter
    let mut value = [0.0f64; 26];
    let mut axis = if jog { AxisCommand::Motion } else { AxisCommand::None };
    let (mut dwell, mut non_modal, mut program) = (false, 0u32, None);
    let (mut spindle, mut coolant) = (None, None);
    let mut at = 0;
    while at < line.len() {
        let letter = line[at];
        if !letter.is_ascii_uppercase() {
            return Err(1);
        }
        at += 1;
        let number = read_number(line, &mut at).ok_or(2u8)?;
        let whole = number.trunc() as i64;
        let tenths = libm::round((number - number.trunc()) * 100.0) as i64; // Grbl's "mantissa"
        let group = match letter {
            b'G' => {
                let axis_for = |axis: &mut AxisCommand, command: AxisCommand| -> Result<(), u8> {
                    if *axis != AxisCommand::None {
                        return Err(24);
                    }
                    *axis = command;
                    Ok(())
                };
                match (whole, tenths) {
                    (10 | 28 | 30 | 92, 0) | (28 | 30 | 92, 10) => {
                        let code = (whole * 10) as u32 + u32::from(tenths == 10);
                        // G92.1 and G28.1 need no axis words.
                        if tenths != 10 {
                            axis_for(&mut axis, AxisCommand::NonModal(code))?;
                        }
                        non_modal = code;
                        0
                    }
                    (4, 0) => {
                        dwell = true;
                        0
                    }
                    (53, 0) => {
                        non_modal = 530;
                        0
                    }
                    (0 | 1, 0) => {
                        axis_for(&mut axis, AxisCommand::Motion)?;
                        m.motion = whole as u16;
                        1
                    }
                    (80, 0) => {
                        m.motion = 80;
                        1
                    }
                    (17..=19, 0) => {
                        m.plane = whole as u16;
                        2
                    }
                    (90 | 91, 0) => {
                        m.incremental = whole == 91;
                        3
                    }
                    (91, 10) => 4,
                    (93 | 94, 0) => {
                        m.inverse_time = whole == 93;
                        5
                    }
                    (20 | 21, 0) => {
                        m.inches = whole == 20;
                        6
                    }
                    (40, 0) => 7,
                    (43, 10) => {
                        axis_for(&mut axis, AxisCommand::ToolLength)?;
                        8
                    }
                    (49, 0) => {
                        m.tool_offset = 0.0;
                        8
                    }
                    (54..=59, 0) => {
                        m.system = (whole - 54) as usize;
                        12
                    }
                    (61, 0) => 13,
                    // A known command with decimals that it does not have.
                    (0 | 1 | 4 | 10 | 17..=21 | 40 | 53..=59 | 80 | 93 | 94, 1..) => return Err(23),
                    _ => return Err(20),
                }
            }
            b'M' => {
                if tenths != 0 {
                    return Err(23);
                }
                match whole {
                    0 | 1 | 2 | 30 => {
                        program = Some(whole);
                        14
                    }
                    3..=5 => {
                        spindle = Some(whole as u16);
                        17
                    }
                    8 | 9 => {
                        coolant = Some(whole == 8);
                        18
                    }
                    _ => return Err(20),
                }
            }
            _ => {
                if !b"FIJKLNPRSTXYZ".contains(&letter) {
                    return Err(20);
                }
                let bit = 1 << (letter - b'A');
                if words & bit != 0 {
                    return Err(25);
                }
                if b"FNPST".contains(&letter) && number < 0.0 {
                    return Err(4);
                }
                if letter == b'T' && number > 255.0 {
                    return Err(38);
                }
                words |= bit;
                value[usize::from(letter - b'A')] = number;
                continue;
            }
        };
        // G and M words of one group exclude each other.
        if groups & (1 << group) != 0 {
            return Err(21);
        }
        groups |= 1 << group;
        if jog && !(matches!(group, 3 | 6) || non_modal == 530 && group == 0) {
            return Err(16);
        }
    }

    let has = |letter: u8| words & (1 << (letter - b'A')) != 0;
    let get = |letter: u8| value[usize::from(letter - b'A')];
    let axes: [bool; 3] = [has(b'X'), has(b'Y'), has(b'Z')];
    let any_axis = axes.iter().any(|a| *a);
    if any_axis && axis == AxisCommand::None {
        axis = AxisCommand::Motion; // the modal motion takes them
    }
    if has(b'N') && get(b'N') > 10_000_000.0 {
        return Err(27);
    }
    let mut used = words & !((1 << (b'N' - b'A')) | (1 << (b'F' - b'A')));
    if !jog {
        used &= !((1 << (b'S' - b'A')) | (1 << (b'T' - b'A')));
    }
    let scale = if m.inches { MILLIMETRES } else { 1.0 };
    if jog && !has(b'F') {
        return Err(22);
    }
    let feed = if m.inverse_time {
        if axis == AxisCommand::Motion && m.motion == 1 && any_axis && !has(b'F') {
            return Err(22);
        }
        if has(b'F') { get(b'F') } else { 0.0 }
    } else if has(b'F') {
        get(b'F') * scale
    } else if modal.inverse_time {
        0.0
    } else {
        modal.feed
    };
    let speed = if has(b'S') { get(b'S') } else { modal.speed };
    if dwell {
        if !has(b'P') {
            return Err(28);
        }
        used &= !(1 << (b'P' - b'A'));
    }
    let origin: [f64; 3] = std::array::from_fn(|i| {
        coordinates.systems[m.system][i] + m.g92[i] + if i == 2 { m.tool_offset } else { 0.0 }
    });
    let word = |i: usize| get(b'X' + i as u8) * scale;
    // Where the axis words point to, in machine coordinates.
    let target: [f64; 3] = std::array::from_fn(|i| match (axes[i], m.incremental) {
        (false, _) => m.position[i],
        _ if axis == AxisCommand::NonModal(100) => m.position[i],
        (true, _) if non_modal == 530 => word(i),
        (true, false) => word(i) + origin[i],
        (true, true) => word(i) + m.position[i],
    });
    let mut stored = coordinates.clone();
    let mut eeprom = false;
    let mut moves: Vec<([f64; 3], bool)> = Vec::new();
    let axis_bits = (1 << 23) | (1 << 24) | (1 << 25);
    match non_modal {
        100 => {
            if !any_axis {
                return Err(26);
            }
            // As Grbl does: only where both are missing.
            if !has(b'P') && !has(b'L') {
                return Err(28);
            }
            let p = get(b'P') as usize;
            if p > 6 {
                return Err(29);
            }
            let l = get(b'L') as i64;
            if l != 2 && l != 20 {
                return Err(20);
            }
            if has(b'R') {
                return Err(20);
            }
            let system = if p == 0 { m.system } else { p - 1 };
            for i in (0..3).filter(|&i| axes[i]) {
                stored.systems[system][i] =
                    if l == 20 { m.position[i] - m.g92[i] - word(i) } else { word(i) };
            }
            eeprom = true;
            used &= !(axis_bits | (1 << (b'P' - b'A')) | (1 << (b'L' - b'A')));
        }
        920 => {
            if !any_axis {
                return Err(26);
            }
            for i in (0..3).filter(|&i| axes[i]) {
                m.g92[i] = m.position[i] - coordinates.systems[m.system][i] - word(i);
            }
            used &= !axis_bits;
        }
        921 => m.g92 = [0.0; 3],
        280 | 300 => {
            let home = coordinates.stored[usize::from(non_modal == 300)];
            if any_axis {
                moves.push((target, true));
            }
            let end = std::array::from_fn(|i| if !any_axis || axes[i] { home[i] } else { m.position[i] });
            moves.push((end, true));
            used &= !axis_bits;
        }
        281 | 301 => {
            stored.stored[usize::from(non_modal == 301)] = m.position;
            eeprom = true;
        }
        530 if m.motion > 1 => return Err(30),
        _ => {}
    }
    if axis == AxisCommand::ToolLength {
        if axes[0] || axes[1] || !axes[2] {
            return Err(37);
        }
        m.tool_offset = word(2);
        used &= !axis_bits;
    }
    if axis == AxisCommand::Motion {
        match m.motion {
            80 if any_axis => return Err(31),
            80 => {}
            0 => {
                if any_axis {
                    moves.push((target, true));
                }
            }
            _ => {
                if feed == 0.0 {
                    return Err(22);
                }
                if any_axis {
                    moves.push((target, false));
                }
            }
        }
        used &= !axis_bits;
    }
    if used != 0 {
        return Err(36);
    }
    if jog {
        // A jog leaves the parser state as it was, but for the position. Without axes Grbl goes to machine zero.
        let target = if any_axis { target } else { [0.0; 3] };
        if settings.on(20) && !within_travel(target, settings) {
            return Err(15);
        }
        modal.position = target;
        return Ok(vec![Action::Line { target, feed, rapid: false, jog: true }, Action::Reply(0)]);
    }

    let mut actions = Vec::new();
    m.feed = feed;
    let speed_changed = speed != m.speed;
    m.speed = speed;
    if has(b'T') {
        m.tool = get(b'T') as u8;
    }
    if speed_changed && spindle.is_none() && m.spindle != 5 {
        actions.extend([Action::Sync, Action::Spindle(true, speed)]);
    }
    if let Some(code) = spindle
        && (code != m.spindle || speed_changed)
    {
        m.spindle = code;
        actions.extend([Action::Sync, Action::Spindle(code != 5, speed)]);
    }
    if let Some(on) = coolant
        && on != m.flood
    {
        m.flood = on;
        actions.extend([Action::Sync, Action::Coolant(on)]);
    }
    if dwell {
        actions.extend([Action::Sync, Action::Dwell(libm::ceil(get(b'P') * 20.0 - 1e-6).max(0.0) as u32)]);
    }
    if eeprom {
        // Grbl waits for the end of motion before it writes to EEPROM (3.3 ms a byte, 13 bytes).
        actions.extend([Action::Sync, Action::Busy(13 * 3300)]);
    }
    let tool_length = axis == AxisCommand::ToolLength && m.tool_offset != modal.tool_offset;
    if matches!(non_modal, 100 | 920 | 921) || m.system != modal.system || tool_length {
        actions.extend([Action::Sync, Action::Offset]);
    }
    for (target, rapid) in moves {
        actions.push(Action::Line { target, feed, rapid, jog: false });
        m.position = target;
    }
    match program {
        Some(0) => actions.extend([Action::Sync, Action::Pause]),
        Some(2 | 30) => {
            actions.extend([Action::Sync, Action::ProgramEnd]);
            m = Modal {
                position: m.position,
                g92: m.g92,
                tool_offset: m.tool_offset,
                tool: m.tool,
                feed: m.feed,
                speed: m.speed,
                motion: 1,
                ..Modal::default()
            };
        }
        _ => {}
    }
    actions.push(Action::Reply(0));
    *modal = m;
    *coordinates = stored;
    Ok(actions)
}

/// Whether a machine position lies in the travel of the axes: machine space is negative.
pub fn within_travel(p: [f64; 3], settings: &Settings) -> bool {
    let travel = settings.axes(130);
    (0..3).all(|i| p[i] <= 0.0 && p[i] >= -travel[i])
}
