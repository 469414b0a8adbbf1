//! Residual velocities around a node → the node's velocity.
//!
//! Samples are held eight by eight, each quantity by itself, so that every sum over them runs in vectors.

use super::samples::Sample;
use crate::readout::Readout;
use nalgebra::Vector2;

/// Samples side by side.
const LANES: usize = 8;

/// Samples on one side that are looked at, at most.
const MOST: usize = 64;

/// Reach of a sample's influence, in distances between samples.
const REACH: f32 = 0.5;

/// From one neighbour to the other a velocity may change by this share and still be the same thing's:
/// cameras accelerate.
const ACCELERATION: f32 = 0.3;

/// Samples around a node that its velocity is looked for among, at most.
const CANDIDATES: usize = 6;

/// Candidates whose velocities differ by less than this share of what may be the same are one.
const SAME_CANDIDATE: f32 = 0.3;

/// Nodes (as a distance) from a sample at which a quarter of it is remembered.
const FORGOTTEN: f32 = 2.5;

/// Samples at hand at which a node believes what they say; fewer are followed in proportion.
const ENOUGH: f32 = 1.0;

/// How near samples must lie to count, and how far their velocities may differ.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Scale {
    /// Pixels from one sample to the next, about.
    pub(super) apart: f32,
    /// Pixels from node to node.
    pub(super) spacing: f32,
    /// Velocities (pixels per readout) that differ by less may be the same.
    pub(super) tolerance: f32,
}

/// Some samples; those that fill up the last group have no trust.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    x: [f32; LANES],
    y: [f32; LANES],
    /// Velocity, pixels per readout.
    u: [f32; LANES],
    v: [f32; LANES],
    trust: [f32; LANES],
    /// Trust by distance to the node.
    weight: [f32; LANES],
}

/// The samples of the neighbours before the frame, or of those after it.
#[derive(Clone, Copy, Debug, Default)]
struct Side {
    groups: [Group; MOST / LANES],
    count: usize,
    /// Sum of the readouts to the neighbour.
    ahead: f32,
}

/// The samples around a node.
#[derive(Debug, Default)]
pub(super) struct Surroundings {
    sides: [Side; 2],
    scale: Scale,
}

impl Surroundings {
    /// Takes some samples; of more than [`MOST`], some are left out everywhere.
    pub(super) fn fill<'a>(
        &mut self,
        scale: Scale,
        count: usize,
        slices: impl Iterator<Item = &'a [Sample]>,
    ) {
        self.scale = scale;
        self.sides.iter_mut().for_each(|side| (side.count, side.ahead) = (0, 0.0));
        let stride = count.div_ceil(MOST).max(1);
        for sample in slices.flat_map(|slice| slice.iter().step_by(stride)) {
            self.sides[usize::from(sample.ahead > 0.0)].push(sample);
        }
        self.sides.iter_mut().for_each(Side::fill_up);
    }

    /// The velocity at a node (frame pixels), in pixels per readout; zero where there is nothing to go by.
    pub(super) fn velocity(&mut self, readout: &Readout, at: Vector2<f64>) -> Vector2<f32> {
        let share = readout.share(at.x, at.y) as f32;
        let present = self.weigh(at.cast());
        let Some(seed) = self.seed() else { return Vector2::zeros() };
        let tolerance = self.scale.tolerance;
        let wide = tolerance + ACCELERATION * seed.velocity.norm();
        let [own, other] = [&self.sides[seed.side], &self.sides[1 - seed.side]];
        let around = own.mean(seed.velocity, tolerance).velocity_or(seed.velocity);
        let beside = other.mean(around, wide).velocity_or(around);
        let [own, other] = [own.mean(around, tolerance), other.mean(beside, tolerance)];
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
        velocity * gain * (present / ENOUGH).min(1.0)
    }

    /// Weighs the samples by their distance to the node, and says how many are at hand: less the further they
    /// are away.
    fn weigh(&mut self, at: Vector2<f32>) -> f32 {
        let reach = REACH * self.scale.apart;
        let scale = 0.5 / (reach * reach);
        let forgotten = 1.0 / (FORGOTTEN * self.scale.spacing).powi(2);
        let mut present = [0.0; LANES];
        for group in self.sides.iter_mut().flat_map(Side::groups_mut) {
            for (i, present) in present.iter_mut().enumerate() {
                let (x, y) = (group.x[i] - at.x, group.y[i] - at.y);
                let square = x * x + y * y;
                group.weight[i] = group.trust[i] * kernel(scale * square);
                *present += group.trust[i] * kernel(forgotten * square);
            }
        }
        total(present)
    }

    /// The sample whose velocity most of the others share: the mode.
    fn seed(&self) -> Option<Seed> {
        let nearest = self.heaviest(f32::INFINITY)?;
        let farthest = self.sides.iter().map(|side| side.farthest(nearest.velocity)).fold(0.0, f32::max);
        if farthest < self.scale.tolerance * self.scale.tolerance {
            return Some(nearest);
        }
        let same = (SAME_CANDIDATE * self.scale.tolerance).powi(2);
        let mut candidates = [nearest; CANDIDATES];
        let mut best = (0.0, None);
        for index in 0..CANDIDATES {
            let seed = match index.checked_sub(1) {
                Some(before) => self.heaviest(candidates[before].weight),
                None => Some(nearest),
            };
            let Some(seed) = seed else { break };
            candidates[index] = seed;
            let is_same = |other: &Seed| (other.velocity - seed.velocity).norm_squared() < same;
            if candidates[..index].iter().any(is_same) {
                continue;
            }
            let score = self.agreement(&seed);
            if score > best.0 {
                best = (score, Some(seed));
            }
        }
        best.1
    }

    /// The sample of greatest weight under `limit`.
    fn heaviest(&self, limit: f32) -> Option<Seed> {
        let mut best = (0.0, None);
        for (side, samples) in self.sides.iter().enumerate() {
            for group in samples.groups() {
                for (lane, &weight) in group.weight.iter().enumerate() {
                    if weight > best.0 && weight < limit {
                        best = (weight, Some((side, group, lane)));
                    }
                }
            }
        }
        let (weight, (side, group, lane)) = (best.0, best.1?);
        Some(Seed { velocity: Vector2::new(group.u[lane], group.v[lane]), side, weight })
    }

    /// Weight of the other samples that move as this one does: what is alone is more likely a mistake.
    fn agreement(&self, seed: &Seed) -> f32 {
        let tolerance = self.scale.tolerance;
        let wide = tolerance + ACCELERATION * seed.velocity.norm();
        let own = self.sides[seed.side].agreement(seed.velocity, tolerance);
        own + self.sides[1 - seed.side].agreement(seed.velocity, wide) - seed.weight
    }
}

impl Side {
    fn push(&mut self, sample: &Sample) {
        let Some(group) = self.groups.get_mut(self.count / LANES) else { return };
        let lane = self.count % LANES;
        (group.x[lane], group.y[lane]) = (sample.at.x, sample.at.y);
        (group.u[lane], group.v[lane]) = (sample.velocity.x, sample.velocity.y);
        group.trust[lane] = sample.trust;
        self.ahead += sample.ahead;
        self.count += 1;
    }

    /// Fills the last group up with nothing.
    fn fill_up(&mut self) {
        for empty in self.count..self.count.next_multiple_of(LANES) {
            self.groups[empty / LANES].trust[empty % LANES] = 0.0;
        }
    }

    fn groups(&self) -> &[Group] {
        &self.groups[..self.count.div_ceil(LANES)]
    }

    fn groups_mut(&mut self) -> &mut [Group] {
        &mut self.groups[..self.count.div_ceil(LANES)]
    }

    /// The greatest squared distance of a sample's velocity from this one.
    fn farthest(&self, velocity: Vector2<f32>) -> f32 {
        let mut farthest = [0.0f32; LANES];
        for group in self.groups() {
            for (i, farthest) in farthest.iter_mut().enumerate() {
                let square = (group.u[i] - velocity.x).powi(2) + (group.v[i] - velocity.y).powi(2);
                let square = if group.trust[i] > 0.0 { square } else { 0.0 };
                *farthest = if square > *farthest { square } else { *farthest };
            }
        }
        farthest.into_iter().fold(0.0, f32::max)
    }

    /// Weight of the samples whose velocities are within `tolerance` or so of this one.
    fn agreement(&self, velocity: Vector2<f32>, tolerance: f32) -> f32 {
        let scale = 1.0 / (tolerance * tolerance);
        let mut sums = [0.0; LANES];
        for group in self.groups() {
            for (i, sum) in sums.iter_mut().enumerate() {
                let square = (group.u[i] - velocity.x).powi(2) + (group.v[i] - velocity.y).powi(2);
                *sum += group.weight[i] * kernel(scale * square);
            }
        }
        total(sums)
    }

    /// The mean velocity of the samples that are within `tolerance` or so of `around`, and what it rests on; no weight
    /// where there are none.
    fn mean(&self, around: Vector2<f32>, tolerance: f32) -> Mean {
        let scale = 1.0 / (tolerance * tolerance);
        let mut sums = [[0.0; LANES]; 5];
        for group in self.groups() {
            for (i, weight) in group.weight.iter().enumerate() {
                let (u, v) = (group.u[i] - around.x, group.v[i] - around.y);
                let square = u * u + v * v;
                let weight = weight * kernel(scale * square);
                sums[0][i] += weight;
                sums[1][i] += weight * u;
                sums[2][i] += weight * v;
                sums[3][i] += weight * weight;
                sums[4][i] += weight * square;
            }
        }
        let [weight, u, v, squares, spread] = sums.map(total);
        if weight <= 0.0 {
            return Mean::default();
        }
        let velocity = around + Vector2::new(u, v) / weight;
        Mean { velocity, weight, squares, spread, ahead: self.ahead / self.count as f32 }
    }
}

/// Sum of the lanes: halves are added, so that few additions wait for others.
fn total(lanes: [f32; LANES]) -> f32 {
    let half: [f32; LANES / 2] = std::array::from_fn(|i| lanes[i] + lanes[i + LANES / 2]);
    (half[0] + half[2]) + (half[1] + half[3])
}

/// A sample that may speak for its surroundings.
#[derive(Clone, Copy, Debug)]
struct Seed {
    velocity: Vector2<f32>,
    /// Index of the side that it is on.
    side: usize,
    weight: f32,
}

/// Geman and McClure's weight of a squared distance in units of its scale.
pub(super) fn kernel(square: f32) -> f32 {
    let share = 1.0 / (1.0 + square);
    share * share
}

/// What the samples of the neighbours on one side say.
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

impl Mean {
    fn velocity_or(&self, other: Vector2<f32>) -> Vector2<f32> {
        if self.weight > 0.0 { self.velocity } else { other }
    }
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
