// SPDX-License-Identifier: MIT OR Apache-2.0

//! Content-preserving warp: a grid mesh that takes points of a frame to given places and is a similarity, as far as that
//! goes, in each of its triangles.
//!
//! Source: F. Liu, M. Gleicher, H. Jin and A. Agarwala, *Content-preserving warps for 3D video stabilization*, SIGGRAPH
//! 2009, section 4. With V the places of the vertices in the output, it minimises E_d + α·E_s:
//!
//! - data, E_d = Σ l |bᵀV − p̂|²: a point, written as the bilinear combination b of the corners of its cell, belongs at p̂; its
//!   weight l rises after the track starts and falls before it ends, so that the mesh does not jump;
//! - similarity, E_s = Σ |V₁ − V₂ − u (V₃ − V₂) − v R₉₀ (V₃ − V₂)|²: the corner V₁ of a triangle has the coordinates (u, v)
//!   that it has at rest in the frame that the opposite side defines.
//!
//! As there, the mesh at rest is the input's grid moved by the homography that fits the points best. Not as there: the
//! weight of a cell in E_s does not depend on the variance of its colours, as methods here see no pixels; and α is
//! chosen for what is judged here.

use super::banded::Banded;
use super::homography::{apply, linear_step};
use super::timed::untouched;
use super::tracks::Track;
use super::{Correction, Corrections, Input};
use nalgebra::{Matrix3, Vector2};
use rayon::prelude::*;
use rsrectify::motion::image_centre;

/// Columns and rows of cells: 10 pixels wide in a frame of 320 × 240, as are the paper's 64 × 36 in one of 640 × 360.
const CELLS: [usize; 2] = [32, 24];
/// α. Of 20, 5, 1, 0.3 and 0.1, the last two leave the least distortion in the mean of both methods and of six sequences at seed
/// 11, which is not judged; and 0.3 leaves less wobble.
const SIMILARITY: f64 = 0.3;
/// Frames over which the weight of a track rises and falls.
const FADE: f64 = 10.0;
/// Fewer points do not say where a frame belongs.
const LEAST_POINTS: usize = 20;
/// Linear steps of the homography: the denominators settle.
const STEPS: usize = 5;

/// A track, and where it belongs in each frame that sees it.
pub struct Moved<'a> {
    /// The track.
    pub track: &'a Track,
    /// The places in the output, in pixels, one for each of the track's.
    pub to: Vec<Vector2<f64>>,
}

/// The warp of each frame of a run. A frame with fewer than 20 points takes the warp of the nearest frame that has one, so that
/// the picture does not jump; without any, all are left as they are.
pub fn corrections(input: &Input, moved: &[Moved]) -> Corrections {
    let size = [input.readout.width(), input.readout.height()];
    let frames = input.stamps.len();
    let mesh = |frame: usize| {
        let point = |moved: &Moved| {
            let from = moved.track.at(frame)?;
            let to = *moved.to.get(frame - moved.track.first)?;
            Some(Point { from, to, weight: weight(moved.track, frame, frames) })
        };
        let points: Vec<_> = moved.iter().filter_map(point).collect();
        Mesh::fit(size, &points)
    };
    let meshes: Vec<_> = (0..frames).into_par_iter().map(mesh).collect();
    let found = |frame: usize| {
        (0..frames).filter(|other| meshes[*other].is_some()).min_by_key(|other| other.abs_diff(frame))
    };
    let correction = |frame: usize| {
        let mesh = found(frame).and_then(|nearest| meshes[nearest].clone());
        mesh.map_or_else(untouched, |mesh| Box::new(mesh) as Box<dyn Correction>)
    };
    (0..frames).map(correction).collect()
}

/// The weight l of a track in a frame; where the run starts and ends there is nothing to jump from or to.
fn weight(track: &Track, frame: usize, frames: usize) -> f64 {
    let since = if track.first == 0 { FADE } else { (frame - track.first + 1) as f64 };
    let until = if track.end() == frames { FADE } else { (track.end() - frame) as f64 };
    since.min(until).min(FADE) / FADE
}

/// A point of the frame, the place in the output where it belongs, and its weight.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    from: Vector2<f64>,
    to: Vector2<f64>,
    weight: f64,
}

/// A mesh, cell by cell bilinear.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Size of a cell of the input in pixels.
    pitch: Vector2<f64>,
    /// Places of the vertices in the output, column by column.
    vertices: Vec<Vector2<f64>>,
}

impl Mesh {
    /// The mesh for a frame of `size` pixels; `None` where the points do not determine it.
    pub fn fit(size: [usize; 2], points: &[Point]) -> Option<Self> {
        let pitch = Vector2::new(size[0] as f64 / CELLS[0] as f64, size[1] as f64 / CELLS[1] as f64);
        let homography = homography(size, points)?;
        let vertex = |index: usize| {
            let [column, row] = [index / (CELLS[1] + 1), index % (CELLS[1] + 1)].map(|at| at as f64);
            apply(&homography, Vector2::new(column, row).component_mul(&pitch).add_scalar(-0.5))
        };
        let rest: Vec<_> = (0..(CELLS[0] + 1) * (CELLS[1] + 1)).map(vertex).collect();
        let mut mesh = Self { pitch, vertices: rest };
        // The unknowns are the displacements from rest.
        let mut equations = Equations::new(mesh.vertices.len());
        for point in points {
            let (corners, off) = (mesh.corners(point.from), point.to - mesh.correct(point.from));
            for axis in [0, 1] {
                let terms = corners.map(|(vertex, share)| (2 * vertex + axis, share));
                equations.add(&terms, off[axis], point.weight);
            }
        }
        for cell in 0..CELLS[0] * CELLS[1] {
            let corners = corners_of(cell / CELLS[1], cell % CELLS[1]);
            for corner in 0..4 {
                for beside in [1, 3] {
                    let triangle = [0, beside, 2].map(|step| corners[(corner + step) % 4]);
                    equations.keep_similar(triangle, triangle.map(|vertex| mesh.vertices[vertex]));
                }
            }
        }
        let found = equations.normal.solve(equations.right)?;
        for (vertex, moved) in mesh.vertices.iter_mut().zip(found.chunks_exact(2)) {
            *vertex += Vector2::from_column_slice(moved);
        }
        mesh.vertices.iter().all(|vertex| vertex.iter().all(|v| v.is_finite())).then_some(mesh)
    }

    /// The corners of the cell of a place, each with its share of it; outside the frame the nearest cell is extrapolated.
    fn corners(&self, place: Vector2<f64>) -> [(usize, f64); 4] {
        let at = place.add_scalar(0.5).component_div(&self.pitch);
        let [column, row] = [0, 1].map(|axis| (at[axis].max(0.0) as usize).min(CELLS[axis] - 1));
        let (x, y) = (at.x - column as f64, at.y - row as f64);
        let shares = [(1.0 - x) * (1.0 - y), x * (1.0 - y), x * y, (1.0 - x) * y];
        let corners = corners_of(column, row);
        [0, 1, 2, 3].map(|corner| (corners[corner], shares[corner]))
    }
}

impl Correction for Mesh {
    fn correct(&self, pixel: Vector2<f64>) -> Vector2<f64> {
        self.corners(pixel).into_iter().map(|(vertex, share)| self.vertices[vertex] * share).sum()
    }
}

/// The vertices around a cell, one after the other.
fn corners_of(column: usize, row: usize) -> [usize; 4] {
    let vertex = |column: usize, row: usize| column * (CELLS[1] + 1) + row;
    [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(right, down)| vertex(column + right, row + down))
}

/// The normal equations of the displacements of all vertices from rest, x and y in turn.
struct Equations {
    normal: Banded,
    right: Vec<f64>,
}

impl Equations {
    fn new(vertices: usize) -> Self {
        // From a coordinate of one corner of a cell to one of the corner across.
        let reach = 2 * (CELLS[1] + 2) + 1;
        Self { normal: Banded::zeros(2 * vertices, reach), right: vec![0.0; 2 * vertices] }
    }

    /// Σ factor · unknown = value, with a weight.
    fn add(&mut self, terms: &[(usize, f64)], value: f64, weight: f64) {
        for &(row, left) in terms {
            self.right[row] += weight * left * value;
            for &(column, factor) in terms.iter().filter(|term| term.0 <= row) {
                *self.normal.at(row, column) += weight * left * factor;
            }
        }
    }

    /// The similarity of the triangle of three vertices to what it is at rest, where the equations hold.
    fn keep_similar(&mut self, vertices: [usize; 3], rest: [Vector2<f64>; 3]) {
        let side = rest[2] - rest[1];
        let turned = Vector2::new(-side.y, side.x);
        let square = side.norm_squared().max(f64::MIN_POSITIVE);
        let [u, v] = [side, turned].map(|along| (rest[0] - rest[1]).dot(&along) / square);
        let [a, b, c] = vertices.map(|vertex| 2 * vertex);
        let x = [(a, 1.0), (b, u - 1.0), (c, -u), (b + 1, -v), (c + 1, v)];
        let y = [(a + 1, 1.0), (b + 1, u - 1.0), (c + 1, -u), (b, v), (c, -v)];
        self.add(&x, 0.0, SIMILARITY);
        self.add(&y, 0.0, SIMILARITY);
    }
}

/// The homography in pixels from the points to where they belong, of least weighted squares; `None` where they do not determine one.
fn homography(size: [usize; 2], points: &[Point]) -> Option<Matrix3<f64>> {
    if points.len() < LEAST_POINTS {
        return None;
    }
    let scale = size[0].max(size[1]) as f64 / 2.0;
    let centre = image_centre(size[0], size[1]);
    let to_unit =
        Matrix3::new(1.0 / scale, 0.0, -centre.x / scale, 0.0, 1.0 / scale, -centre.y / scale, 0.0, 0.0, 1.0);
    let pair = |point: &Point| ([point.from, point.to].map(|place| (place - centre) / scale), point.weight);
    let mut found = Matrix3::identity();
    for _ in 0..STEPS {
        found = linear_step(&found, points.iter().map(pair))?;
    }
    Some(to_unit.try_inverse()? * found * to_unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;

    const SIZE: [usize; 2] = [320, 240];

    /// Points 10 px apart, each taken to `to`.
    fn points(to: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Vec<Point> {
        let place = |index: usize| Vector2::new((index % 32 * 10 + 5) as f64, (index / 32 * 10 + 4) as f64);
        (0..768).map(place).map(|from| Point { from, to: to(from), weight: 1.0 }).collect()
    }

    fn largest_error(mesh: &Mesh, expected: impl Fn(Vector2<f64>) -> Vector2<f64>) -> f64 {
        let places = (0..77).map(|index| Vector2::new((index % 11 * 31) as f64, (index / 11 * 39) as f64));
        places.map(|place| (mesh.correct(place) - expected(place)).norm()).fold(0.0, f64::max)
    }

    #[test]
    fn an_affine_map_is_reproduced_exactly_also_where_there_are_no_points() {
        let map = |p: Vector2<f64>| Matrix2::new(1.1, 0.08, -0.05, 0.93) * p + Vector2::new(12.0, -7.0);
        let all = points(map);
        let left: Vec<_> = all.iter().filter(|point| point.from.x < 120.0).copied().collect();
        for points in [all, left] {
            let error = largest_error(&Mesh::fit(SIZE, &points).unwrap(), map);
            assert!(error < 1e-8, "{error} px");
        }
    }

    #[test]
    fn a_homography_is_reproduced_as_far_as_cells_are_bilinear() {
        let map = Matrix3::new(1.02, 0.03, 4.0, -0.02, 0.98, 3.0, 2e-4, -1e-4, 1.0);
        let mesh = Mesh::fit(SIZE, &points(|p| apply(&map, p))).unwrap();
        let error = largest_error(&mesh, |p| apply(&map, p));
        assert!(error < 0.05, "{error} px");
    }

    #[test]
    fn a_slow_wave_over_the_rows_is_followed_and_one_of_a_few_rows_is_not() {
        let wave = |rows: f64| {
            move |p: Vector2<f64>| p + Vector2::new(3.0 * (std::f64::consts::TAU * p.y / rows).cos(), 0.0)
        };
        let left = |rows: f64| {
            let mesh = Mesh::fit(SIZE, &points(wave(rows))).unwrap();
            let at = |y: f64| Vector2::new(160.0, y);
            let off = (2..22).map(|row| {
                let place = at(f64::from(row) * 10.0 + 4.0);
                (mesh.correct(place) - wave(rows)(place)).norm_squared()
            });
            (off.sum::<f64>() / 20.0 / 4.5).sqrt()
        };
        assert!(left(240.0) < 0.2 && left(22.0) > 0.75, "{} {}", left(240.0), left(22.0));
    }

    #[test]
    fn too_few_points_move_nothing() {
        assert!(Mesh::fit(SIZE, &points(|p| p)[..LEAST_POINTS - 1]).is_none());
        assert!(Mesh::fit(SIZE, &vec![points(|p| p)[0]; 50]).is_none());
    }

    #[test]
    fn tracks_fade_in_and_out_except_at_the_ends_of_the_run() {
        let track = |first, length| Track { first, places: vec![Vector2::zeros(); length] };
        assert_eq!([3, 5, 22].map(|frame| weight(&track(3, 20), frame, 60)), [0.1, 0.3, 0.1]);
        assert_eq!([0, 59].map(|frame| weight(&track(0, 60), frame, 60)), [1.0, 1.0]);
    }
}
