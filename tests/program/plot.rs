// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify plot`, run as a user runs it.

use crate::common::film;
use crate::common::shake::{FPS, RATIO, shake, shaken, write_film, write_shaken};
use crate::shared::{CLIP, Folder, rsrectify};
use std::path::Path;
use std::process::Output;

fn plot(clip: &Path, options: &[&str]) -> Output {
    rsrectify("plot").arg(clip).args(options).output().unwrap()
}

/// The value of an attribute of an SVG element.
fn attribute<'a>(element: &'a str, name: &str) -> &'a str {
    let rest = element.split(&format!(" {name}=\"")).nth(1).unwrap_or_else(|| panic!("no {name}: {element}"));
    rest.split('"').next().unwrap()
}

/// The points of all elements of a kind that have this colour.
fn points(svg: &str, kind: &str, colour: &str) -> Vec<Vec<[f64; 2]>> {
    let elements = svg.lines().filter(|line| {
        line.starts_with(&format!("<{kind} ")) && line.to_ascii_uppercase().contains(&format!("\"{colour}\""))
    });
    let pair = |text: &str| {
        let (x, y) = text.split_once(',').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    };
    elements.map(|element| attribute(element, "points").split_whitespace().map(pair).collect()).collect()
}

/// The text of the file, and where it stands.
fn texts(svg: &str) -> Vec<(String, [f64; 2])> {
    let mut texts = Vec::new();
    let mut lines = svg.lines();
    while let Some(line) = lines.next() {
        if line.starts_with("<text ") {
            let place = ["x", "y"].map(|name| attribute(line, name).parse().unwrap());
            texts.push((lines.next().unwrap().trim().to_owned(), place));
        }
    }
    texts
}

fn covariance(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum()
}

#[test]
fn the_figure_shows_the_motion_and_the_readout_of_a_shaken_camera() {
    let folder = Folder::new("plot");
    let clip = folder.file("shaken.mp4");
    write_shaken(&clip, 1.5);
    let output = plot(&clip, &[]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(folder.names(), ["shaken-motion.svg", "shaken.mp4"]);
    let svg = std::fs::read_to_string(folder.file("shaken-motion.svg")).unwrap();
    let texts = texts(&svg);
    let has = |wanted: &str| texts.iter().any(|(text, _)| text == wanted);
    for label in [
        "pixels per frame",
        "degrees per frame",
        "milliseconds",
        "share, 0 to 1",
        "pixels",
        "seconds of the clip",
        "x, to the right",
        "y, down",
        "clockwise",
    ] {
        assert!(has(label), "{label} is missing: {texts:?}");
    }
    let frames = 45;
    assert!(has(&format!("shaken.mp4: motion of the picture in {frames} frames")), "{texts:?}");

    // Those of the legend have two points.
    let curve = |colour: &str| {
        let curves: Vec<_> =
            points(&svg, "polyline", colour).into_iter().filter(|points| points.len() > 2).collect();
        assert!(curves.iter().all(|points| points.len() == frames), "{colour} has gaps");
        curves
    };
    // Two panels are blue and two vermilion; the first of each is a shift.
    for (colour, axis) in [("#0072B2", 0), ("#D55E00", 1)] {
        let curves = curve(colour);
        assert_eq!(curves.len(), 2, "{colour}");
        let drawn: Vec<f64> = curves[0].iter().map(|point| -point[1]).collect();
        let speed = |frame: usize| {
            let (first, last) = (frame as f64 / FPS, (frame as f64 + RATIO) / FPS);
            let (a, b) = (shake(first), shake(last));
            [b.0 - a.0, b.1 - a.1][axis]
        };
        let truth: Vec<f64> = (0..frames).map(speed).collect();
        let correlation =
            covariance(&drawn, &truth) / (covariance(&drawn, &drawn) * covariance(&truth, &truth)).sqrt();
        assert!(correlation > 0.97, "axis {axis}: {correlation}");
    }
    assert_eq!(curve("#009E73").len(), 1);
    assert_eq!(curve("#CC79A7").len(), 1);
    // The interval has two sides; it is drawn around the curve and narrows.
    let band = &points(&svg, "polygon", "#CC79A7")[0];
    assert_eq!(band.len(), 2 * frames);
    let width = |frame: usize| band[frame][1] - band[2 * frames - 1 - frame][1];
    assert!(width(frames - 1) > 0.0 && width(frames - 1) < 0.5 * width(0), "{} {}", width(0), width(44));

    // From the bottom up is negative.
    let truth = -1e3 * RATIO / FPS;
    let found = texts.iter().find(|(text, _)| text.contains(" ms ")).unwrap();
    assert!(found.0.contains("bottom-to-top in the end, 95 %: "), "{}", found.0);
    let number = |text: &str| text.replace('−', "-").parse::<f64>().unwrap();
    let stated = number(found.0.split(' ').next().unwrap());
    assert!((stated - truth).abs() < 2.0, "{}", found.0);
    // Its axis has the place of −20 ms where the curve ends.
    let end = curve("#CC79A7")[0][frames - 1][1];
    let panel = found.1[1];
    let tick = |wanted: f64| {
        let below = texts.iter().filter(|(_, place)| place[1] > panel && place[1] < panel + 700.0);
        let ticks = below.filter(|(text, _)| text.replace('−', "-").parse::<f64>() == Ok(wanted));
        ticks.map(|(_, place)| place[1]).next().unwrap_or_else(|| panic!("no tick at {wanted}: {texts:?}"))
    };
    let (zero, ten) = (tick(0.0), tick(-10.0));
    let drawn = -10.0 * (end - zero) / (ten - zero);
    assert!((drawn - stated).abs() < 0.5, "{drawn} {stated}");
}

#[test]
fn frames_without_a_motion_are_gaps() {
    let folder = Folder::new("gap");
    let clip = folder.file("gap.mp4");
    // Ten grey frames in the middle.
    let grey = |number: usize| {
        let mut buffer = shaken(number);
        let frame = buffer.get_mut().unwrap();
        if (15..25).contains(&number) {
            frame.map_writable().unwrap().fill(128);
        }
        buffer
    };
    write_film(&clip, 40, grey);
    let svg = folder.file("figure.svg");
    assert!(plot(&clip, &["--output", svg.to_str().unwrap()]).status.success());
    let svg = std::fs::read_to_string(svg).unwrap();
    let turns: Vec<_> =
        points(&svg, "polyline", "#009E73").iter().map(Vec::len).filter(|length| *length > 2).collect();
    assert_eq!(turns.len(), 2, "{turns:?}");
    let missing = 40 - turns.iter().sum::<usize>();
    assert!((9..=12).contains(&missing), "{turns:?}");
    let texts = texts(&svg);
    assert!(texts.iter().any(|(text, _)| *text == format!("{missing} frames without a motion")), "{texts:?}");
}

#[test]
fn a_png_shows_the_same_with_text() {
    let folder = Folder::new("png");
    let clip = folder.clip("still.mp4", "mp4mux", CLIP);
    let png = folder.file("still.png");
    let output = plot(&clip, &["--output", png.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let description = format!(
        "filesrc location={} ! pngdec ! videoconvert ! video/x-raw,format=GRAY8 ! appsink name=out sync=false",
        png.display()
    );
    let pipeline = film::launch(&description);
    use gst::prelude::*;
    pipeline.set_state(gst::State::Playing).unwrap();
    let sink = pipeline.by_name("out").unwrap().downcast::<gst_app::AppSink>().unwrap();
    let sample = sink.pull_sample().unwrap();
    pipeline.set_state(gst::State::Null).unwrap();
    let caps = sample.caps().unwrap().structure(0).unwrap();
    assert_eq!((caps.get::<i32>("width").unwrap(), caps.get::<i32>("height").unwrap()), (2000, 1896));
    // The title, dark on white, where nothing else is drawn.
    let pixels = sample.buffer().unwrap().map_readable().unwrap();
    let dark = pixels[..2000 * 80].iter().filter(|pixel| **pixel < 100).count();
    assert!((1000..40_000).contains(&dark), "{dark} dark pixels");
}

#[test]
fn what_cannot_be_plotted_says_why() {
    let folder = Folder::new("refused-plot");
    let clip = folder.clip("still.mp4", "mp4mux", CLIP);
    let said = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();
    let file = |name: &str| folder.file(name).to_str().unwrap().to_owned();
    let output = plot(&clip, &["--output", &file("figure.pdf")]);
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains(".svg or .png"), "{}", said(&output));
    std::fs::write(folder.file("there.svg"), "mine").unwrap();
    let output = plot(&clip, &["--output", &file("there.svg")]);
    assert_eq!(output.status.code(), Some(1));
    assert!(said(&output).contains("--overwrite"), "{}", said(&output));
    std::fs::write(folder.file("text.mp4"), "no video").unwrap();
    for (name, reason) in [("text.mp4", "text.mp4"), ("none.mp4", "No such file"), ("", "folder")] {
        let output = plot(&folder.file(name), &["--output", &file("new.svg")]);
        assert_eq!(output.status.code(), Some(1), "{}", said(&output));
        assert!(said(&output).starts_with("error: ") && said(&output).contains(reason), "{}", said(&output));
    }
    assert_eq!(std::fs::read_to_string(folder.file("there.svg")).unwrap(), "mine");
    assert_eq!(folder.names(), ["still.mp4", "text.mp4", "there.svg"]);
    // Into a folder.
    assert!(plot(&clip, &["--output", &format!("{}/", file("figures"))]).status.success());
    assert!(folder.file("figures/still-motion.svg").exists());
}
