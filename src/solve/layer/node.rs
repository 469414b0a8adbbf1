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

/// Samples that are looked at together, so that loops over them run on vectors.
pub(super) const LANES: usize = 8;

/// Eight samples, lane by lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes {
    /// Frame pixels.
    x: [f32; LANES],
    y: [f32; LANES],
    /// Pixels per readout, along x and y.
    u: [f32; LANES],
    v: [f32; LANES],
    trust: [f32; LANES],
    /// 1 where the neighbour is later, else 0.
    later: [f32; LANES],
    /// By the distance to the node.
    weight: [f32; LANES],
}

impl Lanes {
    /// Up to eight samples; lanes that are left over repeat the last one and are not trusted.
    fn new(samples: &[Sample]) -> Option<Self> {
        let last = samples.last()?;
        let each = |value: fn(&Sample) -> f32| -> [f32; LANES] {
            std::array::from_fn(|k| value(samples.get(k).unwrap_or(last)))
        };
        let mut trust = each(|sample| sample.trust);
        trust.iter_mut().skip(samples.len()).for_each(|trust| *trust = 0.0);
        Some(Self {
            x: each(|sample| sample.at.x),
            y: each(|sample| sample.at.y),
            u: each(|sample| sample.velocity.x),
            v: each(|sample| sample.velocity.y),
            trust,
            later: each(|sample| f32::from(u8::from(sample.ahead > 0.0))),
            weight: [0.0; LANES],
        })
    }

    fn velocity(&self, lane: usize) -> Vector2<f32> {
        Vector2::new(self.u[lane], self.v[lane])
    }

    /// Squared distances of the velocities from one.
    fn apart(&self, from: Vector2<f32>) -> [f32; LANES] {
        std::array::from_fn(|k| (self.u[k] - from.x).powi(2) + (self.v[k] - from.y).powi(2))
    }
}

/// Where a sample is among the lanes.
type Place = (usize, usize);

/// A velocity that the node may have, and whether it was seen in the later neighbour.
#[derive(Clone, Copy, Debug)]
struct Seed {
    velocity: Vector2<f32>,
    is_later: bool,
}

/// The samples around a node.
#[derive(Debug, Default)]
pub(super) struct Surroundings {
    lanes: Vec<Lanes>,
    /// The earlier and the later neighbour in readouts from the frame, where there is a sample from it.
    ahead: [f32; 2],
    /// Pixels from one sample to the next, about.
    pub(super) apart: f32,
    /// Pixels from node to node.
    pub(super) spacing: f32,
    /// Velocities (pixels per readout) that differ by less may be the same.
    pub(super) tolerance: f32,
}

impl Surroundings {
    /// Takes other samples.
    pub(super) fn fill(&mut self, samples: &[Sample]) {
        self.lanes.clear();
        self.lanes.extend(samples.chunks(LANES).filter_map(Lanes::new));
        for sample in samples {
            self.ahead[usize::from(sample.ahead > 0.0)] = sample.ahead;
        }
    }

    /// The velocity at a node (frame pixels), in pixels per readout; zero where there is nothing to go by.
    pub(super) fn velocity(&mut self, readout: &Readout, at: Vector2<f64>) -> Vector2<f32> {
        let share = readout.share(at.x, at.y) as f32;
        let trust = self.weigh(at.cast());
        let Some(seed) = self.seed() else { return Vector2::zeros() };
        let wide = self.tolerance + ACCELERATION * seed.velocity.norm();
        let own = self.mean(seed.is_later, seed.velocity, self.tolerance);
        let own = self.mean(seed.is_later, own.velocity, self.tolerance);
        let other = self.mean(!seed.is_later, own.velocity, wide);
        let other = self.mean(!seed.is_later, other.velocity, self.tolerance);
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
        velocity * gain * trust
    }

    /// Weighs the samples by their distance to the node; how far those at hand are to be followed, 0 to 1:
    /// less the further they are away.
    fn weigh(&mut self, at: Vector2<f32>) -> f32 {
        let reach = REACH * self.apart;
        let scale = 0.5 / (reach * reach);
        let near = 1.0 / (FORGOTTEN * self.spacing).powi(2);
        let mut present = [0.0; LANES];
        for lanes in &mut self.lanes {
            for k in 0..LANES {
                let square = (lanes.x[k] - at.x).powi(2) + (lanes.y[k] - at.y).powi(2);
                lanes.weight[k] = lanes.trust[k] * kernel(scale * square);
                present[k] += lanes.trust[k] * kernel(near * square);
            }
        }
        (present.iter().sum::<f32>() / ENOUGH).min(1.0)
    }

    /// The sample of the greatest weight under `most`.
    fn heaviest(&self, most: f32) -> Option<(Place, f32)> {
        let mut best = None;
        let mut greatest = 0.0;
        for (index, lanes) in self.lanes.iter().enumerate() {
            for (k, weight) in lanes.weight.into_iter().enumerate() {
                if weight > greatest && weight < most {
                    greatest = weight;
                    best = Some(((index, k), weight));
                }
            }
        }
        best
    }

    fn seed_at(&self, (index, lane): Place) -> Seed {
        let lanes = &self.lanes[index];
        Seed { velocity: lanes.velocity(lane), is_later: lanes.later[lane] > 0.0 }
    }

    /// The sample whose velocity most of the others share: the mode.
    fn seed(&mut self) -> Option<Seed> {
        let (nearest, mut least) = self.heaviest(f32::INFINITY)?;
        let first = self.seed_at(nearest);
        let farthest = self.lanes.iter().fold([0.0; LANES], |most: [f32; LANES], lanes| {
            let apart = lanes.apart(first.velocity);
            std::array::from_fn(|k| most[k].max(apart[k]))
        });
        if farthest.into_iter().fold(0.0, f32::max) < self.tolerance * self.tolerance {
            return Some(first);
        }
        let mut best = (0.0, None);
        let mut place = nearest;
        for _ in 0..CANDIDATES {
            let score = self.agreement(place);
            if score > best.0 {
                best = (score, Some(self.seed_at(place)));
            }
            let Some((next, weight)) = self.heaviest(least) else { break };
            (place, least) = (next, weight);
        }
        best.1
    }

    /// Weight of the other samples that move as this one does: what is alone is more likely a mistake.
    fn agreement(&mut self, (index, lane): Place) -> f32 {
        let seed = self.seed_at((index, lane));
        let wide = self.tolerance + ACCELERATION * seed.velocity.norm();
        let (narrow, wide) = (1.0 / (self.tolerance * self.tolerance), 1.0 / (wide * wide));
        let (earlier, later) = if seed.is_later { (wide, narrow) } else { (narrow, wide) };
        let own = std::mem::take(&mut self.lanes[index].weight[lane]);
        let mut sums = [0.0; LANES];
        for lanes in &self.lanes {
            let apart = lanes.apart(seed.velocity);
            for k in 0..LANES {
                let scale = earlier + (later - earlier) * lanes.later[k];
                sums[k] += lanes.weight[k] * kernel(scale * apart[k]);
            }
        }
        self.lanes[index].weight[lane] = own;
        sums.iter().sum()
    }

    /// The mean of the samples of one neighbour whose velocities are within `tolerance` or so of `around`.
    fn mean(&self, is_later: bool, around: Vector2<f32>, tolerance: f32) -> Mean {
        let scale = 1.0 / (tolerance * tolerance);
        let (sign, offset) = if is_later { (1.0, 0.0) } else { (-1.0, 1.0) };
        let [mut weights, mut squares, mut u, mut v, mut spread] = [[0.0; LANES]; 5];
        for lanes in &self.lanes {
            let apart = lanes.apart(around);
            for k in 0..LANES {
                let weight = (offset + sign * lanes.later[k]) * lanes.weight[k] * kernel(scale * apart[k]);
                weights[k] += weight;
                squares[k] += weight * weight;
                u[k] += weight * lanes.u[k];
                v[k] += weight * lanes.v[k];
                spread[k] += weight * apart[k];
            }
        }
        let [weight, squares, u, v, spread] =
            [weights, squares, u, v, spread].map(|lanes| lanes.iter().sum::<f32>());
        let velocity = if weight > 0.0 { Vector2::new(u, v) / weight } else { Vector2::zeros() };
        Mean { velocity, weight, squares, spread, ahead: self.ahead[usize::from(is_later)] }
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
