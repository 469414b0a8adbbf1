// SPDX-License-Identifier: MIT OR Apache-2.0

//! What is drawn over a frame, as SVG: correspondences, the correction, and a strip of text below them.

use super::strip::{Item, Strip};
use crate::analysis::Frame;
use crate::drawing::{Colour, SKY_BLUE, VERMILION, YELLOW, hex};
use crate::estimate::Estimate;
use crate::property_values::{Direction, name_of};
use rsrectify::motion::FrameMotion;
use rsrectify::nalgebra::Vector2;
use rsrectify::readout::ReadoutDirection;
use rsrectify::rectifier::{FittedCorrespondence, Origin};

/// Colours of the correspondences that follow the motion, of the others, and of the correction.
const INLIER: Colour = SKY_BLUE;
const OUTLIER: Colour = VERMILION;
const CORRECTION: Colour = YELLOW;
/// Arrows across the frame.
const ARROWS: f64 = 12.0;
/// The frame for which widths of lines and sizes of letters are given, in pixels.
const USUAL_SIZE: [f64; 2] = [800.0, 600.0];
/// Letters smaller than this many of its pixels cannot be read.
const SMALLEST: f64 = 0.6;

/// What is drawn over the frames of a clip.
pub struct Overlay {
    size: [u32; 2],
    /// By how much the correction is magnified.
    magnify: f64,
    /// The readout that all frames are rectified with, in signed milliseconds, if it was found before the first of them.
    found: Option<Estimate>,
    /// Milliseconds from frame to frame, where the clip says so.
    period: Option<f64>,
}

impl Overlay {
    pub fn new(size: [u32; 2], magnify: f64, found: Option<Estimate>, period: Option<f64>) -> Self {
        Self { size, magnify, found, period }
    }

    /// Pixels to one of the usual size.
    fn unit(&self) -> f64 {
        let [across, down] = [0, 1].map(|axis| f64::from(self.size[axis]) / USUAL_SIZE[axis]);
        across.min(down).max(SMALLEST)
    }

    /// The drawing over frame `number`.
    pub fn svg(&self, number: u64, frame: &Frame) -> String {
        let [width, height] = self.size;
        let solution = &frame.solution;
        let (inliers, outliers): (Vec<_>, Vec<_>) =
            solution.fitted.iter().partition(|correspondence| correspondence.is_inlier);
        let mut svg = format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" stroke-linecap="round" stroke-linejoin="round">"#
        );
        svg += &self.correspondences(&inliers, INLIER);
        svg += &self.correspondences(&outliers, OUTLIER);
        svg += &self.correction(&solution.motion);
        let mut first = vec![Item::text(format!("frame {number}")).with_room(10)];
        first.extend(frame.time.map(|time| Item::text(format!("{time:.3} s")).with_room(8)));
        first.push(Item::text(self.readout(frame)));
        let mut second = vec![Item::bar("confidence", solution.confidence)];
        if !solution.fitted.is_empty() {
            second.push(Item::key(INLIER, format!("{} inliers", inliers.len())).with_room(11));
            second.push(Item::key(OUTLIER, format!("{} outliers", outliers.len())).with_room(12));
        }
        second.push(match solution.origin {
            Origin::Untouched => Item::text("no motion found, left as it is".to_owned()),
            _ => Item::key(CORRECTION, format!("correction × {}", self.magnify)),
        });
        svg += &Strip { size: self.size, unit: self.unit() }.svg(&[first, second]);
        svg += "</svg>";
        svg
    }

    /// Each as a dot where the frame shows the point, and a line along its motion to the next frame.
    fn correspondences(&self, all: &[&FittedCorrespondence], colour: Colour) -> String {
        let dots: String = all.iter().map(|one| dot(one.position)).collect();
        let lines: String = all.iter().map(|one| line(one.position, one.displacement)).collect();
        let unit = self.unit();
        stroke(&dots, 3.8 * unit, 1.4 * unit, colour) + &stroke(&lines, 1.8 * unit, 1.4 * unit, colour)
    }

    /// Arrows from where the frame shows points to where the rectified frame does, magnified.
    fn correction(&self, motion: &FrameMotion) -> String {
        if motion.is_still() {
            return String::new();
        }
        let [width, height] = self.size.map(f64::from);
        let step = width / ARROWS;
        let rows = (height / step).round().max(1.0);
        let unit = self.unit();
        let places = (0..ARROWS as usize * rows as usize).map(|index| {
            let (column, row) = (index % ARROWS as usize, index / ARROWS as usize);
            Vector2::new((column as f64 + 0.5) * step, (row as f64 + 0.5) * height / rows)
        });
        let arrows: String = places
            .map(|place| arrow(place, motion.displacement(place, 0.5) * self.magnify, 6.0 * unit))
            .collect();
        stroke(&arrows, 2.2 * unit, 1.8 * unit, CORRECTION)
    }

    /// The readout in words.
    fn readout(&self, frame: &Frame) -> String {
        let readout = frame.solution.motion.readout();
        let direction = name(readout.direction());
        // In frame durations; 0 where it was not sought.
        let deviation = frame.solution.readout_deviation;
        let believed = Estimate::of_readout(readout, deviation * self.period.unwrap_or_default());
        let estimate = self.found.unwrap_or(believed);
        let [low, high] = estimate.interval();
        let doubt = match (low < high, deviation > 0.0) {
            (true, _) => format!("95 %: {low:.1} to {high:.1}"),
            (false, true) => format!("deviation {:.0} % of the frame duration", 100.0 * deviation),
            (false, false) => "not sought".to_owned(),
        };
        format!("readout {:.1} ms, {doubt}, {direction}", estimate.value)
    }
}

fn name(direction: ReadoutDirection) -> String {
    name_of(&Direction::from(direction))
}

/// Lines with a dark edge, so that they are seen on any picture.
fn stroke(path: &str, width: f64, edge: f64, colour: Colour) -> String {
    if path.is_empty() {
        return String::new();
    }
    let colour = hex(colour);
    let around = width + edge;
    format!(
        r##"<path d="{path}" fill="none" stroke="#000" stroke-opacity="0.55" stroke-width="{around:.2}"/><path d="{path}" fill="none" stroke="{colour}" stroke-width="{width:.2}"/>"##
    )
}

/// In SVG the middle of the first pixel is at one half.
fn start(pixel: Vector2<f64>) -> String {
    format!("M{:.2} {:.2}", pixel.x + 0.5, pixel.y + 0.5)
}

/// A line as short as can be: its round ends are the dot.
fn dot(pixel: Vector2<f64>) -> String {
    start(pixel) + "h.01"
}

fn line(pixel: Vector2<f64>, by: Vector2<f64>) -> String {
    format!("{}l{:.2} {:.2}", start(pixel), by.x, by.y)
}

/// An arrow whose head is so long at most; a dot where it has no length.
fn arrow(pixel: Vector2<f64>, by: Vector2<f64>, head: f64) -> String {
    let length = by.norm();
    if length < 0.5 {
        return dot(pixel);
    }
    let back = by * (-head.min(0.6 * length) / length);
    let aside = Vector2::new(-back.y, back.x) * 0.55;
    let tip = pixel + by;
    let [left, right] = [back + aside, back - aside];
    format!(
        "{}{}l{:.2} {:.2}{}l{:.2} {:.2}",
        line(pixel, by),
        start(tip),
        left.x,
        left.y,
        start(tip),
        right.x,
        right.y
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arrow_ends_where_the_correction_does() {
        let drawn = arrow(Vector2::new(10.0, 20.0), Vector2::new(8.0, 0.0), 4.0);
        assert_eq!(drawn, "M10.50 20.50l8.00 0.00M18.50 20.50l-4.00 -2.20M18.50 20.50l-4.00 2.20");
        assert_eq!(arrow(Vector2::new(10.0, 20.0), Vector2::zeros(), 4.0), "M10.50 20.50h.01");
    }
}
