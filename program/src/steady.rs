// SPDX-License-Identifier: MIT OR Apache-2.0

//! What stabilisation and a crop take beforehand: the frames to look ahead, and how much is to be cut away.

use crate::analysis::Analysis;
use crate::input::Clip;
use crate::interruption::Interruption;
use crate::part::Part;
use crate::progress;
use crate::rectifier_options::{Crop, MAX_LOOKAHEAD, RectifierOptions};
use anyhow::{Result, bail};
use rsrectify::rectifier::{PLANNED_SHARE, stabilization_lookahead};
use rsrectify::warp::{Interpolation, UNBENT_SHARE, WarpSettings, least_zoom};

/// Per cent that are cut away at most where the picture is steadied: a quarter more zoom.
const MAX_CROP: f64 = 20.0;
/// Largest crop in per cent that the element takes.
const LARGEST: f64 = 50.0;

/// Sets the frames to look ahead where the picture is steadied; not fewer than are set already.
pub fn set_lookahead(clip: &Clip, options: &mut RectifierOptions, interruption: &Interruption) -> Result<()> {
    let stabilization = options.stabilization();
    if stabilization > 0.0 {
        let analysis = Analysis::look(clip, options.analysis.settings(), interruption)?;
        let period = analysis.period().unwrap_or(1.0 / 30.0);
        let wanted = u32::try_from(stabilization_lookahead(stabilization, period)).unwrap_or(u32::MAX);
        let wanted = wanted.max(options.analysis.lookahead.unwrap_or(0)).min(MAX_LOOKAHEAD);
        options.analysis.lookahead = Some(wanted);
    }
    Ok(())
}

/// How frames are rectified with these options, as far as it matters where borders are seen.
pub fn warp_settings(options: &RectifierOptions) -> WarpSettings {
    let mut warp = WarpSettings::default();
    warp.reference_row = options.reference_row.unwrap_or(warp.reference_row);
    warp.strength = options.strength.unwrap_or(warp.strength);
    if options.interpolation.as_deref() == Some("lanczos") {
        warp.interpolation = Interpolation::Lanczos;
    }
    warp
}

/// Sets the crop, in per cent rounded up to hundredths, so that this zoom hides the borders: by so much more that no correction is
/// bent, and that a planned path of the camera stays away from them, where the picture is steadied. What is to be said of it.
pub fn crop_for(zoom: f64, options: &mut RectifierOptions) -> Result<String> {
    if !zoom.is_finite() {
        bail!("no crop hides the borders: they cross the middle of the picture");
    }
    let least = 100.0 * (1.0 - 1.0 / zoom);
    // The window may not come nearer to the edge than it did here, or the path would be another one.
    let is_planned = options.stabilization() > 0.0;
    let unbent = least / UNBENT_SHARE;
    let crop = if is_planned { (least / PLANNED_SHARE).min(MAX_CROP.max(unbent)) } else { unbent };
    let crop = (crop * 100.0).ceil() / 100.0;
    if crop > LARGEST {
        bail!("hiding the borders would take a crop of {crop:.0} %");
    }
    options.steadiness.crop = Some(Crop::PerCent(crop));
    Ok(format!("crop: {crop:.1} % (zoom {:.3})", options.zoom()))
}

/// Finds the least crop, where that is asked for; what is to be said of it.
pub fn set_crop(
    clip: &Clip,
    options: &mut RectifierOptions,
    part: Option<&Part>,
    interruption: &Interruption,
) -> Result<Option<String>> {
    if options.crop() != Some(Crop::Auto) {
        return Ok(None);
    }
    if clip.is_pipe() {
        bail!(
            "what comes on the standard input cannot be analysed beforehand for the least crop: give --crop PERCENT, such as --crop 10"
        );
    }
    let mut settings = options.analysis.settings();
    settings.stabilization = options.stabilization();
    settings.margin = MAX_CROP / 200.0;
    let warp = warp_settings(options);
    let mut analysis = Analysis::open(clip, settings, interruption)?;
    if let Some(part) = part {
        analysis.go_to(part.clone(), interruption)?;
    }
    let bar = progress::spinner()?;
    let (mut zoom, mut frames): (f64, u64) = (1.0, 0);
    analysis.run(None, interruption, &mut |frame| {
        zoom = zoom.max(least_zoom(&frame.solution.motion, &warp));
        frames += 1;
        bar.set_message(format!("looking for the least crop: {frames} frames"));
        bar.tick();
        Ok(())
    })?;
    bar.finish_and_clear();
    crop_for(zoom, options).map(Some)
}
