//! The continuous estimator: the motion path as splines over exposure time.
#![allow(missing_docs)]

mod banded;
mod flow;
mod pair;
mod path;
mod running;
mod smoothness;
mod solver;
mod spline;
mod stream;

pub use stream::{Camera, Continuous, Found, Motion};
