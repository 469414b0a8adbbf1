// SPDX-License-Identifier: MIT OR Apache-2.0

//! What a camera wrote about a clip, in its file or beside it: itself, its readout time, its stabilisation.
//!
//! | where | who writes it | what | file |
//! |---|---|---|---|
//! | `moov/meta`, `moov/trak/meta`: keys | phones, Canon, Panasonic; iPhones up to the 5; Blackmagic | maker, model; readout | `keys.rs` |
//! | `moov/udta`: `©mak`, `©mod` | older QuickTime cameras, GStreamer's muxers | maker, model | `keys.rs` |
//! | `moov/udta/GPMF`, tracks `gpmd` | GoPro | model, readout, stabilisation, orientation, mode | `gopro.rs` |
//! | `moov/udta/FIRM` | GoPro | the version begins with the model's number | `gopro.rs` |
//! | `meta/xml `: `<Device manufacturer modelName>` | Sony | maker, model | `sony.rs` |
//! | tracks `rtmd` | Sony | readout, stabilisation | `acquisition.rs` |
//! | other tracks of timed metadata | Canon | model, readout, stabilisation | `acquisition.rs` |
//! | tracks `djmd` | DJI | model, readout with direction, stabilisation | `dji.rs` |
//! | tracks `camm` | cameras for Street View, phones' apps | readout | `camm.rs` |
//! | end of the file | Insta360 | model, readout, stabilisation | `insta360.rs` |
//! | `clip.gcsv` beside it | loggers for Gyroflow | readout with direction | `gcsv.rs` |

mod acquisition;
mod camm;
mod dji;
mod gcsv;
mod gopro;
mod insta360;
mod keys;
mod protobuf;
mod sony;
mod statement;
mod tracks;

use crate::boxes::{children, read_index, read_top_level};
pub use statement::{Kind, Stabilisation, Stated, StatedReadout};
use std::fs::File;
use std::path::Path;
use tracks::Track;

/// A box at the top level of a file that is larger than this holds no description.
const LARGEST_DESCRIPTION: u64 = 4 << 20;
/// As far as this a sample of metadata is read: a second of telemetry has some 10 kB.
const LARGEST_SAMPLE: u64 = 256 << 10;

/// What is stated about a clip; nothing about a file that cannot be read.
pub fn read(clip: &Path) -> Stated {
    let in_file = File::open(clip).ok().map(|mut file| by_file(&mut file));
    in_file.unwrap_or_default().or(gcsv::beside(clip).unwrap_or_default())
}

fn by_file(file: &mut File) -> Stated {
    let index = read_index(file).unwrap_or_default();
    let mut stated = keys::by_keys(&index).unwrap_or_default();
    for (_, user) in children(&index).filter(|(name, _)| name == b"udta") {
        stated = stated.or(keys::by_user_data(user).unwrap_or_default()).or(gopro::by_user_data(user));
    }
    for track in tracks::tracks(&index) {
        stated = by_track(track, file, stated);
    }
    let description = read_top_level(file, b"meta", LARGEST_DESCRIPTION);
    let description = description.and_then(|meta| sony::by_description(&meta));
    stated.or(description.unwrap_or_default()).or(insta360::by_records(file).unwrap_or_default())
}

/// With what a track states beside the rest.
fn by_track(track: Track, file: &mut File, stated: Stated) -> Stated {
    let mut first = || track.samples(1).first().and_then(|place| tracks::read(file, *place, LARGEST_SAMPLE));
    let further = match (track.handler(), track.format()) {
        (Some(handler), _) if &handler == b"vide" => keys::by_keys(track.content()),
        (_, Some(format)) => match &format {
            b"gpmd" => first().map(|sample| gopro::by_telemetry(&sample)),
            b"djmd" => first().and_then(|sample| dji::by_sample(&sample)),
            b"rtmd" => first().map(|sample| acquisition::by_sony(&sample)),
            b"camm" => {
                let packets = track.samples(camm::MOST);
                let mut packets =
                    packets.into_iter().filter_map(|place| tracks::read(file, place, camm::LENGTH));
                packets.find_map(|packet| camm::by_packet(&packet))
            }
            _ if track.handler().as_ref() == Some(b"meta") => {
                let is_canon = stated.maker.as_deref() == Some("Canon");
                first().and_then(|sample| acquisition::by_canon(&sample, is_canon))
            }
            _ => None,
        },
        _ => None,
    };
    stated.or(further.unwrap_or_default())
}

#[cfg(test)]
mod tests;
