// SPDX-License-Identifier: MIT OR Apache-2.0

//! Metadata by keys, and user data, of QuickTime and MP4 files (Apple, *QuickTime File Format*, "Metadata", "User data atoms").

use super::statement::{Stated, StatedReadout, text};
use crate::boxes::{array, child, children, number};

/// Prefixes of the keys of makers and models.
const KEYS: [[&str; 2]; 2] = [
    ["com.apple.quicktime.make", "com.apple.quicktime.model"],
    ["com.android.manufacturer", "com.android.model"],
];
/// More keys than any film has.
const MOST_KEYS: usize = 4096;
/// iPhones up to the 5: microseconds, of a track.
const APPLE_READOUT: &str = "com.apple.quicktime.camera.framereadouttimeinmicroseconds";

/// The values of a film or a track by their keys.
struct Keyed<'a> {
    names: Vec<&'a [u8]>,
    values: &'a [u8],
}

impl<'a> Keyed<'a> {
    /// Of the box that has `meta` in it.
    fn of(parent: &'a [u8]) -> Option<Self> {
        let meta = child(parent, &[b"meta"])?;
        // QuickTime's has no version before its boxes, MP4's has one.
        let meta = if child(meta, &[b"keys"]).is_some() { meta } else { meta.get(4..)? };
        let names = children(child(meta, &[b"keys"])?.get(8..)?).map(|(_, name)| name);
        Some(Self { names: names.take(MOST_KEYS).collect(), values: child(meta, &[b"ilst"])? })
    }

    /// Type and content.
    fn value(&self, key: &str) -> Option<(u32, &'a [u8])> {
        // The name of a value's box is the number of its key, from 1 on.
        let number_of_key = self.names.iter().position(|name| *name == key.as_bytes())? + 1;
        let (_, content) =
            children(self.values).find(|(name, _)| number(name, 0) == u32::try_from(number_of_key).ok())?;
        let data = child(content, &[b"data"])?;
        Some((number(data, 0)?, data.get(8..)?))
    }

    fn text(&self, key: &str) -> Option<String> {
        text(self.value(key)?.1)
    }

    /// The first of the numbers in a value.
    fn numbers(&self, key: &str) -> Option<[f64; 2]> {
        let (kind, content) = self.value(key)?;
        Some([scalar(kind, content)?, scalar(kind, content.get(4..).unwrap_or_default()).unwrap_or(0.0)])
    }
}

/// A number by its well-known type; of pairs the first.
fn scalar(kind: u32, bytes: &[u8]) -> Option<f64> {
    let unsigned = || {
        let digits = (1..=8).contains(&bytes.len()).then_some(bytes)?;
        Some(digits.iter().fold(0_u64, |number, digit| number << 8 | u64::from(*digit)))
    };
    Some(match kind {
        1 => text(bytes)?.parse().ok()?,
        // Signed ones that are meant here are not negative; others come out too large to be used.
        21 | 22 | 65..=67 | 74..=78 => unsigned()? as f64,
        23 | 70 | 71 => f64::from(f32::from_be_bytes(array(bytes, 0)?)),
        24 => f64::from_be_bytes(array(bytes, 0)?),
        _ => return None,
    })
}

/// What the keys of a film or a track state.
pub fn by_keys(parent: &[u8]) -> Option<Stated> {
    let keyed = Keyed::of(parent)?;
    let named = KEYS.iter().find_map(|[make, model]| Some([keyed.text(make)?, keyed.text(model)?]));
    let blackmagic = keyed.text("manufacturer").zip(keyed.text("camera_type"));
    let [maker, model] =
        named.or(blackmagic.map(|(maker, model)| [maker, model])).map_or([None, None], |name| name.map(Some));
    let apple = keyed
        .numbers(APPLE_READOUT)
        .and_then(|[time, _]| StatedReadout::new(time * 1e-3, "QuickTime framereadouttimeinmicroseconds"));
    // Blackmagic: width and height of the part of the sensor in photosites, and microseconds a row.
    let lines = || {
        let [[_, rows], [time, _]] =
            [keyed.numbers("sensor_area_captured")?, keyed.numbers("sensor_line_time")?];
        StatedReadout::new(rows * time * 1e-3, "Blackmagic sensor_line_time")
    };
    Some(Stated { maker, model, readout: apple.or_else(lines), ..Stated::default() })
}

/// What user data state: older cameras, GStreamer's muxers.
pub fn by_user_data(user: &[u8]) -> Option<Stated> {
    // Length and language come first.
    let value = |name| text(child(user, &[name])?.get(4..)?);
    Some(Stated { maker: Some(value(b"\xa9mak")?), model: Some(value(b"\xa9mod")?), ..Stated::default() })
}

/// A box `meta` with texts and other values.
#[cfg(test)]
pub fn keyed(keys: &[(&str, u32, &[u8])], before: &[u8]) -> Vec<u8> {
    use crate::boxes::boxed;
    let names: Vec<u8> = keys.iter().flat_map(|(key, ..)| boxed(b"mdta", key.as_bytes())).collect();
    let values = keys.iter().zip(1_u32..).flat_map(|((_, kind, value), index)| {
        let data = boxed(b"data", &[&kind.to_be_bytes()[..], &[0; 4], value].concat());
        boxed(&index.to_be_bytes(), &data)
    });
    let count = (keys.len() as u32).to_be_bytes();
    let names = boxed(b"keys", &[&[0; 4], &count[..], &names].concat());
    let values = boxed(b"ilst", &values.collect::<Vec<_>>());
    boxed(b"meta", &[before.to_vec(), boxed(b"hdlr", &[0; 24]), names, values].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_states_its_readout_in_microseconds() {
        // As in a file of an iPhone 4S.
        let meta = keyed(&[(APPLE_READOUT, 22, &[0, 0, 0x76, 0x30])], &[]);
        let readout = by_keys(&meta).unwrap().readout.unwrap();
        assert!((readout.milliseconds - 30.256).abs() < 1e-9);
        let meta = keyed(&[(APPLE_READOUT, 1, b"28512")], &[0; 4]);
        assert!((by_keys(&meta).unwrap().readout.unwrap().milliseconds - 28.512).abs() < 1e-9);
        let meta = keyed(&[(APPLE_READOUT, 21, &[0xff; 8])], &[]);
        assert_eq!(by_keys(&meta).unwrap().readout, None);
    }

    #[test]
    fn the_rows_of_a_sensor_take_their_time() {
        let area = [6048_f32, 4032.0].map(f32::to_be_bytes).concat();
        let meta = keyed(
            &[
                ("manufacturer", 1, b"Blackmagic Design"),
                ("camera_type", 1, b"Blackmagic Cinema Camera 6K"),
                ("sensor_area_captured", 71, &area),
                ("sensor_line_time", 23, &4.638_f32.to_be_bytes()),
            ],
            &[],
        );
        let stated = by_keys(&meta).unwrap();
        assert!((stated.readout.unwrap().milliseconds - 18.7).abs() < 0.01);
        assert_eq!(stated.model.unwrap(), "Blackmagic Cinema Camera 6K");
    }
}
