// SPDX-License-Identifier: MIT OR Apache-2.0

//! The first frame of a stream.

use super::film::*;

#[test]
fn the_first_window_nearly_always_finds_the_readout() {
    let film = Film::new(0.8, true);
    let stamps = regular(60 + LOOKAHEAD);
    // The film from each frame on.
    let confidence = |(seed, stamps)| {
        let (motions, _) = film.solved(UNKNOWN, stamps, seed);
        motions[0].as_ref().map_or(0.0, |first| first.confidence)
    };
    let confidences: Vec<f64> = (1..).zip(stamps.windows(LOOKAHEAD + 1)).map(confidence).collect();
    let unknown = confidences.iter().filter(|confidence| **confidence < 0.5).count();
    assert!(unknown <= 1, "{unknown} of {confidences:.2?}");
}
