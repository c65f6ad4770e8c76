//! Numbers that carry their gradient: the same shading and shape code gives values and exact derivatives.

use glam::Vec3;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// What a formula needs of a number: `f32` for values, [`Dual`] for values with gradients.
///
/// Transcendental functions come from `libm`, so results are the same on every platform.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Mul<f32, Output = Self>
    + Add<f32, Output = Self>
    + Sub<f32, Output = Self>
{
    /// A constant.
    fn of(value: f32) -> Self;
    /// A number with a gradient, which `f32` drops.
    fn with_gradient(value: f32, gradient: Vec3) -> Self;
    /// The number without its gradient.
    fn value(self) -> f32;
    /// Square root; gradient 0 at 0.
    fn sqrt(self) -> Self;
    /// `self^exponent` for a positive number.
    fn powf(self, exponent: f32) -> Self;
    /// Sine and cosine.
    fn sin_cos(self) -> (Self, Self);

    /// Angle of the point (x = `x`, y = `self`), radians in (−π, π]; gradient 0 at the origin.
    fn atan2(self, x: Self) -> Self;

    /// The smaller of two.
    #[inline]
    fn min(self, other: Self) -> Self {
        if other.value() < self.value() { other } else { self }
    }
    /// The larger of two.
    #[inline]
    fn max(self, other: Self) -> Self {
        if other.value() > self.value() { other } else { self }
    }
    /// Absolute value.
    #[inline]
    fn abs(self) -> Self {
        if self.value() < 0.0 { -self } else { self }
    }
    /// Limited to `low..=high`; gradient 0 outside.
    #[inline]
    fn clamp(self, low: f32, high: f32) -> Self {
        self.max(Self::of(low)).min(Self::of(high))
    }
}

impl Real for f32 {
    #[inline]
    fn of(value: f32) -> Self {
        value
    }
    #[inline]
    fn with_gradient(value: f32, _: Vec3) -> Self {
        value
    }
    #[inline]
    fn value(self) -> f32 {
        self
    }
    #[inline]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline]
    fn powf(self, exponent: f32) -> Self {
        libm::powf(self, exponent)
    }
    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        libm::sincosf(self)
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        libm::atan2f(self, x)
    }
}

/// A value and its gradient with respect to three inputs (a light direction, a point).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    /// The value.
    pub value: f32,
    /// Its gradient.
    pub gradient: Vec3,
}

impl Dual {
    /// The three coordinates of `v` as the inputs to differentiate by.
    #[must_use]
    pub fn inputs(v: Vec3) -> V3<Self> {
        let input = |value, gradient| Self { value, gradient };
        V3 { x: input(v.x, Vec3::X), y: input(v.y, Vec3::Y), z: input(v.z, Vec3::Z) }
    }
}

impl Real for Dual {
    #[inline]
    fn of(value: f32) -> Self {
        Self { value, gradient: Vec3::ZERO }
    }
    #[inline]
    fn with_gradient(value: f32, gradient: Vec3) -> Self {
        Self { value, gradient }
    }
    #[inline]
    fn value(self) -> f32 {
        self.value
    }
    #[inline]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        let slope = if root > 0.0 { 0.5 / root } else { 0.0 };
        Self { value: root, gradient: self.gradient * slope }
    }
    #[inline]
    fn powf(self, exponent: f32) -> Self {
        let value = libm::powf(self.value, exponent);
        Self { value, gradient: self.gradient * (exponent * value / self.value) }
    }
    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        let (s, c) = libm::sincosf(self.value);
        (Self { value: s, gradient: self.gradient * c }, Self { value: c, gradient: self.gradient * -s })
    }
    #[inline]
    fn atan2(self, x: Self) -> Self {
        let r2 = (self.value * self.value + x.value * x.value).max(1e-20);
        let gradient = (self.gradient * x.value - x.gradient * self.value) / r2;
        Self { value: libm::atan2f(self.value, x.value), gradient }
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self { value: self.value + o.value, gradient: self.gradient + o.gradient }
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self { value: self.value - o.value, gradient: self.gradient - o.gradient }
    }
}

impl Mul for Dual {
    type Output = Self;
    #[inline]
    fn mul(self, o: Self) -> Self {
        Self { value: self.value * o.value, gradient: self.gradient * o.value + o.gradient * self.value }
    }
}

impl Div for Dual {
    type Output = Self;
    #[inline]
    fn div(self, o: Self) -> Self {
        let value = self.value / o.value;
        Self { value, gradient: (self.gradient - o.gradient * value) / o.value }
    }
}

impl Neg for Dual {
    type Output = Self;
    #[inline]
    fn neg(self) -> Self {
        Self { value: -self.value, gradient: -self.gradient }
    }
}

impl Mul<f32> for Dual {
    type Output = Self;
    #[inline]
    fn mul(self, s: f32) -> Self {
        Self { value: self.value * s, gradient: self.gradient * s }
    }
}

impl Add<f32> for Dual {
    type Output = Self;
    #[inline]
    fn add(self, s: f32) -> Self {
        Self { value: self.value + s, ..self }
    }
}

impl Sub<f32> for Dual {
    type Output = Self;
    #[inline]
    fn sub(self, s: f32) -> Self {
        Self { value: self.value - s, ..self }
    }
}

/// Three numbers: a point or direction.
#[derive(Clone, Copy, Debug)]
pub struct V3<R> {
    /// To the right.
    pub x: R,
    /// Up.
    pub y: R,
    /// Towards the camera.
    pub z: R,
}

impl<R: Real> V3<R> {
    /// A constant vector.
    #[inline]
    pub fn of(v: Vec3) -> Self {
        Self { x: R::of(v.x), y: R::of(v.y), z: R::of(v.z) }
    }
    /// The vector without its gradient.
    #[inline]
    pub fn value(self) -> Vec3 {
        Vec3::new(self.x.value(), self.y.value(), self.z.value())
    }
    /// Dot product with a constant.
    #[inline]
    pub fn dot(self, v: Vec3) -> R {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
    /// Squared length.
    #[inline]
    pub fn length_squared(self) -> R {
        self.x * self.x + self.y * self.y + self.z * self.z
    }
    /// Length.
    #[inline]
    pub fn length(self) -> R {
        self.length_squared().sqrt()
    }
    /// Sum with a constant.
    #[inline]
    pub fn plus(self, v: Vec3) -> Self {
        Self { x: self.x + v.x, y: self.y + v.y, z: self.z + v.z }
    }
    /// The product of the matrix whose rows are `rows` with this vector.
    #[inline]
    pub fn turned(self, rows: &[Vec3; 3]) -> Self {
        Self { x: self.dot(rows[0]), y: self.dot(rows[1]), z: self.dot(rows[2]) }
    }
    /// Component by component times a constant.
    #[inline]
    pub fn scale(self, v: Vec3) -> Self {
        Self { x: self.x * v.x, y: self.y * v.y, z: self.z * v.z }
    }
}
