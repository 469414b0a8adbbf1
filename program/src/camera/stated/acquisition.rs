// SPDX-License-Identifier: MIT OR Apache-2.0

//! Canon and Sony: acquisition metadata in local sets (SMPTE RDD 18, EBU Tech 3349) in samples of timed metadata: a label of
//! 16 bytes that begins with 06 0E 2B 34, a length (BER), then items of a tag, a length, a value. Both makers have private
//! tags from E000 on, as AdrianEddy/telemetry-parser has them. What is around the sets differs; the labels are looked for.

use super::statement::{Kind, Stabilisation, Stated, StatedReadout, text};
use crate::boxes::{array, number};

const LABEL: &[u8] = &[0x06, 0x0e, 0x2b, 0x34];
/// Frames a second that the sensor takes: a fraction.
const CAPTURE_RATE: u16 = 0x8106;

/// The items of all sets in a sample.
fn items(sample: &[u8]) -> Vec<(u16, &[u8])> {
    let mut items = Vec::new();
    let mut rest = sample;
    while let Some(at) = rest.windows(LABEL.len()).position(|window| window == LABEL) {
        let behind = rest.get(at + 16..).unwrap_or_default();
        let (content, further) = set(behind).unwrap_or((&[], behind));
        let mut left = content;
        while let Some((tag, value)) = item(left) {
            items.push((tag, value));
            left = left.get(4 + value.len()..).unwrap_or_default();
        }
        rest = further;
    }
    items
}

/// The content after its length, and what comes after that.
fn set(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let first = usize::from(*bytes.first()?);
    let (start, length) = if first < 0x80 {
        (1, first)
    } else {
        let digits = bytes.get(1..1 + (first & 0x7f))?;
        // More than four of them are no length of a sample.
        let digits = (digits.len() <= 4).then_some(digits)?;
        (1 + digits.len(), digits.iter().fold(0, |length, digit| length << 8 | usize::from(*digit)))
    };
    bytes.get(start..)?.split_at_checked(length)
}

fn item(bytes: &[u8]) -> Option<(u16, &[u8])> {
    let tag = u16::from_be_bytes(array(bytes, 0)?);
    let length = usize::from(u16::from_be_bytes(array(bytes, 2)?));
    Some((tag, bytes.get(4..4 + length)?))
}

/// What a sample of Sony's `rtmd` states.
pub fn by_sony(sample: &[u8]) -> Stated {
    let items = items(sample);
    let get = |wanted: u16| items.iter().find(|(tag, _)| *tag == wanted).map(|(_, value)| *value);
    let microseconds = get(0xe40e).and_then(|value| number(value, 0));
    let readout = microseconds.and_then(|time| StatedReadout::new(f64::from(time) * 1e-3, "Sony rtmd E40E"));
    let rate = get(CAPTURE_RATE)
        .and_then(|value| Some(f64::from(number(value, 0)?) / f64::from(number(value, 4)?)))
        .filter(|rate| rate.is_normal());
    let stabilisation = get(0xe300).and_then(|value| value.first()).map(|mode| Stabilisation {
        is_on: *mode != 0,
        // Moves the sensor in some modes, crops in others.
        kind: Kind::Unknown,
        name: (*mode > 1).then(|| format!("mode {mode}")),
        source: "Sony rtmd E300",
    });
    let readout = readout.map(|readout| StatedReadout { capture_rate: rate, ..readout });
    Stated { readout, stabilisation, ..Stated::default() }
}

/// What a sample of Canon's timed metadata states; `is_canon` where the file names that maker elsewhere.
pub fn by_canon(sample: &[u8], is_canon: bool) -> Option<Stated> {
    let items = items(sample);
    let get = |wanted: u16| items.iter().find(|(tag, _)| *tag == wanted).map(|(_, value)| *value);
    let model = get(0xe228).and_then(text);
    // Another maker's tags of these numbers mean something else.
    let names_canon =
        model.as_ref().is_some_and(|model| model.starts_with("Canon") || model.starts_with("EOS"));
    if !names_canon && !is_canon {
        return None;
    }
    let nanoseconds = get(0xe209).and_then(|value| number(value, 0));
    let readout = nanoseconds.and_then(|time| StatedReadout::new(f64::from(time) * 1e-6, "Canon E209"));
    let mode = get(0xe226).and_then(|value| value.first()).filter(|mode| **mode != 0xff);
    let stabilisation = mode.map(|mode| Stabilisation {
        is_on: *mode != 0,
        kind: Kind::Electronic,
        name: (*mode > 1).then(|| format!("mode {mode}")),
        source: "Canon E226",
    });
    Some(Stated { maker: Some("Canon".to_owned()), model, readout, stabilisation, ..Stated::default() })
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A set of items, its length in three bytes.
    fn set_of(items: &[(u16, &[u8])]) -> Vec<u8> {
        let label = [LABEL, &[0x02, 0x53, 0x01, 0x01, 0x0c, 0x02, 0x01, 0x01, 0x7f, 0x01, 0, 0]].concat();
        let item = |(tag, value): &(u16, &[u8])| {
            [&tag.to_be_bytes()[..], &(value.len() as u16).to_be_bytes(), value].concat()
        };
        let items: Vec<u8> = items.iter().flat_map(item).collect();
        let length = (items.len() as u32).to_be_bytes();
        [&label[..], &[0x83], &length[1..], &items].concat()
    }

    /// A sample of `rtmd`, with a header of 28 bytes.
    pub fn sony() -> Vec<u8> {
        let camera = set_of(&[(CAPTURE_RATE, &[0, 0, 0, 120, 0, 0, 0, 1])]);
        let own = set_of(&[(0xe300, &[1]), (0xe40e, &8_700_u32.to_be_bytes())]);
        [&[0, 28][..], &[0; 26], &camera, &own].concat()
    }

    /// A sample of Canon's cameras: number and size of two packs.
    pub fn canon() -> Vec<u8> {
        let items: [(u16, &[u8]); 3] =
            [(0xe228, b"EOS R5 C\0"), (0xe209, &15_500_000_u32.to_be_bytes()), (0xe226, &[0])];
        let content = set_of(&items);
        let pack = |number: u32, content: &[u8]| {
            [&number.to_le_bytes()[..], &(content.len() as u32).to_le_bytes(), content].concat()
        };
        [pack(1, &[0; 12]), pack(2, &content)].concat()
    }

    #[test]
    fn sets_of_both_makers_are_read() {
        let stated = by_sony(&sony());
        let readout = stated.readout.unwrap();
        assert!((readout.milliseconds - 8.7).abs() < 1e-9 && readout.capture_rate == Some(120.0));
        assert!(stated.stabilisation.unwrap().is_on);
        let stated = by_canon(&canon(), false).unwrap();
        assert_eq!(stated.name().unwrap(), "Canon EOS R5 C");
        assert!((stated.readout.unwrap().milliseconds - 15.5).abs() < 1e-9);
        assert!(!stated.stabilisation.unwrap().is_on);
        assert_eq!(by_canon(&sony(), false), None);
    }
}
