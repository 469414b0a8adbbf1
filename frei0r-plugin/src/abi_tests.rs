// SPDX-License-Identifier: MIT OR Apache-2.0

//! The interface as a host uses it.

use super::*;
use rsrectify::Warper;
use rsrectify::motion::file::{Clip, MotionRecord, MotionWriter};
use rsrectify::motion::{FrameMotion, MotionPath, Twist};
use rsrectify::plane::{Plane, PlaneLayout, PlaneMut, SampleFormat};
use rsrectify::readout::{Readout, ReadoutDirection, ReadoutTime};
use rsrectify::warp::{SampleGrid, WarpSettings};
use std::path::PathBuf;

const SIZE: [usize; 2] = [64, 48];
const PERIOD: i64 = 40_000_000;

fn motion(frame: i64) -> FrameMotion {
    let [width, height] = SIZE;
    let readout =
        Readout::new(width, height, ReadoutDirection::TopToBottom, ReadoutTime::Seconds(0.03), 0.04).unwrap();
    FrameMotion::new(readout, MotionPath::uniform(Twist::new(0.0, 200.0 + 40.0 * frame as f64, 30.0), 0.03))
}

/// A motion file of ten frames, removed at the end.
struct Motions(PathBuf);

impl Motions {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("rsrectify-frei0r-{name}-{}", std::process::id()));
        let mut writer = MotionWriter::new(std::fs::File::create(&path).unwrap(), Clip::default()).unwrap();
        (0..10).for_each(|frame| writer.push(&MotionRecord::new(frame * PERIOD, motion(frame))).unwrap());
        writer.finish().unwrap();
        Self(path)
    }

    fn text(&self) -> CString {
        CString::new(self.0.to_str().unwrap()).unwrap()
    }
}

impl Drop for Motions {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn picture() -> Vec<u32> {
    let pixel = |index: usize| {
        let (x, y) = (index % SIZE[0], index / SIZE[0]);
        let grey = (128.0 + 100.0 * (x as f64 / 5.0 + y as f64 / 9.0).sin()) as u32;
        0xff00_0000 | grey << 16 | (255 - grey) << 8 | x as u32
    };
    (0..SIZE[0] * SIZE[1]).map(pixel).collect()
}

fn bytes(picture: &[u32]) -> Vec<u8> {
    picture.iter().flat_map(|pixel| pixel.to_ne_bytes()).collect()
}

/// The picture rectified by the library.
fn rectified(frame: i64, settings: &WarpSettings) -> Vec<u8> {
    let (input, mut output) = (bytes(&picture()), vec![0; SIZE[0] * SIZE[1] * 4]);
    let packed = PlaneLayout::packed(SIZE[0], SIZE[1], SampleFormat::U8);
    let layout = PlaneLayout { stride: SIZE[0] * 4, step: 4, channels: 4, ..packed };
    let (source, mut target) =
        (Plane::new(&input, layout).unwrap(), PlaneMut::new(&mut output, layout).unwrap());
    let mut warper = Warper::new();
    warper.prepare(&motion(frame), settings).warp(&source, &mut target, SampleGrid::FULL).unwrap();
    output
}

/// A host's handle.
#[derive(Clone, Copy)]
struct Handle(*mut c_void);

// SAFETY: the interface allows calls from any thread.
unsafe impl Send for Handle {}
// SAFETY: as above, at the same time.
unsafe impl Sync for Handle {}

impl Handle {
    fn new() -> Self {
        Self(f0r_construct(SIZE[0] as c_uint, SIZE[1] as c_uint))
    }

    fn set_text(self, index: c_int, text: &CStr) {
        let mut pointer = text.as_ptr();
        // SAFETY: the instance is alive, the value a pointer to a text.
        unsafe { f0r_set_param_value(self.0, (&raw mut pointer).cast(), index) };
    }

    fn set_number(self, index: c_int, mut number: f64) {
        // SAFETY: the instance is alive, the value a double.
        unsafe { f0r_set_param_value(self.0, (&raw mut number).cast(), index) };
    }

    fn update(self, time: f64) -> Vec<u8> {
        let (input, mut output) = (picture(), vec![0; SIZE[0] * SIZE[1]]);
        // SAFETY: the instance is alive, both frames are of its size.
        unsafe { f0r_update(self.0, time, input.as_ptr(), output.as_mut_ptr()) };
        bytes(&output)
    }

    fn end(self) {
        // SAFETY: it is not used afterwards.
        unsafe { f0r_destruct(self.0) };
    }
}

#[test]
fn a_host_is_told_what_the_filter_is() {
    assert_eq!(f0r_init(), 1);
    let mut info = std::mem::MaybeUninit::<PluginInfo>::zeroed();
    // SAFETY: the memory is that of the structure, which may be zero.
    let info = unsafe {
        f0r_get_plugin_info(info.as_mut_ptr());
        info.assume_init()
    };
    // SAFETY: the name is a text of the program.
    assert_eq!(unsafe { CStr::from_ptr(info.name) }, c"Rolling shutter rectifier");
    assert_eq!((info.plugin_type, info.color_model, info.frei0r_version, info.num_params), (0, 0, 1, 8));
    for (index, (name, kind)) in
        [(c"motion-file", 4), (c"time-unit", 4), (c"strength", 1), (c"interpolation", 4), (c"border-mode", 4)]
            .into_iter()
            .enumerate()
    {
        let mut param = std::mem::MaybeUninit::<ParamInfo>::zeroed();
        // SAFETY: as above; the name is a text of the program.
        let found = unsafe {
            f0r_get_param_info(param.as_mut_ptr(), index as c_int);
            let param = param.assume_init();
            (CStr::from_ptr(param.name), param.kind)
        };
        assert_eq!(found, (name, kind));
    }
    f0r_deinit();
}

#[test]
fn frames_are_rectified_by_their_time_and_the_rest_stays() {
    let motions = Motions::new("time");
    let filter = Handle::new();
    let untouched = bytes(&picture());
    assert!(filter.update(0.2) == untouched, "without a file");
    filter.set_text(0, &motions.text());
    filter.set_text(1, c"seconds");
    let settings = WarpSettings::default();
    for (time, frame) in [(0.2, 5), (0.0, 0), (0.239, 6), (0.379, 9)] {
        assert!(filter.update(time) == rectified(frame, &settings), "{time}");
    }
    for time in [-1.0, 0.5, 1e300, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(filter.update(time) == untouched, "{time}");
    }
    filter.set_number(2, 0.5);
    filter.set_text(3, c"linear");
    let mut settings = WarpSettings::default();
    (settings.strength, settings.interpolation) = (0.5, rsrectify::warp::Interpolation::Linear);
    assert!(filter.update(0.2) == rectified(5, &settings));
    // A frame in place.
    let mut frame = picture();
    // SAFETY: the instance is alive, the frame of its size.
    unsafe { f0r_update(filter.0, 0.2, frame.as_ptr(), frame.as_mut_ptr()) };
    assert!(bytes(&frame) == rectified(5, &settings));
    filter.set_text(0, c"/nowhere");
    assert!(filter.update(0.2) == untouched);
    filter.end();
}

#[test]
fn parameters_can_be_asked_for() {
    let filter = Handle::new();
    filter.set_text(4, c"mirror");
    filter.set_number(5, 0.125);
    let (mut text, mut number) = (ptr::null::<c_char>(), 0.0f64);
    // SAFETY: the instance is alive and the memory that of the values; the text is read at once.
    let text = unsafe {
        f0r_get_param_value(filter.0, (&raw mut text).cast(), 4);
        f0r_get_param_value(filter.0, (&raw mut number).cast(), 5);
        CStr::from_ptr(text).to_owned()
    };
    assert_eq!((text.as_c_str(), number), (c"mirror", 0.125));
    filter.end();
}

#[test]
fn what_a_host_must_not_do_is_ignored() {
    let filter = Handle::new();
    let mut number = 0.5f64;
    // SAFETY: null pointers and places that do not exist are what the functions check.
    unsafe {
        f0r_get_plugin_info(ptr::null_mut());
        f0r_get_param_info(ptr::null_mut(), 0);
        f0r_destruct(ptr::null_mut());
        for index in [-1, 8, c_int::MAX, c_int::MIN] {
            let mut param = std::mem::MaybeUninit::<ParamInfo>::zeroed();
            f0r_get_param_info(param.as_mut_ptr(), index);
            f0r_set_param_value(filter.0, (&raw mut number).cast(), index);
            f0r_get_param_value(filter.0, (&raw mut number).cast(), index);
        }
        let mut null = ptr::null::<c_char>();
        f0r_set_param_value(filter.0, (&raw mut null).cast(), 0);
        f0r_set_param_value(filter.0, ptr::null_mut(), 2);
        f0r_set_param_value(ptr::null_mut(), (&raw mut number).cast(), 2);
        f0r_get_param_value(ptr::null_mut(), (&raw mut number).cast(), 2);
        f0r_update(filter.0, 0.0, ptr::null(), ptr::null_mut());
        f0r_update(ptr::null_mut(), 0.0, ptr::null(), ptr::null_mut());
    }
    assert_eq!(number, 0.5);
    filter.end();
    assert!(f0r_construct(c_uint::MAX, c_uint::MAX).is_null() || usize::BITS > 64);
    Handle(f0r_construct(0, 0)).end();
}

#[test]
fn threads_share_a_filter() {
    let motions = Motions::new("threads");
    let filter = Handle::new();
    filter.set_text(0, &motions.text());
    filter.set_text(1, c"seconds");
    let expected: Vec<_> = (0..10).map(|frame| rectified(frame, &WarpSettings::default())).collect();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (expected, path) = (&expected, motions.text());
            scope.spawn(move || {
                let filter = filter;
                for turn in 0..50 {
                    let frame = (turn * 7 + thread) % 10;
                    filter.set_text(0, &path);
                    assert!(filter.update(frame as f64 * 0.04) == expected[frame], "{frame}");
                }
            });
        }
    });
    filter.end();
}
