// SPDX-License-Identifier: MIT OR Apache-2.0

//! All systems that the report compares, with what each is told.

use super::product::{self, Delay};
use anyhow::Result;
use baselines::methods::affine::Affine;
use baselines::methods::curve::Curve;
use baselines::methods::full3d::Full3d;
use baselines::methods::jitter::Jitter;
use baselines::methods::knots::Knotted;
use baselines::methods::mixture::HomographyMixture;
use baselines::methods::paper::Paper;
use baselines::methods::rotation3d::Rotation3d;
use baselines::methods::translation::Translation;
use baselines::methods::translation3d::Translation3d;
use baselines::methods::{Corrections, Method, Uncorrected, solve};
use render::footage::Footage;
use rsrectify::correspond::Correspondence;
use rsrectify::readout::{Readout, ReadoutTime};
use rsrectify::rectifier::Estimator;

/// A system that is compared.
pub struct Entry {
    /// A short name, unique among the entries.
    pub id: String,
    /// What tables and charts call it.
    pub label: &'static str,
    /// Where it was described.
    pub source: &'static str,
    /// What it is told of the readout time.
    pub told: Delay,
    system: System,
}

enum System {
    /// Takes runs of frames and the correspondences between them.
    Runs(Box<dyn Method>),
    /// The library under test: takes pictures as they arrive and finds its own correspondences.
    Product {
        estimator: Estimator,
        /// Frames it may look ahead.
        lookahead: usize,
    },
}

impl Entry {
    fn runs(method: impl Method + 'static, told: Delay, label: &'static str, source: &'static str) -> Self {
        let id = identity(&method.name(), told);
        Self { id, label, source, told, system: System::Runs(Box::new(method)) }
    }

    fn product(estimator: Estimator, lookahead: usize, told: Delay, label: &'static str) -> Self {
        let name = match estimator {
            Estimator::Sequential => "rsrectify-sequential",
            _ => "rsrectify",
        };
        let id = identity(&format!("{name}-{lookahead}"), told);
        Self { id, label, source: "this library", told, system: System::Product { estimator, lookahead } }
    }

    /// Whether it works on the correspondences that it is given, and not on its own.
    pub fn takes_correspondences(&self) -> bool {
        matches!(self.system, System::Runs(_))
    }

    /// The correction of each frame, given the correspondences of each run of the footage; the readout that was
    /// found by the last frame, where it was not told.
    ///
    /// # Errors
    /// Those of the method.
    pub fn solve(
        &self,
        footage: &Footage,
        pairs: &[Vec<Vec<Correspondence>>],
    ) -> Result<(Corrections, Option<Readout>)> {
        match &self.system {
            System::Runs(method) => {
                Ok((solve(method.as_ref(), footage, readout(footage, self.told), pairs)?, None))
            }
            System::Product { estimator, lookahead } => {
                let settings = product::settings(footage.settings(), self.told, *estimator, *lookahead);
                let solutions = product::solve(footage, settings)?;
                let found = solutions.last().map(|last| *last.motion.readout());
                Ok((product::corrections(solutions), found.filter(|_| self.told == Delay::Unknown)))
            }
        }
    }
}

fn identity(name: &str, told: Delay) -> String {
    match told {
        Delay::True => name.into(),
        Delay::Zero => format!("{name}-delay-0"),
        Delay::Unknown => format!("{name}-unknown"),
    }
}

/// The shutter that a method is told.
fn readout(footage: &Footage, told: Delay) -> Readout {
    let truth = footage.readout();
    match told {
        Delay::True => truth,
        Delay::Zero | Delay::Unknown => {
            let (time, period) = (ReadoutTime::WholePeriod, 1.0 / footage.settings().fps);
            Readout::new(truth.width(), truth.height(), truth.direction(), time, period)
                .expect("a period above 0")
        }
    }
}

/// The systems in the order of the tables.
pub fn all() -> Vec<Entry> {
    use Delay::{True, Unknown, Zero};
    use Estimator::{Continuous, Sequential};
    let mut entries = vec![Entry::runs(Uncorrected, True, "uncorrected", "–")];
    entries.extend(image_plane());
    entries.extend(calibrated());
    entries.extend([
        Entry::product(Sequential, 4, Zero, "rsrectify, sequential, delay 0"),
        Entry::product(Sequential, 4, True, "rsrectify, sequential"),
        Entry::product(Continuous, 0, True, "rsrectify, lookahead 0"),
        Entry::product(Continuous, 4, True, "rsrectify"),
        Entry::product(Continuous, 8, True, "rsrectify, lookahead 8"),
        Entry::product(Continuous, 4, Unknown, "rsrectify, readout unknown"),
    ]);
    entries
}

/// Models in the image plane, which need no calibration.
fn image_plane() -> Vec<Entry> {
    use Delay::{True, Zero};
    let chapter = "chapter 25";
    vec![
        Entry::runs(Translation, True, "translation a frame", "Nicklin 2007, Cho 2007, Chun 2008"),
        Entry::runs(Curve, True, "translation curve", "Liang et al. 2008"),
        Entry::runs(Affine, True, "affine between frames", "Cho and Hong 2007"),
        Entry::runs(Jitter::Translation, True, "jitter, translation", "Baker et al. 2010"),
        Entry::runs(Jitter::Affine, True, "jitter, affine", "Baker et al. 2010"),
        Entry::runs(Paper::Initialisation, True, "2D rotation, initialisation only", chapter),
        Entry::runs(Paper::Sequential, True, "2D rotation, sequential", chapter),
        Entry::runs(Paper::Full, Zero, "2D rotation, delay 0", chapter),
        Entry::runs(Paper::Full, True, "2D rotation", chapter),
        Entry::runs(HomographyMixture, True, "homography mixture", "Grundmann et al. 2012"),
    ]
}

/// Models of the camera in space, which are told its focal length: so many frames to a window, so many knots to a frame.
fn calibrated() -> Vec<Entry> {
    use Delay::True;
    let source = "Forssén and Ringaby 2010";
    vec![
        Entry::runs(Knotted::<Rotation3d>::new(2, 0), True, "3D rotation, 2 frames, constant", source),
        Entry::runs(Knotted::<Rotation3d>::new(2, 1), True, "3D rotation, 2 frames", source),
        Entry::runs(Knotted::<Rotation3d>::new(3, 1), True, "3D rotation, 3 frames", source),
        Entry::runs(Knotted::<Translation3d>::new(2, 1), True, "3D translation, 2 frames", source),
        Entry::runs(Knotted::<Translation3d>::new(3, 1), True, "3D translation, 3 frames", source),
        Entry::runs(Knotted::<Full3d>::new(2, 1), True, "3D full, 2 frames", source),
        Entry::runs(Knotted::<Full3d>::new(3, 1), True, "3D full, 3 frames", source),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use baselines::correspondences::{Source, of_run};
    use nalgebra::Vector2;
    use render::sequence;
    use std::collections::HashSet;

    #[test]
    fn names_are_unique_and_labels_say_so() {
        let entries = all();
        let ids: HashSet<_> = entries.iter().map(|entry| &entry.id).collect();
        let labels: HashSet<_> = entries.iter().map(|entry| entry.label).collect();
        assert_eq!((ids.len(), labels.len()), (entries.len(), entries.len()));
    }

    #[test]
    fn every_system_corrects_every_frame_by_a_finite_amount() {
        let settings =
            sequence::Settings { width: 160, height: 120, frames: 5, ..sequence::named("rot1_B40").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        let pairs: Vec<_> =
            footage.runs().iter().map(|run| of_run(&footage, run, Source::Exact).unwrap()).collect();
        for entry in all() {
            let (corrections, _) = entry.solve(&footage, &pairs).unwrap();
            assert_eq!(corrections.len(), 5, "{}", entry.id);
            for correction in corrections {
                let moved = correction.correct(Vector2::new(40.0, 10.0)) - Vector2::new(40.0, 10.0);
                assert!(moved.norm() < 40.0, "{}: {moved}", entry.id);
            }
        }
    }

    #[test]
    fn delay_0_is_told_as_a_readout_of_the_whole_period() {
        let settings =
            sequence::Settings { width: 160, height: 120, frames: 2, ..sequence::named("btt_g085").unwrap() };
        let footage = Footage::of_settings(&settings).unwrap();
        assert!((readout(&footage, Delay::Zero).time() - 1.0 / 30.0).abs() < 1e-12);
        assert!((readout(&footage, Delay::True).time() - 0.85 / 30.0).abs() < 1e-12);
    }
}
