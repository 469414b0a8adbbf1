// SPDX-License-Identifier: MIT OR Apache-2.0

//! What GStreamer offers and its Rust bindings do not.

use gst::ffi;
use gst::glib;
use gst::glib::translate::{Borrowed, from_glib_borrow, from_glib_none};
use gst::prelude::*;
use gst::subclass::prelude::*;
use std::ffi::c_char;

/// The pool that a buffer goes back to.
pub fn pool_of(buffer: &gst::BufferRef) -> Option<gst::BufferPool> {
    // SAFETY: the field is null or a pool that lives as long as the buffer; a reference is taken.
    unsafe { from_glib_none((*buffer.as_ptr()).pool) }
}

/// Leaves `name` and `parent` out of presets: two elements with one preset would have the same name.
pub fn keep_object_properties_out_of_presets<C>(class: &mut C)
where
    C: ClassStruct<Type: PresetImpl>,
{
    // SAFETY: the class implements the interface, whose table exists once the class is initialised and is
    // this class's own.
    unsafe {
        let class = std::ptr::from_mut(class).cast();
        let table = glib::gobject_ffi::g_type_interface_peek(class, ffi::gst_preset_get_type());
        if let Some(table) = table.cast::<ffi::GstPresetInterface>().as_mut() {
            table.get_property_names = Some(preset_property_names);
        }
    }
}

/// The names of the properties that a preset stores: those that are the element's own, and `qos`.
unsafe extern "C" fn preset_property_names(preset: *mut ffi::GstPreset) -> *mut *mut c_char {
    // SAFETY: GStreamer calls this with an element of the class that it was installed in.
    let element: Borrowed<gst::Element> = unsafe { from_glib_borrow(preset.cast::<ffi::GstElement>()) };
    let specs = element.list_properties();
    let stored = specs.iter().filter(|spec| {
        let flags = glib::ParamFlags::READWRITE;
        let of_object =
            [gst::Object::static_type(), gst::Element::static_type()].contains(&spec.owner_type());
        spec.flags().contains(flags) && !of_object
    });
    let names: Vec<glib::GString> = stored.map(|spec| spec.name().into()).collect();
    glib::StrV::from(names).into_raw()
}
