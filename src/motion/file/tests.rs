// SPDX-License-Identifier: MIT OR Apache-2.0

//! Files as they are written and read.

use super::*;
use crate::area::PictureArea;
use crate::motion::{
    FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath, Twist, rounded_homography,
    rounded_velocity,
};
use crate::readout::{Readout, ReadoutDirection, ReadoutTime};
use nalgebra::Matrix3;
use proptest::prelude::*;
use std::io::Cursor;

const PERIOD: i64 = 33_333_333;

fn readout(direction: ReadoutDirection) -> Readout {
    Readout::new(800, 600, direction, ReadoutTime::Seconds(0.0321), 0.0333).unwrap()
}

/// A shaken path with a field, as a rectifier returns it, rounded.
fn shaken(phase: f64) -> FrameMotion {
    let readout = readout(ReadoutDirection::BottomToTop);
    let motions = (0..=32).map(|index| {
        let share = f64::from(index) / 32.0;
        let (sin, cos) = (0.02 * (phase + 3.0 * share).sin()).sin_cos();
        let shift = 40.0 * (phase + 5.0 * share).cos();
        let exact = Matrix3::new(cos, -sin, shift, sin, cos, -0.4 * shift, 1e-5 * sin, 0.0, 1.0);
        rounded_homography(&exact, 800, 600)
    });
    let path = SampledPath::new(&motions.collect::<Vec<_>>(), readout.time()).unwrap();
    let mesh = ResidualMesh { columns: 100, rows: 75, origin: [-396.0, -296.0], spacing: [8.0; 2] };
    let velocity = |node: usize| {
        let (x, y) = ((node % 100) as f32, (node / 100) as f32);
        [0.05 * x - y * 0.01, (0.1 * x + phase as f32).sin()].map(|value| rounded_velocity(value, 8.0))
    };
    let field = ResidualField::new(mesh, (0..7500).map(velocity).collect()).unwrap();
    FrameMotion::new(readout, MotionPath::from(path).with_residual(field)).with_weight(0.75)
}

fn records() -> Vec<MotionRecord> {
    let still = FrameMotion::new(Readout::global_shutter(800, 600), MotionPath::STILL).with_weight(0.0);
    let twist = MotionPath::uniform(Twist::new(0.3, 100.0 / 3.0, -7.0), 0.0321);
    let placement = Matrix3::new(0.99, -0.02, 11.0 / 3.0, 0.02, 1.01, -7.5, 1e-6, -1e-5 / 3.0, 1.0);
    let uniform =
        FrameMotion::new(readout(ReadoutDirection::LeftToRight), twist).with_placement(Some(placement));
    let area = PictureArea::new([800, 900], [0, 120], [800, 600]).unwrap();
    vec![
        MotionRecord::new(-PERIOD, still).with_confidence(0.0, None),
        MotionRecord::new(0, shaken(0.1)).with_confidence(0.75, Some(1.0 / 3.0)),
        MotionRecord::new(PERIOD, uniform),
        MotionRecord::new(2 * PERIOD, shaken(1.7).within(area)),
    ]
}

fn written(records: &[MotionRecord]) -> Vec<u8> {
    let clip = Clip::new("phone.mp4", 12345);
    let mut writer = MotionWriter::new(Cursor::new(Vec::new()), clip).unwrap();
    records.iter().for_each(|record| writer.push(record).unwrap());
    writer.finish().unwrap().into_inner()
}

#[test]
fn motions_come_back_exactly() {
    let bytes = written(&records());
    let path = std::env::temp_dir().join(format!("rsrectify-{}.motion", std::process::id()));
    std::fs::write(&path, &bytes).unwrap();
    let files = [MotionFile::from_bytes(bytes).unwrap(), MotionFile::open(&path).unwrap()];
    std::fs::remove_file(&path).unwrap();
    for file in files {
        assert_eq!(file.clip(), &Clip::new("phone.mp4", 12345));
        assert_eq!(file.frames(), 4);
        // In any order.
        for frame in [2, 0, 3, 1] {
            assert_eq!(file.record(frame).unwrap(), records()[frame], "{frame}");
        }
        assert!(matches!(file.record(4), Err(MotionFileError::NoFrame(4))));
    }
}

#[test]
fn a_path_with_its_field_takes_few_bytes() {
    let one = written(&records()[..2]).len() - written(&records()[..1]).len();
    assert!(one < 3000, "{one} bytes");
}

#[test]
fn a_path_of_any_precision_is_rounded_to_less_than_a_thousandth_of_a_pixel() {
    let readout = readout(ReadoutDirection::TopToBottom);
    let motions: Vec<_> = (0..=32)
        .map(|index| Matrix3::new(1.0, 0.0, f64::from(index) / 3.0, 0.0, 1.0, 1.0 / 7.0, 0.0, 0.0, 1.0))
        .collect();
    let path = MotionPath::from(SampledPath::new(&motions, 0.02).unwrap());
    let file = written(&[MotionRecord::new(0, FrameMotion::new(readout, path.clone()))]);
    let read = MotionFile::from_bytes(file).unwrap().record(0).unwrap();
    let point = nalgebra::Vector2::new(390.0, -290.0);
    let moved = read.motion.path().carry(point, 0.1, 0.5) - path.carry(point, 0.1, 0.5);
    assert!(moved.norm() < 1e-3, "{moved}");
}

#[test]
fn frames_are_found_by_their_time() {
    let at = |records: &[MotionRecord], time| MotionFile::from_bytes(written(records)).unwrap().at(time);
    let records = records();
    let quarter = PERIOD / 4;
    let cases = [
        (-PERIOD - quarter - 1, None),
        (-PERIOD - quarter, Some(0)),
        (-PERIOD, Some(0)),
        // In the middle of a frame, as in an edit of twice its frame rate.
        (-PERIOD / 2, Some(0)),
        (-quarter, Some(1)),
        (-quarter - 1, Some(0)),
        // As programs round it.
        (66_000_000, Some(3)),
        (67_000_000, Some(3)),
        (2 * PERIOD + PERIOD / 2, Some(3)),
        (3 * PERIOD - quarter, None),
        (i64::MAX, None),
        (i64::MIN, None),
    ];
    for (time, frame) in cases {
        assert_eq!(at(&records, time), frame, "{time}");
    }
    // A frame that is shown for long is the one meant until shortly before the next.
    let still = |time| MotionRecord { time, ..records[0].clone() };
    let paused = [still(0), still(PERIOD), still(2 * PERIOD), still(20 * PERIOD), still(21 * PERIOD)];
    assert_eq!(at(&paused, 19 * PERIOD), Some(2));
    assert_eq!(at(&paused, 20 * PERIOD - quarter), Some(3));
    assert_eq!(
        (at(&[], 0), at(&paused[..1], 20_000_000), at(&paused[..1], 40_000_000)),
        (None, Some(0), None)
    );
}

#[test]
fn proxies_have_scaled_motions_and_other_shapes_none() {
    let file = MotionFile::from_bytes(written(&records())).unwrap();
    assert_eq!(file.motion(0, [800, 600]).unwrap(), Some(records()[1].motion.clone()));
    let half = file.motion(0, [400, 300]).unwrap().unwrap();
    assert_eq!(half, records()[1].motion.scaled_to(400, 300));
    assert!(file.motion(1000, [402, 300]).unwrap().is_some());
    assert!(file.motion(-2 * PERIOD, [400, 300]).unwrap().is_none());
    for size in [[600, 800], [800, 450], [0, 600], [800, 0], [0, 0]] {
        let error = file.motion(0, size).unwrap_err();
        assert!(matches!(error, MotionFileError::Shape { file: [800, 600], .. }), "{error}");
    }
}

#[test]
fn frames_that_were_turned_upright_have_turned_motions() {
    let mut writer = MotionWriter::new(Cursor::new(Vec::new()), Clip::default()).unwrap();
    writer.push(&records()[1]).unwrap();
    writer.clip_mut().turned = 270;
    let file = MotionFile::from_bytes(writer.finish().unwrap().into_inner()).unwrap();
    let motion = &records()[1].motion;
    let upright = file.upright_motion(0, [300, 400]).unwrap().unwrap();
    assert_eq!(upright, motion.turned().turned().turned().scaled_to(300, 400));
    assert_eq!(upright.readout().direction(), ReadoutDirection::RightToLeft);
    assert_eq!(file.upright_motion(0, [800, 600]).unwrap().as_ref(), Some(motion));
    assert!(file.upright_motion(0, [800, 450]).is_err() && file.motion(0, [300, 400]).is_err());
}

#[test]
fn square_pixels_may_take_the_place_of_others() {
    let mut writer = MotionWriter::new(Cursor::new(Vec::new()), Clip::default()).unwrap();
    writer.push(&records()[1]).unwrap();
    writer.clip_mut().pixel_aspect = [4, 3];
    writer.clip_mut().turned = 90;
    let file = MotionFile::from_bytes(writer.finish().unwrap().into_inner()).unwrap();
    let motion = &records()[1].motion;
    for size in [[800, 600], [1066, 600]] {
        assert_eq!(file.motion(0, size).unwrap(), Some(motion.scaled_to(size[0], size[1])));
    }
    // Upright, the pixels are narrow.
    let upright = file.upright_motion(0, [600, 1066]).unwrap().unwrap();
    assert_eq!(upright, motion.turned().scaled_to(600, 1066));
    assert!(file.motion(0, [600, 600]).is_err() && file.upright_motion(0, [600, 600]).is_err());
}

#[test]
fn mirrored_clips_are_left_to_who_knows_the_stored_frames() {
    let mut writer = MotionWriter::new(Cursor::new(Vec::new()), Clip::default()).unwrap();
    writer.push(&records()[1]).unwrap();
    writer.clip_mut().mirrored = true;
    let file = MotionFile::from_bytes(writer.finish().unwrap().into_inner()).unwrap();
    assert!(matches!(file.upright_motion(0, [800, 600]), Err(MotionFileError::Mirrored)));
    assert_eq!(file.motion(0, [800, 600]).unwrap().as_ref(), Some(&records()[1].motion));
}

#[test]
fn times_must_rise() {
    let mut writer = MotionWriter::new(Cursor::new(Vec::new()), Clip::default()).unwrap();
    writer.push(&records()[2]).unwrap();
    for record in &records()[1..=2] {
        let error = writer.push(record).unwrap_err();
        assert!(matches!(error, MotionFileError::Order { before: PERIOD, .. }), "{error}");
    }
    assert_eq!(writer.frames(), 1);
}

#[test]
fn what_cannot_be_stored_is_refused() {
    let far = Matrix3::new(1.0, 0.0, 1e300, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    let path = MotionPath::from(SampledPath::new(&[far; 5], 0.02).unwrap());
    let mesh = ResidualMesh { columns: 1, rows: 1, origin: [0.0; 2], spacing: [8.0; 2] };
    let fast = MotionPath::STILL.with_residual(ResidualField::new(mesh, vec![[1e30, 0.0]]).unwrap());
    for path in [path, fast] {
        let motion = FrameMotion::new(readout(ReadoutDirection::TopToBottom), path);
        let mut writer = MotionWriter::new(Cursor::new(Vec::new()), Clip::default()).unwrap();
        let error = writer.push(&MotionRecord::new(5, motion)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the motion of the frame at 5 ns cannot be stored: a number of its motion is too large"
        );
    }
}

#[test]
fn an_unfinished_file_is_refused() {
    let bytes = written(&records());
    let unfinished = [&[b'\n'; 1024], &bytes[1024..]].concat();
    assert!(matches!(MotionFile::from_bytes(unfinished), Err(MotionFileError::NotMotion)));
    for length in [1024, bytes.len() - 64, bytes.len() - 1] {
        let error = MotionFile::from_bytes(bytes[..length].to_vec()).unwrap_err();
        assert!(matches!(error, MotionFileError::CutShort { frames: 4, .. }), "{length}: {error}");
    }
}

#[test]
fn later_minor_versions_may_append_to_records() {
    let mut bytes = written(&records()[1..2]);
    let entry = bytes.split_off(bytes.len() - 16);
    let length = u32::try_from(bytes.len() - 1024 + 9).unwrap();
    bytes[1024..1028].copy_from_slice(&length.to_le_bytes());
    bytes.extend(*b"zoom: 1.2");
    let index = bytes.len();
    bytes.extend(entry);
    let text = String::from_utf8(bytes[..1024].to_vec()).unwrap();
    let text =
        text.replace(&format!("index: {}", index - 9), &format!("index: {index}")).replace("1.0", "1.1");
    bytes[..1024].copy_from_slice(text.as_bytes());
    assert_eq!(MotionFile::from_bytes(bytes).unwrap().record(0).unwrap(), records()[1]);
}

proptest! {
    #[test]
    fn damage_is_an_error_or_another_motion(at in 0..40_000usize, value in any::<u8>()) {
        let mut bytes = written(&records());
        let at = at % bytes.len();
        bytes[at] = value;
        if let Ok(file) = MotionFile::from_bytes(bytes) {
            for frame in 0..file.frames().min(9) {
                if let Ok(record) = file.record(frame) {
                    prop_assert!(record.motion.path().carry(nalgebra::Vector2::zeros(), 0.2, 0.5).x.is_finite());
                }
            }
        }
    }
}
