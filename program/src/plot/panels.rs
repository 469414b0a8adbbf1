// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is plotted: curves over the frames of a clip, in panels.

use super::series::{Motion, Point};
use crate::drawing::{BLUE, Colour, GREEN, PURPLE, VERMILION};
use crate::property_values::{Direction, name_of};
use serde::{Serialize, Serializer};
use std::ops::Range;

/// Expected errors of more than so many times their 90 % quantile are cut off.
const BEYOND: f64 = 3.0;

/// A line of a panel: a value for each frame, none where there is a gap.
#[derive(Debug, Serialize)]
pub struct Curve {
    pub label: String,
    pub colour: Colour,
    #[serde(serialize_with = "short")]
    pub values: Vec<Option<f64>>,
    /// The interval around it, where it has one.
    pub band: Option<Vec<[f64; 2]>>,
}

/// One set of axes.
#[derive(Debug, Serialize)]
pub struct Panel {
    pub title: &'static str,
    /// What the vertical axis shows, with its unit.
    pub axis: &'static str,
    /// What it spans, else what the values need.
    #[serde(skip)]
    range: Option<Range<f64>>,
    pub curves: Vec<Curve>,
}

/// The panels of a clip.
pub fn panels(points: &[Point]) -> Vec<Panel> {
    let of = |value: fn(&Motion) -> Option<f64>| -> Vec<Option<f64>> {
        points.iter().map(|point| point.motion.as_ref().and_then(value)).collect()
    };
    let curve = |label: &str, colour, value: fn(&Motion) -> Option<f64>| Curve {
        label: label.to_owned(),
        colour,
        values: of(value),
        band: None,
    };
    let expected = Expected::new(of(|motion| motion.expected_error));
    vec![
        Panel {
            title: "Shift of the picture",
            axis: "pixels per frame",
            range: None,
            curves: vec![
                curve("x, to the right", BLUE, |motion| Some(motion.shift[0])),
                curve("y, down", VERMILION, |motion| Some(motion.shift[1])),
            ],
        },
        Panel {
            title: "Turn of the picture",
            axis: "degrees per frame",
            range: None,
            curves: vec![curve("clockwise", GREEN, |motion| Some(motion.turn))],
        },
        Panel {
            title: "Readout time, as believed at each frame",
            axis: "milliseconds",
            range: None,
            curves: vec![readout(points)],
        },
        Panel {
            title: "Confidence",
            axis: "share, 0 to 1",
            range: Some(-0.04..1.06),
            curves: vec![curve("share of the correction expected to be right", BLUE, |motion| {
                Some(motion.confidence)
            })],
        },
        Panel {
            title: "Expected error of the rectified frame",
            axis: "pixels",
            range: expected.limit.map(|limit| 0.0..limit),
            curves: vec![expected.curve],
        },
    ]
}

/// The expected errors, and where their axis ends if some are far beyond all others.
struct Expected {
    curve: Curve,
    limit: Option<f64>,
}

impl Expected {
    fn new(values: Vec<Option<f64>>) -> Self {
        let mut known: Vec<f64> = values.iter().copied().flatten().collect();
        known.sort_by(f64::total_cmp);
        // Of a frame that is hardly corrected the error may be any number.
        let usual = known.get(known.len() * 9 / 10).copied();
        let limit = usual.map(|usual| BEYOND * usual).filter(|limit| known.last() > Some(limit));
        let label = match (known.is_empty(), limit) {
            (true, _) => "cannot be told",
            (_, None) => "root mean square over the frame",
            (_, Some(_)) => "root mean square over the frame, cut off at the top",
        };
        let label = label.to_owned();
        Self { curve: Curve { label, colour: VERMILION, values, band: None }, limit }
    }
}

/// The readout is believed in of frames without a motion too.
fn readout(points: &[Point]) -> Curve {
    let label = points.last().map_or(String::new(), |point| {
        let direction = name_of(&Direction::from(point.direction));
        let [low, high] = point.readout.interval();
        match point.readout.deviation > 0.0 {
            true => {
                format!("{:.1} ms {direction} in the end, 95 %: {low:.1} to {high:.1}", point.readout.value)
            }
            false => format!("{:.1} ms {direction}, not sought", point.readout.value),
        }
    });
    Curve {
        label,
        colour: PURPLE,
        values: points.iter().map(|point| Some(point.readout.value)).collect(),
        band: Some(points.iter().map(|point| point.readout.interval()).collect()),
    }
}

impl Panel {
    /// What the vertical axis spans.
    pub fn span(&self) -> Range<f64> {
        if let Some(range) = &self.range {
            return range.clone();
        }
        let bands = self.curves.iter().filter_map(|curve| curve.band.as_ref()).flatten().flatten();
        let values = self.curves.iter().flat_map(|curve| &curve.values).flatten();
        let finite = values.chain(bands).filter(|value| value.is_finite());
        let (low, high) =
            finite.fold((0.0_f64, 0.0_f64), |(low, high), value| (low.min(*value), high.max(*value)));
        if low == high {
            return 0.0..1.0;
        }
        let air = 0.07 * (high - low);
        low - if low < 0.0 { air } else { 0.0 }..high + air
    }
}

/// With as many digits as are seen.
fn short<S: Serializer>(values: &[Option<f64>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(values.iter().map(|value| value.map(|value| value as f32)))
}

/// The times of stretches without a motion, half a frame beyond them on each side.
pub fn untouched(points: &[Point], times: &Range<f64>) -> Vec<Range<f64>> {
    let half = 0.5 * (times.end - times.start) / points.len().max(1) as f64;
    let mut ranges: Vec<Range<f64>> = Vec::new();
    let mut follows = false;
    for point in points {
        let is_untouched = point.motion.is_none();
        let (start, end) = ((point.time - half).max(times.start), (point.time + half).min(times.end));
        match ranges.last_mut().filter(|_| follows) {
            Some(range) if is_untouched => range.end = end,
            _ if is_untouched => ranges.push(start..end),
            _ => {}
        }
        follows = is_untouched;
    }
    ranges
}
