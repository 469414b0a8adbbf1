// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is said of a camera, as text and for JSON.

use crate::camera::{Expectation, Known, Stated};
use crate::estimate::{Estimate, combine};
use crate::property_values::{Direction, name_of};
use crate::readout::{Doubt, Found};
use rsrectify::readout::ReadoutPosterior;
use rsrectify::rectifier::Timeline;
use serde::Serialize;
use std::fmt;

/// What a clip says of its camera.
#[derive(Clone, Debug, Serialize)]
pub struct Measurement {
    pub clip: String,
    /// Pixels.
    pub width: u32,
    pub height: u32,
    /// Frames a second; absent where the file does not say and there are too few frames.
    pub frame_rate: Option<f64>,
    pub frames: u32,
    /// Frames of whose motion at least half is trusted.
    pub frames_with_motion: u32,
    /// Whether the readout can be relied on.
    pub certain: bool,
    /// Why not.
    pub doubts: Vec<String>,
    /// Whether the frames were moved after their readout, as by stabilisation in the camera: `yes`, `no` or `undecided`.
    pub stabilised: String,
    /// Whether leans of such frames are seen, by which they can be rectified.
    pub shows_leans: bool,
    /// When the frames were exposed: `as stated`, or how a conversion of the frame rate has changed it.
    pub timeline: String,
    /// Frames of the clip at which another shot begins; absent where only stretches of it were analysed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cuts: Option<Vec<usize>>,
    /// What the camera states about the clip; absent where nothing is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stated: Option<Stated>,
    /// What is known of the camera in this mode, which has changed nothing of the rest; absent where nothing is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected: Option<Expected>,
    /// Whether the picture shows clearly another readout than the expected one; absent where none is expected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overrules_expected: Option<bool>,
    #[serde(flatten)]
    pub posterior: Option<Posterior>,
    #[serde(flatten)]
    pub camera: Camera,
}

/// The readout of a camera that is known.
#[derive(Clone, Debug, Serialize)]
pub struct Expected {
    pub camera: String,
    /// Size and frame rate.
    pub mode: String,
    pub direction: String,
    pub signed_readout_ms: f64,
    pub deviation_ms: f64,
    /// Where that is from.
    pub source: String,
    /// The readout of the sensor, where the camera stabilised the clip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_stabilisation_ms: Option<f64>,
    #[serde(skip)]
    note: String,
}

impl From<&Expectation> for Expected {
    fn from(expectation: &Expectation) -> Self {
        Self {
            camera: expectation.camera.clone(),
            mode: expectation.mode.clone(),
            direction: name_of(&Direction::from(expectation.direction)),
            signed_readout_ms: expectation.signed_milliseconds(),
            deviation_ms: expectation.deviation,
            source: expectation.source.clone(),
            without_stabilisation_ms: expectation.without_stabilisation,
            note: expectation.note(),
        }
    }
}

/// What is believed of the signed readout time: a mixture of normal densities.
#[derive(Clone, Debug, Serialize)]
pub struct Posterior {
    pub hypotheses: Vec<Hypothesis>,
    pub prior: Prior,
}

/// A part of the mixture, along the rows or the columns.
#[derive(Clone, Debug, Serialize)]
pub struct Hypothesis {
    pub direction: String,
    pub signed_readout_ms: f64,
    pub deviation_ms: f64,
    pub weight: f64,
}

/// What was believed before anything was seen: one normal density about 0 along the rows, one along the columns.
#[derive(Clone, Debug, Serialize)]
pub struct Prior {
    pub deviation_ms: f64,
    /// Their weights.
    pub rows: f64,
    pub columns: f64,
}

impl From<&ReadoutPosterior> for Posterior {
    fn from(posterior: &ReadoutPosterior) -> Self {
        let hypotheses = posterior.hypotheses.iter().map(|hypothesis| Hypothesis {
            direction: name_of(&Direction::from(hypothesis.readout.direction())),
            signed_readout_ms: Estimate::of_readout(&hypothesis.readout, 0.0).value,
            deviation_ms: hypothesis.deviation * 1e3,
            weight: hypothesis.probability,
        });
        let rows = posterior.prior_by_rows;
        let prior = Prior { deviation_ms: posterior.prior_deviation * 1e3, rows, columns: 1.0 - rows };
        Self { hypotheses: hypotheses.collect(), prior }
    }
}

/// Readout and focal length.
#[derive(Clone, Debug, Serialize)]
pub struct Camera {
    /// Negative where the bottom row or the right column is read first.
    pub signed_readout_ms: f64,
    pub readout_deviation_ms: f64,
    /// Of the signed time, 95 %.
    pub readout_interval_ms: [f64; 2],
    pub readout_direction: String,
    /// Absent where nothing is known of it.
    pub focal_length: Option<FocalLength>,
}

/// In frame widths.
///
/// What is estimated, and normal, is κ = (0.5/f)², by which the perspective of a frame grows.
#[derive(Clone, Debug, Serialize)]
pub struct FocalLength {
    pub widths: f64,
    /// 95 %; without an upper end where a view without perspective cannot be ruled out.
    pub interval: [Option<f64>; 2],
    /// Across the frame, in degrees.
    pub field_of_view: f64,
    #[serde(skip)]
    kappa: Estimate,
}

impl FocalLength {
    fn new(kappa: Estimate) -> Self {
        let focal = |kappa: f64| (kappa > 0.0).then(|| 0.5 / kappa.sqrt());
        let [low, high] = kappa.interval();
        let widths = focal(kappa.value).unwrap_or(f64::INFINITY);
        Self {
            widths,
            interval: [focal(high), focal(low)],
            field_of_view: 2.0 * (0.5 / widths).atan().to_degrees(),
            kappa,
        }
    }

    /// κ of a focal length and its deviation in frame widths, to first order.
    fn kappa(widths: f64, deviation: f64) -> Estimate {
        let value = (0.5 / widths).powi(2);
        Estimate { value, deviation: 2.0 * value * deviation / widths }
    }
}

impl Camera {
    fn new(readout: Estimate, direction: String, focal_length: Option<Estimate>) -> Self {
        Self {
            signed_readout_ms: readout.value,
            readout_deviation_ms: readout.deviation,
            readout_interval_ms: readout.interval(),
            readout_direction: direction,
            focal_length: focal_length.map(FocalLength::new),
        }
    }

    /// The signed readout time in milliseconds.
    pub fn readout(&self) -> Estimate {
        Estimate { value: self.signed_readout_ms, deviation: self.readout_deviation_ms }
    }
}

impl Measurement {
    /// Of a clip.
    pub fn new(clip: String, found: &Found) -> Self {
        let readout = found.estimate();
        let focal = found.focal_length.map(|focal| FocalLength::kappa(focal.widths, focal.deviation));
        Self {
            clip,
            width: found.size[0],
            height: found.size[1],
            frame_rate: found.frame_rate,
            frames: found.frames,
            frames_with_motion: found.followed,
            certain: found.doubt().is_none(),
            doubts: doubts(found, &readout),
            stabilised: found.timing.stabilised_name().to_owned(),
            shows_leans: found.shows_leans,
            timeline: found.timing.timeline.to_string(),
            cuts: None,
            stated: None,
            expected: None,
            overrules_expected: None,
            posterior: found.posterior.as_ref().map(Posterior::from),
            camera: Camera::new(readout, name_of(&Direction::from(found.direction)), focal),
        }
    }

    /// With what is known of this camera, beside what was found.
    #[must_use]
    pub fn with_camera(self, known: Option<&Known>, found: &Found) -> Self {
        let Some(known) = known else { return self };
        let expectation = known.expectation([self.width, self.height], self.frame_rate);
        let prior = expectation.as_ref().and_then(|expectation| expectation.prior().ok());
        Self {
            stated: (known.stated != Stated::default()).then(|| known.stated.clone()),
            expected: expectation.as_ref().map(Expected::from),
            overrules_expected: prior.map(|prior| found.overrules(&prior)),
            ..self
        }
    }

    /// With the frames at which shots begin, counted from the first that was analysed, which has this number in the clip.
    #[must_use]
    pub fn with_cuts(self, first_frame: usize, cuts: &[usize]) -> Self {
        Self { cuts: Some(cuts.iter().map(|cut| first_frame + cut).collect()), ..self }
    }
}

fn doubts(found: &Found, readout: &Estimate) -> Vec<String> {
    let mut doubts = Vec::new();
    match found.doubt() {
        Some(Doubt::TooFewFrames) => {
            doubts.push(format!("there are too few frames to see a motion in, {}", found.frames));
        }
        Some(Doubt::Blended) => doubts.push(
            "the frames are blends of two exposures, as a conversion of the frame rate leaves them, so that it cannot be estimated".to_owned(),
        ),
        Some(Doubt::Stabilised) => doubts.push(
            "the frames were moved after they were recorded, as by stabilisation in the camera, so that it cannot be estimated".to_owned(),
        ),
        Some(Doubt::NoMotion) => doubts.push(format!(
            "only {} of {} frames have a motion that most of the picture follows: the camera hardly moved, or there is too \
             little to see",
            found.followed, found.frames
        )),
        Some(Doubt::Uncertain) => doubts.push(format!(
            "the deviation is {:.0} % of the frame duration: the camera hardly speeds up or slows down; a clip in which it \
             shakes, or pans to and fro, tells more",
            100.0 * found.deviation
        )),
        None => {}
    }
    if readout.has_no_sign() && !found.is_global() {
        doubts.push("the edge that is read first is undecided".to_owned());
    }
    doubts
}

/// What several clips of one camera say together.
#[derive(Clone, Debug, Serialize)]
pub struct Together {
    /// The clips that it is made of.
    pub clips: Vec<String>,
    /// Those left out: no motion, or another direction.
    pub left_out: Vec<String>,
    pub agree: bool,
    /// Where they do not.
    pub disagreements: Vec<String>,
    #[serde(flatten)]
    pub camera: Camera,
}

impl Together {
    /// Clips of one camera; `None` where no clip says anything.
    pub fn new(clips: &[Measurement]) -> Option<Self> {
        // A clip without motion states a deviation, but its direction is a guess.
        let telling = clips.iter().filter(|clip| clip.frames_with_motion > 0);
        let surest =
            telling.min_by(|a, b| a.camera.readout_deviation_ms.total_cmp(&b.camera.readout_deviation_ms))?;
        let direction = &surest.camera.readout_direction;
        let (used, left): (Vec<_>, Vec<_>) = clips
            .iter()
            .partition(|clip| clip.frames_with_motion > 0 && clip.camera.readout_direction == *direction);
        let readouts: Vec<_> = used.iter().map(|clip| clip.camera.readout()).collect();
        let focals = used.iter().filter_map(|clip| clip.camera.focal_length.as_ref());
        let focals: Vec<_> = focals.map(|focal| focal.kappa).collect();
        let readout = combine(&readouts)?;
        let focal = combine(&focals);
        let mut disagreements = Vec::new();
        if !readout.agree {
            disagreements.push("the readout times differ by more than their deviations allow".to_owned());
        }
        if focal.is_some_and(|focal| !focal.agree) {
            disagreements.push("the focal lengths differ by more than their deviations allow".to_owned());
        }
        let others = left.iter().filter(|clip| clip.certain);
        disagreements
            .extend(others.map(|clip| format!("{} is read {}", clip.clip, clip.camera.readout_direction)));
        let mode =
            |clip: &Measurement| (clip.width, clip.height, clip.frame_rate.map(|rate| rate.round() as i64));
        if clips.iter().any(|clip| mode(clip) != mode(surest)) {
            disagreements.push(
                "the clips differ in size or frame rate, with which the readout usually changes".to_owned(),
            );
        }
        let names = |clips: &[&Measurement]| clips.iter().map(|clip| clip.clip.clone()).collect();
        Some(Self {
            clips: names(&used),
            left_out: names(&left),
            agree: disagreements.is_empty(),
            disagreements,
            camera: Camera::new(readout.estimate, direction.clone(), focal.map(|focal| focal.estimate)),
        })
    }
}

impl fmt::Display for Camera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [low, high] = self.readout_interval_ms;
        writeln!(
            f,
            "  readout time  {:.1} ms, 95 %: {low:.1} to {high:.1}, {}",
            self.signed_readout_ms, self.readout_direction
        )?;
        match &self.focal_length {
            Some(focal) => {
                let [low, high] = focal.interval.map(|end| end.map(|end| format!("{end:.2}")));
                let low = low.unwrap_or_default();
                let high = high.map_or("or more".to_owned(), |high| format!("to {high}"));
                writeln!(
                    f,
                    "  focal length  {:.2} frame widths, 95 %: {low} {high}, field of view {:.0}° across",
                    focal.widths, focal.field_of_view
                )
            }
            None => writeln!(f, "  focal length  not known"),
        }
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { camera, mode, direction, signed_readout_ms, deviation_ms, note, .. } = self;
        write!(f, "{signed_readout_ms:.1} ms ± {deviation_ms:.1}, {direction}: {camera}, {mode}{note}")
    }
}

impl fmt::Display for Measurement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rate = self.frame_rate.map_or(String::new(), |rate| format!(", {rate:.2} frames/s"));
        writeln!(f, "{}: {} x {}{rate}, {} frames", self.clip, self.width, self.height, self.frames)?;
        self.camera.fmt(f)?;
        if let Some(expected) = &self.expected {
            write!(f, "  expected      {expected}")?;
            writeln!(
                f,
                "{}",
                if self.overrules_expected == Some(true) { "; the picture shows another one" } else { "" }
            )?;
        }
        if let Some(stabilisation) = self.stated.as_ref().and_then(|stated| stated.stabilisation.as_ref()) {
            writeln!(f, "  stabilised    {stabilisation}")?;
        }
        if self.timeline != Timeline::Stated.to_string() {
            writeln!(f, "  timestamps    not those of the exposure: {}", self.timeline)?;
        }
        if self.certain {
            write!(f, "  certain       yes")?;
        } else {
            write!(f, "  certain       no")?;
        }
        self.doubts.iter().try_for_each(|doubt| write!(f, "; {doubt}"))
    }
}

impl fmt::Display for Together {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} clips of one camera", self.clips.len())?;
        self.camera.fmt(f)?;
        write!(f, "  agree         {}", if self.agree { "yes" } else { "no" })?;
        self.disagreements.iter().try_for_each(|reason| write!(f, "; {reason}"))?;
        self.left_out.iter().try_for_each(|clip| write!(f, "\n  left out      {clip}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::readout::ReadoutDirection;

    fn clip(name: &str, direction: ReadoutDirection, milliseconds: f64, deviation: f64) -> Measurement {
        let found = Found::example(direction, milliseconds, deviation);
        Measurement::new(name.to_owned(), &found)
    }

    #[test]
    fn the_bottom_edge_first_is_negative() {
        let up = clip("a", ReadoutDirection::BottomToTop, 20.0, 0.05);
        assert_eq!((up.camera.signed_readout_ms, up.certain), (-20.0, true));
        assert!((up.camera.readout_deviation_ms - 2.0).abs() < 1e-12 && up.doubts.is_empty());
        let vague = clip("b", ReadoutDirection::TopToBottom, 10.0, 0.3);
        assert!(!vague.certain && vague.doubts.len() == 2, "{:?}", vague.doubts);
    }

    #[test]
    fn the_field_of_view_follows_from_the_focal_length() {
        // f = 1/2: 90°; κ = 1 ± 0.2·1.96.
        let focal = FocalLength::new(FocalLength::kappa(0.5, 0.05));
        assert!((focal.field_of_view - 90.0).abs() < 1e-9);
        let [low, high] = focal.interval.map(Option::unwrap);
        assert!((low - 0.5 / 1.392_f64.sqrt()).abs() < 1e-9 && (high - 0.5 / 0.608_f64.sqrt()).abs() < 1e-9);
        assert_eq!(FocalLength::new(FocalLength::kappa(3.0, 2.0)).interval[1], None);
    }

    #[test]
    fn clips_of_one_camera_are_combined() {
        let down = ReadoutDirection::TopToBottom;
        let together = Together::new(&[clip("a", down, 20.0, 0.025), clip("b", down, 21.0, 0.025)]).unwrap();
        assert!(together.agree && (together.camera.signed_readout_ms - 20.5).abs() < 1e-9);
        assert!((together.camera.readout_deviation_ms - 0.5_f64.sqrt()).abs() < 1e-9);
        let other = clip("c", ReadoutDirection::BottomToTop, 20.0, 0.05);
        let together = Together::new(&[clip("a", down, 20.0, 0.025), other]).unwrap();
        assert_eq!((together.agree, together.left_out), (false, vec!["c".to_owned()]));
        let apart = Together::new(&[clip("a", down, 20.0, 0.025), clip("b", down, 30.0, 0.025)]).unwrap();
        assert!(!apart.agree && apart.disagreements.len() == 1);
    }
}
