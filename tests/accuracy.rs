//! What the library leaves of the displacement on rendered sequences, true delay and long lookahead.

use eval::methods::product::{self, Delay};
use eval::metrics::{Stats, displacement, distances};
use eval::scene::Frame;
use eval::sequence::{Sequence, Settings, Strength, named};
use nalgebra::Vector2;
use rsrectify::Rectifier;
use rsrectify::readout::ReadoutTime;
use rsrectify::rectifier::{self, Estimator, FrameSolution};

/// A sequence of the catalogue at half its size: the camera moves as in the whole one, and a quarter of
/// the pixels is rendered.
fn half(name: &str) -> Settings {
    let whole = named(name).expect("a sequence of the catalogue");
    let Strength::Displacement(pixels) = whole.strength else { panic!("{name} displaces nothing") };
    let strength = Strength::Displacement(pixels / 2.0);
    Settings { width: whole.width / 2, height: whole.height / 2, strength, ..whole }
}

fn solve(sequence: &Sequence, frames: &[Frame], settings: rectifier::Settings) -> Vec<FrameSolution> {
    let Settings { width, height, fps, .. } = sequence.settings;
    let mut rectifier = Rectifier::new(settings, width, height, Some(1.0 / fps)).unwrap();
    let stamped = frames.iter().enumerate().map(|(k, frame)| (frame, sequence.start(k)));
    product::motions(&mut rectifier, stamped).unwrap()
}

/// Asserts that at most the share `most` of the uncorrected RMS displacement is left.
fn assert_left(name: &str, estimator: Estimator, most: f64) {
    let sequence = Sequence::new(half(name));
    let frames: Vec<Frame> = sequence.frames().unwrap().collect();
    let settings = product::settings(&sequence.settings, Delay::True, estimator, 12);
    let corrections = product::corrections(solve(&sequence, &frames, settings));
    let samples: Vec<_> = (0..frames.len()).map(|k| sequence.capture(k).samples(8)).collect();
    let uncorrected = displacement::uncorrected(samples.iter().flatten().copied());
    let left =
        samples.iter().zip(&corrections).flat_map(|(samples, own)| distances(samples, |x| own.correct(x)));
    let share = Stats::of(left.collect()).share_of(&uncorrected).unwrap();
    assert!(share <= most, "{:.1} % left", 100.0 * share);
}

#[test]
fn spiral_rotation_without_delay() {
    assert_left("rot1_B0", Estimator::Sequential, 0.15);
    assert_left("rot1_B0", Estimator::Continuous, 0.03);
}

#[test]
fn three_dimensional_rotation_with_40_blank_rows() {
    assert_left("rot2_B40", Estimator::Sequential, 0.22);
    assert_left("rot2_B40", Estimator::Continuous, 0.03);
}

#[test]
fn strong_shake_with_a_short_readout() {
    assert_left("shake_g042", Estimator::Sequential, 0.70);
    assert_left("shake_g042", Estimator::Continuous, 0.03);
}

/// Whatever is claimed of the readout, every frame gets a finite motion, and none that is wilder than
/// what the frames show: some 10 px from one to the next, over as many as the readout is said to take.
#[test]
fn a_readout_set_far_wrong_is_survived() {
    let sequence = Sequence::new(Settings { frames: 8, ..half("rot1_B0") });
    let frames: Vec<Frame> = sequence.frames().unwrap().collect();
    let period = 1.0 / sequence.settings.fps;
    let delays = [40.0, 5e3, 1e9].map(ReadoutTime::DelayRows);
    let seconds = [1e-9, period * 1.5, 0.5, 1e9].map(ReadoutTime::Seconds);
    for readout_time in delays.into_iter().chain(seconds) {
        for lookahead in [0, 4] {
            let mut settings = rectifier::Settings::default();
            (settings.lookahead, settings.readout_time) = (lookahead, readout_time);
            for solution in solve(&sequence, &frames, settings) {
                let corner = Vector2::new(-160.0, -120.0);
                let moved = (solution.motion.path().carry(corner, 0.0, 0.5) - corner).norm();
                let most = 50.0 + 20.0 * solution.motion.readout().time() / period;
                assert!(moved < most, "{readout_time:?}: {moved} px");
                assert!(solution.residual.is_finite() && solution.confidence.is_finite(), "{readout_time:?}");
            }
        }
    }
}
