//! Small patches where the points of the grid are missing or disagree: depth edges, and things that
//! move unlike what is around them.
//!
//! 1. For each cell in which nothing was found a patch of its middle is searched for exhaustively
//!    (`search`), measured forth and back, and kept where neighbours share its motion.
//! 2. The picture is cut into tiles of the size of such a patch. Where points of the grid around a tile are
//!    missing or disagree, it is followed from each of their motions, and keeps the one that shows the same
//!    picture.
//! 3. Tiles that were lost that way are followed from where the tiles next to them were found, then those next
//!    to these, and so on: near things are drawn out so fast across the picture that what is 20 pixels away says
//!    little.
//!
//! 4. Places next to edges choose among all these motions (`edges`).
//!
//! A search takes 66 k multiply-adds; a tile a template and about three samplings for each of at most four
//! motions, 10 k.

use super::Correspondence;
use super::edges::Edges;
use super::field::{Motion, Neighbourhood, Starts};
use super::grid::{Grid, beside, centre};
use super::sampler::{LEAST_TEXTURE, Pair, Patch, level_scale, to_level};
use super::search::best_shift;
use super::tracker::{COARSE, CoarseTemplate, Effort, FINE, Match};
use super::window::Scale;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// The level that is searched: shifts of 16 of its pixels are 64 analysed ones.
const SEARCHED: usize = 2;

/// Searches that end with a lower correlation found nothing.
const LEAST_SEARCH_CORRELATION: f32 = 0.7;

/// Small patches that correlate less are not kept.
const LEAST_CORRELATION: f32 = 0.9;

/// What was searched for is kept where as many neighbours move as it does.
const FEWEST_SUPPORTERS: usize = 2;

/// What was searched for lies this close, in pixels, to where the search saw it, and comes back as close.
const SEARCH_ERROR: f32 = 3.0;
const MOST_RETURN_ERROR: f32 = 0.7;

/// Motions at a tile further apart than this, in pixels, disagree.
const DISAGREEMENT: f32 = 1.0;

/// Points of the grid further than this from a tile, in cells, do not tell what it does.
const BESIDE: f32 = 1.5;

/// Motions that are tried for a tile, at most.
const STARTS: usize = 4;

/// A tile lies this close, in pixels, to where one of the points around has it.
const MOST_STRAY: f32 = 1.5;

/// A tile lies this close, in pixels, to where one next to it has it.
const MOST_GROWTH: f32 = 3.0;

/// Tiles, one after another, over which a motion is handed on.
const GROWTHS: usize = 16;

/// A later start wins over an earlier, nearer one where it leaves this share of what that leaves
/// unexplained of a patch; a hundredth may be unexplained for any reason.
const CLEARLY_BETTER: f32 = 0.7;
const TOLERANCE: f32 = 0.01;

/// Squared grey levels added to the eigenvalues: along an edge the start is kept.
const SEARCH_DAMPING: f32 = 0.3;
const TILE_DAMPING: f32 = 1.0;

const MIDDLE_EFFORT: Effort = Effort { iterations: 4, tolerance: 0.1 };
const SEARCH_EFFORT: Effort = Effort { iterations: 8, tolerance: 0.05 };
const TILE_EFFORT: Effort = Effort { iterations: 4, tolerance: 0.05 };

/// A measured motion and how it changes from pixel to pixel around it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    pub(super) motion: Motion,
    pub(super) slope: Matrix2<f32>,
}

/// A small patch that was found.
type Small = Patch<COARSE>;

/// What small patches found in a pair of frames.
#[derive(Debug, Default)]
pub(super) struct Refinement {
    /// By cell of the grid: what is known of the motion.
    known: Vec<Option<Local>>,
    motions: Vec<Option<Motion>>,
    /// By cell of the grid.
    searched: Vec<Option<Small>>,
    tiles: Vec<Tile>,
    edges: Edges,
}

/// What is known of a tile.
#[derive(Clone, Copy, Debug, Default)]
enum Tile {
    /// There are points of the grid all around it, and they agree.
    #[default]
    Plain,
    /// None of the motions that were tried shows the same picture.
    Lost,
    /// Found after so many motions had been handed on.
    Found(Small, usize),
}

impl Tile {
    fn small(&self) -> Option<&Small> {
        if let Self::Found(small, _) = self { Some(small) } else { None }
    }
}

impl Refinement {
    /// Refines what is known of the motion at the cells of the grid.
    pub(super) fn run(
        &mut self,
        pair: &Pair<'_>,
        grid: &Grid,
        known: impl Iterator<Item = Option<Local>>,
        scale: Scale,
    ) {
        self.known.clear();
        self.known.extend(known);
        self.search(pair, grid);
        self.follow_tiles(pair, grid.columns);
        let of_grid = self.known.iter().flatten().map(|local| local.motion);
        let of_tiles = self.tiles.iter().filter_map(Tile::small).map(Patch::motion);
        self.edges.run(pair, of_grid.chain(of_tiles), scale);
    }

    /// What was found last; `scale` full-frame pixels make an analysed one.
    pub(super) fn found(&self, scale: f64) -> impl Iterator<Item = Correspondence> {
        let small = self.searched.iter().flatten().chain(self.tiles.iter().filter_map(Tile::small));
        small.map(move |small| small.to_full(scale)).chain(self.edges.found(scale))
    }

    /// Searches the cells of which nothing is known, and adds what was found to what is known.
    fn search(&mut self, pair: &Pair<'_>, grid: &Grid) {
        self.motions.clear();
        self.motions.extend(self.known.iter().map(|local| local.map(|local| local.motion)));
        self.searched.resize(grid.len(), None);
        let (known, motions) = (&self.known, &self.motions);
        self.searched.par_iter_mut().enumerate().with_min_len(8).for_each(|(index, searched)| {
            let corner = grid.corner(index).filter(|_| known.get(index).is_some_and(Option::is_none));
            *searched = corner.and_then(|(x, y)| {
                let at = centre::<FINE>(Vector2::new(x as f32, y as f32));
                let around = Neighbourhood::new(motions, grid.columns, index).agreement(at);
                search_patch(pair, at, around.shift.unwrap_or_default())
            });
        });
        for (motion, searched) in self.motions.iter_mut().zip(&self.searched) {
            *motion = motion.or(searched.map(|small| small.motion()));
        }
        let cells = self.searched.iter_mut().zip(&mut self.known).enumerate();
        for (index, (searched, known)) in cells.filter(|(_, (searched, _))| searched.is_some()) {
            let around = Neighbourhood::new(&self.motions, grid.columns, index);
            *searched = searched
                .filter(|small| around.support(small.motion(), &Matrix2::identity()) >= FEWEST_SUPPORTERS);
            *known = searched.map(|small| Local { motion: small.motion(), slope: Matrix2::zeros() });
        }
    }

    fn follow_tiles(&mut self, pair: &Pair<'_>, columns: usize) {
        let Some(level) = pair.first.first() else { return };
        let across = level.width / COARSE;
        let around = Around::new(&self.known, columns, (level.width, level.height));
        self.tiles.resize(across * (level.height / COARSE), Tile::Plain);
        self.tiles.par_iter_mut().enumerate().with_min_len(64).for_each(|(index, tile)| {
            let corner = tile_corner(index, across);
            *tile = match around.opinion(centre::<COARSE>(corner)) {
                Opinion::Agreed => Tile::Plain,
                Opinion::Few(starts) => {
                    let found = follow_tile(pair, corner, starts.list(), MOST_STRAY);
                    found.map_or(Tile::Lost, |small| Tile::Found(small, 0))
                }
            };
        });
        for handed in 0..GROWTHS {
            let tiles = &self.tiles;
            let lost = tiles.par_iter().enumerate().with_min_len(256);
            let grown: Vec<_> = lost
                .filter(|(_, tile)| matches!(tile, Tile::Lost))
                .filter_map(|(index, _)| {
                    let (starts, count) = found_beside(tiles, across, index, handed);
                    let corner = tile_corner(index, across);
                    Some((index, follow_tile(pair, corner, &starts[..count], MOST_GROWTH)?))
                })
                .collect();
            if grown.is_empty() {
                return;
            }
            grown.into_iter().for_each(|(index, small)| self.tiles[index] = Tile::Found(small, handed + 1));
        }
    }
}

/// The top left pixel of a tile.
fn tile_corner(index: usize, across: usize) -> Vector2<f32> {
    Vector2::new((index % across * COARSE) as f32, (index / across * COARSE) as f32)
}

/// Motions of the four tiles next to one that were found after `handed` motions had been handed on.
fn found_beside(
    tiles: &[Tile],
    across: usize,
    index: usize,
    handed: usize,
) -> ([Vector2<f32>; STARTS], usize) {
    let mut starts = [Vector2::zeros(); STARTS];
    let mut count = 0;
    for tile in beside(index, across).filter_map(|index| tiles.get(index)) {
        if let Tile::Found(small, after) = tile
            && *after == handed
        {
            starts[count] = small.found.corner - small.from;
            count += 1;
        }
    }
    (starts, count)
}

/// Searches the patch around `at` near the shift `expected`, and measures it forth and back.
fn search_patch(pair: &Pair<'_>, at: Vector2<f32>, expected: Vector2<f32>) -> Option<Small> {
    let level = SEARCHED.min(pair.first.len().checked_sub(1)?);
    let levels = [pair.first.get(level)?, pair.second.get(level)?];
    let (shift, score) = best_shift(pair.cpu, levels, to_level(at, level), expected / level_scale(level))?;
    if score < LEAST_SEARCH_CORRELATION {
        return None;
    }
    let shift = (1..level).rev().fold(shift * level_scale(level), |shift, level| {
        follow_down(pair, level, at, shift / level_scale(level))
            .map_or(shift, |shift| shift * level_scale(level))
    });
    let from = at.add_scalar(-0.5 * (COARSE as f32 - 1.0)).map(f32::round);
    let there = small_match(pair, from, shift)?;
    let nearest = there.found.corner.map(f32::round);
    let home = from - there.found.corner;
    let back = small_match(&pair.reversed(), nearest, home)?;
    let error = back.found.corner - nearest - home;
    (error.norm() <= MOST_RETURN_ERROR).then_some(there)
}

/// The shift of the patch around a point on a level between, from one near it (pixels of the level).
fn follow_down(pair: &Pair<'_>, level: usize, at: Vector2<f32>, shift: Vector2<f32>) -> Option<Vector2<f32>> {
    let from = to_level(at, level).add_scalar(-0.5 * (COARSE as f32 - 1.0)).map(f32::round);
    let corner = (from.x as usize, from.y as usize);
    let template = CoarseTemplate::new(pair.cpu, pair.first.get(level)?, corner, TILE_DAMPING)?;
    let found = template.find(pair.second.get(level)?, from + shift, MIDDLE_EFFORT)?;
    (found.correlation >= LEAST_SEARCH_CORRELATION).then_some(found.corner - from)
}

/// Measures the small patch at `from` on the finest level, near a shift that was seen.
fn small_match(pair: &Pair<'_>, from: Vector2<f32>, shift: Vector2<f32>) -> Option<Small> {
    let corner = (from.x as usize, from.y as usize);
    let template = CoarseTemplate::new(pair.cpu, pair.first.first()?, corner, SEARCH_DAMPING)?;
    let found = template.find(pair.second.first()?, from + shift, SEARCH_EFFORT)?;
    let stray = (found.corner - from - shift).norm();
    let is_found = template.texture >= LEAST_TEXTURE
        && found.correlation >= LEAST_CORRELATION
        && found.step <= MIDDLE_EFFORT.tolerance
        && stray <= SEARCH_ERROR;
    is_found.then_some(Small { from, found, texture: template.texture })
}

/// Follows the tile at `from` from some motions, to at most `most` pixels from where they have it; the nearest
/// first.
fn follow_tile(pair: &Pair<'_>, from: Vector2<f32>, starts: &[Vector2<f32>], most: f32) -> Option<Small> {
    if starts.is_empty() {
        return None;
    }
    let corner = (from.x as usize, from.y as usize);
    let template = CoarseTemplate::new(pair.cpu, pair.first.first()?, corner, TILE_DAMPING)?;
    if template.texture.is_nan() || template.texture < LEAST_TEXTURE {
        return None;
    }
    let second = pair.second.first()?;
    let unexplained = |found: &Match| 1.0 - found.correlation * found.correlation + TOLERANCE;
    let mut best: Option<Match> = None;
    for start in starts {
        let Some(found) = template.find(second, from + start, TILE_EFFORT) else { continue };
        let is_near = (found.corner - from - start).norm() <= most;
        let is_better = best.is_none_or(|best| unexplained(&found) < CLEARLY_BETTER * unexplained(&best));
        if is_near && is_better {
            best = Some(found);
        }
        if best.is_some_and(|best| CLEARLY_BETTER * unexplained(&best) <= TOLERANCE) {
            break;
        }
    }
    let found = best.filter(|best| best.correlation >= LEAST_CORRELATION)?;
    Some(Small { from, found, texture: template.texture })
}

/// The points of the grid as seen from between them.
struct Around<'a> {
    known: &'a [Option<Local>],
    columns: usize,
    rows: usize,
    /// Pixels from point to point.
    cell: Vector2<f32>,
}

/// What the points of the grid say of a tile.
enum Opinion {
    /// Four points are near, and agree.
    Agreed,
    /// Distinct motions, the nearest first; none where nothing is known.
    Few(Starts<STARTS>),
}

/// Points of the grid around a tile along one axis.
const SIDE: usize = 4;

impl<'a> Around<'a> {
    fn new(known: &'a [Option<Local>], columns: usize, size: (usize, usize)) -> Self {
        let rows = known.len() / columns.max(1);
        let cell = Vector2::new(size.0 as f32 / columns.max(1) as f32, size.1 as f32 / rows.max(1) as f32);
        Self { known, columns, rows, cell }
    }

    /// Distinct motions of the 4 × 4 points around a point, carried to it, the nearest first.
    fn opinion(&self, at: Vector2<f32>) -> Opinion {
        let (motions, count) = self.motions(at);
        let motions = &motions[..count];
        if let [first, second, third, fourth, ..] = motions {
            let agrees = |(distance, motion): &(f32, Vector2<f32>)| {
                *distance < BESIDE && (motion - first.1).norm() < DISAGREEMENT
            };
            if [first, second, third, fourth].into_iter().all(agrees) {
                return Opinion::Agreed;
            }
        }
        let mut starts = Starts::default();
        motions.iter().for_each(|(_, motion)| starts.add(*motion));
        Opinion::Few(starts)
    }

    /// Motions of the 4 × 4 points around a point, carried to it, by distance, and how many there are.
    fn motions(&self, at: Vector2<f32>) -> ([(f32, Vector2<f32>); SIDE * SIDE], usize) {
        let mut motions = [(0.0, Vector2::zeros()); SIDE * SIDE];
        let mut count = 0;
        let place = at.add_scalar(0.5).component_div(&self.cell).map(|place| (place - 0.5).floor() as isize);
        // Outside the outermost points nothing is missing.
        let most =
            Vector2::new(self.columns as f32, self.rows as f32).add_scalar(-0.5).component_mul(&self.cell);
        let between = at.sup(&(0.5 * self.cell)).inf(&most);
        for index in 0..SIDE * SIDE {
            let (i, j) = (place.x - 1 + (index % SIDE) as isize, place.y - 1 + (index / SIDE) as isize);
            let inside = (0..self.columns as isize).contains(&i) && (0..self.rows as isize).contains(&j);
            let cell = inside.then(|| j as usize * self.columns + i as usize);
            if let Some(local) = cell.and_then(|cell| self.known.get(cell).copied().flatten()) {
                let distance = (local.motion.at - between).component_div(&self.cell).norm();
                motions[count] = (distance, local.motion.carried(at, &local.slope));
                count += 1;
            }
        }
        motions[..count].sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        (motions, count)
    }
}

#[cfg(test)]
#[path = "refine_tests.rs"]
mod tests;
