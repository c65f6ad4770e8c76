//! Light direction ↔ joint angles: two solutions, limits, the keep-out cone, the way between two lights.
//!
//! Both axes pass through the object. With azimuth α and slant σ (degrees) the light stands at
//! `R·(sin σ cos α, sin σ sin α, cos σ)`; `R` is the small tilt of the azimuth axis against the optical axis.
//! (α, σ) and (α + 180°, −σ) are the same direction.

use super::Joints;
use super::motion::{AxisLimits, Move};
use crate::light;
use glam::{DMat3, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Where the arm may go, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Smallest and largest azimuth.
    pub azimuth: [f64; 2],
    /// Smallest and largest slant.
    pub slant: [f64; 2],
    /// Half-angle of the cone around the camera that the light must stay out of.
    pub keep_out: f64,
    /// Whether the arm may swing through the cone on its way (nothing to hit there, it only blocks the view).
    pub may_cross: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self { azimuth: [-180.0, 180.0], slant: [-85.0, 85.0], keep_out: 8.0, may_cross: false }
    }
}

/// How the arm stands against the camera, from calibration; all zero for a perfect build. Degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mount {
    /// True azimuth when the azimuth joint says 0.
    pub azimuth: f64,
    /// True slant when the slant joint says 0.
    pub slant: f64,
    /// Tilt of the azimuth axis about x and y.
    pub tilt: [f64; 2],
}

impl Mount {
    fn rotation(&self) -> DMat3 {
        // By libm, because glam's rotations use the platform's sine.
        let [(sx, cx), (sy, cy)] = self.tilt.map(|t| libm::sincos(t.to_radians()));
        let about_x = DMat3::from_cols(DVec3::X, DVec3::new(0.0, cx, sx), DVec3::new(0.0, -sx, cx));
        let about_y = DMat3::from_cols(DVec3::new(cy, 0.0, -sy), DVec3::Y, DVec3::new(sy, 0.0, cy));
        about_x * about_y
    }

    /// Unit direction of the light at these joint angles.
    #[must_use]
    pub fn direction(&self, joints: Joints) -> Vec3 {
        let (a, s) = ((joints.azimuth + self.azimuth).to_radians(), (joints.slant + self.slant).to_radians());
        let d = DVec3::new(libm::sin(s) * libm::cos(a), libm::sin(s) * libm::sin(a), libm::cos(s));
        (self.rotation() * d).as_vec3()
    }

    /// Joint angles of a direction: the solution with a positive slant (before the zero is taken off), azimuth in (−180°, 180°].
    #[must_use]
    pub fn joints(&self, direction: Vec3) -> Joints {
        let d = self.rotation().transpose() * direction.as_dvec3();
        let slant = libm::atan2(d.truncate().length(), d.z).to_degrees();
        let azimuth = libm::atan2(d.y, d.x).to_degrees();
        Joints { azimuth: azimuth - self.azimuth, slant: slant - self.slant }
    }
}

/// The arm of a rig: where it may go, how it stands, how fast it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Arm {
    /// Where it may go.
    pub limits: Limits,
    /// How it stands.
    pub mount: Mount,
    /// Rate and acceleration of azimuth and slant; the firmware's settings replace them.
    pub axes: [AxisLimits; 2],
    /// Feed of a move, degrees a minute along the path.
    pub feed: f64,
}

impl Default for Arm {
    /// The arm of the integration guide.
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            mount: Mount::default(),
            axes: [
                AxisLimits { rate: 5400.0, acceleration: 180.0 },
                AxisLimits { rate: 3600.0, acceleration: 120.0 },
            ],
            feed: 5400.0,
        }
    }
}

/// Why a configuration can't be an arm's.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ArmError {
    /// Not a number to count with.
    #[error("{field} is {value}: a finite number is needed")]
    NotFinite {
        /// Where.
        field: &'static str,
        /// What it is.
        value: f64,
    },
    /// A range that holds nothing.
    #[error("{field} is [{low}, {high}]: write the smaller one first")]
    Order {
        /// Which.
        field: &'static str,
        /// Its first number.
        low: f64,
        /// Its second number.
        high: f64,
    },
    /// A rate, acceleration or feed with which nothing moves.
    #[error("{field} is {value}: it must be above 0")]
    NotPositive {
        /// Which.
        field: &'static str,
        /// What it is.
        value: f64,
    },
    /// A cone that is none.
    #[error("limits.keep_out is {0}°: 0 to 90 is possible")]
    KeepOut(f64),
}

/// How a direction is reached.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// What was asked for.
    pub requested: Vec3,
    /// Where the light will be: the nearest reachable direction.
    pub commanded: Vec3,
    /// Joint angles of that.
    pub joints: Joints,
    /// Angle between the two, degrees; 0 where the direction is reachable.
    pub projected: f64,
    /// Time of the move, seconds.
    pub seconds: f64,
}

/// Angle by which rounding alone may part a reachable direction from its plan, degrees.
const ROUNDING: f64 = 1e-3;

impl Arm {
    /// Whether a plan can be made with these numbers: of what was read from a file, ask first.
    ///
    /// # Errors
    /// [`ArmError`] names the field.
    pub fn check(&self) -> Result<(), ArmError> {
        let Self { limits, mount, axes: [azimuth, slant], feed } = self;
        let finite =
            |field, value: f64| value.is_finite().then_some(()).ok_or(ArmError::NotFinite { field, value });
        for (field, [low, high]) in [("limits.azimuth", limits.azimuth), ("limits.slant", limits.slant)] {
            finite(field, low)?;
            finite(field, high)?;
            if low > high {
                return Err(ArmError::Order { field, low, high });
            }
        }
        if !(0.0..=90.0).contains(&limits.keep_out) {
            return Err(ArmError::KeepOut(limits.keep_out));
        }
        finite("mount.azimuth", mount.azimuth)?;
        finite("mount.slant", mount.slant)?;
        finite("mount.tilt", mount.tilt[0])?;
        finite("mount.tilt", mount.tilt[1])?;
        for (field, value) in [
            ("the rate of axes[0] (azimuth)", azimuth.rate),
            ("the acceleration of axes[0] (azimuth)", azimuth.acceleration),
            ("the rate of axes[1] (slant)", slant.rate),
            ("the acceleration of axes[1] (slant)", slant.acceleration),
            ("feed", *feed),
        ] {
            finite(field, value)?;
            if value <= 0.0 {
                return Err(ArmError::NotPositive { field, value });
            }
        }
        Ok(())
    }

    /// Seconds from one pose to another.
    #[must_use]
    pub fn travel(&self, from: Joints, to: Joints) -> f64 {
        Move::new([to.azimuth - from.azimuth, to.slant - from.slant], self.axes, self.feed).seconds()
    }

    /// Direction of the light at these joint angles.
    #[must_use]
    pub fn direction(&self, joints: Joints) -> Vec3 {
        self.mount.direction(joints)
    }

    /// Largest slant of the light that the slant joint leaves, to whichever side, degrees; not counting the tilt of the
    /// azimuth axis.
    #[must_use]
    pub fn reach(&self) -> f64 {
        let [low, high] = self.limits.slant.map(|slant| (slant + self.mount.slant).abs());
        low.max(high).min(90.0)
    }

    /// Whether joint angles lie within the limits and outside the cone.
    #[must_use]
    pub fn allows(&self, joints: Joints) -> bool {
        let within = |v: f64, [low, high]: [f64; 2]| v >= low - 1e-9 && v <= high + 1e-9;
        within(joints.azimuth, self.limits.azimuth)
            && within(joints.slant, self.limits.slant)
            && f64::from(light::slant(self.direction(joints))).to_degrees() >= self.limits.keep_out - ROUNDING
    }

    /// Both solutions of a direction with their full turns, whether reachable or not.
    #[must_use]
    pub fn solutions(&self, direction: Vec3, from: Joints) -> Vec<Joints> {
        let first = self.mount.joints(direction);
        // The mirrored one: true slant −σ, true azimuth + 180°.
        let mirrored = Joints {
            azimuth: first.azimuth + 180.0,
            slant: -(first.slant + self.mount.slant) - self.mount.slant,
        };
        let mut all = Vec::with_capacity(8);
        for s in [first, mirrored] {
            for turn in [-2.0, -1.0, 0.0, 1.0, 2.0] {
                all.push(Joints { azimuth: s.azimuth + 360.0 * turn, slant: s.slant });
            }
        }
        // Straight above, every azimuth is as good: stay.
        if first.slant + self.mount.slant < 1e-4 {
            all.push(Joints { azimuth: from.azimuth, slant: -self.mount.slant });
        }
        all
    }

    /// Whether the straight way between two poses keeps out of the cone.
    fn keeps_out(&self, from: Joints, to: Joints) -> bool {
        self.limits.may_cross
            || self.limits.keep_out <= 0.0
            // Poses inside the cone (after homing, say) may leave it either way.
            || (from.slant + self.mount.slant).abs() < self.limits.keep_out
            || (from.slant + self.mount.slant) * (to.slant + self.mount.slant) >= 0.0
    }

    /// Where to go for `direction` from `from`: the reachable solution; of two, the one with the shorter travel; of
    /// none, the nearest reachable direction.
    #[must_use]
    pub fn plan(&self, direction: Vec3, from: Joints) -> Plan {
        let made = |joints: Joints| {
            let commanded = self.direction(joints);
            let angle = f64::from(light::angle(direction, commanded)).to_degrees();
            let projected = if angle < ROUNDING { 0.0 } else { angle };
            Plan { requested: direction, commanded, joints, projected, seconds: self.travel(from, joints) }
        };
        let exact = self
            .solutions(direction, from)
            .into_iter()
            .filter(|j| self.allows(*j) && self.keeps_out(from, *j))
            .map(made)
            .min_by(|a, b| a.seconds.total_cmp(&b.seconds));
        exact.unwrap_or_else(|| self.project(direction, from, made))
    }

    /// The nearest reachable direction: on the borders of the joint ranges and on the cone. Of equally near ones the
    /// shorter travel.
    fn project(&self, direction: Vec3, from: Joints, made: impl Fn(Joints) -> Plan) -> Plan {
        let Limits { azimuth: [a0, a1], slant: [s0, s1], keep_out, .. } = self.limits;
        let mut candidates = Vec::new();
        for j in self.solutions(direction, from) {
            for azimuth in [j.azimuth.clamp(a0, a1), a0, a1] {
                // Best slant on this meridian: stationary point of the angle, found where tan σ = tan σ₀·cos Δα.
                let sigma = (j.slant + self.mount.slant).to_radians();
                let turn = (azimuth - j.azimuth).to_radians();
                let best = libm::atan2(libm::sin(sigma) * libm::cos(turn), libm::cos(sigma)).to_degrees();
                let base = (best - self.mount.slant).clamp(s0, s1);
                // The cone is about the camera, a tilted arm's slant is not: search its border on either side.
                let edge = |sign: f64| {
                    let mut slant = sign * keep_out - self.mount.slant;
                    for _ in 0..60 {
                        let at = Joints { azimuth, slant };
                        let short = keep_out - f64::from(light::slant(self.direction(at))).to_degrees();
                        if short.abs() < ROUNDING / 4.0 {
                            break;
                        }
                        slant += sign * short;
                    }
                    slant.clamp(s0, s1)
                };
                candidates.extend([base, edge(1.0), edge(-1.0)].map(|slant| Joints { azimuth, slant }));
            }
        }
        let better = |a: &Plan, b: &Plan| {
            let near = (a.projected - b.projected).abs() < ROUNDING;
            if near { a.seconds.total_cmp(&b.seconds) } else { a.projected.total_cmp(&b.projected) }
        };
        candidates
            .into_iter()
            .filter(|j| self.allows(*j) && self.keeps_out(from, *j))
            .map(&made)
            .min_by(better)
            // Limits that leave nothing: stay.
            .unwrap_or_else(|| made(from))
    }

    /// Seconds to bring the light from one pose to a direction: what a move costs.
    #[must_use]
    pub fn cost(&self, from: Joints, direction: Vec3) -> f64 {
        self.plan(direction, from).seconds
    }
}

/// How serious a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// The rig would not do what is asked.
    Error,
    /// It works, but not as well as it could.
    Warning,
}

/// Something about the firmware's settings.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// How serious.
    pub severity: Severity,
    /// What, and what would be right.
    pub text: String,
}

/// Checks the firmware's settings (`$$`) and work offset against the arm's configuration and the LED's brightness.
#[must_use]
pub fn check_settings(
    settings: &BTreeMap<u16, f64>,
    work_offset: Option<[f64; 3]>,
    arm: &Arm,
    brightness: f64,
) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut say = |severity, text: String| found.push(Finding { severity, text });
    let get = |n: u16| settings.get(&n).copied();
    let on = |n: u16| get(n).is_some_and(|v| v != 0.0);
    if on(13) {
        say(Severity::Error, "$13=1 reports inches: set $13=0, the arm counts in degrees".into());
    }
    if on(32) {
        say(Severity::Error, "$32=1 (laser mode) switches the LED off at rest: set $32=0".into());
    }
    if !on(22) {
        say(
            Severity::Warning,
            "$22=0: no homing, angles count from where the arm stood when it was switched on".into(),
        );
    }
    if !on(20) {
        say(
            Severity::Warning,
            "$20=0: no soft limits, only this program keeps the arm inside its range".into(),
        );
    }
    if get(1).is_some_and(|v| v != 255.0) {
        say(
            Severity::Warning,
            "$1 is not 255: the motors let go at rest and the arm may sag; set $1=255".into(),
        );
    }
    for (i, (name, range)) in
        [("azimuth", arm.limits.azimuth), ("slant", arm.limits.slant)].into_iter().enumerate()
    {
        let n = i as u16;
        if let Some(steps) = get(100 + n).filter(|s| *s < 5.0) {
            say(
                Severity::Warning,
                format!("${}={steps}: {name} moves in steps of {:.2}°", 100 + n, 1.0 / steps),
            );
        }
        if let Some(rate) = get(110 + n).filter(|r| *r < arm.axes[i].rate * 0.999) {
            say(
                Severity::Warning,
                format!(
                    "${}={rate}: {name} is slower than the {} °/min of the configuration",
                    110 + n,
                    arm.axes[i].rate
                ),
            );
        }
        if on(20)
            && let (Some(travel), Some(offset)) = (get(130 + n), work_offset)
        {
            // Machine space runs from −travel to 0.
            let (low, high) = (-travel - offset[i], -offset[i]);
            if range[0] < low - 0.01 || range[1] > high + 0.01 {
                say(
                    Severity::Error,
                    format!(
                        "{name} {}° to {}° is configured, but the soft limits leave {low:.1}° to {high:.1}°: \
                         raise ${} or set the work offset (G10 L2 P1)",
                        range[0],
                        range[1],
                        130 + n
                    ),
                );
            }
        }
    }
    if get(30).is_some_and(|full| full < brightness) {
        say(
            Severity::Warning,
            format!("brightness S{brightness} is above $30={}: it is clipped", get(30).unwrap_or(0.0)),
        );
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    const FROM: Joints = Joints { azimuth: 0.0, slant: 20.0 };

    #[test]
    fn both_solutions_point_where_they_should() {
        let mount = Mount { azimuth: 3.0, slant: -1.5, tilt: [0.8, -0.6] };
        let arm = Arm { mount, ..Arm::default() };
        for d in light::fibonacci_hemisphere(300) {
            for j in arm.solutions(d, FROM) {
                assert!(light::angle(arm.direction(j), d) < 1e-5, "{d} {j:?}");
            }
        }
    }

    #[test]
    fn takes_the_shorter_way_of_two() {
        let arm = Arm { limits: Limits { keep_out: 0.0, ..Limits::default() }, ..Arm::default() };
        let opposite = light::from_azimuth_slant(std::f32::consts::PI, 0.3);
        let plan = arm.plan(opposite, FROM);
        // A few degrees over the top instead of half a turn.
        assert!(plan.joints.slant < 0.0 && plan.joints.azimuth.abs() < 0.01 && plan.projected == 0.0);
        // With the camera in the way it goes round.
        let plan = Arm::default().plan(opposite, FROM);
        assert!(plan.joints.slant > 0.0 && (plan.joints.azimuth.abs() - 180.0).abs() < 0.01);
    }

    #[test]
    fn the_reach_is_that_of_the_longer_side() {
        for (slant, zero, reach) in [
            ([-80.0, 0.0], 0.0, 80.0),
            ([0.0, 70.0], 0.0, 70.0),
            ([-80.0, 20.0], -3.0, 83.0),
            ([-20.0, 80.0], -3.0, 77.0),
            ([-95.0, 85.0], 0.0, 90.0),
        ] {
            let limits = Limits { slant, keep_out: 0.0, ..Limits::default() };
            let arm = Arm { limits, mount: Mount { slant: zero, ..Mount::default() }, ..Arm::default() };
            assert_eq!(arm.reach(), reach);
            for azimuth in [-150.0f32, -20.0, 0.0, 75.0, 180.0] {
                let projected = |slant: f64| {
                    let d = light::from_azimuth_slant(azimuth.to_radians(), slant.to_radians() as f32);
                    arm.plan(d, FROM).projected
                };
                assert_eq!(projected(reach - 0.1), 0.0, "{arm:?}, azimuth {azimuth}°");
                assert!(reach == 90.0 || projected(reach + 1.0) > 0.9, "{arm:?}, azimuth {azimuth}°");
            }
        }
    }

    #[test]
    fn every_plan_is_allowed_and_projection_is_nearest() {
        let mut rng = Rng::new(1);
        let narrow = Limits { azimuth: [-60.0, 100.0], slant: [5.0, 70.0], keep_out: 12.0, may_cross: false };
        for (limits, mount) in [
            (Limits::default(), Mount::default()),
            (narrow, Mount::default()),
            (narrow, Mount { azimuth: 4.0, slant: 1.0, tilt: [1.0, -0.5] }),
        ] {
            let arm = Arm { limits, mount, ..Arm::default() };
            // A fine grid of poses stands for all that is reachable.
            let mut reachable = Vec::new();
            for a in 0..=240 {
                for s in 0..=120 {
                    let azimuth =
                        limits.azimuth[0] + (limits.azimuth[1] - limits.azimuth[0]) * f64::from(a) / 240.0;
                    let slant = limits.slant[0] + (limits.slant[1] - limits.slant[0]) * f64::from(s) / 120.0;
                    let j = Joints { azimuth, slant };
                    if arm.allows(j) && slant > 0.0 {
                        reachable.push(arm.direction(j));
                    }
                }
            }
            for _ in 0..300 {
                let d = rng.direction(std::f32::consts::FRAC_PI_2);
                let plan = arm.plan(d, FROM);
                assert!(arm.allows(plan.joints), "{plan:?}");
                let nearest = reachable.iter().map(|r| light::angle(*r, d)).fold(f32::MAX, f32::min);
                let excess = plan.projected - f64::from(nearest).to_degrees();
                assert!(
                    excess < 0.35,
                    "{d}: {} against {} of the grid",
                    plan.projected,
                    nearest.to_degrees()
                );
            }
        }
    }

    #[test]
    fn a_configuration_is_read_back_and_a_wrong_one_is_told() {
        let read = |text: &str| serde_json::from_str::<Arm>(text);
        let arm = Arm { mount: Mount { azimuth: 1.5, slant: -0.5, tilt: [0.1, 0.2] }, ..Arm::default() };
        assert_eq!(read(&serde_json::to_string(&arm).unwrap()).unwrap(), arm);
        assert_eq!(read("{}").unwrap(), Arm::default());
        assert_eq!(Arm::default().check(), Ok(()));
        for (text, says) in [
            (r#"{"fead": 3000}"#, "fead"),
            (r#"{"mount": {"azimuth": 1, "slant": 0, "tilt": [0, 0], "roll": 1}}"#, "roll"),
            (
                r#"{"axes": [{"rate": 1, "acceleration": 1, "jerk": 1}, {"rate": 1, "acceleration": 1}]}"#,
                "jerk",
            ),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
        let limits = Limits::default();
        let wrong = [
            (Arm { limits: Limits { azimuth: [180.0, -180.0], ..limits }, ..arm.clone() }, "limits.azimuth"),
            (Arm { limits: Limits { slant: [f64::NAN, 1.0], ..limits }, ..arm.clone() }, "limits.slant"),
            (Arm { limits: Limits { keep_out: -1.0, ..limits }, ..arm.clone() }, "limits.keep_out"),
            (Arm { feed: 0.0, ..arm.clone() }, "feed is 0"),
            (Arm { axes: [AxisLimits { rate: -1.0, acceleration: 1.0 }; 2], ..arm.clone() }, "axes[0]"),
        ];
        for (arm, says) in wrong {
            let error = arm.check().unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn settings_are_checked_in_words() {
        let mut settings: BTreeMap<u16, f64> = [
            (13, 0.0),
            (20, 1.0),
            (22, 1.0),
            (1, 255.0),
            (30, 1000.0),
            (32, 0.0),
            (100, 88.889),
            (101, 88.889),
        ]
        .into();
        settings.extend([(110, 5400.0), (111, 3600.0), (130, 370.0), (131, 200.0)]);
        let offset = Some([-185.0, -100.0, 0.0]);
        assert_eq!(check_settings(&settings, offset, &Arm::default(), 800.0), []);
        settings.extend([(131, 90.0), (32, 1.0), (30, 255.0)]);
        let found = check_settings(&settings, offset, &Arm::default(), 800.0);
        assert_eq!(found.iter().filter(|f| f.severity == Severity::Error).count(), 2);
        assert!(
            found.iter().any(|f| f.text.contains("$131")) && found.iter().any(|f| f.text.contains("S800"))
        );
    }
}
