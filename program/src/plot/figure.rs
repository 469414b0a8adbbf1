// SPDX-License-Identifier: MIT OR Apache-2.0

//! Panels below each other over the time of the clip, as SVG.

use super::panels::{Panel, panels, untouched};
use super::series::Point;
use crate::drawing::Colour;
use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

/// Size of the figure without its panels, and the height of one, in pixels.
const WIDTH: u32 = 1000;
const TOP: u32 = 44;
const PANEL: u32 = 172;
const TIME_AXIS: u32 = 44;
/// Distance of the vertical axes from the left edge, and of the panels from the right one.
const AXIS: u32 = 78;
const MARGIN: u32 = 24;
/// Distance of the first entry of each legend from the left edge, and of one entry from the next.
const LEGEND: u32 = 560;
const LEGEND_STEP: u32 = 180;
/// Distance of the names of the vertical axes from the left edge.
const LEFT: u32 = 20;
/// Height of a panel's title.
const TITLE: u32 = 28;
/// Coordinates are whole numbers in the file: so many to a pixel.
const FINE: u32 = 4;

const TEXT: RGBColor = RGBColor(40, 40, 40);
const GRID: RGBColor = RGBColor(226, 226, 226);
const UNTOUCHED: RGBColor = RGBColor(236, 236, 236);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Failure = Box<dyn std::error::Error>;

/// The figure of a clip, as SVG.
pub fn draw(clip: &str, points: &[Point]) -> Result<String> {
    let panels = panels(points);
    let size = [WIDTH, TOP + PANEL * panels.len() as u32 + TIME_AXIS];
    let mut svg = String::new();
    draw_all(&mut svg, size, clip, points, &panels).map_err(|error| anyhow!("cannot be drawn: {error}"))?;
    let [fine, usual] =
        [size.map(|side| side * FINE), size].map(|[w, h]| format!("width=\"{w}\" height=\"{h}\""));
    Ok(svg.replacen(&fine, &usual, 1))
}

fn rgb([red, green, blue]: Colour) -> RGBColor {
    RGBColor(red, green, blue)
}

/// A length in pixels, in the whole numbers of the file.
fn fine(pixels: u32) -> i32 {
    (pixels * FINE) as i32
}

fn text(pixels: u32) -> TextStyle<'static> {
    // The backend takes a size for the height of a line, 1.24 times that of the font.
    ("sans-serif", f64::from(pixels * FINE) * 1.24).into_font().color(&TEXT)
}

fn draw_all(
    svg: &mut String,
    size: [u32; 2],
    clip: &str,
    points: &[Point],
    panels: &[Panel],
) -> Result<(), Failure> {
    let root = SVGBackend::with_string(svg, (size[0] * FINE, size[1] * FINE)).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!("{clip}: motion of the picture in {} frames", points.len());
    root.draw(&Text::new(title, (fine(MARGIN), fine(14)), text(17)))?;
    for (index, panel) in panels.iter().enumerate() {
        let is_last = index + 1 == panels.len();
        let top = TOP + PANEL * index as u32;
        let height = PANEL + if is_last { TIME_AXIS } else { 0 };
        let area = root.clone().shrink((0, fine(top)), (fine(WIDTH), fine(height)));
        draw_panel(&area, panel, points, is_last)?;
    }
    let untouched = points.iter().filter(|point| point.motion.is_none()).count();
    if untouched > 0 {
        let (x, y) = (fine(AXIS), fine(size[1] - 18));
        root.draw(&Rectangle::new([(x, y), (x + fine(24), y + fine(12))], UNTOUCHED.filled()))?;
        let label = format!("{untouched} frames without a motion");
        root.draw(&Text::new(label, (x + fine(30), y), text(13)))?;
    }
    root.present()?;
    Ok(())
}

fn draw_panel(area: &Area<'_>, panel: &Panel, points: &[Point], is_last: bool) -> Result<(), Failure> {
    let (first, last) = (points.first().map_or(0.0, |p| p.time), points.last().map_or(0.0, |p| p.time));
    // One frame has no length.
    let times = first..if last > first { last } else { first + 1.0 };
    let span = panel.span();
    let mut chart = ChartBuilder::on(area)
        .margin_top(fine(TITLE))
        .margin_right(fine(MARGIN))
        .margin_bottom(fine(10))
        .x_label_area_size(if is_last { fine(TIME_AXIS) } else { 0 })
        .margin_left(fine(LEFT))
        .y_label_area_size(fine(AXIS - LEFT))
        .build_cartesian_2d(times.clone(), span.clone())?;
    for range in untouched(points, &times) {
        let corners = [(range.start, span.start), (range.end, span.end)];
        chart.draw_series(std::iter::once(Rectangle::new(corners, UNTOUCHED.filled())))?;
    }
    let line = FINE;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID.stroke_width(line))
        .axis_style(TEXT.stroke_width(line))
        .x_desc("seconds of the clip")
        .y_desc(panel.axis)
        .axis_desc_style(text(13))
        .label_style(text(12))
        .x_labels(12)
        .y_labels(5)
        .x_label_formatter(&|time| number(*time))
        .y_label_formatter(&|value| number(*value))
        .draw()?;
    for curve in &panel.curves {
        let colour = rgb(curve.colour);
        for band in runs(points, |index| curve.band.as_ref().and_then(|band| band.get(index)).copied()) {
            let low = band.iter().map(|(time, [low, _])| (*time, *low));
            let high = band.iter().rev().map(|(time, [_, high])| (*time, *high));
            let outline: Vec<_> = low.chain(high).collect();
            chart.draw_series(std::iter::once(Polygon::new(outline, colour.mix(0.25).filled())))?;
        }
        let value = |index: usize| curve.values.get(index).copied().flatten();
        for run in runs(points, |index| value(index).map(|value| value.clamp(span.start, span.end))) {
            if let [alone] = run.as_slice() {
                let dot = Circle::new(*alone, fine(2), colour.filled());
                chart.draw_series(std::iter::once(dot))?;
            } else {
                let path = PathElement::new(run, colour.stroke_width(2 * FINE - FINE / 2));
                chart.draw_series(std::iter::once(path))?;
            }
        }
    }
    draw_legend(area, panel)
}

/// Above the axes, where it hides no curve.
fn draw_legend(area: &Area<'_>, panel: &Panel) -> Result<(), Failure> {
    area.draw(&Text::new(panel.title, (fine(AXIS), fine(9)), text(14)))?;
    for (index, curve) in panel.curves.iter().enumerate() {
        let (x, y) = (fine(LEGEND + LEGEND_STEP * index as u32), fine(17));
        let colour = rgb(curve.colour);
        if curve.band.is_some() {
            let corners = [(x, y - fine(6)), (x + fine(24), y + fine(6))];
            area.draw(&Rectangle::new(corners, colour.mix(0.25).filled()))?;
        }
        area.draw(&PathElement::new([(x, y), (x + fine(24), y)], colour.stroke_width(2 * FINE)))?;
        area.draw(&Text::new(curve.label.as_str(), (x + fine(30), fine(10)), text(13)))?;
    }
    Ok(())
}

/// Stretches of frames that have a value, with their times.
fn runs<T>(points: &[Point], value: impl Fn(usize) -> Option<T>) -> Vec<Vec<(f64, T)>> {
    let mut runs: Vec<Vec<_>> = vec![Vec::new()];
    for (index, point) in points.iter().enumerate() {
        match (value(index), runs.last_mut()) {
            (Some(value), Some(run)) => run.push((point.time, value)),
            _ => runs.push(Vec::new()),
        }
    }
    runs.retain(|run| !run.is_empty());
    runs
}

/// A number as short as it can be.
fn number(value: f64) -> String {
    // Steps of an axis are not exact, and zero has no sign.
    let text = format!("{:.3}", value + 0.0);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.replace('-', "−") }
}

#[cfg(test)]
mod tests {
    use super::super::series::Motion;
    use super::*;
    use crate::estimate::Estimate;
    use rsrectify::readout::ReadoutDirection;

    fn point(frame: usize, motion: Option<Motion>) -> Point {
        Point {
            time: frame as f64 * 0.1,
            motion,
            readout: Estimate { value: 20.0, deviation: 1.0 },
            direction: ReadoutDirection::TopToBottom,
        }
    }

    const MOTION: Motion =
        Motion { shift: [3.0, -2.0], turn: 0.5, confidence: 0.9, expected_error: Some(0.3) };

    #[test]
    fn frames_without_a_motion_are_gaps() {
        let motions = [true, true, false, false, true, false, true, true, true];
        let points: Vec<_> =
            (0..9).map(|k| point(k, motions.get(k).copied().unwrap_or(false).then_some(MOTION))).collect();
        let lengths = |runs: Vec<Vec<(f64, f64)>>| runs.iter().map(Vec::len).collect::<Vec<_>>();
        let shift = |k: usize| points.get(k).and_then(|p| p.motion).map(|motion| motion.shift[0]);
        assert_eq!(lengths(runs(&points, shift)), [2, 1, 3]);
        let grey = untouched(&points, &(0.0..0.8));
        assert_eq!(grey.len(), 2);
        assert!(grey[0].start > 0.1 && grey[0].start < 0.2 && grey[0].end > 0.3 && grey[0].end < 0.4);
    }

    #[test]
    fn numbers_are_short() {
        let numbers = [0.0, -0.0, -1e-9, 0.1 + 0.2, 12.0, -2.5, 100.0].map(number);
        assert_eq!(numbers, ["0", "0", "0", "0.3", "12", "−2.5", "100"]);
    }

    #[test]
    fn a_clip_of_one_frame_or_none_with_a_motion_can_be_drawn() {
        for points in [vec![point(0, Some(MOTION))], vec![point(0, None), point(1, None)]] {
            let svg = draw("a <b> & c.mp4", &points).unwrap();
            assert!(svg.contains("a &lt;b&gt; &amp; c.mp4") && svg.contains("width=\"1000\""), "{svg}");
        }
    }
}
