// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify show`, run as a user runs it.

use crate::common::shake::{FPS, RATIO, shake, shaken, write_film, write_shaken};
use crate::shared::{CLIP, Folder, TONE, buffers, rsrectify, size, times};
use std::path::Path;
use std::process::Output;

/// Columns of arrows across the frame, as the program draws them.
const ARROWS: usize = 12;
/// The readout of the film, as it is told.
const TOLD: [&str; 4] = ["--readout-time", "20", "--readout-direction", "bottom-to-top"];

fn show(clip: &Path, output: &Path, options: &[&str]) -> Output {
    rsrectify("show").arg(clip).arg("--output").arg(output).args(options).output().unwrap()
}

/// The frames of a clip in colour.
fn frames(path: &Path) -> Vec<gst::Sample> {
    buffers(path, "decodebin ! videoconvert ! video/x-raw,format=RGBx")
}

/// What a grey film with a drawing over it shows at a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    Inlier,
    Outlier,
    Arrow,
    Film,
}

/// A frame of 320 × 240 pixels.
struct Picture(Vec<u8>);

impl Picture {
    fn new(sample: &gst::Sample) -> Self {
        assert_eq!(size(sample), (320, 240));
        Self(sample.buffer().unwrap().map_readable().unwrap().to_vec())
    }

    fn seen(&self, x: usize, y: usize) -> Seen {
        let at = 4 * (320 * y + x);
        let [red, green, blue] = [self.0[at], self.0[at + 1], self.0[at + 2]].map(i32::from);
        // Blue, vermilion and yellow over grey.
        if blue > red + 60 {
            Seen::Inlier
        } else if red > blue + 60 && red > green + 50 {
            Seen::Outlier
        } else if red > blue + 60 {
            Seen::Arrow
        } else {
            Seen::Film
        }
    }

    /// Pixels of a part of the frame that show this.
    fn count(&self, seen: Seen, part: impl Fn(usize, usize) -> bool) -> usize {
        let places = (0..240).flat_map(|y| (0..320).map(move |x| (x, y)));
        places.filter(|(x, y)| part(*x, *y) && self.seen(*x, *y) == seen).count()
    }

    /// Whether there is an arrow within a pixel.
    fn has_arrow(&self, x: f64, y: f64) -> bool {
        let near = |centre: f64, most: usize| {
            let first = (centre - 0.5).round() as usize;
            first.saturating_sub(1)..=(first + 1).min(most - 1)
        };
        near(y, 240).any(|y| near(x, 320).any(|x| self.seen(x, y) == Seen::Arrow))
    }
}

/// Whether a pixel is above the strip of text.
fn above(_: usize, y: usize) -> bool {
    y < 170
}

#[test]
fn all_frames_are_shown_at_their_times_and_arrows_point_where_the_rows_belong() {
    let folder = Folder::new("show");
    let (clip, output) = (folder.file("shaken.mp4"), folder.file("shown.mkv"));
    write_shaken(&clip, 1.5);
    let magnify = 4.0;
    let options = [&TOLD[..], &["--codec", "ffv1", "--magnify", "4"]].concat();
    let result = show(&clip, &output, &options);
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    let (before, after) = (frames(&clip), frames(&output));
    assert_eq!(after.len(), 45);
    // Matroska counts milliseconds.
    for (before, after) in times(&before).into_iter().zip(times(&after)) {
        assert!(before.unwrap().abs_diff(after.unwrap()) <= 1000, "{before:?} {after:?}");
    }
    let step = 320.0 / ARROWS as f64;
    let (mut long, mut right, mut wrong) = (0, 0, 0);
    for (number, sample) in after.iter().enumerate() {
        let picture = Picture::new(sample);
        // A row is corrected by what the picture moves from when it is read until mid-readout.
        let at = |elapsed: f64| shake((number as f64 + RATIO * elapsed) / FPS);
        for index in 0..ARROWS * 6 {
            let place = [index % ARROWS, index / ARROWS].map(|k| (k as f64 + 0.5) * step + 0.5);
            let (seen, middle) = (at(1.0 - place[1] / 240.0), at(0.5));
            let arrow = [magnify * (middle.0 - seen.0), magnify * (middle.1 - seen.1)];
            // Long enough to be told from its neighbours and its own start.
            if arrow[0].hypot(arrow[1]) < 5.0 {
                continue;
            }
            let on = |share: f64| picture.has_arrow(place[0] + share * arrow[0], place[1] + share * arrow[1]);
            long += 1;
            right += usize::from(on(0.4) && on(0.85));
            wrong += usize::from(on(-0.5) || on(1.6));
        }
    }
    println!("{right} of {long} arrows are where they should be, {wrong} where they should not");
    assert!(long > 500, "{long} arrows");
    assert!(right > long * 95 / 100, "{right} of {long} arrows are where they should be");
    assert!(wrong < long / 10, "{wrong} of {long} arrows are where they should not be");

    // Correspondences follow the camera.
    let picture = Picture::new(&after[20]);
    let (inliers, outliers) = (picture.count(Seen::Inlier, above), picture.count(Seen::Outlier, above));
    assert!(inliers > 1500 && outliers < inliers / 20, "{inliers} and {outliers} pixels");
    // The bar is full: a line of it through its middle.
    let bar = (170..240).map(|y| picture.count(Seen::Inlier, |_, row| row == y)).max().unwrap();
    assert!(bar > 40, "a bar of {bar} pixels");
}

#[test]
fn what_moves_by_itself_is_drawn_as_outliers() {
    let folder = Folder::new("outliers");
    let (clip, output) = (folder.file("patch.mp4"), folder.file("patch.mkv"));
    let is_patch = |x: usize, y: usize| (120..200).contains(&x) && (60..140).contains(&y);
    // The patch shows the film backwards.
    write_film(&clip, 30, |number| {
        let mut buffer = shaken(number);
        let other = shaken(100 - number);
        {
            let other = other.map_readable().unwrap();
            let mut pixels = buffer.get_mut().unwrap().map_writable().unwrap();
            for y in 60..140 {
                let row = 320 * y + 120..320 * y + 200;
                pixels[row.clone()].copy_from_slice(&other[row]);
            }
        }
        buffer
    });
    let options = [&TOLD[..], &["--codec", "ffv1"]].concat();
    let result = show(&clip, &output, &options);
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    // At some instants both move alike: all frames are counted together.
    let (mut inliers, mut outliers) = ([0; 2], [0; 2]);
    for sample in &frames(&output)[5..25] {
        let picture = Picture::new(sample);
        let inside = |x: usize, y: usize| (130..190).contains(&x) && (70..130).contains(&y);
        let outside =
            |x: usize, y: usize| above(x, y) && !is_patch(x + 15, y) && !is_patch(x.max(15) - 15, y);
        for (sum, seen) in [(&mut inliers, Seen::Inlier), (&mut outliers, Seen::Outlier)] {
            sum[0] += picture.count(seen, inside);
            sum[1] += picture.count(seen, outside);
        }
    }
    println!("inside and outside the patch: {inliers:?} pixels of inliers, {outliers:?} of outliers");
    assert!(outliers[0] > 2000 && inliers[0] < outliers[0] / 5);
    assert!(inliers[1] > 20_000 && outliers[1] < inliers[1] / 10);
}

#[test]
fn a_film_without_motion_is_shown_as_it_is() {
    let folder = Folder::new("still-show");
    let clip = folder.clip("still.mp4", "mp4mux", &format!("{CLIP} {TONE} ! avenc_aac ! mux."));
    // Beside the clip, in its own kind of file.
    let result = rsrectify("show").arg(&clip).output().unwrap();
    let said = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success() && said.contains("--readout-time"), "{said}");
    assert_eq!(folder.names(), ["still-shown.mp4", "still.mp4"]);
    let shown = frames(&folder.file("still-shown.mp4"));
    assert_eq!(times(&shown), times(&frames(&clip)));
    let picture = Picture::new(&shown[15]);
    for seen in [Seen::Inlier, Seen::Outlier, Seen::Arrow] {
        assert_eq!(picture.count(seen, |_, _| true), 0, "{seen:?}");
    }
    // White letters on a dark strip: the gradient is brightest there.
    let dark = (0..320 * 240).filter(|k| k / 320 > 200 && picture.0[4 * k] < 90).count();
    assert!(dark > 5000, "{dark} dark pixels");
    // What is shown is no clip of the folder.
    let again = rsrectify("measure").arg(&folder.0).output().unwrap();
    assert!(!String::from_utf8_lossy(&again.stdout).contains("shown"));
}

#[test]
fn what_cannot_be_shown_says_why_and_leaves_nothing_behind() {
    let folder = Folder::new("refused-show");
    let clip = folder.clip("still.mp4", "mp4mux", CLIP);
    let sound = folder.clip("sound.mp4", "mp4mux", &format!("{TONE} ! avenc_aac ! mux."));
    std::fs::write(folder.file("text.mp4"), "no video").unwrap();
    let (none, text, new) = (folder.file("none.mp4"), folder.file("text.mp4"), folder.file("new.mp4"));
    for (clip, output, options, code, reason) in [
        (&clip, &folder.file("new.avi"), &[][..], 2, ".mp4, .mov, .mkv"),
        (&clip, &new, &["--magnify", "0"], 2, "between 0.1 and 1000"),
        (&clip, &new, &["--codec", "prores"], 1, "--container mov"),
        (&clip, &text, &[], 1, "--overwrite"),
        (&clip, &clip, &["--overwrite"], 1, "same file"),
        (&none, &new, &[], 1, "No such file"),
        (&sound, &new, &[], 1, "no video"),
        (&text, &new, &[], 1, "text.mp4"),
        (&clip, &folder.file("none/new.mp4"), &[], 1, "none/new.mp4"),
    ] {
        let result = show(clip, output, options);
        let said = String::from_utf8_lossy(&result.stderr);
        assert_eq!(result.status.code(), Some(code), "{said}");
        assert!(said.contains("error: ") && said.contains(reason), "{reason}: {said}");
    }
    assert_eq!(folder.names(), ["sound.mp4", "still.mp4", "text.mp4"]);
}

#[test]
fn a_page_has_both_videos_with_all_frames_and_the_name_as_text() {
    let folder = Folder::new("page");
    let clip = folder.file("<b> & \"1\".mp4");
    write_shaken(&folder.file("shaken.mp4"), 0.8);
    std::fs::rename(folder.file("shaken.mp4"), &clip).unwrap();
    let page = folder.file("page");
    let html = |options: &[&str]| {
        rsrectify("show").arg(&clip).arg("--html").arg(&page).args(TOLD).args(options).output().unwrap()
    };
    let result = html(&[]);
    assert!(result.status.success(), "{}", String::from_utf8_lossy(&result.stderr));
    let mut names: Vec<_> = std::fs::read_dir(&page).unwrap().map(|file| file.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["after.mp4", "before.mp4", "index.html"]);
    let [original, before, after] =
        [&clip, &page.join("before.mp4"), &page.join("after.mp4")].map(|file| frames(file));
    assert_eq!((before.len(), after.len(), size(&after[0])), (24, 24, (320, 240)));
    assert!(times(&before) == times(&original) && times(&after) == times(&original));
    // What is rectified is another picture, what is not is the clip's.
    let difference = |one: &gst::Sample, other: &gst::Sample| {
        let [one, other] = [one, other].map(|frame| frame.buffer().unwrap().map_readable().unwrap().to_vec());
        let sum: u32 = one.iter().zip(&other).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
        f64::from(sum) / one.len() as f64
    };
    let [same, other] = [&before, &after].map(|video| {
        let differences = video.iter().zip(&original).map(|(one, other)| difference(one, other));
        differences.fold(0.0, f64::max)
    });
    assert!(same < 3.0 && other > 2.0 * same, "{same} and {other}");

    let text = std::fs::read_to_string(page.join("index.html")).unwrap();
    assert!(text.contains("<title>&lt;b&gt; &amp; &quot;1&quot;.mp4: before and after</title>"));
    // The name of SVG is no address.
    let text = text.replace("http://www.w3.org/2000/svg", "");
    assert!(!text.contains("<b>") && !text.contains("{{") && !text.contains("http"));
    let data = text.split("id=\"data\">").nth(1).and_then(|rest| rest.split("</script>").next()).unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["name"], "<b> & \"1\".mp4");
    assert_eq!(data["times"].as_array().unwrap().len(), 24);
    for panel in data["panels"].as_array().unwrap() {
        let curves = panel[0]["curves"].as_array().unwrap();
        assert!(curves.iter().all(|curve| curve["values"].as_array().unwrap().len() == 24));
    }

    let refused = html(&[]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("--overwrite"), "{said}");
    assert!(html(&["--overwrite"]).status.success());
    assert_eq!(html(&["--overwrite", "--codec", "av1"]).status.code(), Some(2));
    // Of what is no clip no folder is left.
    let none = folder.file("none");
    let result =
        rsrectify("show").arg(folder.file("page/index.html")).arg("--html").arg(&none).output().unwrap();
    assert!(result.status.code() == Some(1) && !none.exists());
}

#[test]
fn raw_video_is_refused() {
    let folder = Folder::new("show-raw");
    let clip = folder.file("a.mp4");
    std::fs::write(&clip, "").unwrap();
    let refused = rsrectify("show").arg(&clip).args(["--container", "y4m"]).output().unwrap();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("MP4, MOV or MKV"), "{said}");
    assert_eq!(folder.names(), ["a.mp4"]);
}
