// SPDX-License-Identifier: MIT OR Apache-2.0

//! What VapourSynth calls.

use crate::frames::{Rectifier, Settings};
use std::ffi::{CStr, CString, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use vapoursynth4_rs::core::CoreRef;
use vapoursynth4_rs::ffi::{VSColorFamily, VSFilterDependency, VSRequestPattern, VSSampleType};
use vapoursynth4_rs::frame::{FrameContext, VideoFrame};
use vapoursynth4_rs::map::{Key, MapRef};
use vapoursynth4_rs::node::{ActivationReason, Dependencies, Filter, Node, VideoNode};

/// The filter of one clip.
pub struct Apply {
    clip: VideoNode,
    /// All that changes in it is behind a lock, and a panic leaves no buffer there.
    rectifier: AssertUnwindSafe<Rectifier>,
}

/// The arguments of a call.
struct Arguments<'a>(MapRef<'a>);

impl Arguments<'_> {
    fn text(&self, name: &str) -> Option<Result<String, String>> {
        let key = Key::new(name).ok()?;
        // Python states that its texts are UTF-8, others nothing.
        if let Ok(text) = self.0.get_utf8(&key, 0) {
            return Some(Ok(text.to_owned()));
        }
        let bytes = self.0.get_binary(&key, 0).ok()?;
        Some(String::from_utf8(bytes.to_vec()).map_err(|_| format!("{name} is no UTF-8")))
    }

    fn number(&self, name: &str) -> Option<f64> {
        self.0.get_float(&Key::new(name).ok()?, 0).ok()
    }

    fn clip(&self) -> Option<VideoNode> {
        self.0.get_video_node(&Key::new("clip").ok()?, 0).ok()
    }
}

/// The filter that is asked for; why it cannot be made.
fn made(arguments: &Arguments<'_>) -> Result<Apply, String> {
    let clip = arguments.clip().ok_or("clip is missing")?;
    let info = clip.info();
    let format = &info.format;
    if info.width == 0 || info.height == 0 || format.color_family == VSColorFamily::Undefined {
        return Err("clips of variable size or format cannot be rectified".into());
    }
    let is_known =
        format.sample_type == VSSampleType::Integer && [8, 10, 12, 16].contains(&format.bits_per_sample);
    if !is_known {
        return Err("clips must have integer samples of 8, 10, 12 or 16 bits".into());
    }
    let text = |name| arguments.text(name).transpose();
    let mut settings = Settings::default();
    if let Some(name) = text("interpolation")? {
        settings.set_interpolation(&name)?;
    }
    if let Some(name) = text("border")? {
        settings.set_border(&name)?;
    }
    if let Some(strength) = arguments.number("strength") {
        settings.set_strength(strength)?;
    }
    if let Some(crop) = arguments.number("crop") {
        settings.set_crop(crop)?;
    }
    if let Some(start) = arguments.number("start") {
        settings.set_start(start)?;
    }
    let path = text("motion")?.ok_or("motion is missing")?;
    let rectifier = Rectifier::open(Path::new(&path), settings)?;
    Ok(Apply { clip, rectifier: AssertUnwindSafe(rectifier) })
}

fn c_text(text: String) -> CString {
    CString::new(text.replace('\0', "")).unwrap_or_default()
}

/// What a call returns, with the reason where it panicked: the bindings can pass on none.
fn guarded<R>(call: impl FnOnce() -> Result<R, String>) -> Result<R, CString> {
    let done = catch_unwind(AssertUnwindSafe(call)).unwrap_or_else(|_| Err("a defect of the filter".into()));
    done.map_err(|reason| c_text(format!("rsrectify.Apply: {reason}")))
}

impl Filter for Apply {
    type Error = CString;
    type FrameType = VideoFrame;
    type FilterData = ();

    const NAME: &'static CStr = c"Apply";
    const ARGS: &'static CStr = c"clip:vnode;motion:data;strength:float:opt;interpolation:data:opt;\
        border:data:opt;crop:float:opt;start:float:opt;";
    const RETURN_TYPE: &'static CStr = c"clip:vnode;";

    fn create(
        input: MapRef<'_>,
        output: MapRef<'_>,
        _: Option<Box<()>>,
        mut core: CoreRef<'_>,
    ) -> Result<(), CString> {
        guarded(|| {
            let filter = made(&Arguments(input))?;
            let info = filter.clip.info().clone();
            let dependency = VSFilterDependency {
                source: filter.clip.as_ptr(),
                request_pattern: VSRequestPattern::StrictSpatial,
            };
            let dependencies = [dependency];
            let dependencies = Dependencies::new(&dependencies).ok_or("too many clips")?;
            core.create_video_filter(output, c"Apply", &info, Box::new(filter), dependencies);
            Ok(())
        })
    }

    fn get_frame(
        &self,
        n: i32,
        activation_reason: ActivationReason,
        _: *mut *mut c_void,
        mut context: FrameContext,
        core: CoreRef<'_>,
    ) -> Result<Option<VideoFrame>, CString> {
        guarded(|| {
            match activation_reason {
                ActivationReason::Initial => context.request_frame_filter(n, &self.clip),
                ActivationReason::AllFramesReady => {
                    let source = self.clip.get_frame_filter(n, &mut context);
                    return self.rectifier.rectified(n, source, &core).map(Some);
                }
                ActivationReason::Error => {}
            }
            Ok(None)
        })
    }
}
