//! How a capture is set up: what is asked for, whether that is possible, and the capture made of it.
//!
//! The command line and the page fill in a [`Setup`]; what follows from it is the same for both. A session that goes on
//! is set up as it was begun ([`Setup::follow`]): the page takes that over, the command line refuses to say otherwise.

use super::camera::SimulatedView;
use super::capture::{Capture, CaptureError, Options};
use super::hdr::Crop;
use super::sphere::Circle;
use super::store::{Record, Resumed};
use super::thrifty::Thrifty;
use crate::arm::grbl::Link;
use crate::arm::kinematics::{Arm, Finding, Severity, check_settings};
use crate::camera::Domain;
use crate::planner::{self, Learned, PlanError, Planner};
use crate::session::Session;
use crate::stack::Mask;

/// What is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Name of the object.
    pub object: String,
    /// Planner.
    pub planner: String,
    /// Number of lights, T.
    pub lights: usize,
    /// Seed.
    pub seed: u64,
    /// Largest slant that the planner may ask for, degrees.
    pub reach: f32,
    /// By how much a light may be moved to save travel, degrees; none for not at all.
    pub nearby: Option<f32>,
    /// Camera, as the record says it: [`SimulatedView`] or a name.
    pub camera: String,
    /// Code value of black of the camera's files, where it saves some.
    pub black: Option<u16>,
    /// Code value at which they saturate; none for the largest of the file.
    pub white: Option<u16>,
    /// Whether a mirror sphere stands beside the object.
    pub ball: bool,
    /// Exposures, brightness and how the arm is handled.
    pub options: Options,
}

/// Why a capture can't be made so.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// A number out of its range.
    #[error("{name} {value}: {possible}")]
    Range {
        /// Which.
        name: &'static str,
        /// What it is.
        value: String,
        /// What is possible.
        possible: &'static str,
    },
    /// The firmware would not do what is asked.
    #[error("the firmware's settings don't fit the arm's configuration: {}", .0.join("; "))]
    Board(Vec<String>),
    /// The planner can't be had.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The session can't go on.
    #[error(transparent)]
    Capture(#[from] CaptureError),
}

/// What is worth a warning in the firmware's settings; nothing until they are read.
///
/// # Errors
/// [`SetupError::Board`] where the arm would not do what is asked.
pub fn check_board(link: &Link, arm: &Arm, brightness: f64) -> Result<Vec<Finding>, SetupError> {
    if link.settings().is_empty() {
        return Ok(Vec::new());
    }
    let found = check_settings(link.settings(), link.work_offset(), arm, brightness);
    let (errors, warnings): (Vec<_>, Vec<_>) = found.into_iter().partition(|f| f.severity == Severity::Error);
    if errors.is_empty() {
        return Ok(warnings);
    }
    Err(SetupError::Board(errors.into_iter().map(|f| f.text).collect()))
}

/// `arm` with the rates and accelerations of the board, once they are read.
#[must_use]
pub fn with_axes(arm: Arm, link: &Link) -> Arm {
    let axes = if link.settings().is_empty() { arm.axes } else { link.axis_limits() };
    Arm { axes, ..arm }
}

impl Setup {
    /// Whether these numbers are possible.
    ///
    /// # Errors
    /// [`SetupError::Range`] names the first that is not.
    pub fn check(&self) -> Result<(), SetupError> {
        let Options { exposures, settle, brightness, .. } = &self.options;
        let within = |name, value: String, right: bool, possible| match right {
            true => Ok(()),
            false => Err(SetupError::Range { name, value, possible }),
        };
        let lights = (3..=1000).contains(&self.lights);
        within("lights", self.lights.to_string(), lights, "3 to 1000")?;
        let reach = (1.0..=90.0).contains(&self.reach);
        within("reach", self.reach.to_string(), reach, "1 to 90 degrees")?;
        if let Some(nearby) = self.nearby {
            let right = (0.0..=30.0).contains(&nearby);
            within("nearby", nearby.to_string(), right, "0 to 30 degrees")?;
        }
        let possible = "one or more times above 0 and up to 60000 ms";
        within("exposures", "(none)".into(), !exposures.is_empty(), possible)?;
        for s in exposures {
            let right = *s > 0.0 && *s <= 60.0;
            within("exposures", (s * 1000.0).to_string(), right, possible)?;
        }
        within("settle", settle.to_string(), (0.0..=30.0).contains(settle), "0 to 30 s")?;
        let right = *brightness > 0.0 && *brightness <= 100_000.0;
        within("brightness", brightness.to_string(), right, "above 0 and up to 100000")
    }

    /// What the simulated camera sees, where that is the camera.
    #[must_use]
    pub fn view(&self) -> Option<SimulatedView> {
        SimulatedView::parse(&self.camera)
    }

    /// Takes over what pictures of one session have in common, as far as its record knows it.
    pub fn follow(&mut self, begun: &Record) {
        self.object.clone_from(&begun.object);
        self.planner.clone_from(&begun.planner);
        (self.lights, self.seed) = (begun.lights, begun.seed);
        self.camera.clone_from(&begun.camera);
        self.ball = begun.sphere.is_some();
        if let Some(reach) = begun.reach {
            (self.reach, self.nearby) = (reach, begun.nearby);
        }
        if begun.black.is_some() {
            (self.black, self.white) = (begun.black, begun.white);
        }
        self.options.brightness = begun.brightness.unwrap_or(self.options.brightness);
        self.options.dark = begun.dark.unwrap_or(self.options.dark);
        if let Some(shot) = begun.shots.first() {
            self.options.exposures.clone_from(&shot.exposures);
        }
    }

    /// The planner, for this arm.
    ///
    /// # Errors
    /// [`PlanError`] where there is none of that name, or not for so many lights.
    pub fn planner<'a>(
        &self,
        arm: &Arm,
        learned: Option<&'a dyn Learned>,
    ) -> Result<Box<dyn Planner + 'a>, PlanError> {
        let (lights, seed) = (self.lights, self.seed);
        let setup = planner::Setup { lights, seed, draw: 0, camera: None, truth: None, learned };
        let chosen = planner::build(&self.planner, &setup)?;
        let Some(degrees) = self.nearby else { return Ok(chosen) };
        let online = planner::info(&self.planner)?.online;
        Ok(Box::new(Thrifty::new(chosen, online, arm.clone(), degrees.to_radians())))
    }

    /// Largest slant asked for of this arm, radians.
    fn reach(&self, arm: &Arm) -> f32 {
        self.reach.min(arm.reach() as f32).to_radians()
    }

    fn session<'a>(
        &self,
        arm: &Arm,
        mask: Mask,
        learned: Option<&'a dyn Learned>,
    ) -> Result<Session<'a>, SetupError> {
        let domain = Domain::Hemisphere { reach: self.reach(arm) };
        Ok(Session::new(mask, domain, self.planner(arm, learned)?, self.lights))
    }

    /// Writes down what was asked for and who does it.
    fn note(&self, record: &mut Record, link: &Link, learned: Option<&dyn Learned>) {
        if !link.version().is_empty() {
            record.firmware = format!("Grbl {}", link.version());
        }
        record.camera.clone_from(&self.camera);
        record.model = learned.and_then(|l| l.network(&self.planner, self.reach(&record.arm)));
        record.brightness = Some(self.options.brightness);
        (record.reach, record.nearby) = (Some(self.reach), self.nearby);
        (record.black, record.white) = (self.black, self.white);
        record.dark = Some(self.options.dark);
    }

    /// A new capture with this arm, of what is inside `mask` in the part `crop` of the picture; `sphere` is the outline of
    /// the mirror sphere, where there is one.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn begin<'a>(
        &self,
        link: &Link,
        learned: Option<&'a dyn Learned>,
        arm: Arm,
        mask: Mask,
        crop: Option<Crop>,
        sphere: Option<Circle>,
    ) -> Result<Capture<'a>, SetupError> {
        self.check()?;
        let arm = with_axes(arm, link);
        let session = self.session(&arm, mask, learned)?;
        let mut record = Record::new(&self.object, &self.planner, self.seed, self.lights, arm);
        self.note(&mut record, link, learned);
        (record.crop, record.sphere) = (crop, sphere);
        Ok(Capture::new(session, record, self.options.clone()))
    }

    /// Goes on with a session. Crop, sphere and arm are those of its first light: with others the planner would not ask for
    /// the same lights again.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn go_on<'a>(
        &self,
        link: &Link,
        learned: Option<&'a dyn Learned>,
        mut resumed: Resumed,
    ) -> Result<Capture<'a>, SetupError> {
        self.check()?;
        let session = self.session(&resumed.record.arm, resumed.mask.clone(), learned)?;
        self.note(&mut resumed.record, link, learned);
        Ok(Capture::resume(session, resumed, self.options.clone())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::grbl::Phase;
    use crate::arm::kinematics::Mount;
    use crate::arm::simulated::Simulated;
    use std::time::Duration;

    fn setup() -> Setup {
        Setup {
            object: "bust".into(),
            planner: "random".into(),
            lights: 8,
            seed: 1 << 40,
            reach: 75.0,
            nearby: Some(5.0),
            camera: "folder:/cam".into(),
            black: Some(16),
            white: None,
            ball: false,
            options: Options::default(),
        }
    }

    /// The link to the guide's board after `lines` were typed there.
    fn connected(lines: &str) -> Link {
        let (mut link, mut board) = (Link::new(), Simulated::arm());
        let mut now = Duration::ZERO;
        let mut bytes = Vec::new();
        board.open(now);
        for line in lines.split_inclusive('\n') {
            now += Duration::from_secs(3);
            board.drain(now, &mut bytes);
            board.feed(now, line.as_bytes());
        }
        now += Duration::from_secs(3);
        board.drain(now, &mut bytes);
        board.open(now);
        link.opened(now);
        let end = now + Duration::from_secs(10);
        while link.phase() != &Phase::Ready {
            assert!(now < end, "{link:?}");
            now += Duration::from_millis(5);
            board.feed(now, &link.take_output());
            bytes.clear();
            board.drain(now, &mut bytes);
            link.receive(now, &bytes);
            link.tick(now);
        }
        link
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        setup().check().unwrap();
        let refused = |change: fn(&mut Setup), said: &str| {
            let mut s = setup();
            change(&mut s);
            assert_eq!(s.check().unwrap_err().to_string(), said);
        };
        refused(|s| s.lights = 2, "lights 2: 3 to 1000");
        refused(|s| s.reach = 0.5, "reach 0.5: 1 to 90 degrees");
        refused(|s| s.nearby = Some(-1.0), "nearby -1: 0 to 30 degrees");
        refused(|s| s.options.settle = f64::NAN, "settle NaN: 0 to 30 s");
        refused(|s| s.options.brightness = 0.0, "brightness 0: above 0 and up to 100000");
        let times = "one or more times above 0 and up to 60000 ms";
        refused(|s| s.options.exposures.clear(), &format!("exposures (none): {times}"));
        refused(|s| s.options.exposures = vec![1e-3, -2e-3], &format!("exposures -2: {times}"));
    }

    #[test]
    fn a_board_that_does_not_fit_is_refused_with_every_reason() {
        let arm = Arm::default();
        assert_eq!(check_board(&connected(""), &arm, 800.0).unwrap(), []);
        let clipped = check_board(&connected("$30=500\n"), &arm, 800.0).unwrap();
        assert!(matches!(&clipped[..], [f] if f.text.contains("brightness S800 is above $30=500")));
        assert!(check_board(&connected("$30=500\n"), &arm, 400.0).unwrap().is_empty());
        let link = connected("$32=1\n$130=90\n");
        let said = check_board(&link, &arm, 800.0).unwrap_err().to_string();
        assert!(said.contains("$32=1 (laser mode)") && said.contains("the soft limits leave"), "{said}");
        assert!(check_board(&Link::new(), &arm, 800.0).unwrap().is_empty(), "nothing is read yet");
    }

    #[test]
    fn a_capture_has_the_axes_of_the_board() {
        let begun = |link: &Link| {
            let mask = Mask::full(2, 2).unwrap();
            setup().begin(link, None, Arm::default(), mask, None, None).unwrap().record().clone()
        };
        let record = begun(&connected("$110=1234\n"));
        assert_eq!((record.arm.axes[0].rate, record.arm.axes[1].rate), (1234.0, 3600.0));
        assert_eq!((record.firmware.as_str(), record.camera.as_str()), ("Grbl 1.1h", "folder:/cam"));
        assert_eq!((record.brightness, record.nearby, record.black), (Some(800.0), Some(5.0), Some(16)));
        assert_eq!(begun(&Link::new()).arm, Arm::default(), "nothing is read yet");
    }

    #[test]
    fn a_session_goes_on_as_it_was_begun() {
        let link = connected("");
        let (begun, mask) = (setup(), Mask::full(2, 2).unwrap());
        let arm = Arm { mount: Mount { azimuth: 3.0, ..Mount::default() }, ..Arm::default() };
        let record =
            begun.begin(&link, None, arm.clone(), mask.clone(), None, None).unwrap().record().clone();
        let mut now = Setup { lights: 5, seed: 2, reach: 40.0, nearby: None, ..setup() };
        now.options.brightness = 100.0;
        now.follow(&record);
        assert_eq!(now, begun);
        // A board that was set differently meanwhile does not change the order of the lights.
        let resumed = Resumed { record: record.clone(), mask, seen: Vec::new(), damaged: Vec::new() };
        let slower = now.go_on(&connected("$110=1234\n"), None, resumed).unwrap();
        assert_eq!(slower.record().arm, record.arm);
        // Records from before did not say these.
        let mut old = record;
        (old.reach, old.brightness, old.dark, old.black) = (None, None, None, None);
        let mut now = Setup { reach: 40.0, nearby: None, white: Some(4095), ..setup() };
        now.follow(&old);
        assert_eq!((now.reach, now.nearby, now.white), (40.0, None, Some(4095)));
    }
}
