// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the library leaves of the displacement on rendered sequences, true delay and long lookahead.

use eval::systems::product::{self, Delay};
use nalgebra::Vector2;
use render::scene::Frame;
use render::sequence::{Sequence, Settings, Strength, named};
use render::stats::{self, Stats, distances};
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
    let uncorrected = stats::uncorrected(samples.iter().flatten().copied());
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

/// The frame with each pixel shown `factor` times along either axis.
fn enlarged(frame: &Frame, factor: usize) -> Frame {
    let mut rgb = Vec::with_capacity(frame.rgb.len() * factor * factor);
    for row in frame.rgb.chunks_exact(3 * frame.width) {
        let row: Vec<u8> = row.chunks_exact(3).flat_map(|pixel| pixel.repeat(factor)).collect();
        rgb.extend(row.repeat(factor));
    }
    Frame { width: frame.width * factor, height: frame.height * factor, rgb }
}

/// What is found of one film, nothing of its readout given, at an analysed pixel of 1, 2 and 4 full ones, the last two as
/// 1080p and 4K: the picture that is analysed is the same.
fn found_at_three_sizes() -> [Vec<FrameSolution>; 3] {
    let film = named("hand_g08").expect("a sequence of the catalogue");
    let strength = Strength::Displacement(5.0);
    let sequence = Sequence::new(Settings { width: 960, height: 540, frames: 12, strength, ..film });
    let frames: Vec<Frame> = sequence.frames().unwrap().collect();
    let settings = product::settings(&sequence.settings, Delay::Unknown, Estimator::Continuous, 4);
    [1, 2, 4].map(|factor| {
        let larger = Settings { width: 960 * factor, height: 540 * factor, ..sequence.settings.clone() };
        let frames: Vec<Frame> = frames.iter().map(|frame| enlarged(frame, factor)).collect();
        let stamped = frames.iter().enumerate().map(|(k, frame)| (frame, sequence.start(k)));
        let period = Some(1.0 / larger.fps);
        let mut rectifier = Rectifier::new(settings, larger.width, larger.height, period).unwrap();
        product::motions(&mut rectifier, stamped).unwrap()
    })
}

/// By how much a frame of 960 columns, times `factor`, is corrected at some points, in pixels of 960 columns.
fn corrections_at(solution: &FrameSolution, factor: f64) -> impl Iterator<Item = Vector2<f64>> {
    let half = Vector2::new(0.5, 0.5);
    let points = (0..96).map(|k| Vector2::new((k % 12 * 80 + 40) as f64, (k / 12 * 64 + 46) as f64));
    points.map(move |point| {
        let pixel = point * factor - half;
        (product::corrected(solution, pixel) - pixel) / factor
    })
}

/// The greatest difference of a solution from that of the same film with fewer pixels: of the readout ratio, and of the
/// correction over its size (root mean squares).
fn differences(fewer: &[FrameSolution], more: &[FrameSolution], factor: f64) -> [f64; 2] {
    let ratio = |solution: &FrameSolution| 30.0 * solution.motion.readout().time();
    let frames = fewer.iter().zip(more);
    let readout = frames.clone().map(|(a, b)| (ratio(a) - ratio(b)).abs()).fold(0.0, f64::max);
    let corrections = frames.flat_map(|(a, b)| corrections_at(a, 1.0).zip(corrections_at(b, factor)));
    let squares = corrections.map(|(a, b)| [(a - b).norm_squared(), a.norm_squared()]);
    let [off, whole] = squares.fold([0.0; 2], |[off, whole], [a, b]| [off + a, whole + b]);
    [readout, (off / whole).sqrt()]
}

/// All that is left to differ is rounding.
#[test]
fn more_pixels_of_the_same_picture_change_nothing() {
    let [small, larger, largest] = found_at_three_sizes();
    for (more, factor) in [(&larger, 2.0), (&largest, 4.0)] {
        let [readout, correction] = differences(&small, more, factor);
        assert!(readout < 1e-4 && correction < 1e-4, "× {factor}: {readout}, {correction}");
    }
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
