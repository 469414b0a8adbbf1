// SPDX-License-Identifier: MIT OR Apache-2.0

//! When frames of a steady rate are shown.

/// Has the frame with a number, counted from 0, state when it is shown and for how long.
pub fn stamp(frame: &mut gst::BufferRef, number: u64, rate: gst::Fraction) {
    let [start, end] = [time(number, rate), time(number + 1, rate)];
    frame.set_pts(start);
    frame.set_duration(start.zip(end).and_then(|(start, end)| end.checked_sub(start)));
}

/// When the frame with a number is shown.
fn time(number: u64, rate: gst::Fraction) -> Option<gst::ClockTime> {
    let [num, den] = [rate.numer(), rate.denom()].map(|part| u128::try_from(part).ok());
    let nanoseconds = u128::from(number) * 1_000_000_000 * den?;
    u64::try_from(nanoseconds.checked_div(num?)?).ok().map(gst::ClockTime::from_nseconds)
}
