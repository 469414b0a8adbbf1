//! Residual velocities around a node → the node's velocity.

use super::samples::Sample;
use crate::readout::Readout;
use nalgebra::Vector2;

/// What surrounds a node.
#[derive(Debug, Default)]
pub(super) struct Surroundings {
    pub(super) samples: Vec<Sample>,
    /// Pixels from one sample to the next, about.
    pub(super) apart: f32,
    /// Pixels from node to node.
    pub(super) spacing: f32,
    weights: Vec<f32>,
}

/// Debug knob.
fn knob(name: &str, default: f32) -> f32 {
    use std::collections::HashMap;
    use std::sync::{Mutex, OnceLock};
    static KNOBS: OnceLock<Mutex<HashMap<String, f32>>> = OnceLock::new();
    let map = KNOBS.get_or_init(|| Mutex::new(HashMap::new()));
    let mut map = map.lock().unwrap();
    *map.entry(name.into()).or_insert_with(|| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default))
}

#[derive(Clone, Copy)]
struct Knobs { sharp: f32, same: f32, drift: f32, far: f32, least: f32, shrink: f32, accel: f32 }
thread_local! { static K: Knobs = Knobs { sharp: knob("SHARP", 0.8), same: knob("SAME", 1.0), drift: knob("DRIFT", 0.3), far: knob("FAR", 2.5), least: knob("LEAST", 0.2), shrink: knob("SHRINK", 1.0), accel: knob("ACCEL", 1.0) }; }

impl Surroundings {
    pub(super) fn velocity(&mut self, readout: &Readout, at: Vector2<f64>) -> Vector2<f32> {
        let k = K.with(|k| *k);
        if self.samples.is_empty() {
            return Vector2::zeros();
        }
        let share = readout.share(at.x, at.y) as f32;
        let at: Vector2<f32> = at.cast();
        let reach = k.sharp * self.apart;
        let falloff = 0.5 / (reach * reach);
        self.weights.clear();
        self.weights.extend(
            self.samples.iter().map(|s| s.trust * (-falloff * (s.at - at).norm_squared()).exp() + 1e-12),
        );
        let presence: f32 = self
            .samples
            .iter()
            .map(|s| s.trust * (-0.5 * (s.at - at).norm_squared() / (k.far * self.spacing).powi(2)).exp())
            .sum();
        let same = k.same * self.spacing / 8.0;
        let mut best = (0.0f32, 0usize);
        for i in 0..self.samples.len() {
            let score = self.score(i, same, k.drift);
            if score > best.0 {
                best = (score, i);
            }
        }
        let seed = self.samples[best.1];
        let total: f32 = self.weights.iter().sum();
        let wide = same + k.drift * seed.velocity.norm();
        // own side
        let own = self.mean(seed.ahead, seed.velocity, same);
        let own = self.mean(seed.ahead, own.velocity, same);
        let other = self.mean(-seed.ahead, own.velocity, wide);
        let other = self.mean(-seed.ahead, other.velocity, same);
        let _ = total;
        let both = own.weight + other.weight;
        let balance = (4.0 * own.weight.min(other.weight) / both).min(1.0);
        // forward weight
        let (dt_own, dt_other) = (own.ahead, other.ahead);
        let plain = (own.velocity * own.weight + other.velocity * other.weight) / both;
        let mut v = plain;
        if balance > 0.0 && dt_own != dt_other && other.weight > 0.0 {
            // The mean velocity until the neighbour is that at half the time; wanted is that
            // halfway to the reference instant.
            let wanted = k.accel * 0.5 * (0.5 - share);
            let t = (wanted - 0.5 * dt_own) / (0.5 * dt_other - 0.5 * dt_own);
            let t = t.clamp(-0.5, 1.5);
            let line = own.velocity + (other.velocity - own.velocity) * t;
            v = line * balance + plain * (1.0 - balance);
        }
        let count = both * both / (own.squares + other.squares).max(1e-20);
        let variance = (own.spread + other.spread) / both / count;
        let square = v.norm_squared();
        let gain = square / (square + k.shrink * variance + 1e-9);
        let fade = presence / (presence + k.least);
        v * gain * fade
    }

    fn score(&self, index: usize, same: f32, drift: f32) -> f32 {
        let s = self.samples[index];
        let narrow = 1.0 / (same * same);
        let wide = same + drift * s.velocity.norm();
        let wide = 1.0 / (wide * wide);
        let mut sum = 0.0;
        for (o, w) in self.samples.iter().zip(&self.weights) {
            let scale = if (o.ahead > 0.0) == (s.ahead > 0.0) { narrow } else { wide };
            let k = 1.0 / (1.0 + scale * (o.velocity - s.velocity).norm_squared());
            sum += w * k * k;
        }
        sum
    }

    fn mean(&self, ahead: f32, around: Vector2<f32>, same: f32) -> Mean {
        let narrow = 1.0 / (same * same);
        let mut m = Mean::default();
        for (o, w) in self.samples.iter().zip(&self.weights) {
            if (o.ahead > 0.0) != (ahead > 0.0) {
                continue;
            }
            let d = (o.velocity - around).norm_squared();
            let k = 1.0 / (1.0 + narrow * d);
            let w = w * k * k;
            m.weight += w;
            m.squares += w * w;
            m.velocity += o.velocity * w;
            m.spread += w * d;
            m.ahead = o.ahead;
        }
        m.velocity /= m.weight.max(1e-20);
        m
    }
}

#[derive(Default, Clone, Copy)]
struct Mean {
    velocity: Vector2<f32>,
    weight: f32,
    squares: f32,
    spread: f32,
    ahead: f32,
}
