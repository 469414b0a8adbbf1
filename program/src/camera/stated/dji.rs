// SPDX-License-Identifier: MIT OR Apache-2.0

//! DJI: messages in the samples of tracks of the format `djmd`.
//!
//! The fields are those of DJI's `dvtm_library.proto` and of its products' files, as AdrianEddy/telemetry-parser has them.
//! The fields 1 to 5 of a clip's metadata are the same for all products; what comes after them is numbered anew by some.

use super::protobuf::{field, message};
use super::statement::{Kind, Stabilisation, Stated, StatedReadout, text};
use rsrectify::readout::ReadoutDirection;

const CLIP: u64 = 1;
const HEADER: u64 = 1;
const PRODUCT_NAME: u64 = 10;
/// `SensorFrameReadOutTime`: nanoseconds.
const READOUT_TIME: u64 = 4;
/// `SensorReadDirection`.
const READ_DIRECTION: u64 = 5;
/// Where the focal length, the stabilisation and the frame rate of the sensor are, of most products and of others.
const LAYOUTS: [[u64; 3]; 2] = [[8, 9, 11], [6, 7, 9]];

/// What the first sample states.
pub fn by_sample(sample: &[u8]) -> Option<Stated> {
    let clip = message(sample, &[CLIP])?;
    let time = message(clip, &[READOUT_TIME]).and_then(|time| field(time, 1)?.number());
    // The focal length is the only one of these that is a float: it shows the layout.
    let is_float = |number| message(clip, &[number]).and_then(|focal| field(focal, 1)?.float()).is_some();
    let layout = LAYOUTS.into_iter().find(|[focal, ..]| is_float(*focal));
    let stabilisation = layout.and_then(|[_, status, _]| Some(stabilisation(message(clip, &[status])?)));
    let rate = layout.and_then(|[_, _, rate]| field(message(clip, &[rate])?, 1)?.float());
    let readout = time.and_then(|time| StatedReadout::new(time as f64 * 1e-6, "DJI sensor_readout_time"));
    let direction = message(clip, &[READ_DIRECTION]).map(direction);
    let readout = readout.map(|readout| StatedReadout {
        direction: direction.flatten(),
        capture_rate: rate.filter(|rate| rate.is_normal() && *rate > 0.0),
        ..readout
    });
    let model = message(clip, &[HEADER, PRODUCT_NAME]).and_then(text);
    let maker = Some("DJI".to_owned());
    Some(Stated { maker, model, readout, stabilisation, ..Stated::default() })
}

fn stabilisation(status: &[u8]) -> Stabilisation {
    // A value of 0 is not written.
    let status = field(status, 1).map_or(Some(0), |status| status.number());
    let (is_on, name) = match status {
        Some(0) => (false, None),
        Some(1) => (true, Some("RockSteady".to_owned())),
        Some(2) => (true, Some("HorizonSteady".to_owned())),
        // Off, with the same crop as if it were on.
        Some(7) => (false, None),
        other => (true, other.map(|mode| format!("mode {mode}"))),
    };
    Stabilisation { is_on, kind: Kind::Electronic, name, source: "DJI EisStatus" }
}

/// By the corner that is read first, and the edge along which it goes on.
fn direction(message: &[u8]) -> Option<ReadoutDirection> {
    match field(message, 1).map_or(Some(0), |corner| corner.number())? {
        0 | 1 => Some(ReadoutDirection::TopToBottom),
        2 | 3 => Some(ReadoutDirection::BottomToTop),
        4 | 7 => Some(ReadoutDirection::LeftToRight),
        5 | 6 => Some(ReadoutDirection::RightToLeft),
        _ => None,
    }
}

#[cfg(test)]
pub mod tests {
    use super::super::protobuf::Value;
    use super::super::protobuf::tests::written;
    use super::*;

    /// A sample by a layout, with a status of stabilisation.
    pub fn sample(layout: [u64; 3], status: Option<u64>) -> Vec<u8> {
        let nested = |number, fields: Vec<u8>| written(number, Value::Bytes(&fields));
        let header = [
            written(1, Value::Bytes(b"dvtm_wm169.proto")),
            written(PRODUCT_NAME, Value::Bytes(b"DJI Osmo Action 4")),
        ];
        let [focal, eis, rate] = layout;
        let clip = [
            nested(HEADER, header.concat()),
            nested(READOUT_TIME, written(1, Value::Number(7_800_000))),
            nested(READ_DIRECTION, written(1, Value::Number(2))),
            nested(focal, written(1, Value::Float(1800.0))),
            nested(eis, status.map(|status| written(1, Value::Number(status))).unwrap_or_default()),
            nested(rate, written(1, Value::Float(119.88))),
        ];
        nested(CLIP, clip.concat())
    }

    #[test]
    fn the_clip_metadata_of_each_layout_are_read() {
        for layout in LAYOUTS {
            let stated = by_sample(&sample(layout, Some(1))).unwrap();
            assert_eq!(stated.name().unwrap(), "DJI Osmo Action 4");
            let readout = stated.readout.unwrap();
            assert!((readout.milliseconds - 7.8).abs() < 1e-9);
            assert!((readout.on_clock_of(Some(29.97)) - 31.2).abs() < 1e-3);
            assert_eq!(readout.direction, Some(ReadoutDirection::BottomToTop));
            assert_eq!(stated.stabilisation.unwrap().name.unwrap(), "RockSteady");
            for off in [None, Some(0), Some(7)] {
                assert!(!by_sample(&sample(layout, off)).unwrap().stabilisation.unwrap().is_on);
            }
        }
        assert_eq!(by_sample(b"\0\0\0"), None);
    }
}
