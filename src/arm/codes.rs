//! The numbers of Grbl 1.1 in words, with what to do (Grbl: `doc/csv/*_codes_en_US.csv`).

/// What `error:N` means.
#[must_use]
pub fn error(code: u8) -> &'static str {
    match code {
        1 => "a G-code word must begin with a letter",
        2 => "a number is missing or malformed",
        3 => "the '$' command is not known",
        4 => "a value that must be positive is negative",
        5 => "homing is off: set $22=1",
        6 => "the step pulse must be at least 3 µs ($0)",
        7 => "the settings in EEPROM could not be read and were replaced by defaults",
        8 => "not possible while the arm moves: wait until it is idle",
        9 => "locked while in alarm or jogging: home ($H) or unlock ($X) first",
        10 => "soft limits need homing: set $22=1 before $20=1",
        11 => "the line is too long",
        12 => "the setting asks for more than 30000 steps a second: lower $100/$101 or $110/$111",
        13 => "the safety door is open: close it and resume",
        14 => "the line is too long for EEPROM",
        15 => "the jog would leave the travel of the axis ($130/$131)",
        16 => "a jog needs '=' and holds motion words only",
        17 => "laser mode needs a PWM spindle output",
        20 => "a G-code word is not supported",
        21 => "two G-codes of one modal group in a line",
        22 => "no feed rate is set",
        23 => "a G-code word needs a whole number",
        24 => "two commands of the line need the axis words",
        25 => "a G-code word is repeated in the line",
        26 => "the command needs axis words and there are none",
        27 => "the line number is out of range",
        28 => "the command lacks a P or L value",
        29 => "the work coordinate system is not supported (G54 to G59)",
        30 => "G53 goes with G0 and G1 only",
        31 => "axis words without a command that uses them",
        32 => "an arc needs axis words of its plane",
        33 => "the motion target is invalid",
        34 => "the arc's radius does not fit",
        35 => "an arc needs its centre",
        36 => "unused words in the line",
        37 => "a tool length offset is possible on its configured axis only",
        38 => "the tool number is too high",
        _ => "an error this program does not know",
    }
}

/// What `ALARM:N` means, and what to do.
#[must_use]
pub fn alarm(code: u8) -> &'static str {
    match code {
        1 => {
            "a limit switch was hit: the position is lost. Free the arm by hand with the power off, reset, then home"
        }
        2 => {
            "the target is outside the soft limits: the arm did not start. Reset, then unlock; the position is kept"
        }
        3 => "reset while moving: the position is lost. Home before the next move",
        4 => "the probe was not in its expected state. Reset, then unlock",
        5 => "the probe met nothing. Reset, then unlock",
        6 => "homing was interrupted by a reset. Home again",
        7 => "homing was interrupted by the safety door. Close it and home again",
        8 => "homing: the switch stayed closed after the pull-off. Check the switch, raise $27, home again",
        9 => {
            "homing: no switch was met. Check wiring and direction ($23) and the travel ($130 to $132); stock Grbl homes Z too"
        }
        _ => "an alarm this program does not know. Reset, then home",
    }
}

/// Whether the firmware does not know where the arm is after this alarm.
#[must_use]
pub fn loses_position(alarm: u8) -> bool {
    !matches!(alarm, 2 | 4 | 5)
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_code_of_the_firmware_has_words() {
        for code in (1..=38).filter(|c| !(18..=19).contains(c)) {
            assert!(!super::error(code).contains("does not know"), "error:{code}");
        }
        for code in 1..=9 {
            assert!(!super::alarm(code).contains("does not know"), "ALARM:{code}");
        }
    }
}
