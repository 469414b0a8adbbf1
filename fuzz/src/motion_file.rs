// SPDX-License-Identifier: MIT OR Apache-2.0

//! Motion files: any bytes, and any motion written and read.

use super::input::{DIRECTIONS, readout, readout_time, real, small};
use arbitrary::{Result, Unstructured};
use nalgebra::{Matrix3, Vector2};
use rsrectify::motion::file::{Clip, MotionFile, MotionRecord, MotionWriter};
use rsrectify::motion::{FrameMotion, MotionPath, ResidualField, ResidualMesh, SampledPath, Twist};
use std::io::Cursor;

/// Bytes of the header, and of an entry of the index.
const HEADER: usize = 1024;
const ENTRY: usize = 16;

/// No bytes end in a panic, and what is written comes back as it is once it has been rounded.
pub fn check(data: &[u8]) {
    read(data.to_vec());
    let mut u = Unstructured::new(data);
    // Bytes that end make the rest of a case its defaults; they are no failure.
    let _ = written(&mut u);
}

/// Reads all of a file, if it can be opened.
fn read(bytes: Vec<u8>) {
    let Ok(file) = MotionFile::from_bytes(bytes) else { return };
    for frame in 0..file.frames().min(8) {
        let Some(time) = file.time(frame) else { panic!("frame {frame} has no time") };
        assert_eq!(file.at(time), Some(frame));
        if let Ok(record) = file.record(frame) {
            let path = record.motion.path();
            let point = Vector2::new(3.0, -2.0);
            std::hint::black_box(path.carry(point, 0.1, 0.5));
            let scaled = record.motion.scaled_to(7, 5);
            std::hint::black_box((scaled.path().carry(point, 0.1, 0.5), scaled.placement()));
        }
    }
}

fn written(u: &mut Unstructured<'_>) -> Result<()> {
    let mut writer = match MotionWriter::new(Cursor::new(Vec::new()), Clip::default()) {
        Ok(writer) => writer,
        Err(error) => panic!("{error}"),
    };
    let mut records = Vec::new();
    for _ in 0..u.int_in_range(1..=3usize)? {
        let record = MotionRecord::new(u.arbitrary()?, motion(u)?).with_confidence(small(u, 1.0)?, None);
        if writer.push(&record).is_ok() {
            records.push(record);
        }
    }
    assert_eq!(writer.frames(), records.len());
    let Ok(bytes) = writer.finish().map(Cursor::into_inner) else { panic!("memory cannot be written") };
    let once = all(&bytes);
    assert_eq!(once.len(), records.len());
    let mut again = match MotionWriter::new(Cursor::new(Vec::new()), Clip::default()) {
        Ok(writer) => writer,
        Err(error) => panic!("{error}"),
    };
    for (record, read) in records.iter().zip(&once) {
        // A path can become singular by being rounded.
        let Some(read) = read else { return Ok(()) };
        assert_eq!((record.time, record.motion.weight()), (read.time, read.motion.weight()));
        assert_eq!(record.motion.readout(), read.motion.readout());
        assert!(again.push(read).is_ok());
    }
    let Ok(twice) = again.finish().map(Cursor::into_inner) else { panic!("memory cannot be written") };
    assert_eq!(all(&twice), once);
    // Damage behind the header, which a checksum protects.
    let mut damaged = bytes;
    let end = damaged.len() - records.len() * ENTRY;
    if end > HEADER {
        for _ in 0..u.int_in_range(1..=4u8)? {
            let at = u.int_in_range(HEADER..=end - 1)?;
            if let Some(byte) = damaged.get_mut(at) {
                *byte = u.arbitrary()?;
            }
        }
        if u.arbitrary()? {
            mend_checksums(&mut damaged, end);
        }
        read(damaged);
    }
    Ok(())
}

/// Writes the checksums of records anew, so that what is in them is read although it was damaged.
fn mend_checksums(bytes: &mut [u8], index: usize) {
    // What a record has before the placement and the integers; its last bytes are the checksum. Whether there is a placement.
    const FIXED: usize = 126;
    const IS_PLACED: usize = 20;
    let entries = bytes.get(index..).unwrap_or_default().as_chunks::<ENTRY>().0;
    let offsets: Vec<_> = entries
        .iter()
        .filter_map(|entry| Some(u64::from_le_bytes(*entry.last_chunk::<8>()?) as usize))
        .collect();
    for offset in offsets {
        let Some(record) = bytes.get_mut(offset..index) else { continue };
        let Some(length) = record.get(FIXED - 8..).and_then(|field| field.first_chunk::<4>()) else {
            continue;
        };
        let placement = if record.get(IS_PLACED..IS_PLACED + 2) == Some(&[1, 0]) { 64 } else { 0 };
        let after = FIXED..(FIXED + placement).saturating_add(u32::from_le_bytes(*length) as usize);
        let Some(after) = record.get(after) else { continue };
        let hashed = record.iter().take(FIXED - 4).skip(4).chain(after);
        let hash = hashed.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        if let Some(field) = record.get_mut(FIXED - 4..FIXED) {
            field.copy_from_slice(&(hash as u32).to_le_bytes());
        }
    }
}

/// All records of a file; `None` for one that cannot be read.
fn all(bytes: &[u8]) -> Vec<Option<MotionRecord>> {
    match MotionFile::from_bytes(bytes.to_vec()) {
        Ok(file) => (0..file.frames()).map(|frame| file.record(frame).ok()).collect(),
        Err(error) => panic!("{error}"),
    }
}

/// Any motion.
fn motion(u: &mut Unstructured<'_>) -> Result<FrameMotion> {
    let size = [u.int_in_range(0..=70usize)?, u.int_in_range(0..=50usize)?];
    let readout = readout(size, *u.choose(&DIRECTIONS)?, readout_time(u)?, 0.04);
    let uniform =
        MotionPath::uniform(Twist::new(small(u, 9.0)?, small(u, 900.0)?, small(u, 900.0)?), readout.time());
    let mut path = uniform;
    if u.arbitrary()? {
        let samples: Result<Vec<_>> = (0..u.int_in_range(5..=9usize)?).map(|_| homography(u)).collect();
        let samples = samples?;
        path = SampledPath::new(&samples, readout.time()).map_or(path, MotionPath::from);
    }
    if u.arbitrary()? {
        let (columns, rows) = (u.int_in_range(1..=4usize)?, u.int_in_range(1..=4usize)?);
        let mesh = ResidualMesh {
            columns,
            rows,
            origin: [real(u, 9.0)?, real(u, 9.0)?],
            spacing: [real(u, 9.0)?, 8.0],
        };
        let velocities: Result<Vec<_>> =
            (0..columns * rows).map(|_| Ok([real(u, 4.0)? as f32, small(u, 1e4)? as f32])).collect();
        if let Ok(field) = ResidualField::new(mesh, velocities?) {
            path = path.with_residual(field);
        }
    }
    let placement = if u.arbitrary()? { Some(homography(u)?) } else { None };
    Ok(FrameMotion::new(readout, path).with_weight(real(u, 1.0)?).with_placement(placement))
}

/// The identity with up to three elements changed.
fn homography(u: &mut Unstructured<'_>) -> Result<Matrix3<f64>> {
    let mut matrix = Matrix3::identity();
    for _ in 0..u.int_in_range(0..=3u8)? {
        matrix[u.int_in_range(0..=8usize)?] += real(u, 0.1)?;
    }
    Ok(matrix)
}
