// SPDX-License-Identifier: MIT OR Apache-2.0

//! Cameras that `rsrectify` knows, and clips that name theirs.

use crate::common::shake::write_shaken;
use crate::shared::{Folder, rsrectify};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

/// Frames that tell nothing, in a mode of a HERO5 Session.
const VIDEO: &str = "videotestsrc num-buffers=4 pattern=snow \
    ! video/x-raw,format=I420,width=1280,height=720,framerate=25/1 ! x264enc speed-preset=ultrafast ! mux.";

/// A box of an MP4 file.
fn boxed(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len() + 8).unwrap().to_be_bytes();
    [&length[..], name, content].concat()
}

/// Adds the version of a GoPro's firmware to the index of a film, where cameras write it. The index is the last box.
fn sign(path: &Path, firmware: &str) {
    add_user_data(path, &boxed(b"FIRM", firmware.as_bytes()));
}

/// Adds the settings of a GoPro with HyperSmooth.
fn sign_stabilised(path: &Path) {
    let entry = |name: &[u8; 4], kind: u8, size: u8, content: &[u8]| {
        let head = [&name[..], &[kind, size, 0, (content.len() / usize::from(size)) as u8]].concat();
        [head, content.to_vec(), vec![0; content.len().next_multiple_of(4) - content.len()]].concat()
    };
    let entries = [
        entry(b"MINF", b'c', 1, b"HERO11 Black"),
        entry(b"SROT", b'f', 4, &12.0_f32.to_be_bytes()),
        entry(b"EISE", b'c', 1, b"Y"),
        entry(b"EISA", b'c', 1, b"HS High"),
    ];
    add_user_data(path, &boxed(b"GPMF", &entry(b"DEVC", 0, 1, &entries.concat())));
}

/// Writes a gyroscope's log with a readout beside a clip.
fn write_log(clip: &Path, milliseconds: f64, direction: u32) {
    let log = format!(
        "GYROFLOW IMU LOG\nversion,1.3\nvendor,potatocam\nframe_readout_time,{milliseconds}\n\
         frame_readout_direction,{direction}\nt,gx,gy,gz\n"
    );
    std::fs::write(clip.with_extension("gcsv"), log).unwrap();
}

fn add_user_data(path: &Path, content: &[u8]) {
    let mut file = std::fs::read(path).unwrap();
    let name = file.windows(4).rposition(|name| name == b"moov").unwrap();
    let index = file.split_off(name - 4);
    let signature = boxed(b"udta", content);
    file.extend(boxed(b"moov", &[&index[8..], &signature].concat()));
    std::fs::write(path, file).unwrap();
}

fn fix(clip: &Path, options: &[&str]) -> Output {
    let output = clip.with_extension("fixed.mp4");
    rsrectify("fix").arg(clip).arg("--output").arg(output).args(options).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_clip_that_names_its_camera_starts_from_its_readout() {
    let folder = Folder::new("camera-named");
    let clip = folder.clip("clip.mp4", "mp4mux", VIDEO);
    assert!(!said(&fix(&clip, &[])).contains("camera:"));
    sign(&clip, "HD5.03.02.51.00");
    let output = fix(&clip, &["--overwrite"]);
    assert!(output.status.success());
    assert!(
        said(&output).contains("camera: GoPro HERO5 Session 1280x720@25; 25.2 ± 2.5 ms expected"),
        "{}",
        said(&output)
    );
    assert!(!said(&fix(&clip, &["--overwrite", "--camera", "none"])).contains("camera:"));
    // It is expected as well where the readout is sought frame by frame only.
    assert!(said(&fix(&clip, &["--overwrite", "--readout-time", "0"])).contains("25.2 ± 2.5 ms expected"));
    // What is given by hand is no expectation.
    assert!(!said(&fix(&clip, &["--overwrite", "--readout-time", "12"])).contains("camera:"));
    let output = fix(&clip, &["--overwrite", "--camera", "hero8 black"]);
    assert!(
        said(&output).contains("camera: GoPro HERO8 Black; no readout is known at 1280x720, 25.00 frames/s")
    );
}

#[test]
fn what_is_known_of_a_camera_is_stated_beside_what_is_measured() {
    let folder = Folder::new("camera-measured");
    let clip = folder.clip("clip.mp4", "mp4mux", VIDEO);
    sign(&clip, "HD5.03.02.51.00");
    let measure = |options: &[&str]| {
        let output = rsrectify("measure").arg(&clip).args(options).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let report = |options: &[&str]| {
        let report: Value = serde_json::from_str(&measure(&[options, &["--json"]].concat())).unwrap();
        report["clips"][0].clone()
    };
    let (known, alone) = (report(&[]), report(&["--camera", "none"]));
    let expected = &known["expected"];
    assert_eq!(expected["camera"], "GoPro HERO5 Session");
    assert_eq!((&expected["mode"], &expected["direction"]), (&"1280x720@25".into(), &"top-to-bottom".into()));
    assert_eq!(expected["signed_readout_ms"], 25.2);
    // It is no part of what is measured.
    assert_eq!(alone.get("expected"), None);
    assert!(alone["hypotheses"].is_array() && known["hypotheses"] == alone["hypotheses"]);
    assert!(
        measure(&[]).contains("expected      25.2 ms ± 2.5, top-to-bottom: GoPro HERO5 Session, 1280x720@25")
    );
    assert!(!measure(&["--camera", "hero8 black"]).contains("expected"));
}

#[test]
fn a_readout_that_is_stated_is_expected_by_all_commands() {
    let folder = Folder::new("camera-stated");
    let clip = folder.file("clip.mp4");
    write_shaken(&clip, 0.5);
    write_log(&clip, 20.0, 1);
    let expected = "20.0 ± 2.0 ms expected, stated with the clip: GCSV frame_readout_time";
    let output = fix(&clip, &[]);
    assert!(said(&output).contains(expected), "{}", said(&output));
    assert!(!String::from_utf8_lossy(&output.stdout).contains("overrules"));
    for (command, file) in [("track", "csv"), ("plot", "svg"), ("show", "shown.mp4")] {
        let option = if command == "track" { "--csv" } else { "--output" };
        let output =
            rsrectify(command).arg(&clip).arg(option).arg(clip.with_extension(file)).output().unwrap();
        assert!(output.status.success() && said(&output).contains(expected), "{command}: {}", said(&output));
    }
    // A camera that the user names, or none, counts instead.
    assert!(!said(&fix(&clip, &["--overwrite", "--camera", "none"])).contains("expected"));
}

#[test]
fn the_picture_overrules_a_readout_that_is_stated() {
    let folder = Folder::new("camera-overruled");
    let clip = folder.file("clip.mp4");
    write_shaken(&clip, 1.5);
    // The film is read in 20 ms, from the bottom up.
    write_log(&clip, 8.0, 0);
    let output = fix(&clip, &[]);
    let found = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(found.contains("bottom-to-top"), "{found}");
    assert!(found.contains("; the picture overrules the 8.0 ± 0.8 ms that were expected"), "{found}");
    let output = rsrectify("measure").arg(&clip).arg("--json").output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let clip = &report["clips"][0];
    assert_eq!((&clip["overrules_expected"], &clip["stated"]["readout"]["ms"]), (&true.into(), &8.0.into()));
    assert_eq!(clip["stated"]["readout"]["direction"], "top-to-bottom");
}

#[test]
fn stabilisation_in_the_camera_is_reported() {
    let folder = Folder::new("camera-stabilised");
    let clip = folder.clip("clip.mp4", "mp4mux", VIDEO);
    sign_stabilised(&clip);
    for options in [&[][..], &["--readout-time", "0"], &["--readout-time", "12"], &["--camera", "none"]] {
        let output = fix(&clip, &[options, &["--overwrite"]].concat());
        let line = "stabilisation: on in the camera (HS High, GPMF EISE)";
        assert_eq!(said(&output).matches(line).count(), 1, "{options:?}: {}", said(&output));
    }
    // Anything from 0 to what is stated: half of it, ± 1/√12 of it.
    let expected = "camera: GoPro HERO11 Black 1280x720; 6.0 ± 3.5 ms expected, stated with the clip: GPMF SROT, 12.0 ms \
        without the stabilisation";
    assert!(said(&fix(&clip, &["--overwrite"])).contains(expected));
    let measure = |options: &[&str]| {
        let output = rsrectify("measure").arg(&clip).args(options).output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(measure(&[]).contains("  stabilised    on in the camera (HS High, GPMF EISE)"));
    let report: Value = serde_json::from_str(&measure(&["--json"])).unwrap();
    let clip = &report["clips"][0];
    assert_eq!(clip["stated"]["stabilisation"]["on"], true);
    assert_eq!(clip["stated"]["stabilisation"]["kind"], "electronic");
    assert_eq!(clip["expected"]["without_stabilisation_ms"], 12.0);
}

#[test]
fn a_camera_that_is_not_known_is_an_error() {
    let folder = Folder::new("camera-unknown");
    let clip = folder.file("clip.mp4");
    write_shaken(&clip, 0.5);
    let output = fix(&clip, &["--camera", "Pinhole 3"]);
    assert_eq!(output.status.code(), Some(2));
    let reason = "'Pinhole 3' for '--camera <NAME>': no such camera is known; `rsrectify cameras` lists those that are";
    assert!(said(&output).contains(reason), "{}", said(&output));
}

#[test]
fn cameras_are_listed_and_found_by_a_part_of_their_name() {
    let list = rsrectify("cameras").output().unwrap();
    let list = String::from_utf8(list.stdout).unwrap();
    assert!(list.lines().filter(|line| line.starts_with("GoPro")).count() == 4, "{list}");
    let found = rsrectify("cameras").arg("x-t5").output().unwrap();
    let found = String::from_utf8(found.stdout).unwrap();
    assert!(
        found.starts_with("Fujifilm X-T5\n") && found.contains("13.3 ms ± 1.3, bottom-to-top"),
        "{found}"
    );
    assert_eq!(rsrectify("cameras").arg("pinhole").output().unwrap().status.code(), Some(1));
}
