//! The number types that splines are computed with.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::simd;

/// f32 with the polynomials of [`simd`], or f64 with the functions of the standard library, for checks.
pub trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Sealed
{
    /// Zero.
    const ZERO: Self;
    /// One.
    const ONE: Self;
    /// The largest number below 1.
    const BELOW_ONE: Self;

    /// Converts to the nearest number.
    fn of(value: f64) -> Self;
    /// `e^x` for `x <= 0`.
    fn exp_of_negative(self) -> Self;
    /// The natural logarithm.
    fn ln(self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// The largest integer not above.
    fn floor(self) -> Self;
    /// The nearest integer, ties to even.
    fn round(self) -> Self;
    /// `ln(1 + e^x)`.
    fn softplus(self) -> Self;
    /// `1 / (1 + e^-x)`.
    fn sigmoid(self) -> Self;
    /// Selects one of two numbers bitwise: compilers turn choices between several arrays into a branch per
    /// lane.
    fn select(condition: bool, yes: Self, no: Self) -> Self;
}

/// Restricts [`Real`] to the types of this file.
pub trait Sealed {}

impl Sealed for f32 {}
impl Sealed for f64 {}

macro_rules! real {
    ($real:ident, $bits:ident, $exp:expr, $ln:expr, $softplus:expr, $sigmoid:expr) => {
        impl Real for $real {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const BELOW_ONE: Self = 1.0 - $real::EPSILON / 2.0;

            #[inline(always)]
            fn of(value: f64) -> Self {
                value as Self
            }

            #[inline(always)]
            fn exp_of_negative(self) -> Self {
                $exp(self)
            }

            #[inline(always)]
            fn ln(self) -> Self {
                $ln(self)
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }

            #[inline(always)]
            fn floor(self) -> Self {
                self.floor()
            }

            #[inline(always)]
            fn round(self) -> Self {
                self.round_ties_even()
            }

            #[inline(always)]
            fn softplus(self) -> Self {
                $softplus(self)
            }

            #[inline(always)]
            fn sigmoid(self) -> Self {
                $sigmoid(self)
            }

            #[inline(always)]
            fn select(condition: bool, yes: Self, no: Self) -> Self {
                let mask = $bits::from(condition).wrapping_neg();
                $real::from_bits((yes.to_bits() & mask) | (no.to_bits() & !mask))
            }
        }
    };
}

real!(f32, u32, simd::exp_to_88, simd::ln, simd::softplus, simd::sigmoid);
real!(f64, u64, f64::exp, f64::ln, softplus, sigmoid);

fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
