// SPDX-License-Identifier: MIT OR Apache-2.0

//! Insta360: records behind the film, at the end of the file.
//!
//! The last 72 bytes are padding (32), the size of all records, a version, and a magic text (32). Before them are the records,
//! the last one first: content, format, number, size of the content. Record 1 is a message of Protocol Buffers. Numbers of
//! its fields: AdrianEddy/telemetry-parser.

use super::protobuf::field;
use super::statement::{Kind, Stabilisation, Stated, StatedReadout, text};
use crate::boxes::array;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

const MAGIC: &[u8] = b"8db42d694ccc418790edff439fe026bf";
const TRAILER: u64 = 72;
const DESCRIPTION: u8 = 1;
/// More records than any file has.
const MOST: usize = 64;
/// A description that is larger is damaged: it has thumbnails and tables of some 100 kB.
const LARGEST: u64 = 4 << 20;
const MODEL: u64 = 2;
/// Milliseconds.
const READOUT_TIME: u64 = 25;
/// Whether FlowState was applied while the camera recorded.
const FLOW_STATE: u64 = 42;

/// What the records state.
pub fn by_records(file: &mut File) -> Option<Stated> {
    let length = file.seek(SeekFrom::End(0)).ok()?;
    let trailer = read(file, length.checked_sub(TRAILER)?, TRAILER)?;
    if trailer.get(40..)? != MAGIC {
        return None;
    }
    let mut end = length - TRAILER;
    for _ in 0..MOST {
        let head = read(file, end.checked_sub(6)?, 6)?;
        let size = u64::from(u32::from_le_bytes(array(&head, 2)?));
        let start = (end - 6).checked_sub(size)?;
        if head.get(1) == Some(&DESCRIPTION) {
            return Some(by_description(&read(file, start, size.min(LARGEST))?));
        }
        end = start;
    }
    None
}

fn read(file: &mut File, start: u64, length: u64) -> Option<Vec<u8>> {
    file.seek(SeekFrom::Start(start)).ok()?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

fn by_description(message: &[u8]) -> Stated {
    let milliseconds = field(message, READOUT_TIME).and_then(|time| time.double());
    let readout = milliseconds.and_then(|time| StatedReadout::new(time, "Insta360 rolling_shutter_time"));
    // A value of 0 is not written: one that is missing may not be known to the camera either.
    let is_on = field(message, FLOW_STATE).and_then(|value| value.number()).is_some_and(|value| value != 0);
    let stabilisation = is_on.then(|| Stabilisation {
        is_on,
        kind: Kind::Electronic,
        name: Some("FlowState".to_owned()),
        source: "Insta360 is_flowstate_online",
    });
    let model = field(message, MODEL).and_then(|model| text(model.bytes()?));
    Stated { maker: Some("Insta360".to_owned()), model, readout, stabilisation, ..Stated::default() }
}

/// Records at the end of a file.
#[cfg(test)]
pub fn records() -> Vec<u8> {
    use super::protobuf::{Value, tests::written};
    let description = [
        written(MODEL, Value::Bytes(b"Insta360 GO 2")),
        written(READOUT_TIME, Value::Double(11.2)),
        written(FLOW_STATE, Value::Number(1)),
    ];
    let record = |number: u8, content: &[u8]| {
        [content, &[1, number][..], &(content.len() as u32).to_le_bytes()].concat()
    };
    let records = [record(DESCRIPTION, &description.concat()), record(3, &[0; 40])].concat();
    let size = (records.len() as u32 + TRAILER as u32).to_le_bytes();
    [&records, &[0; 32][..], &size, &3_u32.to_le_bytes(), MAGIC].concat()
}
