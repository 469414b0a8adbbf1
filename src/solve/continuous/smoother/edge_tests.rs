// SPDX-License-Identifier: MIT OR Apache-2.0

//! The first and the last frame of a shot where nothing is measured in the lines at the end of its path, as behind a dashcam's bonnet.

use super::film::*;

#[test]
fn the_expected_error_of_lines_beyond_all_matches_is_that_of_the_path() {
    // Read from the bottom, the path begins with such lines; else it ends with them.
    for gamma in [0.9, -0.9] {
        let film = Film { fixed: 0.3, ..Film::new(gamma, true) };
        let (solutions, _) = film.solved(film.camera(), &regular(12), 6);
        for solution in [solutions.first(), solutions.last()] {
            let solution = solution.unwrap().as_ref().unwrap();
            let worst = solution.region_errors.iter().copied().fold(0.0, f64::max);
            assert!(
                worst < 2.0 && solution.confidence > 0.9,
                "γ = {gamma}: {worst} px, {}",
                solution.confidence
            );
        }
    }
}
