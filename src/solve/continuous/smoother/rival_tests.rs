// SPDX-License-Identifier: MIT OR Apache-2.0

//! How often hypotheses beside the likeliest one are fitted.

use super::film::*;
use super::*;
use crate::readout::ReadoutDirection;
use crate::solve::random::Random;

/// Whether a rival with these log odds, which has the path of the leading hypothesis when it joins, is fitted to each of the next frames.
fn fits_of_rival(log_odds: f64) -> Vec<bool> {
    let film = Film::new(0.8, true);
    let mut random = Random(7);
    let mut continuous = Continuous::new(UNKNOWN, SIZE[0], SIZE[1], 1.0);
    let stamps = regular(30);
    let mut fits = Vec::new();
    for (k, &stamp) in stamps.iter().enumerate() {
        let pair = k.checked_sub(1).map(|last| film.pair(stamps[last], stamp, &mut random));
        push(&mut continuous, pair.as_deref(), stamp);
        if k == 24 {
            let mut rival = continuous.posterior.leading().clone();
            rival.scan = ReadoutDirection::LeftToRight.into();
            rival.log_probability += log_odds;
            continuous.posterior.hypotheses.push(rival);
        }
        if k >= LOOKAHEAD {
            settle(&mut continuous);
        }
        if k >= 24 {
            fits.extend(continuous.posterior.hypotheses.get(1).map(|rival| rival.is_fitted));
        }
    }
    fits
}

#[test]
fn a_rival_is_fitted_to_each_window_unless_it_is_unlikely_and_its_path_covers_the_frame() {
    assert!(fits_of_rival(-2.0)[0]);
    // The path ends with the frame that was looked ahead at last.
    let fits = fits_of_rival(-5.0);
    let is_last = |frame: usize| frame == LOOKAHEAD;
    assert!((0..=LOOKAHEAD).all(|frame| fits[frame] == is_last(frame)), "{fits:?}");
}
