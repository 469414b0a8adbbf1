// SPDX-License-Identifier: MIT OR Apache-2.0

//! One pair of successive frames: its correspondences and the twists fitted to them.

use super::measurement::{Minimiser, TimedMatch};
use super::start::robust_start;
use crate::correspond::Correspondence;
use crate::motion::{Twist, image_centre};
use crate::readout::Readout;
use crate::robust::loss::GemanMcClure;
use crate::solve::pairs::{MIN_MATCHES, explained_share, noise_limit};
use nalgebra::Vector2;

/// E is the mean over this share of the correspondences, those of least residual: a third of the points
/// may lie on independently moving objects.
const INLIER_SHARE: f64 = 2.0 / 3.0;

/// A correspondence with the exposure times of its points.
#[derive(Clone, Copy, Debug)]
struct TimedCorrespondence {
    /// Centred pixels.
    from: Vector2<f64>,
    to: Vector2<f64>,
    /// Seconds after the first frame's timestamp.
    from_time: f64,
    to_time: f64,
}

/// The correspondences between a frame and the next one that differs from it.
#[derive(Clone, Debug)]
pub struct Link {
    pairs: Vec<TimedCorrespondence>,
    /// From the first frame's timestamp to the second's, in seconds; negative in reverse playback.
    interval: f64,
    readout_time: f64,
    /// Standard deviation of a measured coordinate in pixels.
    noise: f64,
    /// E of zero motion, per inlier, in px².
    still_energy: f64,
}

/// A twist fitted to the correspondences of one link, with its residual energy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The motion.
    pub twist: Twist,
    /// E of 25.4 as a mean per inlier, in px²; inliers are the two thirds of least residual.
    pub energy: f64,
    /// Correspondences within the reach of the robust loss.
    pub inliers: usize,
    /// Correspondences of the pair.
    pub correspondences: usize,
    /// Confidence in the motion, 0 to 1: the share of the displacement that it explains beyond the
    /// noise floor.
    pub confidence: f64,
}

impl Fit {
    /// Whether the confidence is positive.
    pub fn is_trusted(&self) -> bool {
        self.confidence > 0.0
    }
}

/// Buffers of the solvers of one stream.
#[derive(Debug, Default)]
pub struct FitBuffers {
    minimiser: Minimiser,
    matches: Vec<TimedMatch>,
    errors: Vec<f64>,
}

/// The frame of a link whose motion is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KnownFrame {
    /// The first frame; the second's motion is unknown.
    First,
    /// The second frame; the first's motion is unknown.
    Second,
}

impl Link {
    /// A link of the correspondences from a frame to a frame `interval` seconds later.
    ///
    /// `noise` is the standard deviation of a measured coordinate in pixels.
    pub fn new(correspondences: &[Correspondence], readout: &Readout, interval: f64, noise: f64) -> Self {
        let centre = image_centre(readout.width, readout.height);
        let pairs: Vec<_> = correspondences
            .iter()
            .map(|c| TimedCorrespondence {
                from: c.from - centre,
                to: c.to - centre,
                from_time: readout.offset(c.from.x, c.from.y),
                to_time: interval + readout.offset(c.to.x, c.to.y),
            })
            .collect();
        let mut errors: Vec<_> = pairs.iter().map(|p| (p.to - p.from).norm_squared() / 2.0).collect();
        let still_energy = mean_of_inliers(&mut errors);
        Self { pairs, interval, readout_time: readout.time, noise, still_energy }
    }

    /// Whether nothing moved between the two frames: any model fits such a pair, so it cannot be the
    /// initial pair.
    pub fn is_still(&self) -> bool {
        self.still_energy < noise_limit(self.noise)
    }

    /// Initialisation: one uniform rotation for both frames (25.6). τ is the time between the two
    /// exposures, (N_t + r′ − r)/N_t of the interval.
    pub fn uniform(&self, scratch: &mut FitBuffers) -> Option<Fit> {
        scratch.matches.clear();
        scratch.matches.extend(self.pairs.iter().map(|p| TimedMatch {
            from: p.from,
            to: p.to,
            time: p.to_time - p.from_time,
        }));
        self.fit(scratch)
    }

    /// One step of the recursion: the motion of one frame from that of the other.
    ///
    /// The known frame moves during its own readout only, **the unknown frame takes the blank**:
    /// forward in time ((N − r)/N_t)·θ(k), then ((B + r′)/N_t)·θ(k + 1) (25.7, 25.8); backward
    /// (−r/N_t)·θ(k), then (−(N_t − r′)/N_t)·θ(k − 1) (25.9 with r for its printed r′, 25.10).
    pub fn sequential_step(&self, known: KnownFrame, motion: Twist, scratch: &mut FitBuffers) -> Option<Fit> {
        let known_start = if known == KnownFrame::First { 0.0 } else { self.interval };
        let unknown_is_later = (known == KnownFrame::First) == (self.interval > 0.0);
        let border = known_start + if unknown_is_later { self.readout_time } else { 0.0 };
        scratch.matches.clear();
        scratch.matches.extend(self.pairs.iter().map(|p| {
            let (near, near_time, far, far_time) = match known {
                KnownFrame::First => (p.from, p.from_time, p.to, p.to_time),
                KnownFrame::Second => (p.to, p.to_time, p.from, p.from_time),
            };
            TimedMatch {
                from: motion.after(border - near_time).apply(near),
                to: far,
                time: far_time - border,
            }
        }));
        self.fit(scratch)
    }

    /// Fits the twist to `scratch.matches`.
    fn fit(&self, scratch: &mut FitBuffers) -> Option<Fit> {
        let FitBuffers { minimiser, matches, errors } = scratch;
        if matches.len() < MIN_MATCHES {
            return None;
        }
        let start = robust_start(matches, self.noise, errors)?;
        let twist = minimiser.minimise(matches, start.twist, GemanMcClure(start.reach))?;
        errors.clear();
        errors.extend(matches.iter().map(|m| m.error(twist)));
        let inliers = errors.iter().filter(|&&error| error < start.reach).count();
        let energy = mean_of_inliers(errors);
        let confidence = self.confidence(twist, energy);
        energy.is_finite().then_some(Fit {
            twist,
            energy,
            inliers,
            correspondences: matches.len(),
            confidence,
        })
    }

    /// Confidence of a twist of residual `energy`: 1 if it explains all displacement, 0 if the residual
    /// is a quarter of the measured displacement or of the displacement that the twist predicts over the
    /// interval (in a shake that reverses between two frames the measured displacement is small).
    fn confidence(&self, twist: Twist, energy: f64) -> f64 {
        let motion = twist.after(self.interval);
        let swept =
            self.pairs.iter().map(|p| (motion.apply(p.from) - p.from).norm_squared() / 2.0).sum::<f64>();
        let displaced = self.still_energy.max(swept / self.pairs.len().max(1) as f64);
        explained_share(energy, displaced, self.noise)
    }
}

/// The mean of the smallest two thirds of the errors; reorders them.
fn mean_of_inliers(errors: &mut [f64]) -> f64 {
    let count = (errors.len() as f64 * INLIER_SHARE).ceil() as usize;
    if count == 0 {
        return 0.0;
    }
    if count < errors.len() {
        errors.select_nth_unstable_by(count, f64::total_cmp);
    }
    errors.iter().take(count).sum::<f64>() / count as f64
}
