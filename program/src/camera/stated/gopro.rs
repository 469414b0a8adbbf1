// SPDX-License-Identifier: MIT OR Apache-2.0

//! GoPro: GPMF, in `moov/udta/GPMF` and in the samples of tracks of the format `gpmd`.
//!
//! Names and types of the entries: gopro/gpmf-parser, ExifTool's `GoPro` tags; looked up in files of a GoPro MAX and a HERO5.

use super::statement::{Kind, Stabilisation, Stated, StatedReadout, text};
use crate::boxes::{array, child};

/// GoPro's cameras by the first field of the firmware's version.
const MODELS: [(&str, &str); 4] = [
    ("HD5.02", "HERO5 Black"),
    ("HD5.03", "HERO5 Session"),
    ("HD6.01", "HERO6 Black"),
    ("HD8.01", "HERO8 Black"),
];
/// Names of a stabilisation that is off.
const OFF: [&str; 4] = ["N", "N/A", "NONE", "OFF"];

/// An entry of a name, a type, the size of an item, their number, and items up to a multiple of four bytes.
#[derive(Clone, Copy, Debug)]
struct Entry<'a> {
    kind: u8,
    content: &'a [u8],
}

impl Entry<'_> {
    /// One number, or several: a size, a fraction.
    fn numbers(&self, separator: &str) -> Option<String> {
        let numbers =
            self.content.chunks_exact(4).filter_map(|bytes| array(bytes, 0).map(u32::from_be_bytes));
        let numbers: Vec<String> = numbers.map(|number| number.to_string()).collect();
        (self.kind == b'L' && !numbers.is_empty()).then(|| numbers.join(separator))
    }

    fn float(&self) -> Option<f64> {
        (self.kind == b'f').then(|| array(self.content, 0).map(f32::from_be_bytes))?.map(f64::from)
    }

    fn text(&self) -> Option<String> {
        text(self.content)
    }
}

/// The first entry of a name. Entries of type 0 hold entries.
fn entry<'a>(mut entries: &'a [u8], wanted: &[u8; 4]) -> Option<Entry<'a>> {
    while let (Some(name), Some([kind, size, high, low])) = (entries.get(..4), entries.get(4..8)) {
        let length = usize::from(*size) * usize::from(u16::from_be_bytes([*high, *low]));
        let content = entries.get(8..8 + length)?;
        if name == wanted {
            return Some(Entry { kind: *kind, content });
        }
        // Nothing nests deeper than an entry in a device.
        entries =
            if *kind == 0 { entries.get(8..)? } else { entries.get(8 + length.next_multiple_of(4)..)? };
    }
    None
}

/// What entries state.
pub fn by_telemetry(telemetry: &[u8]) -> Stated {
    let get = |name| entry(telemetry, name);
    let name = get(b"EISA").and_then(|entry| entry.text());
    let is_off = |name: &str| OFF.contains(&name.to_uppercase().as_str());
    let (is_on, source) = match (get(b"EISE").and_then(|entry| entry.text()), &name) {
        (Some(switch), _) => (Some(!is_off(&switch)), "GPMF EISE"),
        // Cameras before HERO8 state only this.
        (None, name) => (name.as_ref().map(|name| !is_off(name)), "GPMF EISA"),
    };
    let stabilisation = is_on.map(|is_on| Stabilisation {
        is_on,
        kind: Kind::Electronic,
        name: name.filter(|name| !is_off(name)),
        source,
    });
    let orientation = get(b"OREN").and_then(|entry| entry.text()).map(|letter| match letter.as_str() {
        "U" => "up".to_owned(),
        "D" => "down".to_owned(),
        "A" => "automatic".to_owned(),
        _ => letter,
    });
    let mode = [
        get(b"VRES").and_then(|entry| entry.numbers("x")),
        get(b"VFPS").and_then(|entry| entry.numbers("/")),
        get(b"VFOV").and_then(|entry| entry.text()),
    ];
    let mode = mode.into_iter().flatten().collect::<Vec<_>>().join(" ");
    let milliseconds = get(b"SROT").and_then(|entry| entry.float());
    Stated {
        maker: entry(telemetry, b"DEVC").map(|_| "GoPro".to_owned()),
        model: get(b"MINF").and_then(|entry| entry.text()),
        readout: milliseconds.and_then(|time| StatedReadout::new(time, "GPMF SROT")),
        stabilisation,
        orientation,
        mode: (!mode.is_empty()).then_some(mode),
    }
}

/// What the user data of a film state.
pub fn by_user_data(user: &[u8]) -> Stated {
    let stated = child(user, &[b"GPMF"]).map(by_telemetry).unwrap_or_default();
    let version = child(user, &[b"FIRM"]).and_then(text);
    let model = version.and_then(|version| MODELS.iter().find(|(prefix, _)| version.starts_with(prefix)));
    let by_firmware = model.map(|(_, model)| Stated {
        maker: Some("GoPro".to_owned()),
        model: Some((*model).to_owned()),
        ..Stated::default()
    });
    stated.or(by_firmware.unwrap_or_default())
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn gpmf(name: &[u8; 4], kind: u8, size: u8, content: &[u8]) -> Vec<u8> {
        let head = [&name[..], &[kind, size, 0, (content.len() / usize::from(size)) as u8]].concat();
        let fill = vec![0; content.len().next_multiple_of(4) - content.len()];
        [head, content.to_vec(), fill].concat()
    }

    pub fn device(entries: &[Vec<u8>]) -> Vec<u8> {
        gpmf(b"DEVC", 0, 1, &entries.concat())
    }

    #[test]
    fn a_device_states_readout_stabilisation_and_mode() {
        let fields = |switch: &[u8], name: &[u8]| {
            by_telemetry(&device(&[
                gpmf(b"DVID", b'L', 4, &[0; 4]),
                gpmf(b"MINF", b'c', 1, b"HERO9 Black\0"),
                gpmf(b"OREN", b'c', 1, b"U"),
                gpmf(b"VRES", b'L', 4, &[0, 0, 15, 0, 0, 0, 8, 112]),
                gpmf(b"VFPS", b'L', 4, &[0, 0, 234, 96, 0, 0, 3, 233]),
                gpmf(b"VFOV", b'c', 1, b"W"),
                gpmf(b"SROT", b'f', 4, &15.5_f32.to_be_bytes()),
                gpmf(b"EISE", b'c', 1, switch),
                gpmf(b"EISA", b'c', 1, name),
            ]))
        };
        let stated = fields(b"Y", b"HS High\0");
        assert_eq!(stated.name().unwrap(), "GoPro HERO9 Black");
        assert_eq!(stated.readout.unwrap().milliseconds, 15.5);
        assert_eq!(stated.orientation.unwrap(), "up");
        assert_eq!(stated.mode.unwrap(), "3840x2160 60000/1001 W");
        let stabilisation = stated.stabilisation.unwrap();
        assert!(stabilisation.is_on && stabilisation.name.unwrap() == "HS High");
        let stabilisation = fields(b"N", b"N/A").stabilisation.unwrap();
        assert!(!stabilisation.is_on && stabilisation.name.is_none());
    }

    #[test]
    fn older_cameras_state_their_stabilisation_by_name() {
        let on =
            |name: &[u8]| by_telemetry(&device(&[gpmf(b"EISA", b'c', 1, name)])).stabilisation.unwrap().is_on;
        assert!(on(b"Y") && on(b"EIS") && !on(b"N") && !on(b"None"));
        assert_eq!(by_telemetry(b"no such thing"), Stated::default());
    }
}
