//! What the library leaves of the displacement on rendered sequences, true delay and long lookahead.

use eval::footage::Footage;
use eval::methods::product::{self, Delay};
use eval::metrics::displacement;
use eval::sequence::{Sequence, named};
use nalgebra::Vector2;
use rsrectify::readout::ReadoutTime;
use rsrectify::rectifier::Settings;

/// Asserts that at most the share `most` of the uncorrected RMS displacement is left.
fn assert_left(name: &str, most: f64) {
    let footage = Footage::render(Sequence::new(named(name).expect("a sequence of the catalogue"))).unwrap();
    let settings = product::settings(footage.settings(), Delay::True, 12);
    let corrections = product::corrections(product::solve(&footage, settings).unwrap());
    let left = displacement::left(&footage.truth, &corrections);
    let share = left.share_of(&footage.uncorrected()).unwrap();
    assert!(share <= most, "{:.1} % left", 100.0 * share);
}

#[test]
fn spiral_rotation_without_delay() {
    assert_left("rot1_B0", 0.15);
}

#[test]
fn three_dimensional_rotation_with_40_blank_rows() {
    assert_left("rot2_B40", 0.22);
}

#[test]
fn strong_shake_with_a_short_readout() {
    assert_left("shake_g042", 0.70);
}

/// Whatever is claimed of the readout, every frame gets a finite motion, and none that is wilder than
/// what the frames show: some 20 px from one to the next.
#[test]
fn a_readout_set_far_wrong_is_survived() {
    let mut settings = named("rot1_B0").expect("a sequence of the catalogue");
    settings.frames = 8;
    let period = 1.0 / settings.fps;
    let footage = Footage::render(Sequence::new(settings)).unwrap();
    let delays = [40.0, 5e3, 1e9].map(ReadoutTime::DelayRows);
    let seconds = [1e-9, period * 1.5, 0.5, 1e9].map(ReadoutTime::Seconds);
    for readout_time in delays.into_iter().chain(seconds) {
        for lookahead in [0, 4] {
            let settings = Settings { lookahead, readout_time, ..Settings::default() };
            let solutions = product::solve(&footage, settings).unwrap();
            for solution in solutions {
                let moved = solution.path.mean_twist().after(period).apply(Vector2::zeros()).norm();
                assert!(moved < 200.0 && solution.residual.is_finite(), "{readout_time:?}: {solution:?}");
            }
        }
    }
}
