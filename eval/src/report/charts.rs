//! Charts as SVG: a figure of each frame along a sequence, a curve a system.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Size of one panel in pixels.
const PANEL: (u32, u32) = (560, 360);

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

impl Panel {
    fn figures(&self) -> impl Iterator<Item = f64> + '_ {
        self.curves.iter().flat_map(|curve| curve.figures.iter().copied())
    }

    /// The vertical range: all figures and some air; room for the legend below.
    fn range(&self) -> Option<Range<f64>> {
        let lowest = self.figures().reduce(f64::min)?;
        let highest = self.figures().reduce(f64::max)?;
        let air = (highest - lowest).max(1e-3 * highest.abs().max(1.0));
        let legend = 0.11 * self.curves.len() as f64 * air;
        Some(lowest - legend - 0.05 * air..highest + 0.08 * air)
    }
}

/// Draws panels in rows of two.
///
/// # Errors
/// Where the file cannot be written.
pub fn draw(path: &Path, panels: &[Panel]) -> Result<()> {
    let panels: Vec<&Panel> = panels.iter().filter(|panel| panel.figures().next().is_some()).collect();
    if panels.is_empty() {
        return Ok(());
    }
    let columns = panels.len().min(2);
    let rows = panels.len().div_ceil(columns);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let root = SVGBackend::new(path, size).into_drawing_area();
    let failed = |error: &dyn std::fmt::Display| anyhow!("cannot draw {}: {error}", path.display());
    root.fill(&WHITE).map_err(|error| failed(&error))?;
    for (area, panel) in root.split_evenly((rows, columns)).iter().zip(panels) {
        draw_panel(area, panel).map_err(|error| failed(&error))?;
    }
    root.present().map_err(|error| failed(&error))
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Axes<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn draw_panel(area: &Area, panel: &Panel) -> Result<(), Box<dyn std::error::Error>> {
    let Some(range) = panel.range() else { return Ok(()) };
    let frames = panel.curves.iter().map(|curve| curve.figures.len()).max().unwrap_or(1);
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, ("sans-serif", 18))
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(58)
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
    draw_curves(&mut chart, &panel.curves)?;
    Ok(())
}

fn draw_curves<'a, 'b: 'a>(
    chart: &mut Axes<'a, 'b>,
    curves: &[Curve],
) -> Result<(), Box<dyn std::error::Error>> {
    for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        let style = colour.stroke_width(2);
        let points = || curve.figures.iter().enumerate().map(|(frame, figure)| (frame as f64 + 1.0, *figure));
        chart
            .draw_series(LineSeries::new(points(), style))?
            .label(&curve.label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 22, y)], style));
        chart.draw_series(points().map(|point| Circle::new(point, 2, colour.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .label_font(("sans-serif", 13))
        .legend_area_size(28)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(200, 200, 200))
        .draw()?;
    Ok(())
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
        draw(&path, &[panel(&[1.0, 3.0, 2.0]), panel(&[0.5, 0.5]), panel(&[])]).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(svg.contains("width=\"1120\" height=\"360\""), "two panels side by side");
        assert_eq!(svg.matches("a &amp; b").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 5);
    }

    #[test]
    fn the_range_holds_all_figures() {
        let range = panel(&[0.9, 1.0]).range().unwrap();
        assert!(range.start < 0.9 && range.end > 1.0);
        assert!(panel(&[]).range().is_none());
    }
}
