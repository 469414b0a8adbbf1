// SPDX-License-Identifier: MIT OR Apache-2.0

//! Kernels: every CPU level against plain Rust, and memory that must not be written.

use super::*;

const INTERPOLATIONS: [Interpolation; 4] =
    [Interpolation::Nearest, Interpolation::Linear, Interpolation::Cubic, Interpolation::Lanczos];
const BORDERS: [BorderMode; 3] =
    [BorderMode::Replicate, BorderMode::Mirror, BorderMode::Constant(Fill::packed([200, 100, 50, 255]))];
const FORMATS: [SampleFormat; 6] = [
    SampleFormat::U8,
    SampleFormat::U10,
    SampleFormat::U10_HIGH,
    SampleFormat::U12,
    SampleFormat::U12_HIGH,
    SampleFormat::U16,
];

fn random_layout(random: &mut Random) -> PlaneLayout {
    let channels = 1 + random.below(4);
    let step = channels + random.below(3);
    let format = if random.below(2) == 0 { SampleFormat::U8 } else { FORMATS[random.below(FORMATS.len())] };
    let (width, height) = (1 + random.below(90), 1 + random.below(50));
    let stride = (width * step + random.below(20)) * format.bytes();
    PlaneLayout { width, height, stride, step, channels, format }
}

fn random_warp(random: &mut Random, layout: &PlaneLayout, level: CpuLevel, seed: [f64; 4]) -> Warper {
    let directions = [
        ReadoutDirection::TopToBottom,
        ReadoutDirection::BottomToTop,
        ReadoutDirection::LeftToRight,
        ReadoutDirection::RightToLeft,
    ];
    let readout = readout(layout.width, layout.height, directions[random.below(4)], 1.0);
    let settings = WarpSettings {
        interpolation: INTERPOLATIONS[random.below(4)],
        border: BORDERS[random.below(3)],
        zoom: if random.below(3) == 0 { 1.0 + 3.0 * seed[3].abs() } else { 1.0 },
        ..WarpSettings::default()
    };
    let size = layout.height as f64;
    let mut warper = Warper::with_cpu(level);
    let path = path(&readout, seed[0] * 0.6, seed[1] * size, seed[2] * size);
    warper.solve(&FrameMotion::new(readout, path), &settings);
    warper
}

/// Which bytes of a plane's buffer belong to its own samples.
fn own_bytes(layout: &PlaneLayout, len: usize) -> Vec<bool> {
    let bytes = layout.format.bytes();
    let mut own = vec![false; len];
    for row in 0..layout.height {
        for pixel in 0..layout.width {
            let at = row * layout.stride + pixel * layout.step * bytes;
            own[at..at + layout.channels * bytes].fill(true);
        }
    }
    own
}

#[test]
fn levels_agree_and_only_own_samples_are_written() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for round in 0..600 {
        let from = random_layout(&mut random);
        let step = from.channels + random.below(3);
        let stride = (from.width * step + random.below(9)) * from.format.bytes();
        let to = PlaneLayout { step, stride, ..from };
        let samples = from.required_bytes().unwrap();
        // The buffer ends with the last sample: reading past it would panic.
        let data: Vec<u8> = (0..samples).map(|_| random.next() as u8).collect();
        let seed = [random.signed(), random.signed(), random.signed(), random.signed()];
        let state = random.next() | 1;
        let results: Vec<Vec<u8>> = CpuLevel::supported()
            .map(|level| {
                let warper = random_warp(&mut Random(state), &from, level, seed);
                let mut out = vec![0xa5; to.required_bytes().unwrap() + 7];
                let mut dst = PlaneMut::new(&mut out, to).unwrap();
                let src = Plane::new(&data, from).unwrap();
                warper.warp(&src, &mut dst, SampleGrid::FULL, 0).unwrap();
                out
            })
            .collect();
        for result in &results {
            assert_eq!(result, &results[0], "round {round}: {from:?}");
            let own = own_bytes(&to, result.len());
            assert!(result.iter().zip(own).all(|(&byte, own)| own || byte == 0xa5), "{round}: {to:?}");
        }
    }
}

#[test]
fn constant_pictures_stay_constant() {
    let readout = readout(50, 40, ReadoutDirection::TopToBottom, 1.0);
    for format in FORMATS {
        for interpolation in INTERPOLATIONS {
            for border in BORDERS {
                let mut warper = Warper::new();
                for value in [0, 1, format.max_value() / 3, format.max_value()] {
                    let border = match border {
                        BorderMode::Constant(_) => BorderMode::Constant(Fill::packed([value; 4])),
                        other => other,
                    };
                    let settings = WarpSettings { interpolation, border, ..WarpSettings::default() };
                    warper.solve(&FrameMotion::new(readout, path(&readout, 0.2, 9.0, -7.0)), &settings);
                    let stored = (value << format.shift()).to_le_bytes();
                    let data = stored[..format.bytes()].repeat(50 * 40);
                    let layout = PlaneLayout::packed(50, 40, format);
                    let out = rectify(&warper, &data, layout, SampleGrid::FULL);
                    assert_eq!(out, data, "{format:?} {interpolation:?} {border:?} {value}");
                }
            }
        }
    }
}

#[test]
fn words_keep_their_shift_and_range() {
    let mut random = Random(7);
    let readout = readout(64, 48, ReadoutDirection::TopToBottom, 1.0);
    for format in FORMATS.into_iter().filter(|format| format.bytes() == 2) {
        let value = |random: &mut Random| {
            if random.below(2) == 0 { 0 } else { format.max_value() << format.shift() }
        };
        let data: Vec<u8> = (0..64 * 48).flat_map(|_| u16::to_le_bytes(value(&mut random))).collect();
        for interpolation in INTERPOLATIONS {
            let mut warper = Warper::new();
            let settings = WarpSettings { interpolation, ..WarpSettings::default() };
            warper.solve(&FrameMotion::new(readout, path(&readout, 0.1, 5.0, 3.3)), &settings);
            let layout = PlaneLayout::packed(64, 48, format);
            for word in rectify(&warper, &data, layout, SampleGrid::FULL).chunks(2) {
                let word = u16::from_le_bytes([word[0], word[1]]);
                assert!(word >> format.shift() <= format.max_value());
                assert_eq!(word % (1 << format.shift()), 0);
            }
        }
    }
}

#[test]
fn hostile_motion_ends_and_stays_inside() {
    let wild = [f64::NAN, f64::INFINITY, 1e300, -1e9, 1e4, 30.0];
    for (index, &value) in wild.iter().enumerate() {
        let readout = readout(70, 33, ReadoutDirection::RightToLeft, 1.0);
        let other = wild[(index + 1) % wild.len()];
        for path in [path(&readout, value, 0.0, other), path(&readout, 0.0, value, value)] {
            for border in BORDERS {
                let mut warper = Warper::new();
                let settings = WarpSettings { border, zoom: other, ..WarpSettings::default() };
                warper.solve(&FrameMotion::new(readout, path.clone()), &settings);
                let layout = PlaneLayout::packed(70, 33, SampleFormat::U8);
                rectify(&warper, &[9; 70 * 33], layout, SampleGrid::FULL);
                let far = SampleGrid { scale: [3.0, 1e-3], offset: [1e5, -1e5] };
                rectify(&warper, &[9; 70 * 33], layout, far);
            }
        }
    }
}

#[test]
fn planes_of_a_scale_near_zero_agree_at_all_levels() {
    // A scale near zero: displacements are infinite, and their differences NaN.
    let readout = readout(52, 11, ReadoutDirection::TopToBottom, 1.0);
    let motion = FrameMotion::new(readout, path(&readout, 0.3, 9.0, -4.0));
    let layout = PlaneLayout::packed(52, 11, SampleFormat::U8);
    let data: Vec<u8> = (0..52 * 11).map(|index| (index * 37 % 251) as u8).collect();
    for (scale, offset) in [
        ([f64::MIN_POSITIVE, 0.5], [8.0, 5.0]),
        ([0.5, f64::MIN_POSITIVE], [8.0, 5.0]),
        ([1e-200, 1e200], [-1e100, 1e100]),
        ([f64::MAX, f64::MAX], [f64::MAX, f64::MIN]),
    ] {
        let shown: Vec<Vec<u8>> = CpuLevel::supported()
            .map(|level| {
                let mut warper = Warper::with_cpu(level);
                warper.solve(&motion, &WarpSettings::default());
                rectify(&warper, &data, layout, SampleGrid { scale, offset })
            })
            .collect();
        assert!(shown.windows(2).all(|pair| pair[0] == pair[1]), "{scale:?}");
    }
}

#[test]
fn an_invalid_sample_grid_is_refused() {
    let layout = PlaneLayout::packed(70, 33, SampleFormat::U8);
    let (source, mut target) = ([9; 70 * 33], [0; 70 * 33]);
    for (scale, offset) in [
        ([0.0, 1.0], [0.0; 2]),
        ([1.0, -2.0], [0.0; 2]),
        ([1.0, f64::NAN], [0.0; 2]),
        ([1.0; 2], [f64::INFINITY, 0.0]),
    ] {
        let (source, mut target) =
            (Plane::new(&source, layout).unwrap(), PlaneMut::new(&mut target, layout).unwrap());
        let refused = Warper::new().warp(&source, &mut target, SampleGrid { scale, offset }, 0);
        assert_eq!(refused, Err(WarpError::SampleGrid));
    }
}
