//! Residual velocities around a node → the node's velocity.

use super::samples::Sample;
use crate::readout::Readout;
use nalgebra::Vector2;

/// Reach of a sample's influence, in distances between samples.
const REACH: f32 = 0.7;

/// From one neighbour to the other a velocity may change by this share and still be the same thing's:
/// cameras accelerate.
const ACCELERATION: f32 = 0.3;

/// Samples around a node that its velocity is looked for among, at most.
const CANDIDATES: usize = 6;

/// Nodes (as a distance) from a sample at which a quarter of it is remembered.
const FORGOTTEN: f32 = 2.5;

/// Samples at hand at which a node believes what they say; fewer are followed in proportion.
const ENOUGH: f32 = 1.0;

/// The samples around a node, and room for their weights.
#[derive(Debug, Default)]
pub(super) struct Surroundings {
    pub(super) samples: Vec<Sample>,
    /// Pixels from one sample to the next, about.
    pub(super) apart: f32,
    /// Pixels from node to node.
    pub(super) spacing: f32,
    /// Velocities (pixels per readout) that differ by less may be the same.
    pub(super) tolerance: f32,
    weights: Vec<f32>,
}

impl Surroundings {
    /// The velocity at a node (frame pixels), in pixels per readout; zero where there is nothing to go by.
    pub(super) fn velocity(&mut self, readout: &Readout, at: Vector2<f64>) -> Vector2<f32> {
        let share = readout.share(at.x, at.y) as f32;
        let at = at.cast();
        self.weigh(at);
        let Some(seed) = self.seed() else { return Vector2::zeros() };
        let wide = self.tolerance + ACCELERATION * seed.velocity.norm();
        let own = self.mean(seed.ahead, seed.velocity, self.tolerance);
        let own = self.mean(seed.ahead, own.velocity, self.tolerance);
        let other = self.mean(-seed.ahead, own.velocity, wide);
        let other = self.mean(-seed.ahead, other.velocity, self.tolerance);
        let weight = own.weight + other.weight;
        if weight <= 0.0 {
            return Vector2::zeros();
        }
        let velocity = towards_reference(&own, &other, share);
        let count = weight * weight / (own.squares + other.squares);
        let variance = (own.spread + other.spread) / weight / count;
        // Wiener's gain: what is as small as its own error is as likely noise.
        let square = velocity.norm_squared();
        let gain = square / (square + variance + f32::MIN_POSITIVE);
        velocity * gain * self.trust(at)
    }

    /// Weighs the samples by their distance to the node.
    fn weigh(&mut self, at: Vector2<f32>) {
        let reach = REACH * self.apart;
        let scale = 0.5 / (reach * reach);
        let weight = |sample: &Sample| sample.trust * kernel(scale * (sample.at - at).norm_squared());
        self.weights.clear();
        self.weights.extend(self.samples.iter().map(weight));
    }

    /// How far the samples at hand are to be followed, 0 to 1: less the further they are away.
    fn trust(&self, at: Vector2<f32>) -> f32 {
        let scale = 1.0 / (FORGOTTEN * self.spacing).powi(2);
        let near = |sample: &Sample| sample.trust * kernel(scale * (sample.at - at).norm_squared());
        let present: f32 = self.samples.iter().map(near).sum();
        (present / ENOUGH).min(1.0)
    }

    /// The sample whose velocity most of the others share: the mode.
    fn seed(&self) -> Option<Sample> {
        let weighed = || self.samples.iter().zip(&self.weights);
        let (nearest, most) = weighed().max_by(|a, b| a.1.total_cmp(b.1))?;
        let apart = |sample: &Sample| (sample.velocity - nearest.velocity).norm_squared();
        if *most > 0.0 && self.samples.iter().all(|sample| apart(sample) < self.tolerance * self.tolerance) {
            return Some(*nearest);
        }
        let mut best = (0.0, None);
        let mut least = f32::INFINITY;
        for _ in 0..CANDIDATES {
            let next = weighed().filter(|(_, weight)| **weight < least).max_by(|a, b| a.1.total_cmp(b.1));
            let Some((sample, weight)) = next else { break };
            least = *weight;
            let score = self.agreement(sample);
            if score > best.0 {
                best = (score, Some(*sample));
            }
        }
        best.1
    }

    /// Weight of the other samples that move as this one does: what is alone is more likely a mistake.
    fn agreement(&self, seed: &Sample) -> f32 {
        let wide = self.tolerance + ACCELERATION * seed.velocity.norm();
        let (narrow, wide) = (1.0 / (self.tolerance * self.tolerance), 1.0 / (wide * wide));
        let agrees = |(sample, weight): (&Sample, &f32)| {
            let scale = if sample.is_on_side_of(seed.ahead) { narrow } else { wide };
            weight * kernel(scale * (sample.velocity - seed.velocity).norm_squared())
        };
        let others =
            self.samples.iter().zip(&self.weights).filter(|(sample, _)| !std::ptr::eq(*sample, seed));
        others.map(agrees).sum()
    }

    /// The mean of the samples of one neighbour whose velocities are within `tolerance` or so of `around`.
    fn mean(&self, ahead: f32, around: Vector2<f32>, tolerance: f32) -> Mean {
        let scale = 1.0 / (tolerance * tolerance);
        let mut mean = Mean::default();
        for (sample, weight) in self.samples.iter().zip(&self.weights) {
            if !sample.is_on_side_of(ahead) {
                continue;
            }
            let distance = (sample.velocity - around).norm_squared();
            let weight = weight * kernel(scale * distance);
            mean.weight += weight;
            mean.squares += weight * weight;
            mean.velocity += sample.velocity * weight;
            mean.spread += weight * distance;
            mean.ahead = sample.ahead;
        }
        if mean.weight > 0.0 {
            mean.velocity /= mean.weight;
        }
        mean
    }
}

/// Geman and McClure's weight of a squared distance in units of its scale.
fn kernel(square: f32) -> f32 {
    let share = 1.0 / (1.0 + square);
    share * share
}

/// What the samples of one neighbour say.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    velocity: Vector2<f32>,
    weight: f32,
    /// Sum of squared weights.
    squares: f32,
    /// Sum of weighted squared deviations.
    spread: f32,
    ahead: f32,
}

/// The mean velocity from a node's exposure, at share `share`, to the middle of the readout.
///
/// The mean velocity until a neighbour is that at half the time until then; what is wanted is that at
/// half the time until the middle of the readout: on the line through the two, where both are known.
fn towards_reference(own: &Mean, other: &Mean, share: f32) -> Vector2<f32> {
    let weight = own.weight + other.weight;
    let mean = (own.velocity * own.weight + other.velocity * other.weight) / weight;
    let apart = other.ahead - own.ahead;
    if other.weight <= 0.0 || apart == 0.0 {
        return mean;
    }
    let along = ((0.5 - share - own.ahead) / apart).clamp(-0.5, 1.5);
    let line = own.velocity + (other.velocity - own.velocity) * along;
    let balance = (4.0 * own.weight.min(other.weight) / weight).min(1.0);
    line * balance + mean * (1.0 - balance)
}
