//! Arithmetic on several pixels at once.
//!
//! Plain arrays in fixed loops: the compiler makes SSE, AVX or WASM SIMD of them, and every lane
//! computes what a single pixel would, so results don't depend on the machine.

use std::ops::{Add, AddAssign, Div, Mul, Sub};

/// Pixels in a block.
pub const LANES: usize = 8;

/// One value of each of [`LANES`] pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(32))]
pub struct Lanes(pub [f32; LANES]);

macro_rules! operator {
    ($trait:ident, $method:ident, $assign:tt) => {
        impl $trait for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..LANES {
                    self.0[i] $assign other.0[i];
                }
                self
            }
        }
        impl $trait<f32> for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                $trait::$method(self, Self::splat(other))
            }
        }
    };
}
operator!(Add, add, +=);
operator!(Sub, sub, -=);
operator!(Mul, mul, *=);
operator!(Div, div, /=);

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Lanes {
    /// 0 everywhere.
    pub const ZERO: Self = Self([0.0; LANES]);
    /// 1 everywhere.
    pub const ONE: Self = Self([1.0; LANES]);

    /// `value` everywhere.
    #[inline(always)]
    pub fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// The first values of `values`, what is missing or not finite as 0.
    #[inline(always)]
    pub fn load(values: &[f32]) -> Self {
        let mut out = [0.0; LANES];
        if let Some(whole) = values.first_chunk::<LANES>() {
            out = *whole;
        } else {
            out[..values.len()].copy_from_slice(values);
        }
        for v in &mut out {
            *v = if v.abs() <= f32::MAX { *v } else { 0.0 };
        }
        Self(out)
    }

    /// 0 where a pixel is flagged, else 1; also 1 where there is no flag.
    #[inline(always)]
    pub fn unflagged(flags: &[bool]) -> Self {
        let mut out = [1.0; LANES];
        for (v, &flag) in out.iter_mut().zip(flags) {
            *v = f32::from(!flag);
        }
        Self(out)
    }

    /// Lane by lane the larger.
    #[inline(always)]
    pub fn max(mut self, other: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = if other.0[i] > self.0[i] { other.0[i] } else { self.0[i] };
        }
        self
    }

    /// Magnitude.
    #[inline(always)]
    pub fn abs(mut self) -> Self {
        for v in &mut self.0 {
            *v = v.abs();
        }
        self
    }

    /// Square root.
    #[inline(always)]
    pub fn sqrt(mut self) -> Self {
        for v in &mut self.0 {
            *v = v.sqrt();
        }
        self
    }

    /// 1 where `self < other`, else 0.
    #[inline(always)]
    pub fn below(mut self, other: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = if self.0[i] < other.0[i] { 1.0 } else { 0.0 };
        }
        self
    }

    /// 1 where `self <= other`, else 0.
    #[inline(always)]
    pub fn at_most(mut self, other: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = if self.0[i] <= other.0[i] { 1.0 } else { 0.0 };
        }
        self
    }

    /// `yes` where `self` is not 0, else `no`.
    #[inline(always)]
    pub fn select(self, yes: Self, no: Self) -> Self {
        let mut out = no;
        for i in 0..LANES {
            out.0[i] = if self.0[i] != 0.0 { yes.0[i] } else { no.0[i] };
        }
        out
    }
}
