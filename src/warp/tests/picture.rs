// SPDX-License-Identifier: MIT OR Apache-2.0

//! Rectified pictures against closed forms.

use super::*;

const SIZE: (usize, usize) = (320, 240);

fn smooth(x: f64, y: f64) -> f64 {
    128.0 + 50.0 * (x * 0.11 + y * 0.05).sin() + 50.0 * (y * 0.13 - x * 0.03).cos()
}

/// The frame of a rotating and shifting camera: each row shows `scene` at its own exposure time.
fn distorted(readout: &Readout, path: &MotionPath, scene: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let centre = Vector2::new((SIZE.0 as f64 - 1.0) / 2.0, (SIZE.1 as f64 - 1.0) / 2.0);
    picture(SIZE.0, SIZE.1, |x, y| {
        let share = readout.share(x, y);
        let twist = path.mean_twist();
        let angle = twist.omega * (share - 0.5) * readout.time;
        // The scene is at rest at share ½; a pixel exposed at `share` is rotated back to it.
        let about = twist.centre().unwrap();
        let (dx, dy) = (x - centre.x - about.x, y - centre.y - about.y);
        let (sin, cos) = (-angle).sin_cos();
        scene(centre.x + about.x + cos * dx - sin * dy, centre.y + about.y + sin * dx + cos * dy)
    })
}

/// Mean and largest absolute difference inside a margin.
fn difference(out: &[u8], truth: impl Fn(f64, f64) -> f64, margin: usize) -> (f64, f64) {
    let (mut sum, mut worst, mut count) = (0.0, 0.0f64, 0.0);
    for y in margin..SIZE.1 - margin {
        for x in margin..SIZE.0 - margin {
            let error = (f64::from(out[y * SIZE.0 + x]) - truth(x as f64, y as f64)).abs();
            (sum, worst, count) = (sum + error, worst.max(error), count + 1.0);
        }
    }
    (sum / count, worst)
}

fn rectified(
    direction: ReadoutDirection,
    interpolation: Interpolation,
    scene: fn(f64, f64) -> f64,
) -> Vec<u8> {
    let readout = readout(SIZE.0, SIZE.1, direction, 0.9);
    let path = path(&readout, 0.12, 18.0, -13.0);
    let data = distorted(&readout, &path, scene);
    let mut warper = Warper::new();
    warper
        .solve(&FrameMotion::new(readout, path), &WarpSettings { interpolation, ..WarpSettings::default() });
    rectify(&warper, &data, PlaneLayout::packed(SIZE.0, SIZE.1, SampleFormat::U8), SampleGrid::FULL)
}

#[test]
fn a_turning_camera_is_undone() {
    let directions = [
        ReadoutDirection::TopToBottom,
        ReadoutDirection::BottomToTop,
        ReadoutDirection::LeftToRight,
        ReadoutDirection::RightToLeft,
    ];
    for direction in directions {
        for (interpolation, limit) in [(Interpolation::Cubic, 1.6), (Interpolation::Lanczos, 1.6)] {
            let out = rectified(direction, interpolation, smooth);
            let (mean, worst) = difference(&out, smooth, 30);
            assert!(mean < 0.45 && worst < limit, "{direction:?} {interpolation:?}: {mean} {worst}");
        }
    }
}

#[test]
fn better_kernels_keep_more_of_fine_detail() {
    let chirp = |x: f64, y: f64| 128.0 + 80.0 * (x * x * 0.002 + y * 0.2).sin();
    let error = |interpolation| {
        difference(&rectified(ReadoutDirection::TopToBottom, interpolation, chirp), chirp, 30).0
    };
    let errors =
        [Interpolation::Nearest, Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos]
            .map(error);
    assert!(errors[0] > errors[1] && errors[1] > 1.5 * errors[2] && errors[2] > errors[3], "{errors:?}");
}

/// 16-bit ramps, so that rounding to grey levels does not mask an error in position.
fn ramp(layout: PlaneLayout, grid: SampleGrid, axis: usize) -> Vec<u8> {
    (0..layout.width * layout.height)
        .flat_map(|index| {
            let at = [index % layout.width, index / layout.width][axis] as f64;
            let frame = grid.scale[axis] * at + grid.offset[axis];
            ((2000.0 + 100.0 * frame).round() as u16).to_le_bytes()
        })
        .collect()
}

/// Frame positions of the pixels of the rectified plane, from a ramp along each axis.
pub(super) fn positions(warper: &Warper, layout: PlaneLayout, grid: SampleGrid) -> [Vec<f64>; 2] {
    [0, 1].map(|axis| {
        rectify(warper, &ramp(layout, grid, axis), layout, grid)
            .chunks(2)
            .map(|word| (f64::from(u16::from_le_bytes([word[0], word[1]])) - 2000.0) / 100.0)
            .collect()
    })
}

#[test]
fn luma_and_chroma_agree() {
    let readout = readout(320, 240, ReadoutDirection::TopToBottom, 1.0);
    let luma_layout = PlaneLayout::packed(320, 240, SampleFormat::U16);
    let chroma_layout = PlaneLayout::packed(160, 120, SampleFormat::U16);
    for interpolation in [Interpolation::Linear, Interpolation::Cubic] {
        let mut warper = Warper::new();
        let settings = WarpSettings { interpolation, ..WarpSettings::default() };
        warper.solve(&FrameMotion::new(readout, path(&readout, 0.05, 12.0, -6.0)), &settings);
        let luma = positions(&warper, luma_layout, SampleGrid::FULL);
        let chroma = positions(&warper, chroma_layout, SampleGrid { scale: [2.0; 2], offset: [0.5; 2] });
        for (row, column) in (10..110).flat_map(|row| (10..150).map(move |column| (row, column))) {
            for axis in [0, 1] {
                let at = |dy: usize, dx: usize| luma[axis][(2 * row + dy) * 320 + 2 * column + dx];
                let between = (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)) / 4.0;
                let shown = chroma[axis][row * 160 + column];
                assert!((shown - between).abs() < 0.02, "{axis} ({column}, {row}): {shown} {between}");
            }
        }
    }
}

#[test]
fn a_translation_moves_each_row_to_the_reference() {
    // 64 px a frame over 64 rows: row r was read at share (r + ½)/64 and moves by 32 − (r + ½).
    let readout = readout(256, 64, ReadoutDirection::TopToBottom, 1.0);
    let layout = PlaneLayout::packed(256, 64, SampleFormat::U8);
    let mut warper = Warper::new();
    let settings = WarpSettings { interpolation: Interpolation::Linear, ..WarpSettings::default() };
    warper.solve(&FrameMotion::new(readout, path(&readout, 0.0, 64.0, 0.0)), &settings);
    let data = picture(256, 64, |x, _| x);
    let out = rectify(&warper, &data, layout, SampleGrid::FULL);
    for row in 0..64 {
        for column in 40..216 {
            let truth = column as f64 - (32.0 - (row as f64 + 0.5));
            assert!((f64::from(out[row * 256 + column]) - truth).abs() <= 0.51, "{column} {row}");
        }
    }
}

#[test]
fn a_weight_of_half_halves_the_correction() {
    // As above, halved by the weight, and again by the strength.
    let readout = readout(256, 64, ReadoutDirection::TopToBottom, 1.0);
    let layout = PlaneLayout::packed(256, 64, SampleFormat::U8);
    let data = picture(256, 64, |x, _| x);
    for (weight, strength) in [(0.5, 1.0), (0.5, 0.5), (0.0, 1.0)] {
        let motion = FrameMotion::new(readout, path(&readout, 0.0, 64.0, 0.0)).with_weight(weight);
        let mut warper = Warper::new();
        let interpolation = Interpolation::Linear;
        warper.solve(&motion, &WarpSettings { interpolation, strength, ..WarpSettings::default() });
        let out = rectify(&warper, &data, layout, SampleGrid::FULL);
        for (row, column) in (0..64).flat_map(|row| (40..216).map(move |column| (row, column))) {
            let truth = column as f64 - weight * strength * (32.0 - (row as f64 + 0.5));
            assert!((f64::from(out[row * 256 + column]) - truth).abs() <= 0.51, "{weight}: {column} {row}");
        }
    }
}

#[test]
fn without_motion_the_result_is_an_exact_copy() {
    let readout = readout(33, 21, ReadoutDirection::TopToBottom, 1.0);
    let mut random = Random(3);
    let data: Vec<u8> = (0..33 * 21 * 2).map(|_| random.next() as u8).collect();
    let still = WarpSettings { strength: 0.0, ..WarpSettings::default() };
    let moved = path(&readout, 0.1, 3.0, 4.0);
    for (path, settings) in [(MotionPath::STILL, WarpSettings::default()), (moved, still)] {
        let mut warper = Warper::new();
        warper.solve(&FrameMotion::new(readout, path), &settings);
        for format in [SampleFormat::U10_HIGH, SampleFormat::U16] {
            let out = rectify(&warper, &data, PlaneLayout::packed(33, 21, format), SampleGrid::FULL);
            assert_eq!(out, data);
        }
    }
}

#[test]
fn borders_follow_their_mode() {
    // The picture moves 40 px to the right during the readout; the reference is share 1.
    let readout = readout(64, 8, ReadoutDirection::TopToBottom, 1.0);
    let motion = path(&readout, 0.0, 40.0, 0.0);
    let layout = PlaneLayout::packed(64, 8, SampleFormat::U8);
    let data = picture(64, 8, |x, _| 10.0 + x);
    let first = |border| {
        let mut warper = Warper::new();
        let settings = WarpSettings {
            border,
            reference_row: 1.0,
            interpolation: Interpolation::Nearest,
            ..WarpSettings::default()
        };
        warper.solve(&FrameMotion::new(readout, motion.clone()), &settings);
        rectify(&warper, &data, layout, SampleGrid::FULL)[..64].to_vec()
    };
    // Row 0 was read at share 1/16 and moves by 15/16 · 40 = 37.5 px: pixel X shows X − 37.5.
    assert_eq!(first(BorderMode::Replicate)[..37], [10; 37]);
    assert_eq!(first(BorderMode::Constant(Fill::packed([7; 4])))[..37], [7; 37]);
    let mirror: Vec<u8> = (0..30).map(|x| 10 + (37 - x) - 1).collect();
    assert_eq!(first(BorderMode::Mirror)[..30], mirror);
}

#[test]
fn a_frame_is_its_planes_each_with_its_grid_and_fill() {
    let (width, height) = (64, 48);
    let layout = FrameLayout::yuv420(width, height, SampleFormat::U8);
    let [y, u, v] = [0, 1, 2].map(|plane| {
        let (plane_layout, _) = layout.planes[plane];
        picture(plane_layout.width, plane_layout.height, |x, y| 40.0 + 50.0 * plane as f64 + x + 0.5 * y)
    });
    let settings = WarpSettings {
        border: BorderMode::Constant(Fill::planar([16, 128, 129, 0])),
        reference_row: 1.0,
        ..WarpSettings::default()
    };
    let readout = readout(width, height, ReadoutDirection::TopToBottom, 1.0);
    let motion = FrameMotion::new(readout, path(&readout, 0.0, 40.0, 0.0));
    let mut warper = Warper::new();
    let prepared = warper.prepare(&motion, &settings);
    let mut shown = [vec![0; y.len()], vec![0; u.len()], vec![0; v.len()]];
    prepared.warp_frame(&layout, &[&y, &u, &v], &mut shown).unwrap();
    assert_eq!([0, 1, 2].map(|plane| shown[plane][0]), [16, 128, 129]);
    for (index, source) in [&y, &u, &v].into_iter().enumerate() {
        let (plane_layout, grid) = layout.planes[index];
        let mut alone = vec![0; source.len()];
        let mut dst = PlaneMut::new(&mut alone, plane_layout).unwrap();
        let src = Plane::new(source, plane_layout).unwrap();
        prepared.warp_plane(index, &src, &mut dst, grid).unwrap();
        assert_eq!(shown[index], alone);
    }
    assert_eq!(prepared.warp_frame(&layout, &[&y, &u], &mut shown), Err(WarpError::Planes));
    assert_eq!(prepared.warp_frame(&layout, &[&y, &u, &v], &mut shown[..2]), Err(WarpError::Planes));
    let short = PlaneError::TooShort { len: v.len() - 1, needed: v.len() };
    let refused = prepared.warp_frame(&layout, &[&y, &u, &v[1..].to_vec()], &mut shown);
    assert_eq!(refused, Err(WarpError::Plane(short)));
}

#[test]
fn planes_that_differ_are_refused() {
    let layout = PlaneLayout::packed(4, 4, SampleFormat::U8);
    let src = Plane::new(&[0; 16], layout).unwrap();
    for other in [PlaneLayout::packed(4, 3, SampleFormat::U8), PlaneLayout::packed(4, 4, SampleFormat::U10)] {
        let mut out = vec![0; 64];
        let mut dst = PlaneMut::new(&mut out, other).unwrap();
        assert_eq!(Warper::new().warp(&src, &mut dst, SampleGrid::FULL, 0), Err(WarpError::Mismatch));
    }
}
