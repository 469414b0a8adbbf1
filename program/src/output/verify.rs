// SPDX-License-Identifier: MIT OR Apache-2.0

//! Reads a file again that was written, before it is said to be done.

use crate::interruption::Interruption;
use crate::packets::Packets;
use anyhow::{Result, bail};
use std::path::Path;

/// What containers may round times to: Matroska's clock has milliseconds.
const ROUNDING: gst::ClockTime = gst::ClockTime::from_mseconds(1);

/// Checks that a file has a frame for each that was encoded, and that the last is shown as long after the first.
///
/// # Errors
/// If that is not so, or the file cannot be read.
pub fn verify(file: &Path, encoded: &[Option<gst::ClockTime>], interruption: &Interruption) -> Result<()> {
    let mut packets = Packets::open(file, interruption)?;
    let mut times = Vec::with_capacity(encoded.len());
    while let Some(packet) = packets.next(interruption)? {
        times.push(packet.time);
    }
    if times.len() != encoded.len() {
        bail!("{} frames were written where there should be {}", times.len(), encoded.len());
    }
    let spread = |times: &[Option<gst::ClockTime>]| {
        let times = || times.iter().flatten();
        Some(*times().max()? - *times().min()?)
    };
    if let Some((written, due)) =
        spread(&times).zip(spread(encoded)).filter(|(one, other)| one.absdiff(*other) > ROUNDING * 2)
    {
        bail!("the last frame is {written} after the first where it should be {due}");
    }
    Ok(())
}
