// SPDX-License-Identifier: MIT OR Apache-2.0

//! Numbered images as clips, and as what is written.

use crate::shared::{CLIP, Folder, READOUT, rsrectify};
use std::path::Path;
use std::process::{Command, Output};

const FRAMES: usize = 12;
/// A moving picture, lossless.
const MOVING: &str = "-f lavfi -i testsrc2=size=160x120:rate=30,format=PIX -frames:v 12";

fn ffmpeg(folder: &Path, arguments: &[&str]) -> Vec<u8> {
    let mut command = Command::new("ffmpeg");
    command.current_dir(folder).args(["-nostdin", "-v", "error", "-y"]).args(arguments);
    let output = command.output().expect("the tests need ffmpeg");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// Images 1 to 12 of a format in a folder, from 1 on.
fn images(folder: &Folder, below: &str, name: &str, format: &str) {
    std::fs::create_dir_all(folder.file(below)).unwrap();
    let arguments = MOVING.replace("PIX", format);
    let mut arguments: Vec<&str> = arguments.split_whitespace().collect();
    arguments.push(name);
    // FFmpeg would take a `%` in the name of the folder for a pattern, too.
    ffmpeg(&folder.file(below), &arguments);
}

fn run(command: &str, arguments: &[&str], folder: &Folder) -> Output {
    rsrectify(command).current_dir(&folder.0).args(arguments).output().unwrap()
}

fn succeeds(command: &str, arguments: &[&str], folder: &Folder) -> String {
    let result = run(command, arguments, folder);
    let said = String::from_utf8([result.stdout, result.stderr].concat()).unwrap();
    assert!(result.status.success(), "{said}");
    said
}

/// The frames of a file or of images as RGB.
fn frames(folder: &Path, input: &[&str], format: &str) -> Vec<u8> {
    ffmpeg(folder, &[input, &["-pix_fmt", format, "-f", "rawvideo", "-"]].concat())
}

fn names(folder: &Folder, below: &str) -> Vec<String> {
    names_of(&folder.file(below))
}

#[test]
fn images_become_images_with_the_frames_of_the_film() {
    let folder = Folder::new("images 50%");
    images(&folder, "my 100% frames", "%04d.png", "rgb24");
    let below = folder.file("my 100% frames");
    // Names with what C takes for formats, from a number on that is not 1.
    for number in (1..=FRAMES).rev() {
        let from = below.join(format!("{number:04}.png"));
        std::fs::rename(from, below.join(format!("a 7%x {:03}.png", number + 98))).unwrap();
    }
    let options = [&READOUT[..], &["--fps", "30"]].concat();
    let told = succeeds("fix", &[&["my 100% frames"], &options[..]].concat(), &folder);
    assert!(told.contains("images: 12 at 30 frames/s"), "{told}");
    let written = names(&folder, "my 100% frames-rectified");
    assert_eq!(
        (written.len(), written[0].as_str(), written[11].as_str()),
        (12, "a 7%x 099.png", "a 7%x 110.png")
    );

    // By the pattern, as a film that loses nothing.
    let pattern = "my 100% frames/a 7%x %03d.png";
    succeeds("fix", &[&[pattern, "--output", "film.mkv"], &options[..]].concat(), &folder);
    let film = frames(&folder.0, &["-i", "film.mkv"], "rgb24");
    assert_eq!(film.len(), FRAMES * 160 * 120 * 3);
    let after = folder.file("my 100% frames-rectified");
    let read = |folder: &Path| -> Vec<u8> {
        let all = names_of(folder).into_iter().map(|name| {
            frames(folder, &["-f", "image2", "-pattern_type", "none", "-i", name.as_str()], "rgb24")
        });
        all.flatten().collect()
    };
    let all = read(&after);
    assert!(all == film, "the images are not the frames of the film");
    assert!(all != read(&below), "nothing was rectified");

    // And the film as images, from 1 on.
    succeeds(
        "fix",
        &[&["film.mkv", "--output", "again/%d.png", "--strength", "0"], &READOUT[..]].concat(),
        &folder,
    );
    assert!(
        frames(&folder.0, &["-i", "again/%d.png"], "rgb24") == film,
        "the film's images are not its frames"
    );
}

fn names_of(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn deep_images_stay_deep() {
    let folder = Folder::new("deep");
    images(&folder, "in", "%d.png", "rgb48be");
    succeeds(
        "fix",
        &[&["in", "--output", "out/%02d.png", "--strength", "0"], &READOUT[..]].concat(),
        &folder,
    );
    let [before, after] =
        ["in/%d.png", "out/%02d.png"].map(|name| frames(&folder.0, &["-i", name], "rgb48le"));
    assert!(before == after, "16 bits are not kept");
    let kind = |name: &str| {
        let mut probe = Command::new("ffprobe");
        probe
            .args(["-v", "error", "-show_entries", "stream=pix_fmt", "-of", "csv=p=0"])
            .arg(folder.file(name));
        String::from_utf8(probe.output().unwrap().stdout).unwrap()
    };
    assert_eq!(kind("out/03.png").trim(), "rgb48be");
    // A film of 10 bits becomes images of 16.
    ffmpeg(&folder.0, &["-i", "in/%d.png", "-c:v", "ffv1", "-pix_fmt", "yuv420p10le", "film.mkv"]);
    succeeds("fix", &[&["film.mkv", "--output", "ten/%d.png"], &READOUT[..]].concat(), &folder);
    assert_eq!((kind("ten/1.png").trim(), names(&folder, "ten").len()), ("rgb48be", FRAMES));
}

#[test]
fn jpeg_and_tiff_are_read_and_their_times_are_those_of_the_rate() {
    let folder = Folder::new("jpeg");
    images(&folder, "jpeg", "%d.jpg", "yuvj420p");
    images(&folder, "tiff", "%d.tiff", "rgb24");
    for below in ["jpeg", "tiff"] {
        let told = succeeds("track", &[&[below, "--fps", "50"], &READOUT[..]].concat(), &folder);
        let lines: Vec<_> =
            told.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit())).collect();
        assert_eq!(lines.len(), FRAMES, "{told}");
        assert!(lines[FRAMES - 1].starts_with("11,0.220000,"), "{told}");
        let told = succeeds("measure", &[below, "--json"], &folder);
        assert!(told.contains("25 frames/s, as --fps is not given"), "{told}");
        succeeds("plot", &[&[below], &READOUT[..]].concat(), &folder);
        succeeds("show", &[&[below], &READOUT[..]].concat(), &folder);
        let output = format!("{below}.mp4");
        succeeds("fix", &[&[below, "--output", &output], &READOUT[..]].concat(), &folder);
    }
    for name in ["jpeg-motion.svg", "jpeg-shown.mkv", "tiff-shown.mkv", "tiff.mp4"] {
        assert!(folder.names().contains(&name.to_owned()), "{name}: {:?}", folder.names());
    }
}

#[test]
fn images_that_are_no_clip_are_named() {
    let folder = Folder::new("no-images");
    images(&folder, "gap", "%03d.png", "rgb24");
    std::fs::remove_file(folder.file("gap/007.png")).unwrap();
    images(&folder, "size", "%03d.png", "rgb24");
    ffmpeg(&folder.0, &["-f", "lavfi", "-i", "testsrc2=size=64x48", "-frames:v", "1", "size/005.png"]);
    images(&folder, "kinds", "a%d.png", "rgb24");
    images(&folder, "kinds", "b%d.png", "rgb24");
    images(&folder, "broken", "%d.png", "rgb24");
    std::fs::write(folder.file("broken/9.png"), "no image").unwrap();
    images(&folder, "there", "%d.png", "rgb24");
    std::fs::create_dir(folder.file("empty")).unwrap();
    let film = folder.clip("film.mp4", "mp4mux", CLIP);
    let film = film.to_str().unwrap();
    for (arguments, code, reason) in [
        (&["gap"][..], 1, "gap/007.png is missing: there are images from 1 to 12"),
        (&["size"], 1, "size/005.png is of 64 x 48 pixels, size/001.png of 160 x 120"),
        (&["kinds"], 2, "images of several kinds in this folder, such as a%d.png and b%d.png"),
        (&["broken/%d.png"], 1, "broken/9.png is no image"),
        (&["empty"], 2, "no video in this folder"),
        (&["none/%d.png"], 1, "none"),
        (&["there/x%d.png"], 1, "no file matches"),
        (&[film, "--fps", "30"], 2, "--fps is of numbered images"),
        (&["there", "--fps", "0"], 2, "neither a number"),
        (&["there", "--output", "there/%d.png"], 1, "the same images"),
        (&[film, "--output", "there/%d.png"], 1, "there/1.png is there already"),
        (&[film, "--output", "new/%d.jpg"], 2, "a pattern such as frames/%06d.png"),
        (&[film, "--output", "no/new/%d.png"], 1, "cannot make no/new"),
        (&[film, "--output", "new/%d.png", "--codec", "h264"], 1, "leave --codec out"),
        (&[film, "--output", "new/%d.png", "--quality", "3"], 1, "neither --quality"),
        (&["there", "--output", "new/%d.png", "--frames", "1:3"], 1, "takes a file, not numbered images"),
    ] {
        let result = run("fix", &[arguments, &READOUT].concat(), &folder);
        let said = String::from_utf8_lossy(&result.stderr);
        assert_eq!(result.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains("error: ") && said.contains(reason), "{reason}: {said}");
    }
    assert!(!["no", "new"].iter().any(|name| folder.names().contains(&(*name).to_owned())));
    let left: Vec<_> = names(&folder, "there").into_iter().filter(|name| name.ends_with(".part")).collect();
    assert!(left.is_empty(), "{left:?}");
    let result = run("index", &["there/%d.png"], &folder);
    assert!(
        String::from_utf8_lossy(&result.stderr).contains("rsrectify index takes a file, not numbered images")
    );
}

#[test]
fn images_that_are_replaced_may_leave_others() {
    let folder = Folder::new("replaced");
    images(&folder, "in", "%d.png", "rgb24");
    images(&folder, "out", "%d.png", "rgb24");
    std::fs::copy(folder.file("in/1.png"), folder.file("out/13.png")).unwrap();
    let told =
        succeeds("fix", &[&["in", "--output", "out/%d.png", "--overwrite"], &READOUT[..]].concat(), &folder);
    assert!(told.contains("warning: out/13.png was there before and is not of this clip"), "{told}");
    assert_eq!(names(&folder, "out").len(), FRAMES + 1);
}
