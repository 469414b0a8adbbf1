// SPDX-License-Identifier: MIT OR Apache-2.0

//! Motions known exactly: both frames are samples of one analytic texture.

use super::{Correspondence, Pyramid, Sampler};
use crate::cpu::CpuLevel;
use crate::parallel::*;
use crate::plane::{Luma, Plane, PlaneLayout, SampleFormat};
use nalgebra::Vector2;

type Point = Vector2<f64>;

/// SplitMix64, to have the same textures everywhere.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn unit(&mut self) -> f64 {
        self.bits() as f64 / u64::MAX as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// Waves of a texture.
const WAVES: usize = 40;

/// A sum of waves of 7 to 400 pixels in all directions: smooth and not repetitive. Of each wave: cycles per pixel along x and y,
/// its phase in cycles, its amplitude in grey levels.
struct Texture([[f64; WAVES]; 4]);

/// The sine of so many cycles, to 1e-7. Compilers vectorise it; with the C library's the textures take nearly all of the tests' time.
fn wave(cycles: f64) -> f64 {
    // Adding and subtracting this rounds to the nearest integer.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let cycles = cycles - ((cycles + ROUND) - ROUND);
    // The second half of each half cycle mirrors the first.
    let angle = std::f64::consts::TAU * cycles.abs().min(0.5 - cycles.abs());
    let square = angle * angle;
    let factors = [1.0 / 110.0, 1.0 / 72.0, 1.0 / 42.0, 1.0 / 20.0, 1.0 / 6.0];
    let series = factors.iter().fold(1.0, |sum, factor| 1.0 - factor * square * sum);
    (angle * series).copysign(cycles)
}

impl Texture {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let mut waves = [[0.0; WAVES]; 4];
        for i in 0..WAVES {
            let length = 7.0 * (400.0f64 / 7.0).powf(i as f64 / (WAVES - 1) as f64);
            let (sin, cos) = (std::f64::consts::TAU * random.unit()).sin_cos();
            let phase = random.unit();
            let wave = [cos / length, sin / length, phase, 4.0 + 0.03 * length];
            waves.iter_mut().zip(wave).for_each(|(all, own)| all[i] = own);
        }
        Self(waves)
    }

    fn grey(&self, at: Point) -> f64 {
        let [across, down, phase, amplitude] = &self.0;
        let mut grey = [0.0; WAVES];
        for (i, grey) in grey.iter_mut().enumerate() {
            *grey = amplitude[i] * wave(across[i] * at.x + down[i] * at.y + phase[i]);
        }
        128.0 + grey.iter().sum::<f64>()
    }
}

/// A frame of 16-bit samples, whose rounding is negligible.
struct Frame {
    data: Vec<u8>,
    layout: PlaneLayout,
}

impl Frame {
    fn new(width: usize, height: usize, grey: impl Fn(Point) -> f64 + Sync) -> Self {
        let sample = |i: usize| {
            let value = grey(Point::new((i % width) as f64, (i / width) as f64)).clamp(0.0, 255.0);
            ((value * 257.0).round() as u16).to_le_bytes()
        };
        let data: Vec<[u8; 2]> = (0..width * height).into_par_iter().map(sample).collect();
        Self { data: data.into_flattened(), layout: PlaneLayout::packed(width, height, SampleFormat::U16) }
    }

    /// 8-bit samples of the same picture.
    fn bytes(&self) -> Vec<u8> {
        self.data.as_chunks::<2>().0.iter().map(|s| (u16::from_le_bytes(*s) / 257) as u8).collect()
    }

    fn luma(&self) -> Luma<'_> {
        Plane::new(&self.data, self.layout).unwrap().into()
    }
}

fn sampler(frame: &Frame) -> Sampler {
    Sampler::new(frame.layout.width, frame.layout.height, 32, 24)
}

fn measure(first: &Luma<'_>, second: &Luma<'_>, sampler: &mut Sampler) -> Vec<Correspondence> {
    let (mut a, mut b) = (Pyramid::new(), Pyramid::new());
    sampler.build(first, &mut a);
    sampler.build(second, &mut b);
    let mut out = Vec::new();
    sampler.correspond(&a, &b, |at| at, &mut out);
    out
}

fn measure_frames(first: &Frame, second: &Frame) -> Vec<Correspondence> {
    measure(&first.luma(), &second.luma(), &mut sampler(first))
}

/// Errors in analysed pixels, in order of size.
fn errors(found: &[Correspondence], truth: impl Fn(Point) -> Point, scale: f64) -> Vec<f64> {
    let mut errors: Vec<f64> = found.iter().map(|c| (c.to - truth(c.from)).norm() / scale).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// Checks and prints count, median and RMS (analysed pixels).
fn assert_accurate(what: &str, errors: &[f64], least: usize, median: f64, rms: f64) {
    let count = errors.len();
    assert!(count >= least, "{what}: {count} points, not {least}");
    let found_rms = (errors.iter().map(|e| e * e).sum::<f64>() / count as f64).sqrt();
    let found_median = errors[count / 2];
    let greatest = errors[count - 1];
    println!("{what}: {count} points, median {found_median:.4}, RMS {found_rms:.4}, greatest {greatest:.3}");
    assert!(found_median <= median, "{what}: median {found_median}");
    assert!(found_rms <= rms, "{what}: RMS {found_rms}");
}

fn rotation(angle: f64, centre: Point, shift: Point) -> impl Fn(Point) -> Point {
    let (sin, cos) = angle.sin_cos();
    move |x| {
        let d = x - centre;
        centre + shift + Point::new(cos * d.x - sin * d.y, sin * d.x + cos * d.y)
    }
}

fn rotation_back(angle: f64, centre: Point, shift: Point) -> impl Fn(Point) -> Point {
    let back = rotation(-angle, centre, Point::zeros());
    move |x| back(x - shift)
}

#[test]
fn sub_pixel_shifts_are_exact() {
    let texture = Texture::new(1);
    let first = Frame::new(640, 480, |x| texture.grey(x));
    for shift in [(0.0, 0.0), (0.25, -0.4), (0.5, 0.5), (-1.3, 2.75), (7.37, -4.12)] {
        let shift = Point::new(shift.0, shift.1);
        let second = Frame::new(640, 480, |x| texture.grey(x - shift));
        let found = measure_frames(&first, &second);
        assert_accurate(&format!("shift {shift:?}"), &errors(&found, |x| x + shift, 1.0), 700, 0.01, 0.02);
    }
}

#[test]
fn reduced_frames_are_not_biased() {
    let texture = Texture::new(2);
    for (width, height) in [(1280, 720), (1024, 768), (1920, 1080)] {
        let scale = width as f64 / 960.0;
        let grey = |x: Point| texture.grey(x / scale);
        let first = Frame::new(width, height, grey);
        let shift = Point::new(1.7, -3.45);
        let second = Frame::new(width, height, |x| grey(x - shift));
        let found = measure_frames(&first, &second);
        let errors = errors(&found, |x| x + shift, scale);
        assert_accurate(&format!("{width}×{height}"), &errors, 730, 0.02, 0.03);
    }
}

#[test]
fn rotation_is_followed() {
    let texture = Texture::new(3);
    let first = Frame::new(960, 540, |x| texture.grey(x));
    for (degrees, shift) in [(1.0, (0.0, 0.0)), (5.0, (0.0, 0.0)), (-10.0, (0.0, 0.0)), (6.0, (60.0, -20.0))]
    {
        let (angle, centre) = (f64::to_radians(degrees), Point::new(500.0, 250.0));
        let shift = Point::new(shift.0, shift.1);
        let back = rotation_back(angle, centre, shift);
        let second = Frame::new(960, 540, |x| texture.grey(back(x)));
        let found = measure_frames(&first, &second);
        let errors = errors(&found, rotation(angle, centre, shift), 1.0);
        assert_accurate(&format!("{degrees}°"), &errors, 520, 0.03, 0.1);
    }
}

#[test]
fn a_large_shift_is_found_without_a_prediction() {
    let texture = Texture::new(4);
    let first = Frame::new(1024, 768, |x| texture.grey(x));
    for shift in [(150.0, 0.0), (-120.3, 90.6), (0.0, -150.0)] {
        let shift = Point::new(shift.0, shift.1);
        let second = Frame::new(1024, 768, |x| texture.grey(x - shift));
        let found = measure_frames(&first, &second);
        let errors = errors(&found, |x| x + shift, 1024.0 / 960.0);
        assert_accurate(&format!("shift {shift:?}"), &errors, 480, 0.03, 0.1);
    }
}

#[test]
fn slow_changes_of_brightness_do_not_hide_a_shift() {
    let waves: [[f64; 4]; 12] = std::array::from_fn(|i| {
        let i = i as f64;
        let (sin, cos) = (i * 2.4).sin_cos();
        let length = 14.0 * 1.5f64.powf(i);
        [cos / length, sin / length, i / std::f64::consts::TAU, 6.0 + i]
    });
    let grey = |at: Point| {
        let wave = |[across, down, phase, grey]: [f64; 4]| grey * wave(across * at.x + down * at.y + phase);
        128.0 + waves.map(wave).iter().sum::<f64>()
    };
    // Without reduction the waves are longer relative to a patch, and more points have too little texture.
    for (width, height, least) in [(1280, 720, 600), (960, 540, 350)] {
        let first = Frame::new(width, height, grey);
        let shift = Point::new(22.4, -9.3);
        let second = Frame::new(width, height, |x| grey(x - shift));
        let errors = errors(&measure_frames(&first, &second), |x| x + shift, width as f64 / 960.0);
        assert_accurate("slow changes", &errors, least, 0.03, 0.1);
    }
}

#[test]
fn a_shutter_that_rolls_is_followed() {
    let texture = Texture::new(5);
    let first = Frame::new(1024, 768, |x| texture.grey(x));
    // The second frame moves while it is read: its row y shows the scene shifted by slope·y.
    for (shift, slope) in [((40.0, 12.0), 0.1), ((-90.0, 0.0), -0.08), ((3.0, 1.0), 0.02)] {
        let shift = Point::new(shift.0, shift.1);
        let back = |x: Point| Point::new(x.x - shift.x - slope * x.y, x.y - shift.y);
        let forth = |x: Point| Point::new(x.x + shift.x + slope * (x.y + shift.y), x.y + shift.y);
        let second = Frame::new(1024, 768, |x| texture.grey(back(x)));
        let errors = errors(&measure_frames(&first, &second), forth, 1024.0 / 960.0);
        assert_accurate(&format!("slope {slope}"), &errors, 550, 0.03, 0.1);
    }
}

#[test]
fn brightness_may_change() {
    let texture = Texture::new(6);
    let shift = Point::new(2.3, -1.6);
    let first = Frame::new(640, 480, |x| texture.grey(x));
    let second = Frame::new(640, 480, |x| 0.8 * texture.grey(x - shift) + 15.0);
    let found = measure_frames(&first, &second);
    assert_accurate("gain and offset", &errors(&found, |x| x + shift, 1.0), 650, 0.01, 0.05);
}

#[test]
fn errors_grow_with_noise_without_bias() {
    let texture = Texture::new(7);
    let shift = Point::new(2.3, -1.6);
    let noisy = |seed: u64, shift: Point| {
        let mut random = Random(seed);
        let noise: Vec<f64> = (0..640 * 480).map(|_| 5.0 * random.normal()).collect();
        Frame::new(640, 480, |x| texture.grey(x - shift) + noise[x.y as usize * 640 + x.x as usize])
    };
    let found = measure_frames(&noisy(1, Point::zeros()), &noisy(2, shift));
    assert_accurate("noise of 5 grey levels", &errors(&found, |x| x + shift, 1.0), 600, 0.2, 0.35);
    let mean = found.iter().map(|c| c.to - c.from - shift).sum::<Point>() / found.len() as f64;
    assert!(mean.norm() < 0.03, "biased by {mean:?}");
    // Two noises of 5 add up to 7.1; interpolation reduces it.
    let residual = found.iter().map(|c| f64::from(c.residual)).sum::<f64>() / found.len() as f64;
    assert!((5.5..7.5).contains(&residual), "residual {residual}");
}

#[test]
fn frames_without_texture_have_no_points() {
    for grey in [0.0, 128.0, 255.0] {
        let frame = Frame::new(320, 240, |_| grey);
        assert!(measure_frames(&frame, &frame).is_empty());
    }
    let ramp = Frame::new(320, 240, |x| 0.7 * x.x);
    assert!(measure_frames(&ramp, &ramp).is_empty());
}

#[test]
fn any_size_will_do() {
    let texture = Texture::new(8);
    for (width, height) in [(1, 1), (7, 5), (33, 17), (1, 4000), (5000, 3), (64, 64), (200, 30), (90, 700)] {
        let frame = Frame::new(width, height, |x| texture.grey(x));
        for (columns, rows) in [(32, 24), (1, 1), (0, 0), (0, 5), (300, 200)] {
            let mut sampler = Sampler::new(width, height, columns, rows);
            let found = measure(&frame.luma(), &frame.luma(), &mut sampler);
            assert!(found.iter().all(|c| (c.to - c.from).norm() < 1e-2));
        }
    }
    let mut sampler = Sampler::new(0, 0, 32, 24);
    let frame = Frame::new(64, 48, |x| texture.grey(x));
    assert!(measure(&frame.luma(), &frame.luma(), &mut sampler).is_empty());
}

#[test]
fn a_luma_of_another_size_shows_nothing() {
    let texture = Texture::new(8);
    let (frame, other) =
        (Frame::new(320, 240, |x| texture.grey(x)), Frame::new(322, 240, |x| texture.grey(x)));
    assert!(measure_frames(&frame, &other).is_empty());
    let (mut a, mut b) = (Pyramid::new(), Pyramid::new());
    let sampler = sampler(&frame);
    sampler.build(&frame.luma(), &mut a);
    sampler.build(&frame.luma(), &mut b);
    sampler.build(&other.luma(), &mut b);
    assert!(b.is_empty());
    assert_eq!(sampler.difference(&a, &b), f64::INFINITY);
}

#[test]
fn a_cut_leaves_few_points() {
    for seed in 10..14 {
        let (before, after) = (Texture::new(seed), Texture::new(seed + 100));
        let first = Frame::new(960, 540, |x| before.grey(x));
        let second = Frame::new(960, 540, |x| after.grey(x));
        let count = measure_frames(&first, &second).len();
        println!("cut {seed}: {count} points");
        assert!(count <= 768 * 15 / 100, "{count} points");
    }
}

#[test]
fn both_of_two_motions_are_measured() {
    let (back, front) = (Texture::new(20), Texture::new(21));
    let (slow, fast) = (Point::new(2.4, 1.2), Point::new(-30.3, 8.7));
    let is_front = |x: Point| x.x < 320.0;
    let first = Frame::new(960, 540, |x| if is_front(x) { front.grey(x) } else { back.grey(x) });
    let second =
        Frame::new(960, 540, |x| if is_front(x - fast) { front.grey(x - fast) } else { back.grey(x - slow) });
    let found = measure_frames(&first, &second);
    let (near, far): (Vec<_>, Vec<_>) = found.iter().partition(|c| is_front(c.from));
    assert_accurate("fast third", &errors(&near, |x| x + fast, 1.0), 170, 0.03, 1.0);
    assert_accurate("slow rest", &errors(&far, |x| x + slow, 1.0), 440, 0.03, 1.0);
}

#[test]
fn a_repeated_texture_is_taken_where_it_is_expected() {
    let wave = |v: f64| (std::f64::consts::TAU * v / 40.0).sin();
    let grey = |x: Point| 128.0 + 40.0 * wave(x.x) + 40.0 * wave(x.y) + 30.0 * wave(2.0 * x.x + x.y);
    let shift = Point::new(25.0, -4.0);
    let first = Frame::new(960, 540, grey);
    let second = Frame::new(960, 540, |x| grey(x - shift));
    let mut sampler = sampler(&first);
    let (mut a, mut b) = (Pyramid::new(), Pyramid::new());
    sampler.build(&first.luma(), &mut a);
    sampler.build(&second.luma(), &mut b);
    let mut found = Vec::new();
    sampler.correspond(&a, &b, |x| x + Point::new(22.0, 0.0), &mut found);
    assert_accurate("expected", &errors(&found, |x| x + shift, 1.0), 500, 0.03, 1.0);
    // An invalid prediction is one candidate of several.
    sampler.correspond(&a, &b, |x| x * f64::NAN, &mut found);
    sampler.correspond(&a, &b, |x| x * 1e300, &mut found);
}

#[test]
fn an_alias_of_the_motion_is_refused() {
    // Waves of 10 to 100 pixels that nearly repeat.
    let wave = |x: Point, length: f64, degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        (std::f64::consts::TAU * (cos * x.x + sin * x.y) / length).sin()
    };
    let grey = |x: Point| {
        let fine = 25.0 * wave(x, 11.0, 20.0) + 25.0 * wave(x, 17.0, 75.0) + 20.0 * wave(x, 23.0, 130.0);
        128.0 + fine + 15.0 * wave(x, 41.0, 160.0) + 15.0 * wave(x, 97.0, 50.0)
    };
    let shift = Point::new(7.2, -2.4);
    let first = Frame::new(320, 240, grey);
    let second = Frame::new(320, 240, |x| grey(x - shift));
    let found = measure_frames(&first, &second);
    let worst = found.iter().map(|c| c.residual).fold(0.0, f32::max);
    assert!(worst < 1.0, "residual {worst}");
    assert_accurate("all but repeated", &errors(&found, |x| x + shift, 1.0), 600, 0.01, 0.02);
}

#[test]
fn all_levels_of_the_processor_measure_the_same() {
    let texture = Texture::new(33);
    let first = Frame::new(960, 540, |x| texture.grey(x));
    let back = rotation_back(0.05, Point::new(500.0, 250.0), Point::new(20.0, -7.0));
    let second = Frame::new(960, 540, |x| texture.grey(back(x)));
    let run = |level| {
        let mut sampler = Sampler::with_cpu(level, 960, 540, 32, 24);
        measure(&first.luma(), &second.luma(), &mut sampler)
    };
    let scalar = run(CpuLevel::Scalar);
    assert!(scalar.len() > 500);
    // Fused multiplications of the flow round differently, which decides between displacements of equal
    // residual.
    for level in CpuLevel::supported() {
        let found = run(level);
        let is_same =
            |a: &&Correspondence| found.iter().any(|b| a.from == b.from && (a.to - b.to).norm() < 1e-3);
        let same = scalar.iter().filter(is_same).count();
        assert!(
            same as f64 > 0.99 * found.len().max(scalar.len()) as f64,
            "{level:?}: {same} of {}",
            found.len()
        );
    }
}

#[test]
fn sample_formats_agree() {
    let texture = Texture::new(30);
    let shift = Point::new(3.3, -2.2);
    let (width, height) = (320, 240);
    let first = Frame::new(width, height, |x| texture.grey(x));
    let second = Frame::new(width, height, |x| texture.grey(x - shift));
    let points = |layout: PlaneLayout, weights: [f32; 4], convert: &dyn Fn(&Frame) -> Vec<u8>| {
        let (a, b) = (convert(&first), convert(&second));
        let luma = |data| Luma { plane: Plane::new(data, layout).unwrap(), weights };
        measure(&luma(&a), &luma(&b), &mut Sampler::new(width, height, 16, 12))
    };
    let only = [1.0, 0.0, 0.0, 0.0];
    let planar = points(PlaneLayout::packed(width, height, SampleFormat::U8), only, &Frame::bytes);
    let p010 = points(PlaneLayout::packed(width, height, SampleFormat::U10_HIGH), only, &|frame| {
        let words = frame.data.as_chunks::<2>().0.iter();
        words.flat_map(|w| (u16::from_le_bytes(*w) & 0xffc0).to_le_bytes()).collect()
    });
    let yuy2 =
        PlaneLayout { step: 2, stride: 2 * width, ..PlaneLayout::packed(width, height, SampleFormat::U8) };
    let yuy2 = points(yuy2, only, &|frame| frame.bytes().iter().flat_map(|&y| [y, 77]).collect());
    let rgbx = PlaneLayout {
        step: 4,
        channels: 3,
        stride: 4 * width,
        ..PlaneLayout::packed(width, height, SampleFormat::U8)
    };
    let rgbx = points(rgbx, [0.3, 0.6, 0.1, 9.0], &|frame| {
        frame.bytes().iter().flat_map(|&y| [y, y, y, 3]).collect()
    });
    assert!(planar.len() > 150);
    assert_eq!(planar, yuy2);
    // Rounding decides between displacements of equal residual: a few points may differ more than the others.
    for (other, usual) in [(p010, 0.01), (rgbx, 1e-4)] {
        assert_eq!(planar.len(), other.len());
        let mut apart = Vec::new();
        for (a, b) in planar.iter().zip(&other) {
            apart.push((a.to - b.to).norm());
            assert!(a.from == b.from && (a.to - b.to).norm() < 0.03, "{a:?} {b:?}");
            assert!((a.texture / b.texture - 1.0).abs() < 0.1);
        }
        apart.sort_by(f64::total_cmp);
        assert!(apart[apart.len() / 2] < usual, "{}", apart[apart.len() / 2]);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let texture = Texture::new(31);
    let first = Frame::new(960, 540, |x| texture.grey(x));
    let second = Frame::new(960, 540, |x| texture.grey(x * 1.01));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| measure_frames(&first, &second))
    };
    let alone = run(1);
    assert!(alone.len() > 500);
    assert_eq!(alone, run(3));
    assert_eq!(alone, run(8));
}

#[test]
fn a_duplicate_is_told_from_a_small_movement() {
    let texture = Texture::new(32);
    let still = |x: Point| texture.grey(x);
    let scene = |seed: u64, square: f64, noise: f64| {
        let mut random = Random(seed);
        let noise: Vec<f64> = (0..960 * 540).map(|_| noise * random.normal()).collect();
        let is_square = move |x: Point| (x.x - square).abs() < 6.0 && (x.y - 300.0).abs() < 6.0;
        Frame::new(960, 540, |x| {
            still(x) * 0.5 + noise[x.y as usize * 960 + x.x as usize] + if is_square(x) { 50.0 } else { 0.0 }
        })
    };
    let first = scene(1, 400.0, 0.5);
    let sampler = sampler(&first);
    let difference = |second: &Frame| {
        let (mut a, mut b) = (Pyramid::new(), Pyramid::new());
        sampler.build(&first.luma(), &mut a);
        sampler.build(&second.luma(), &mut b);
        sampler.difference(&a, &b)
    };
    assert_eq!(difference(&first), 0.0);
    let (again, moved) = (difference(&scene(2, 400.0, 1.0)), difference(&scene(2, 401.0, 0.5)));
    println!("encoded again {again:.2}, moved {moved:.2}");
    assert!(again < 1.5 && moved > 3.0, "{again} {moved}");
}
