//! The motion path: splines over exposure time, and the homographies that they make.

pub mod homographies;
pub mod knots;
pub mod pixels;
pub mod spline;
pub mod splines;
