// SPDX-License-Identifier: MIT OR Apache-2.0

//! A page of a clip for browsers: before and after under a slider, and its motion over time.

use super::videos;
use crate::damage::{self, Complaints};
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::messages::RESULT;
use crate::output::{self, MadeFolder, Unfinished};
use crate::plot::panels::{Panel, panels, untouched};
use crate::plot::series::Point;
use crate::readout::{self, Found};
use crate::rectifier_options::AnalysisOptions;
use crate::summary::{Source, Summary};
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;

/// The page, with `{{name}}` and `{{data}}` in it.
const TEMPLATE: &str = include_str!("page.html");
/// The files of the folder.
const PAGE: &str = "index.html";
const VIDEOS: [&str; 2] = ["before.mp4", "after.mp4"];

/// What the page's script draws.
#[derive(Serialize)]
struct Data<'a> {
    name: &'a str,
    /// Files before and after.
    videos: [&'static str; 2],
    /// Seconds after the first frame.
    times: Vec<f64>,
    /// Seconds from frame to frame, in the mean.
    period: f64,
    /// When stretches of frames without a motion begin and end.
    untouched: Vec<[f64; 2]>,
    panels: Vec<(Panel, [f64; 2])>,
    rows: Vec<(&'static str, String)>,
}

/// Writes the page of a clip, and its videos, into a folder.
pub fn write(
    clip: &Clip,
    folder: &Path,
    is_overwritten: bool,
    analysis: &AnalysisOptions,
    interruption: &Interruption,
) -> Result<()> {
    let started = Instant::now();
    clip.only_file("show --html")?;
    clip.begin()?;
    let is_empty = |folder: &Path| std::fs::read_dir(folder).is_ok_and(|mut files| files.next().is_none());
    if folder.exists() && !is_overwritten && !is_empty(folder) {
        bail!("{} is there already; --overwrite replaces a page in it", folder.display());
    }
    let _made = MadeFolder::make(folder, true)?;
    let page = folder.join(PAGE);
    let files = VIDEOS.map(|name| folder.join(name));
    for file in files.iter().chain([&page]) {
        output::check(clip.path(), file, is_overwritten)?;
    }
    let unfinished = [&files[0], &files[1], &page].map(|file| Unfinished::beside(file));
    for file in &unfinished {
        output::check_writable(file.path())?;
    }
    let mut told = analysis.clone();
    let found = readout::find_first(clip, &mut told, interruption)?;
    if !analysis.wants_readout() && told.leaves_readout_open() {
        told.expected = readout::expected(clip, &told, interruption)?;
    }
    let complaints = Complaints::listen();
    let written = videos::write(clip, &told, [unfinished[0].path(), unfinished[1].path()], interruption)?;
    let source = if analysis.leaves_readout_open() {
        Source::Sought(found.clone().map(Box::new))
    } else {
        Source::Given
    };
    let summary = Summary::new(&written.tally, &source, written.frames, started.elapsed(), 1.0);
    let html = html(&clip.name(), written.series.points(Some(summary.period)), &summary, found.as_ref())?;
    std::fs::write(unfinished[2].path(), html).with_context(|| format!("cannot write {}", page.display()))?;
    for (unfinished, file) in unfinished.iter().zip([&files[0], &files[1], &page]) {
        unfinished.finish(file)?;
    }
    log::info!(target: RESULT, "{}: {summary}", page.display());
    damage::report(clip, written.frames, false, complaints.first(), interruption)
}

/// The page of a clip.
fn html(name: &str, mut points: Vec<Point>, summary: &Summary, found: Option<&Found>) -> Result<String> {
    if let Some(found) = found.filter(|found| found.doubt().is_none()) {
        // All frames were rectified with it.
        points.iter_mut().for_each(|point| point.readout = found.estimate());
    }
    let first = points.first().map_or(0.0, |point| point.time);
    let last = points.last().map_or(first, |point| point.time);
    let with_span = |panel: Panel| {
        let span = panel.span();
        (panel, [span.start, span.end])
    };
    let data = Data {
        name,
        videos: VIDEOS,
        times: points.iter().map(|point| point.time - first).collect(),
        period: summary.period,
        untouched: untouched(&points, &(first..last))
            .into_iter()
            .map(|range| [range.start - first, range.end - first])
            .collect(),
        panels: panels(&points).into_iter().map(with_span).collect(),
        rows: [vec![("frames", summary.frames.to_string())], summary.rows()].concat(),
    };
    // Within a script, a tag of HTML would end it.
    let data = serde_json::to_string(&data)?.replace('<', "\\u003c");
    Ok(filled(TEMPLATE, &[("name", &escaped(name)), ("data", &data)]))
}

/// Text as HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The template with values in place of their names in double braces.
fn filled(template: &str, values: &[(&str, &str)]) -> String {
    let mut parts = template.split("{{");
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let named = part.split_once("}}");
        let value = named.and_then(|(name, _)| values.iter().find(|(known, _)| *known == name));
        match named.zip(value) {
            Some(((_, rest), (_, value))) => text.extend([*value, rest]),
            None => text.extend(["{{", part]),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_clips_are_text() {
        let name = "</title><script>alert(1)</script> {{data}} & \"x\".mp4";
        let text =
            filled("<title>{{name}}</title>{{data}} {{other}}", &[("name", &escaped(name)), ("data", "[]")]);
        let escaped = "&lt;/title&gt;&lt;script&gt;alert(1)&lt;/script&gt; {{data}} &amp; &quot;x&quot;.mp4";
        assert_eq!(text, format!("<title>{escaped}</title>[] {{{{other}}}}"));
        assert!(TEMPLATE.matches("{{name}}").count() == 2 && TEMPLATE.matches("{{data}}").count() == 1);
    }
}
