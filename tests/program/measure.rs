// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify measure`, run as a user runs it.

use crate::common::shake::{FPS, RATIO, write_shaken};
use crate::shared::{CLIP, Folder, rsrectify, undocumented};
use serde_json::Value;
use std::path::Path;

/// What `measure` says, and its exit code.
fn measure(clips: &[&Path], options: &[&str]) -> (String, Option<i32>) {
    let output = rsrectify("measure").args(clips).args(options).output().unwrap();
    (String::from_utf8(output.stdout).unwrap(), output.status.code())
}

#[test]
fn a_shaken_camera_is_measured() {
    let folder = Folder::new("measure");
    let clip = folder.file("shaken.mp4");
    write_shaken(&clip, 1.5);
    // It reads from the bottom up.
    let truth = -1e3 * RATIO / FPS;
    let (said, code) = measure(&[&clip], &["--json"]);
    assert_eq!(code, Some(0));
    let report: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(undocumented(&report, "## rsrectify measure"), [""; 0]);
    let found = &report["clips"][0];
    let number = |value: &Value| value.as_f64().unwrap();
    assert!((number(&found["signed_readout_ms"]) - truth).abs() < 2.0, "{said}");
    let interval = &found["readout_interval_ms"];
    let width = number(&interval[1]) - number(&interval[0]);
    assert!((width - 2.0 * 1.96 * number(&found["readout_deviation_ms"])).abs() < 1e-9, "{said}");
    // Not as sure as if it were given, surer than a twentieth of the frame duration.
    assert!(width > 0.1 && width < 4.0 * 1e3 / FPS / 20.0, "{said}");
    assert_eq!(found["readout_direction"], "bottom-to-top");
    assert_eq!((&found["certain"], &found["frames_with_motion"]), (&Value::from(true), &found["frames"]));

    let (said, _) = measure(&[&clip], &[]);
    assert!(said.contains("bottom-to-top") && said.contains("certain       yes"), "{said}");
    assert!(said.contains("320 x 240, 30.00 frames/s, 4"), "{said}");
}

#[test]
fn clips_that_tell_nothing_say_why_and_count_for_nothing() {
    let folder = Folder::new("nothing");
    let shaken = folder.file("shaken.mp4");
    write_shaken(&shaken, 1.5);
    let still = folder.clip("still.mp4", "mp4mux", CLIP);
    let text = folder.file("text.mp4");
    std::fs::write(&text, "no video").unwrap();
    let (said, code) = measure(&[&still, &shaken, &text], &["--json", "--same-camera"]);
    assert_eq!(code, Some(1));
    let report: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(undocumented(&report, "## rsrectify measure"), [""; 0]);
    assert_eq!(report["clips"][0]["certain"], false);
    assert!(report["clips"][0]["doubts"][0].as_str().unwrap().contains("hardly moved"), "{said}");
    assert!(report["failed"][0]["clip"].as_str().unwrap().ends_with("text.mp4"), "{said}");
    let together = &report["same_camera"];
    assert!(together["left_out"][0].as_str().unwrap().ends_with("still.mp4"), "{said}");
    // The surer clip alone.
    let readout = |value: &Value| (value["signed_readout_ms"].clone(), value["readout_deviation_ms"].clone());
    assert_eq!(readout(together), readout(&report["clips"][1]), "{said}");
}
