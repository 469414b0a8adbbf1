// SPDX-License-Identifier: MIT OR Apache-2.0

//! Charts as SVG: a figure of each frame along a sequence, a curve a system.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Width of one panel, and height of its axes with their title, in pixels.
const PANEL: (u32, u32) = (560, 340);
/// Distance of the vertical axis from the panel's left edge.
const AXIS: i32 = 68;
/// Curves beside each other in the legend; width of each, and height of a row of them.
const LEGEND_COLUMNS: usize = 2;
const LEGEND_CELL: (i32, i32) = (240, 18);

/// Colours that people with colour-blindness tell apart (M. Okabe and K. Ito, *Color universal
/// design*, 2008).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 0, 0),
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(150, 150, 150),
];

/// One set of axes.
pub struct Panel {
    /// What stands above it.
    pub title: String,
    /// What the vertical axis shows.
    pub axis: String,
    /// The curves.
    pub curves: Vec<Curve>,
}

/// A figure of each frame.
pub struct Curve {
    /// What the legend calls it.
    pub label: String,
    /// A figure for each frame from the first.
    pub figures: Vec<f64>,
}

/// What the vertical axes of a chart span; all panels share it, so that they can be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// From 0 to the highest figure: of distances.
    FromZero,
    /// From the lowest figure to 1: of shares.
    ToOne,
}

impl Scale {
    /// The range that holds all figures with some air; `None` without figures.
    fn range(self, panels: &[Panel]) -> Option<Range<f64>> {
        let figures = || panels.iter().flat_map(Panel::figures);
        let (lowest, highest) = (figures().reduce(f64::min)?, figures().reduce(f64::max)?);
        let air = |span: f64| 0.05 * span.max(0.01);
        Some(match self {
            Self::FromZero => 0.0..highest + air(highest),
            Self::ToOne => lowest - air(1.0 - lowest)..1.0 + air(1.0 - lowest) / 2.0,
        })
    }
}

impl Panel {
    fn figures(&self) -> impl Iterator<Item = f64> + '_ {
        self.curves.iter().flat_map(|curve| curve.figures.iter().copied())
    }

    /// Height of the legend in pixels.
    fn legend(&self) -> u32 {
        (self.curves.len().div_ceil(LEGEND_COLUMNS) as u32 + 1) * LEGEND_CELL.1 as u32
    }
}

/// Draws panels in rows of two; those without figures are left out.
///
/// # Errors
/// Where the file cannot be written.
pub fn draw(path: &Path, mut panels: Vec<Panel>, scale: Scale) -> Result<()> {
    panels.retain(|panel| panel.figures().next().is_some());
    let Some(range) = scale.range(&panels) else { return Ok(()) };
    let columns = panels.len().min(2);
    let rows = panels.len().div_ceil(columns);
    let legend = panels.iter().map(Panel::legend).max().unwrap_or(0);
    let size = (PANEL.0 * columns as u32, (PANEL.1 + legend) * rows as u32);
    let root = SVGBackend::new(path, size).into_drawing_area();
    let failed = |error: &dyn std::fmt::Display| anyhow!("cannot draw {}: {error}", path.display());
    root.fill(&WHITE).map_err(|error| failed(&error))?;
    for (area, panel) in root.split_evenly((rows, columns)).iter().zip(&panels) {
        let (axes, below) = area.split_vertically(PANEL.1);
        draw_panel(&axes, panel, range.clone()).map_err(|error| failed(&error))?;
        draw_legend(&below, &panel.curves).map_err(|error| failed(&error))?;
    }
    root.present().map_err(|error| failed(&error))
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn draw_panel(area: &Area, panel: &Panel, range: Range<f64>) -> Result<(), Box<dyn std::error::Error>> {
    let frames = panel.curves.iter().map(|curve| curve.figures.len()).max().unwrap_or(1);
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, ("sans-serif", 18))
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(AXIS - 10)
        .build_cartesian_2d(1.0..frames.max(2) as f64, range)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc("frame")
        .y_desc(&panel.axis)
        .axis_desc_style(("sans-serif", 15))
        .label_style(("sans-serif", 13))
        .x_labels(8)
        .x_label_formatter(&|frame| format!("{frame:.0}"))
        .y_labels(7)
        .draw()?;
    for (curve, colour) in coloured(&panel.curves) {
        let points = || curve.figures.iter().enumerate().map(|(frame, figure)| (frame as f64 + 1.0, *figure));
        chart.draw_series(LineSeries::new(points(), colour.stroke_width(2)))?;
        chart.draw_series(points().map(|point| Circle::new(point, 2, colour.filled())))?;
    }
    Ok(())
}

/// Below the axes, where it hides no curve.
fn draw_legend(area: &Area, curves: &[Curve]) -> Result<(), Box<dyn std::error::Error>> {
    for (index, (curve, colour)) in coloured(curves).enumerate() {
        let (column, row) = ((index % LEGEND_COLUMNS) as i32, (index / LEGEND_COLUMNS) as i32);
        let (x, y) = (AXIS + column * LEGEND_CELL.0, row * LEGEND_CELL.1 + LEGEND_CELL.1 / 2);
        area.draw(&PathElement::new([(x, y), (x + 24, y)], colour.stroke_width(3)))?;
        area.draw(&Text::new(curve.label.as_str(), (x + 32, y - 6), ("sans-serif", 13).into_font()))?;
    }
    Ok(())
}

fn coloured(curves: &[Curve]) -> impl Iterator<Item = (&Curve, &RGBColor)> {
    curves.iter().zip(COLOURS.iter().cycle())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(figures: &[f64]) -> Panel {
        let curve = Curve { label: "a & b".into(), figures: figures.to_vec() };
        Panel { title: "title".into(), axis: "px".into(), curves: vec![curve] }
    }

    #[test]
    fn a_chart_has_its_words_and_its_curves() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chart.svg");
        let panels = vec![panel(&[1.0, 3.0, 2.0]), panel(&[0.5, 0.5]), panel(&[])];
        draw(&path, panels, Scale::FromZero).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(svg.contains("width=\"1120\""), "two panels side by side");
        assert_eq!(svg.matches("a &amp; b").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 5);
    }

    #[test]
    fn all_panels_share_a_range_that_holds_their_figures() {
        let panels = [panel(&[0.9, 1.0]), panel(&[0.6])];
        let distances = Scale::FromZero.range(&panels).unwrap();
        assert!(distances.start == 0.0 && distances.end > 1.0);
        let shares = Scale::ToOne.range(&panels).unwrap();
        assert!(shares.start < 0.6 && shares.start > 0.5 && shares.end > 1.0 && shares.end < 1.05);
        assert!(Scale::ToOne.range(&[panel(&[])]).is_none());
    }
}
