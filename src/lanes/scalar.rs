//! Vectors in plain Rust: the reference.

use super::{Cpu, FLOATS};
use std::array::from_fn;
use std::ops::{Add, Mul, Sub};

/// Plain Rust.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Array([f32; FLOATS]);

impl Cpu for Scalar {
    type Lanes = Array;

    #[inline(always)]
    fn vectorize<R>(self, work: impl FnOnce() -> R) -> R {
        work()
    }

    #[inline(always)]
    fn load(self, samples: &[f32; FLOATS]) -> Array {
        Array(*samples)
    }

    #[inline(always)]
    fn store(self, Array(lanes): Array) -> [f32; FLOATS] {
        lanes
    }

    #[inline(always)]
    fn splat(self, value: f32) -> Array {
        Array([value; FLOATS])
    }

    #[inline(always)]
    fn fused(self, a: Array, b: Array, c: Array) -> Array {
        a * b + c
    }

    #[inline(always)]
    fn halves(self, four: [Array; 4]) -> [f32; FLOATS] {
        from_fn(|k| {
            let (Array(lanes), from) = (four[k % 4], k / 4 * 4);
            (lanes[from] + lanes[from + 1]) + (lanes[from + 2] + lanes[from + 3])
        })
    }
}

/// A binary operator on lanes.
macro_rules! operation {
    ($name:ident, $function:ident) => {
        impl $name for Array {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self(from_fn(|lane| self.0[lane].$function(other.0[lane])))
            }
        }
    };
}

operation!(Add, add);
operation!(Sub, sub);
operation!(Mul, mul);
