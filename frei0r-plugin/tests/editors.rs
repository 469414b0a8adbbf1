// SPDX-License-Identifier: MIT OR Apache-2.0

//! What Kdenlive and Shotcut show of the filter names its parameters and their values.

use frei0r_rsrectify::{Filter, Kind, PARAMETERS};
use std::ffi::CString;

const KDENLIVE: &str = include_str!("../editors/kdenlive/frei0r_rsrectify.xml");
const SHOTCUT: [&str; 2] =
    [include_str!("../editors/shotcut/meta.qml"), include_str!("../editors/shotcut/ui.qml")];

/// What stands between quotation marks behind each place of `before`.
fn quoted<'a>(text: &'a str, before: &'a str) -> impl Iterator<Item = &'a str> {
    text.split(before).skip(1).filter_map(|rest| rest.split('"').next())
}

fn index_of(name: &str) -> usize {
    let found = PARAMETERS.iter().position(|parameter| parameter.name.to_str() == Ok(name));
    found.unwrap_or_else(|| panic!("the filter has no {name}"))
}

#[test]
fn kdenlive_sets_all_parameters() {
    let mut names = Vec::new();
    for parameter in KDENLIVE.split("<parameter ").skip(1) {
        let name = quoted(parameter, " name=\"").next().unwrap();
        let value = quoted(parameter, "default=\"").next().unwrap();
        let (index, filter) = (index_of(name), Filter::new(4, 4));
        // The defaults are the filter's own, but where MLT knows better.
        match PARAMETERS[index].kind {
            Kind::Number => assert_eq!(filter.number(index), value.parse().ok(), "{name}"),
            Kind::Text if name == "time-unit" => assert_eq!(value, "seconds"),
            Kind::Text => {
                assert_eq!(filter.text(index), CString::new(value).ok(), "{name}");
            }
        }
        names.push(name);
    }
    names.sort_unstable();
    let mut expected: Vec<_> = PARAMETERS.iter().map(|parameter| parameter.name.to_str().unwrap()).collect();
    expected.sort_unstable();
    assert_eq!(names, expected);
}

#[test]
fn editors_offer_the_values_that_the_filter_takes() {
    let explained = |name| PARAMETERS[index_of(name)].explanation.to_str().unwrap();
    let lists: Vec<Vec<&str>> =
        quoted(KDENLIVE, "paramlist=\"").map(|list| list.split(';').collect()).collect();
    assert_eq!(lists.len(), 2);
    for (list, name) in lists.iter().zip(["interpolation", "border-mode"]) {
        assert!(list.iter().all(|value| explained(name).contains(value)), "{list:?}");
        let in_shotcut = list.iter().map(|value| format!("\"{value}\"")).collect::<Vec<_>>().join(", ");
        assert!(SHOTCUT[1].contains(&in_shotcut), "{in_shotcut}");
    }
}

#[test]
fn shotcut_sets_parameters_that_there_are() {
    assert_eq!(quoted(KDENLIVE, "tag=\"").next(), Some("frei0r.rsrectify"));
    assert_eq!(quoted(SHOTCUT[0], "mlt_service: \"").next(), Some("frei0r.rsrectify"));
    let set: Vec<_> = quoted(SHOTCUT[1], "filter.set(\"").collect();
    assert!(set.len() > 5 && set.iter().all(|name| index_of(name) < PARAMETERS.len()));
    let defaults = SHOTCUT[1].split("property var defaults: ({").nth(1).unwrap().split("})").next().unwrap();
    for line in defaults.lines().filter(|line| line.contains(':')) {
        let name = quoted(line, "        \"").next().unwrap();
        let value = line.split(": ").nth(1).unwrap().trim_end_matches(',').trim_matches('"');
        let (index, filter) = (index_of(name), Filter::new(4, 4));
        match PARAMETERS[index].kind {
            Kind::Number => assert_eq!(filter.number(index), value.parse().ok(), "{name}"),
            Kind::Text => assert_eq!(filter.text(index), CString::new(value).ok(), "{name}"),
        }
    }
}
