// SPDX-License-Identifier: MIT OR Apache-2.0

//! Sony: the description of a clip of XAVC S, XML in a box at the top level of the file. Its samples: `acquisition.rs`.

use super::statement::Stated;
use crate::boxes::child;

/// What the box states.
pub fn by_description(meta: &[u8]) -> Option<Stated> {
    // The version comes before the boxes.
    let xml = child(meta.get(4..)?, &[b"xml "])?.get(4..)?;
    let xml = std::str::from_utf8(xml).ok()?;
    let device = xml.split("<Device ").nth(1)?.split('>').next()?;
    let attribute = |name: &str| {
        let value = device.split(&format!("{name}=\"")).nth(1)?.split('"').next()?;
        super::statement::text(value.as_bytes())
    };
    Some(Stated { maker: attribute("manufacturer"), model: attribute("modelName"), ..Stated::default() })
}
