//! The camera that a file names.
//!
//! | where | who writes it | source |
//! |---|---|---|
//! | `moov/meta`: `com.apple.quicktime.make`, `.model`; `com.android.manufacturer`, `.model` | phones, Canon, Panasonic | Apple, *QuickTime File Format*, "Metadata"; Android's MPEG4Writer |
//! | `moov/udta`: `©mak`, `©mod` | older QuickTime cameras, GStreamer's muxers | Apple, *QuickTime File Format*, "User data atoms" |
//! | `moov/udta/GPMF`: `MINF` | GoPro since HERO6 | gopro/gpmf-parser |
//! | `moov/udta/FIRM` | GoPro | the version begins with the model's number |
//! | `meta/xml `: `<Device manufacturer modelName>` | Sony | XAVC's NonRealTimeMeta |

use crate::boxes::{child, children, number, read_index, read_top_level};
use std::fs::File;
use std::path::Path;

/// Maker and model as a file states them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stated {
    pub maker: String,
    pub model: String,
}

/// GoPro's cameras by the first field of the firmware's version.
const GOPRO: [(&str, &str); 4] = [
    ("HD5.02", "HERO5 Black"),
    ("HD5.03", "HERO5 Session"),
    ("HD6.01", "HERO6 Black"),
    ("HD8.01", "HERO8 Black"),
];
/// Prefixes of the keys of makers and models.
const KEYS: [[&str; 2]; 2] = [
    ["com.apple.quicktime.make", "com.apple.quicktime.model"],
    ["com.android.manufacturer", "com.android.model"],
];
/// A box at the top level of a file that is larger than this holds no description.
const LARGEST_DESCRIPTION: u64 = 4 << 20;

/// The camera that made a file, if the file says so.
pub fn camera_of(path: &Path) -> Option<Stated> {
    let mut file = File::open(path).ok()?;
    let index = read_index(&mut file);
    let by_index = index.as_deref().and_then(|index| {
        let mut user_data = children(index).filter(|(name, _)| name == b"udta");
        by_keys(index)
            .or_else(|| user_data.find_map(|(_, user)| by_user_data(user).or_else(|| by_gopro(user))))
    });
    by_index.or_else(|| {
        let description = read_top_level(&mut file, b"meta", LARGEST_DESCRIPTION)?;
        by_sony(&description)
    })
}

/// The keys of a film's metadata, and their values.
fn by_keys(index: &[u8]) -> Option<Stated> {
    let meta = child(index, &[b"meta"])?;
    // QuickTime's has no version before its boxes, MP4's has one.
    let meta = if child(meta, &[b"keys"]).is_some() { meta } else { meta.get(4..)? };
    let names: Vec<&[u8]> = children(child(meta, &[b"keys"])?.get(8..)?).map(|(_, name)| name).collect();
    let values = child(meta, &[b"ilst"])?;
    // The name of a value's box is the number of its key, from 1 on.
    let value = |key: &str| {
        let number_of_key = names.iter().position(|name| *name == key.as_bytes())? + 1;
        let (_, content) =
            children(values).find(|(name, _)| number(name, 0) == u32::try_from(number_of_key).ok())?;
        // Type and language come first.
        text(child(content, &[b"data"])?.get(8..)?)
    };
    KEYS.iter().find_map(|[make, model]| Some(Stated { maker: value(make)?, model: value(model)? }))
}

fn by_user_data(user: &[u8]) -> Option<Stated> {
    // Length and language come first.
    let value = |name| text(child(user, &[name])?.get(4..)?);
    Some(Stated { maker: value(b"\xa9mak")?, model: value(b"\xa9mod")? })
}

fn by_gopro(user: &[u8]) -> Option<Stated> {
    let named = child(user, &[b"GPMF"]).and_then(|telemetry| text(gpmf_value(telemetry, b"MINF")?));
    let by_firmware = || {
        let version = text(child(user, &[b"FIRM"])?)?;
        GOPRO.iter().find(|(prefix, _)| version.starts_with(prefix)).map(|(_, model)| (*model).to_owned())
    };
    Some(Stated { maker: "GoPro".to_owned(), model: named.or_else(by_firmware)? })
}

/// The content of an entry of GoPro's metadata: entries of a name, a type, the size of an item, their number, and items up to
/// a multiple of four bytes. Entries of type 0 hold entries.
fn gpmf_value<'a>(mut entries: &'a [u8], wanted: &[u8; 4]) -> Option<&'a [u8]> {
    while let (Some(name), Some([kind, size, high, low])) = (entries.get(..4), entries.get(4..8)) {
        let length = usize::from(*size) * usize::from(u16::from_be_bytes([*high, *low]));
        let content = entries.get(8..8 + length)?;
        if name == wanted {
            return Some(content);
        }
        // Nothing nests deeper than an entry in a device.
        entries =
            if *kind == 0 { entries.get(8..)? } else { entries.get(8 + length.next_multiple_of(4)..)? };
    }
    None
}

fn by_sony(meta: &[u8]) -> Option<Stated> {
    // The version comes before the boxes.
    let xml = child(meta.get(4..)?, &[b"xml "])?.get(4..)?;
    let xml = std::str::from_utf8(xml).ok()?;
    let device = xml.split("<Device ").nth(1)?.split('>').next()?;
    let attribute = |name: &str| {
        let value = device.split(&format!("{name}=\"")).nth(1)?.split('"').next()?;
        Some(value.to_owned())
    };
    Some(Stated { maker: attribute("manufacturer")?, model: attribute("modelName")? })
}

/// Text without the zeros and blanks that fill it up; `None` where there is none.
fn text(bytes: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(bytes).ok()?.trim_matches(|c: char| c == '\0' || c.is_whitespace());
    (!text.is_empty()).then(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boxes::boxed;

    fn stated(bytes: &[u8]) -> Option<Stated> {
        let name = format!("rsrectify-camera-{:?}-{}", std::thread::current().id(), std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).unwrap();
        let found = camera_of(&path);
        std::fs::remove_file(path).unwrap();
        found
    }

    fn camera(maker: &str, model: &str) -> Option<Stated> {
        Some(Stated { maker: maker.to_owned(), model: model.to_owned() })
    }

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_be_bytes()).collect()
    }

    /// Metadata by keys.
    fn keyed(keys: &[(&str, &str)], before: &[u8]) -> Vec<u8> {
        let names: Vec<u8> = keys.iter().flat_map(|(key, _)| boxed(b"mdta", key.as_bytes())).collect();
        let values = keys.iter().zip(1_u32..).flat_map(|((_, value), index)| {
            let data = boxed(b"data", &[words(&[1, 0]), value.as_bytes().to_vec()].concat());
            boxed(&index.to_be_bytes(), &data)
        });
        let names = boxed(b"keys", &[words(&[0, keys.len() as u32]), names].concat());
        let content =
            [before.to_vec(), boxed(b"hdlr", &[0; 24]), names, boxed(b"ilst", &values.collect::<Vec<_>>())];
        boxed(b"moov", &[boxed(b"mvhd", &[0; 20]), boxed(b"meta", &content.concat())].concat())
    }

    fn with_user_data(content: &[Vec<u8>]) -> Vec<u8> {
        boxed(b"moov", &boxed(b"udta", &content.concat()))
    }

    #[test]
    fn each_kind_of_statement_is_read() {
        let phone = [("com.apple.quicktime.make", "Apple"), ("com.apple.quicktime.model", "iPhone 13")];
        assert_eq!(stated(&keyed(&phone, &[])), camera("Apple", "iPhone 13"));
        let phone = [
            ("com.android.version", "14"),
            ("com.android.manufacturer", "Google"),
            ("com.android.model", "Pixel 8"),
        ];
        assert_eq!(stated(&keyed(&phone, &[0; 4])), camera("Google", "Pixel 8"));
        let user = [boxed(b"\xa9mak", b"\0\x05\0\0Canon"), boxed(b"\xa9mod", b"\0\x09\0\0EOS R5 C")];
        assert_eq!(stated(&with_user_data(&user)), camera("Canon", "EOS R5 C"));
        let firmware = [boxed(b"FIRM", b"HD5.02.02.00.00")];
        assert_eq!(stated(&with_user_data(&firmware)), camera("GoPro", "HERO5 Black"));
        let entry = |name: &[u8; 4], kind: u8, size: u8, content: &[u8]| {
            let head = [&name[..], &[kind, size, 0, (content.len() / usize::from(size)) as u8]].concat();
            let fill = vec![0; content.len().next_multiple_of(4) - content.len()];
            [head, content.to_vec(), fill].concat()
        };
        let entries = [
            entry(b"DVID", b'L', 4, &[0; 4]),
            entry(b"DVNM", b'c', 1, b"Global Settings"),
            entry(b"MINF", b'c', 1, b"HERO8 Black"),
        ];
        let telemetry = entry(b"DEVC", 0, 1, &entries.concat());
        assert_eq!(stated(&with_user_data(&[boxed(b"GPMF", &telemetry)])), camera("GoPro", "HERO8 Black"));
        let xml = r#"<NonRealTimeMeta><Device manufacturer="Sony" modelName="ILCE-7SM3" serialNo="1"/></NonRealTimeMeta>"#;
        let description =
            boxed(b"meta", &[vec![0; 4], boxed(b"xml ", &[&[0; 4], xml.as_bytes()].concat())].concat());
        assert_eq!(
            stated(&[boxed(b"moov", &[]), boxed(b"mdat", &[0; 9]), description].concat()),
            camera("Sony", "ILCE-7SM3")
        );
    }

    #[test]
    fn files_that_name_no_camera_or_are_broken_have_none() {
        assert_eq!(stated(&with_user_data(&[boxed(b"FIRM", b"X1.02")])), None);
        assert_eq!(stated(b"no film"), None);
        let phone = [("com.apple.quicktime.make", "Apple"), ("com.apple.quicktime.model", "iPhone 13")];
        let whole = keyed(&phone, &[]);
        for end in 0..whole.len() {
            // An index that is cut off may still name its maker; any answer will do.
            let _ = stated(&whole[..end]);
        }
        for place in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[place] ^= 0xff;
            let _ = stated(&bytes);
        }
    }
}
