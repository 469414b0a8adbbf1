// SPDX-License-Identifier: MIT OR Apache-2.0

//! Presets: settings saved under a name and taken over again.

use crate::common::*;
use gst::prelude::*;
use std::process::Command;

/// Set for the copy of this program that may write presets.
const FOLDER: &str = "XDG_DATA_HOME";

/// Presets go to a folder of the user, which is only read when GStreamer starts: the work is done by
/// another process of this program.
#[test]
fn a_preset_brings_back_every_setting() {
    let folder = std::env::temp_dir().join(format!("rsrectify-presets-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "presets::save_and_load"])
        .env(FOLDER, &folder)
        .output()
        .unwrap();
    let file = std::fs::read_to_string(folder.join("gstreamer-1.0/presets/GstRsRectify.prs"));
    std::fs::remove_dir_all(&folder).unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.contains("1 passed"), "{said}");
    let file = file.unwrap();
    assert!(file.contains("[camera]") && file.contains("readout-time=21000000"), "{file}");
    assert!(!file.contains("stats"), "{file}");
    // Two elements with one preset would have the same name, and could not be in one pipeline.
    assert!(!file.contains("\nname=") && !file.contains("\nparent="), "{file}");
}

#[test]
#[ignore = "writes into the user's folder; run by the test above with one of its own"]
fn save_and_load() {
    init();
    let make = || gst::ElementFactory::make("rsrectify").build().unwrap();
    let saved = make();
    saved.set_property("readout-time", 21_000_000u64);
    saved.set_property("lookahead", 9u32);
    saved.set_property("strength", 0.25);
    saved.set_property("border-color", 0x80ff_0010u32);
    saved.set_property_from_str("readout-direction", "right-to-left");
    saved.set_property_from_str("border-mode", "constant");
    saved.set_property("post-messages", true);
    saved.dynamic_cast_ref::<gst::Preset>().unwrap().save_preset("camera").unwrap();

    let loaded = make();
    loaded.dynamic_cast_ref::<gst::Preset>().unwrap().load_preset("camera").unwrap();
    for spec in saved.list_properties().iter().filter(|spec| spec.owner_type() == saved.type_()) {
        let value = |element: &gst::Element| format!("{:?}", element.property_value(spec.name()));
        assert!(spec.name() == "stats" || value(&saved) == value(&loaded), "{}", spec.name());
    }
    let names = loaded.dynamic_cast_ref::<gst::Preset>().unwrap().preset_names();
    assert_eq!(names.iter().map(|name| name.as_str()).collect::<Vec<_>>(), ["camera"]);
    let both = "fakesrc ! rsrectify @preset=camera ! rsrectify @preset=camera ! fakesink";
    let launched = gst::parse::launch(both);
    assert!(launched.is_ok(), "{launched:?}");
}

/// The presets of known cameras, from the folder that GStreamer is told of before it starts.
#[test]
fn known_cameras_are_presets() {
    let presets = concat!(env!("CARGO_MANIFEST_DIR"), "/presets");
    let folder = std::env::temp_dir().join(format!("rsrectify-no-presets-{}", std::process::id()));
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "presets::load_a_camera"])
        .env("GST_PRESET_PATH", presets)
        .env(FOLDER, &folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.contains("1 passed"), "{said}");
}

#[test]
#[ignore = "needs presets in a folder that GStreamer knows before it starts; run by the test above"]
fn load_a_camera() {
    init();
    let element = gst::ElementFactory::make("rsrectify").build().unwrap();
    let presets = element.dynamic_cast_ref::<gst::Preset>().unwrap();
    assert!(presets.preset_names().len() > 80);
    presets.load_preset("Sony A7S III 3840x2160@59.94").unwrap();
    assert_eq!(element.property::<u64>("expected-readout-time"), 8_700_000);
    assert_eq!(element.property::<u64>("expected-readout-deviation"), 313_200);
    let direction = element.property_value("expected-readout-direction");
    assert_eq!(direction.serialize().unwrap(), "top-to-bottom");
    // An expectation, no order.
    assert_eq!(element.property::<u64>("readout-time"), 0);
    let comment = presets.meta("Sony A7S III 3840x2160@59.94", "comment").unwrap();
    assert!(comment.contains("8 of 8 profiles by 8 people"), "{comment}");
    presets.load_preset("Fujifilm X-T5 3840x2160@50").unwrap();
    assert_eq!(element.property_value("expected-readout-direction").serialize().unwrap(), "bottom-to-top");
}
