//! Small patches where the points of the grid disagree.

use super::Correspondence;
use super::field::Motion;
use super::grid::centre;
use super::pyramid::Level;
use super::sampler::to_full;
use super::tracker::{COARSE, CoarseTemplate, Effort, Match};
use crate::cpu::CpuLevel;
use nalgebra::{Matrix2, Vector2};

/// Motions at a point further apart than this, in pixels, disagree.
fn disagreement() -> f32 { knob("DIS", 1.0) }

/// Motions that are tried for a point, at most.
const CANDIDATES: usize = 4;

pub(super) fn knob(name: &str, default: f32) -> f32 {
    use std::collections::HashMap;
    use std::sync::{Mutex, OnceLock};
    static KNOBS: OnceLock<Mutex<HashMap<String, f32>>> = OnceLock::new();
    let map = KNOBS.get_or_init(|| Mutex::new(HashMap::new()));
    let mut map = map.lock().unwrap();
    *map.entry(name.into()).or_insert_with(|| std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default))
}

const EFFORT: Effort = Effort { iterations: 4, tolerance: 0.05 };

/// A motion and how it changes from pixel to pixel around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    pub(super) motion: Motion,
    pub(super) slope: Matrix2<f32>,
}

/// What is known of the motion: that of the points of the grid.
pub(super) struct Known<'a> {
    pub(super) motions: &'a [Option<Local>],
    pub(super) columns: usize,
    /// Analysed pixels.
    pub(super) size: (usize, usize),
}

impl Known<'_> {
    /// Motions of the 4 × 4 grid points around a point, carried to it, nearest first, and whether
    /// those of the 2 × 2 around it are all there.
    fn around(&self, at: Vector2<f32>, out: &mut Vec<(f32, Vector2<f32>)>) {
        out.clear();
        let rows = self.motions.len() / self.columns.max(1);
        let cell = Vector2::new(self.size.0 as f32 / self.columns as f32, self.size.1 as f32 / rows as f32);
        let place = (at.add_scalar(0.5)).component_div(&cell).map(|p| (p - 0.5).floor() as isize);
        for j in place.y - 1..=place.y + 2 {
            for i in place.x - 1..=place.x + 2 {
                if i < 0 || j < 0 || i as usize >= self.columns || j as usize >= rows {
                    continue;
                }
                if let Some(local) = self.motions[j as usize * self.columns + i as usize] {
                    let d = (local.motion.at - at).component_div(&cell).norm();
                    out.push((d, local.motion.carried(at, &local.slope)));
                }
            }
        }
        out.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
}

/// The picture cut into tiles.
pub(super) struct Tiles {
    columns: usize,
    rows: usize,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Fine {
    pub(super) from: Vector2<f32>,
    pub(super) found: Match,
    pub(super) texture: f32,
}

impl Fine {
    pub(super) fn motion(&self) -> Motion {
        Motion { at: centre::<COARSE>(self.from), shift: self.found.corner - self.from }
    }

    pub(super) fn to_full(&self, scale: f64) -> Correspondence {
        Correspondence {
            from: to_full(centre::<COARSE>(self.from), scale),
            to: to_full(centre::<COARSE>(self.found.corner), scale),
            texture: self.texture,
            residual: self.found.residual,
        }
    }
}

impl Tiles {
    pub(super) fn new(size: (usize, usize)) -> Self {
        Self { columns: size.0 / COARSE, rows: size.1 / COARSE }
    }

    pub(super) fn len(&self) -> usize {
        self.columns * self.rows
    }

    pub(super) fn follow(
        &self,
        index: usize,
        cpu: CpuLevel,
        [first, second]: [&Level; 2],
        known: &Known<'_>,
    ) -> Option<Fine> {
        let corner = ((index % self.columns) * COARSE, (index / self.columns) * COARSE);
        let from = Vector2::new(corner.0 as f32, corner.1 as f32);
        let at = centre::<COARSE>(from);
        let mut motions = Vec::with_capacity(16);
        known.around(at, &mut motions);
        let nearest = &motions[..motions.len().min(4)];
        let dis = disagreement();
        if nearest.iter().all(|(_, m)| (m - nearest[0].1).norm() < dis) {
            return None;
        }
        let mut candidates: Vec<Vector2<f32>> = Vec::with_capacity(CANDIDATES);
        for (_, m) in &motions {
            if candidates.len() < CANDIDATES && candidates.iter().all(|c| (c - m).norm() > knob("CAND", 0.7)) {
                candidates.push(*m);
            }
        }
        let template = CoarseTemplate::new(cpu, first, corner, knob("DAMP", 1.0))?;
        if template.texture < knob("TEXT", 1.0) {
            return None;
        }
        let mut best: Option<Match> = None;
        for c in candidates {
            let Some(found) = template.find(second, from + c, EFFORT) else { continue };
            if (found.corner - from - c).norm() > knob("STRAY", 1.5) || found.step > 0.3 {
                continue;
            }
            let un = |f: &Match| 1.0 - f.correlation * f.correlation + 0.01;
            if best.is_none_or(|b| un(&found) < knob("BETTER", 0.7) * un(&b)) {
                best = Some(found);
            }
        }
        let found = best.filter(|b| b.correlation > knob("CORR", 0.8))?;
        Some(Fine { from, found, texture: template.texture })
    }
}
