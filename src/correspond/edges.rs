//! Which of the motions around a place shows the same picture there: depth edges, place by place.
//!
//! A patch that lies across an edge follows the side with more contrast, mostly the outline of the nearer thing, so
//! that a strip beside that thing seems to move along with it. Here the places of a regular mesh choose among the
//! motions that were found around them: the one that takes the place to where the other frame shows the same,
//! in a window that counts what looks like the place itself (`window`). Each motion is fitted to the place first,
//! for near things turn and grow. Then places try what those next to them chose, which carries motions along
//! thin things (Barnes et al., *PatchMatch*, SIGGRAPH 2009).
//!
//! Both frames of a pair choose, each for its own places. A place that the other frame does not show fits badly
//! there, but well in the frame on its other side in time: whoever has both tells them by their residuals.
//!
//! A place costs a window of 1.5 k operations, and for each of two or three motions two or three samplings of 2 k.
//! Places around which all motions agree cost nothing.

use super::Correspondence;
use super::field::{Motion, Starts};
use super::grid::beside;
use super::pyramid::Level;
use super::sampler::{LEAST_TEXTURE, Pair, to_full};
use super::window::{Fit, Scale, Window};
use nalgebra::Vector2;
use rayon::prelude::*;

/// Analysed pixels from place to place.
const SPACING: usize = 8;

/// Motions in a cell of that size that are kept, at most.
const KEPT: usize = 2;

/// Cells to each side of a place in which motions are looked for.
const REACH: usize = 2;

/// Motions around a place, at most.
const AROUND: usize = KEPT * (2 * REACH + 1) * (2 * REACH + 1);

/// Motions that are tried for a place, at most.
const STARTS: usize = 6;

/// Motions further than this, in pixels, from the first one around a place disagree; less is a slant.
const DISAGREEMENT: f32 = 2.0;

/// A motion is taken over from the next place where it leaves this share of what the own one leaves.
const CLEARLY_BETTER: f32 = 0.7;

/// Places, one after another, over which a motion is handed on.
const GROWTHS: usize = 4;

/// What the places of a pair of frames chose.
#[derive(Debug, Default)]
pub(super) struct Edges {
    cells: Cells,
    choices: Vec<Option<Choice>>,
    chosen: Vec<Chosen>,
}

/// A place with a motion, analysed pixels.
#[derive(Clone, Copy, Debug)]
struct Chosen {
    first: Vector2<f32>,
    second: Vector2<f32>,
    residual: f32,
    texture: f32,
}

/// The motion of a place.
#[derive(Clone, Copy, Debug)]
struct Choice {
    fit: Fit,
    /// Motions that had been handed on before.
    handed: usize,
}

impl Edges {
    /// Chooses in both frames of a pair, among motions from the first to the second.
    pub(super) fn run(
        &mut self,
        pair: &Pair<'_>,
        motions: impl Iterator<Item = Motion> + Clone,
        scale: Scale,
    ) {
        self.chosen.clear();
        self.choose(pair, motions.clone(), scale);
        let forward = self.cells.chosen(&self.choices);
        self.chosen.extend(forward);
        let back = motions.map(|motion| Motion { at: motion.at + motion.shift, shift: -motion.shift });
        self.choose(&pair.reversed(), back, scale.reversed());
        let backward = self.cells.chosen(&self.choices);
        self.chosen.extend(backward.map(|to| Chosen { first: to.second, second: to.first, ..to }));
    }

    /// What was chosen last; `scale` full-frame pixels make an analysed one.
    pub(super) fn found(&self, scale: f64) -> impl Iterator<Item = Correspondence> {
        self.chosen.iter().map(move |chosen| Correspondence {
            from: to_full(chosen.first, scale),
            to: to_full(chosen.second, scale),
            texture: chosen.texture,
            residual: chosen.residual,
        })
    }

    /// Chooses for the places of the first frame of a pair.
    fn choose(&mut self, pair: &Pair<'_>, motions: impl Iterator<Item = Motion>, scale: Scale) {
        self.choices.clear();
        let (Some(first), Some(second)) = (pair.first.first(), pair.second.first()) else { return };
        self.cells.fill(first, motions);
        let chooser = Chooser { pair, first, second, scale, cells: &self.cells };
        self.choices.resize(self.cells.motions.len(), None);
        let choices = self.choices.par_iter_mut().enumerate().with_min_len(64);
        choices.for_each(|(index, choice)| {
            *choice = chooser.best(index).map(|fit| Choice { fit, handed: 0 });
        });
        for handed in 0..GROWTHS {
            let places = (0..self.choices.len()).into_par_iter().with_min_len(256);
            let choices = &self.choices;
            let grown: Vec<_> =
                places.filter_map(|index| Some((index, chooser.grown(choices, index, handed)?))).collect();
            if grown.is_empty() {
                return;
            }
            for (index, fit) in grown {
                self.choices[index] = Some(Choice { fit, handed: handed + 1 });
            }
        }
    }
}

/// Chooses for the places of one frame.
struct Chooser<'a> {
    pair: &'a Pair<'a>,
    first: &'a Level,
    second: &'a Level,
    scale: Scale,
    cells: &'a Cells,
}

impl Chooser<'_> {
    /// Of the motions around a place that fits best, or the nearest that leaves no more than noise; `None` where
    /// all agree.
    fn best(&self, index: usize) -> Option<Fit> {
        if self.cells.agree(index) {
            return None;
        }
        let window = self.window(index)?;
        let mut best: Option<Fit> = None;
        for start in self.cells.around(index).starts().list() {
            let Some(fit) = window.fit(self.second, *start) else { continue };
            if best.is_none_or(|best| fit.cost < best.cost) {
                best = Some(fit);
            }
            if fit.cost <= self.scale.enough() {
                break;
            }
        }
        best
    }

    /// What a place takes over from those next to it that chose after `handed` motions had been handed on.
    fn grown(&self, choices: &[Option<Choice>], index: usize, handed: usize) -> Option<Fit> {
        let choice = |index: usize| choices.get(index).copied().flatten();
        let own = choice(index).map(|choice| choice.fit);
        let is_good = |fit: Option<Fit>| fit.is_some_and(|fit| fit.cost <= self.scale.enough());
        let newest =
            || beside(index, self.cells.columns).filter_map(choice).filter(|next| next.handed == handed);
        if is_good(own) || newest().next().is_none() {
            return None;
        }
        let start = own.map(|fit| fit.shift).or_else(|| self.cells.around(index).nearest())?;
        let mut starts = Starts::<STARTS>::default();
        starts.add(start);
        newest().for_each(|next| starts.add(next.fit.shift));
        let [_, others @ ..] = starts.list() else { return None };
        if others.is_empty() {
            return None;
        }
        let window = self.window(index)?;
        let own = own.or_else(|| window.fit(self.second, start));
        if is_good(own) {
            return None;
        }
        let fits = others.iter().filter_map(|start| window.fit(self.second, *start));
        let fit = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        own.is_none_or(|own| fit.cost < CLEARLY_BETTER * own.cost).then_some(fit)
    }

    fn window(&self, index: usize) -> Option<Window> {
        Window::new(self.pair.cpu, self.first, self.cells.place(index), self.scale)
    }
}

/// Motions in cells around the places.
#[derive(Debug, Default)]
struct Cells {
    columns: usize,
    rows: usize,
    motions: Vec<[Option<Motion>; KEPT]>,
}

impl Cells {
    fn fill(&mut self, level: &Level, motions: impl Iterator<Item = Motion>) {
        (self.columns, self.rows) = (level.width / SPACING + 1, level.height / SPACING + 1);
        self.motions.clear();
        self.motions.resize(self.columns * self.rows, [None; KEPT]);
        for motion in motions {
            let place = (motion.at / SPACING as f32).map(f32::round);
            let inside = |place: f32, count: usize| place >= 0.0 && place < count as f32;
            if !(inside(place.x, self.columns) && inside(place.y, self.rows)) {
                continue;
            }
            let cell = place.y as usize * self.columns + place.x as usize;
            if let Some(free) = self.motions[cell].iter_mut().find(|motion| motion.is_none()) {
                *free = Some(motion);
            }
        }
    }

    fn place(&self, index: usize) -> Vector2<f32> {
        Vector2::new((index % self.columns) as f32, (index / self.columns) as f32) * SPACING as f32
    }

    /// The motions within reach of a place.
    fn near(&self, index: usize) -> impl Iterator<Item = &Motion> {
        let (column, row) = (index % self.columns, index / self.columns);
        let range = |at: usize, count: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(count);
        let across = range(column, self.columns);
        let rows = range(row, self.rows)
            .map(move |y| &self.motions[y * self.columns + across.start..y * self.columns + across.end]);
        rows.flatten().flatten().flatten()
    }

    /// Whether the motions around a place are one.
    fn agree(&self, index: usize) -> bool {
        let mut near = self.near(index);
        let Some(first) = near.next() else { return true };
        near.all(|motion| (motion.shift - first.shift).norm_squared() <= DISAGREEMENT * DISAGREEMENT)
    }

    fn around(&self, index: usize) -> Around {
        let at = self.place(index);
        let mut around = Around { motions: [(0.0, Vector2::zeros()); AROUND], count: 0 };
        for (slot, motion) in around.motions.iter_mut().zip(self.near(index)) {
            *slot = ((motion.at - at).norm_squared(), motion.shift);
            around.count += 1;
        }
        around
    }

    /// The places that can be told, with their motions.
    fn chosen(&self, choices: &[Option<Choice>]) -> impl Iterator<Item = Chosen> {
        let fits = choices.iter().enumerate().filter_map(|(index, choice)| Some((index, (*choice)?.fit)));
        fits.filter(|(_, fit)| fit.texture >= LEAST_TEXTURE).map(|(index, fit)| {
            let first = self.place(index);
            Chosen { first, second: first + fit.shift, residual: fit.cost.sqrt(), texture: fit.texture }
        })
    }
}

/// Motions around a place, each with its squared distance.
struct Around {
    motions: [(f32, Vector2<f32>); AROUND],
    count: usize,
}

impl Around {
    fn list(&self) -> &[(f32, Vector2<f32>)] {
        &self.motions[..self.count]
    }

    fn nearest(&self) -> Option<Vector2<f32>> {
        self.list().iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, shift)| *shift)
    }

    /// Distinct motions, the nearest first.
    fn starts(mut self) -> Starts<STARTS> {
        self.motions[..self.count].sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut starts = Starts::default();
        self.list().iter().for_each(|(_, shift)| starts.add(*shift));
        starts
    }
}

#[cfg(test)]
#[path = "edges_tests.rs"]
mod tests;
