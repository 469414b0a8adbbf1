// SPDX-License-Identifier: MIT OR Apache-2.0

//! The C interface of frei0r 1.2, as far as filters have it.
//!
//! No panic crosses it: one is reported on the error output by Rust itself, and the call does nothing more.

use crate::filter::{Filter, lock};
use crate::parameters::{Kind, PARAMETERS};
use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::slice;
use std::sync::Mutex;

/// A filter; with one input.
const PLUGIN_TYPE_FILTER: c_int = 0;
/// Blue, green, red, alpha, a byte each.
const COLOR_MODEL_BGRA8888: c_int = 0;
/// Version of the interface.
const FREI0R_VERSION: c_int = 1;
const PARAM_DOUBLE: c_int = 1;
const PARAM_STRING: c_int = 4;

/// What a host asks for first.
#[repr(C)]
struct PluginInfo {
    name: *const c_char,
    author: *const c_char,
    plugin_type: c_int,
    color_model: c_int,
    frei0r_version: c_int,
    major_version: c_int,
    minor_version: c_int,
    num_params: c_int,
    explanation: *const c_char,
}

/// What a host asks for of each parameter.
#[repr(C)]
struct ParamInfo {
    name: *const c_char,
    kind: c_int,
    explanation: *const c_char,
}

/// What a host holds.
struct Instance {
    filter: Filter,
    /// Texts that the host has asked for; it may read each until it asks for it again.
    asked: Mutex<[CString; PARAMETERS.len()]>,
}

/// What a call returns; `None` where it panicked.
fn guarded<R>(call: impl FnOnce() -> R) -> Option<R> {
    catch_unwind(AssertUnwindSafe(call)).ok()
}

/// A part of the version, which cargo states as text.
fn version(part: &str) -> c_int {
    part.parse().unwrap_or_default()
}

/// Called once before all else; success is 1.
#[unsafe(no_mangle)]
extern "C" fn f0r_init() -> c_int {
    1
}

/// Called once after all else.
#[unsafe(no_mangle)]
extern "C" fn f0r_deinit() {}

/// Describes the filter.
///
/// # Safety
/// `info` is null or points to memory for the structure.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_get_plugin_info(info: *mut PluginInfo) {
    if info.is_null() {
        return;
    }
    let described = PluginInfo {
        name: c"Rolling shutter rectifier".as_ptr(),
        author: c"The rsrectify authors".as_ptr(),
        plugin_type: PLUGIN_TYPE_FILTER,
        color_model: COLOR_MODEL_BGRA8888,
        frei0r_version: FREI0R_VERSION,
        major_version: version(env!("CARGO_PKG_VERSION_MAJOR")),
        minor_version: version(env!("CARGO_PKG_VERSION_MINOR")),
        num_params: PARAMETERS.len() as c_int,
        explanation: c"Takes rolling-shutter distortion (lean, jello, wobble) out of video, by a motion file"
            .as_ptr(),
    };
    // SAFETY: by the interface the pointer is to memory for this structure, and it is not null.
    unsafe { info.write(described) };
}

/// Describes a parameter.
///
/// # Safety
/// `info` is null or points to memory for the structure.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_get_param_info(info: *mut ParamInfo, index: c_int) {
    let parameter = usize::try_from(index).ok().and_then(|index| PARAMETERS.get(index));
    let Some(parameter) = parameter.filter(|_| !info.is_null()) else { return };
    let kind = match parameter.kind {
        Kind::Number => PARAM_DOUBLE,
        Kind::Text => PARAM_STRING,
    };
    let described =
        ParamInfo { name: parameter.name.as_ptr(), kind, explanation: parameter.explanation.as_ptr() };
    // SAFETY: by the interface the pointer is to memory for this structure, and it is not null.
    unsafe { info.write(described) };
}

/// Makes a filter; null if there cannot be frames of the size.
#[unsafe(no_mangle)]
extern "C" fn f0r_construct(width: c_uint, height: c_uint) -> *mut c_void {
    let made = guarded(|| {
        let filter = Filter::new(width as usize, height as usize);
        filter.frame_bytes()?;
        Some(Box::new(Instance { filter, asked: Mutex::default() }))
    });
    made.flatten().map_or(ptr::null_mut(), |instance| Box::into_raw(instance).cast())
}

/// Ends a filter.
///
/// # Safety
/// `instance` is null or was made by [`f0r_construct`], and is not used afterwards.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_destruct(instance: *mut c_void) {
    if !instance.is_null() {
        // SAFETY: it comes from `Box::into_raw` of a box of this type, and the host does not use it again.
        let instance = unsafe { Box::from_raw(instance.cast::<Instance>()) };
        guarded(|| drop(instance));
    }
}

/// The filter that a host means.
///
/// # Safety
/// `instance` is null or was made by [`f0r_construct`] and has not been ended.
unsafe fn known<'a>(instance: *mut c_void) -> Option<&'a Instance> {
    // SAFETY: it is null or points to an instance that lives until it is ended; all that changes in it is behind mutexes, so
    // that several threads may share it.
    unsafe { instance.cast::<Instance>().cast_const().as_ref() }
}

/// Sets a parameter.
///
/// # Safety
/// `instance` is as of [`known`]; `value` is null or points to a value of the parameter's kind: a double, or a pointer to a text
/// that ends in a zero byte.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_set_param_value(instance: *mut c_void, value: *mut c_void, index: c_int) {
    // SAFETY: the host's promise, see above.
    let instance = unsafe { known(instance) };
    let (Some(instance), Ok(index), false) = (instance, usize::try_from(index), value.is_null()) else {
        return;
    };
    match PARAMETERS.get(index).map(|parameter| parameter.kind) {
        Some(Kind::Number) => {
            // SAFETY: the value of a number is a double; whether it is aligned is not promised.
            let number = unsafe { value.cast::<f64>().read_unaligned() };
            guarded(|| instance.filter.set_number(index, number));
        }
        Some(Kind::Text) => {
            // SAFETY: the value of a text is a pointer to it.
            let text = unsafe { value.cast::<*const c_char>().read_unaligned() };
            if !text.is_null() {
                // SAFETY: it ends in a zero byte and is not changed during the call.
                let text = unsafe { CStr::from_ptr(text) };
                guarded(|| instance.filter.set_text(index, text));
            }
        }
        None => {}
    }
}

/// Gives the value of a parameter.
///
/// # Safety
/// `instance` is as of [`known`]; `value` is null or points to memory for a value of the parameter's kind: a double, or a pointer.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_get_param_value(instance: *mut c_void, value: *mut c_void, index: c_int) {
    // SAFETY: the host's promise, see above.
    let instance = unsafe { known(instance) };
    let (Some(instance), Ok(index), false) = (instance, usize::try_from(index), value.is_null()) else {
        return;
    };
    let filter = &instance.filter;
    if let Some(number) = guarded(|| filter.number(index)).flatten() {
        // SAFETY: the memory is that of a double.
        unsafe { value.cast::<f64>().write_unaligned(number) };
    } else if let Some(text) = guarded(|| filter.text(index)).flatten() {
        let mut asked = lock(&instance.asked);
        if let Some(kept) = asked.get_mut(index) {
            *kept = text;
            // SAFETY: the memory is that of a pointer; the text is kept until it is asked for again or the filter ends.
            unsafe { value.cast::<*const c_char>().write_unaligned(kept.as_ptr()) };
        }
    }
}

/// Rectifies a frame.
///
/// # Safety
/// `instance` is as of [`known`]; `input` and `output` are null or point to frames of its size, which nobody else writes to, and the
/// first of which is the same as the second or does not overlap it.
#[unsafe(no_mangle)]
unsafe extern "C" fn f0r_update(instance: *mut c_void, time: f64, input: *const u32, output: *mut u32) {
    // SAFETY: the host's promise, see above.
    let Some(instance) = (unsafe { known(instance) }) else { return };
    let Some(bytes) = instance.filter.frame_bytes().filter(|_| !input.is_null() && !output.is_null()) else {
        return;
    };
    // SAFETY: the frame has so many bytes, any of which is valid; it is read before another slice to it is made, below.
    let source = unsafe { slice::from_raw_parts(input.cast::<u8>(), bytes) };
    if ptr::eq(input, output) {
        let copy = source.to_vec();
        // SAFETY: as above; no other slice to this frame is used any more.
        let target = unsafe { slice::from_raw_parts_mut(output.cast::<u8>(), bytes) };
        guarded(|| instance.filter.update(time, &copy, target));
    } else {
        // SAFETY: as above, and the frames do not overlap.
        let target = unsafe { slice::from_raw_parts_mut(output.cast::<u8>(), bytes) };
        guarded(|| instance.filter.update(time, source, target));
    }
}

#[cfg(test)]
#[path = "abi_tests.rs"]
mod tests;
