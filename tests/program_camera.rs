//! Cameras that `rsrectify` knows, and clips that name theirs.

mod common;
#[path = "common/program.rs"]
mod program;

use common::shake::write_shaken;
use program::{Folder, rsrectify};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

/// Frames that tell nothing, in a mode of a HERO5 Session.
const VIDEO: &str = "videotestsrc num-buffers=12 pattern=snow \
    ! video/x-raw,format=I420,width=1280,height=720,framerate=25/1 ! x264enc speed-preset=ultrafast ! mux.";

/// A box of an MP4 file.
fn boxed(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = u32::try_from(content.len() + 8).unwrap().to_be_bytes();
    [&length[..], name, content].concat()
}

/// Adds the version of a GoPro's firmware to the index of a film, where cameras write it. The index is the last box.
fn sign(path: &Path, firmware: &str) {
    let mut file = std::fs::read(path).unwrap();
    let name = file.windows(4).rposition(|name| name == b"moov").unwrap();
    let index = file.split_off(name - 4);
    let signature = boxed(b"udta", &boxed(b"FIRM", firmware.as_bytes()));
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
fn a_camera_that_is_not_known_is_an_error() {
    let folder = Folder::new("camera-unknown");
    let clip = folder.file("clip.mp4");
    write_shaken(&clip, 1.5);
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
