//! The pairs of a window, held against the path.
//!
//! What a pair leaves and says is kept as long as nothing that it depends on changes: where the evidence of a window
//! was asked for, the next window, a frame later, finds all but its first and last pairs done.

use super::left::{Left, View};
use super::normal::Normal;
use super::pair::Pair;
use super::path::SplinePath;
use nalgebra::Vector2;
use rayon::prelude::*;

/// What the sums of a pair depend on, beside the path.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    stamps: [f64; 2],
    /// Where the first match arrives, as timestamps may come twice.
    first: Option<Vector2<f64>>,
    readout: f64,
    kappa: f64,
    /// Whether the path reaches to the pair before.
    tracks: bool,
}

/// A pair that was held against the path.
#[derive(Clone, Debug, Default)]
pub(super) struct Held {
    pub left: Left,
    pub normal: Normal,
    /// `None` where the path has changed since.
    seen: Option<Seen>,
    /// First block of the path at that time.
    base: i64,
}

/// Marks all as done before the path changed.
pub(super) fn forget(held: &mut [Held]) {
    held.iter_mut().for_each(|held| held.seen = None);
}

/// Holds pairs that follow one another against a path; those that were are not again.
pub(super) fn hold(held: &mut Vec<Held>, pairs: &[&Pair], view: &View<'_>) {
    let wanted = |(index, pair): (usize, &&Pair)| Seen {
        stamps: pair.stamps,
        first: pair.matches.first().map(|m| m.to),
        readout: view.readout,
        kappa: view.path.kappa,
        tracks: index > 0,
    };
    let wanted: Vec<Seen> = pairs.iter().enumerate().map(wanted).collect();
    held.iter_mut().for_each(|held| held.move_to(view.path));
    // What is wanted in its place, the rest wherever there is room.
    held.resize_with(pairs.len().max(held.len()), Held::default);
    for (index, wanted) in wanted.iter().enumerate() {
        if let Some(found) = held.iter().skip(index).position(|held| held.seen == Some(*wanted)) {
            held.swap(index, index + found);
        }
    }
    held.truncate(pairs.len());
    held.par_iter_mut().zip(pairs).zip(&wanted).for_each(|((held, pair), wanted)| {
        if held.seen != Some(*wanted) {
            view.left(pair, wanted.tracks, &mut held.left);
            view.normal(&held.left, &mut held.normal);
            (held.seen, held.base) = (Some(*wanted), view.path.base);
        }
    });
}

impl Held {
    /// Goes on with a path that begins at another block.
    fn move_to(&mut self, path: &SplinePath) {
        if self.base != path.base && !self.normal.equations.shift(path.base - self.base, path) {
            self.seen = None;
        }
        self.base = path.base;
    }
}
