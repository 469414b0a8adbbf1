// SPDX-License-Identifier: MIT OR Apache-2.0

//! Any luma view → reduced grey in 0 to 255, by area average.
//!
//! One pass over the source: the rows under an output row are weighted and summed (vectorised, the
//! sample format and channel weights folded into one factor), then the sum is reduced along the
//! row, which is written where it stays. Reads each byte ⌈s⌉/s to (⌈s⌉ + 1)/s times for a ratio s, once if s is whole.

use super::level::{BORDER, Level, replicate};
use crate::cpu::{CpuLevel, for_each_cpu};
use crate::parallel::*;
use crate::plane::{Luma, PlaneLayout};

/// Bands of output rows, each with its own accumulator; more than cores, to balance the load.
const BANDS: usize = 16;

/// The reduction of frames of one size.
#[derive(Debug)]
pub(crate) struct Reduction {
    full: (usize, usize),
    columns: ReductionFilter,
    rows: ReductionFilter,
    scale: f64,
}

impl Reduction {
    /// For full frames of `width` × `height`, `scale` full-frame pixels per analysed pixel, at least 1.
    pub(crate) fn new(width: usize, height: usize, scale: f64) -> Self {
        Self {
            full: (width, height),
            columns: ReductionFilter::new(width, scale),
            rows: ReductionFilter::new(height, scale),
            scale,
        }
    }

    /// Full-frame pixels per analysed pixel, at least 1; the same along both axes.
    pub(crate) fn scale(&self) -> f64 {
        self.scale
    }

    /// Width and height of the analysed grey.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.columns.outputs(), self.rows.outputs())
    }

    /// Reduces `luma` into `level`, with `scratch` for the sums. Returns false and does nothing if the luma is not of
    /// the full frame's size.
    pub(crate) fn reduce(
        &self,
        cpu: CpuLevel,
        luma: &Luma<'_>,
        level: &mut Level,
        scratch: &mut Vec<f32>,
    ) -> bool {
        let layout = luma.plane.layout();
        let (width, height) = self.size();
        if (layout.width, layout.height) != self.full || width == 0 || height == 0 {
            return false;
        }
        let band = height.div_ceil(BANDS);
        scratch.resize(self.full.0 * height.div_ceil(band), 0.0);
        level.write(width, height, |inside, stride| {
            let bands = inside.par_chunks_mut(stride * band).zip(scratch.par_chunks_mut(self.full.0));
            bands.enumerate().for_each(|(index, (rows, sums))| {
                for (offset, row) in rows.chunks_exact_mut(stride).enumerate() {
                    let out = &mut row[BORDER..BORDER + width];
                    reduce_row(cpu, self, luma, index * band + offset, out, sums);
                    replicate(row, width);
                }
            });
        });
        true
    }
}

for_each_cpu! {
    /// Output row `y`; `sums` has one sum per column of the frame.
    fn reduce_row(reduction: &Reduction, luma: &Luma<'_>, y: usize, out: &mut [f32], sums: &mut [f32]) {
        let (first, weights) = reduction.rows.of(y);
        let mut sums = RowSums { sums, is_begun: false };
        for (k, &weight) in weights.iter().enumerate() {
            sums.add_row(luma, first + k, weight);
        }
        reduction.columns.apply(sums.finished(), out);
    }
}

/// The grey of row `y` of the frame, 0 to 255.
pub(crate) fn grey_row(luma: &Luma<'_>, y: usize, row: &mut [f32]) {
    let mut sums = RowSums { sums: row, is_begun: false };
    sums.add_row(luma, y, 1.0);
    sums.finished();
}

/// A one-dimensional reduction filter: per output `count` weights, the first for input `first`.
#[derive(Debug)]
struct ReductionFilter {
    first: Vec<usize>,
    weights: Vec<f32>,
    count: usize,
    whole: bool,
}

impl ReductionFilter {
    /// Reduces `inputs` samples by `scale`; a remainder of less than one output sample is dropped.
    ///
    /// Whole ratios use the plain mean, others the mean of the *linear interpolant* over the output
    /// pixel: the centre of mass of the mean of the piecewise constant picture is off the pixel's centre
    /// by up to 1/(8s) input pixels, with a sign that changes along the row, which would be measured as
    /// motion.
    fn new(inputs: usize, scale: f64) -> Self {
        let outputs = (inputs as f64 / scale + 1e-9).floor() as usize;
        let whole = scale.fract() == 0.0;
        let count = if whole { scale as usize } else { (scale.ceil() as usize + 2).min(inputs) };
        let mut filter = Self { first: Vec::with_capacity(outputs), weights: Vec::new(), count, whole };
        for output in 0..outputs {
            let start = output as f64 * scale;
            let reach = if whole { start } else { start - 0.5 };
            let first = (reach.floor().max(0.0) as usize).min(inputs - count);
            filter.first.push(first);
            let weights = filter.weights.len();
            filter.weights.resize(weights + count, 1.0 / count as f32);
            if !whole {
                interpolant_means(start - 0.5, scale, first, inputs, &mut filter.weights[weights..]);
            }
        }
        filter
    }

    fn outputs(&self) -> usize {
        self.first.len()
    }

    /// The first input of an output, and the weights of the inputs that start there.
    #[inline(always)]
    fn of(&self, output: usize) -> (usize, &[f32]) {
        (self.first[output], &self.weights[output * self.count..][..self.count])
    }

    #[inline(always)]
    fn apply(&self, input: &[f32], out: &mut [f32]) {
        match (self.whole, self.count) {
            (true, 1) => out.copy_from_slice(&input[..out.len()]),
            (true, 2) => mean_of::<2>(input, out),
            (true, 4) => mean_of::<4>(input, out),
            (false, 4) => self.apply_fixed::<4>(input, out),
            _ => {
                for (x, out) in out.iter_mut().enumerate() {
                    let (first, weights) = self.of(x);
                    *out = weights.iter().zip(&input[first..]).map(|(w, v)| w * v).sum();
                }
            }
        }
    }

    #[inline(always)]
    fn apply_fixed<const K: usize>(&self, input: &[f32], out: &mut [f32]) {
        let (weights, _) = self.weights.as_chunks::<K>();
        for ((out, &first), weights) in out.iter_mut().zip(&self.first).zip(weights) {
            let input = &input[first..first + K];
            *out = (0..K).map(|k| weights[k] * input[k]).sum();
        }
    }
}

#[inline(always)]
fn mean_of<const K: usize>(input: &[f32], out: &mut [f32]) {
    for (out, values) in out.iter_mut().zip(input.as_chunks::<K>().0) {
        *out = values.iter().sum::<f32>() * (1.0 / K as f32);
    }
}

/// Weights of inputs `first…` in the mean over [start, start + length] (pixel centres at integers)
/// of the linear interpolant, constant beyond its ends.
fn interpolant_means(start: f64, length: f64, first: usize, inputs: usize, weights: &mut [f32]) {
    // The integral of the hat function of an input up to the distance d past its centre.
    let hat = |d: f64| {
        let d = d.clamp(-1.0, 1.0);
        0.5 + d - 0.5 * d * d.abs()
    };
    let mass = |from: f64, to: f64| (hat(to) - hat(from)) / length;
    let mut weight_of = vec![0.0; weights.len()];
    for (k, weight) in weight_of.iter_mut().enumerate() {
        let centre = (first + k) as f64;
        *weight = mass(start - centre, start + length - centre);
    }
    let outside_left = mass(start + 1.0, start + length + 1.0);
    let outside_right = mass(start - inputs as f64, start + length - inputs as f64);
    weight_of[0] += outside_left;
    if let Some(last) = weight_of.last_mut() {
        *last += outside_right;
    }
    for (weight, value) in weights.iter_mut().zip(weight_of) {
        *weight = value as f32;
    }
}

/// Sums of samples, one per column of the frame.
struct RowSums<'a> {
    sums: &'a mut [f32],
    /// Whether anything has been added: the first samples replace what is there.
    is_begun: bool,
}

impl<'a> RowSums<'a> {
    /// Adds `weight` times the grey of row `y`.
    #[inline(always)]
    fn add_row(&mut self, luma: &Luma<'_>, y: usize, weight: f32) {
        let layout = luma.plane.layout();
        let row = luma.plane.row(y);
        let factor = weight * 255.0 / f32::from(layout.format.max_value());
        for (channel, channel_weight) in luma.weights.iter().enumerate().take(layout.channels) {
            let factor = factor * channel_weight;
            if factor != 0.0 {
                self.add_channel(row, layout, channel, factor);
            }
        }
    }

    #[inline(always)]
    fn add_channel(&mut self, row: &[u8], layout: &PlaneLayout, channel: usize, factor: f32) {
        if layout.format.bytes() == 1 {
            let row = row.get(channel..).unwrap_or(&[]);
            let grey = |&sample: &u8| factor * f32::from(sample);
            match layout.step {
                1 => self.add(row.iter().map(grey)),
                2 => self.add(row.iter().step_by(2).map(grey)),
                4 => self.add(row.iter().step_by(4).map(grey)),
                step => self.add(row.iter().step_by(step).map(grey)),
            }
        } else {
            let (words, _) = row.as_chunks::<2>();
            let words = words.get(channel..).unwrap_or(&[]);
            let shift = layout.format.shift();
            let grey = |&sample: &[u8; 2]| factor * f32::from(u16::from_le_bytes(sample) >> shift);
            match layout.step {
                1 => self.add(words.iter().map(grey)),
                step => self.add(words.iter().step_by(step).map(grey)),
            }
        }
    }

    #[inline(always)]
    fn add(&mut self, grey: impl Iterator<Item = f32>) {
        let both = self.sums.iter_mut().zip(grey);
        if self.is_begun {
            both.for_each(
                #[inline(always)]
                |(sum, grey)| *sum += grey,
            );
        } else {
            both.for_each(
                #[inline(always)]
                |(sum, grey)| *sum = grey,
            );
        }
        self.is_begun = true;
    }

    #[inline(always)]
    fn finished(self) -> &'a [f32] {
        if !self.is_begun {
            self.sums.fill(0.0);
        }
        self.sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{Plane, SampleFormat};

    /// A reduction to 960 pixels along the longer side.
    fn reduction(width: usize, height: usize) -> Reduction {
        Reduction::new(width, height, (width.max(height) as f64 / 960.0).max(1.0))
    }

    #[test]
    fn every_ratio_keeps_lines_straight() {
        for (width, height) in [(1920, 1080), (1280, 720), (1024, 577), (3000, 1001), (961, 5), (720, 1280)] {
            let reduction = reduction(width, height);
            let (columns, rows) = reduction.size();
            assert!(columns.max(rows) <= 960);
            let ramp: Vec<f32> = (0..width).map(|x| x as f32 * 0.125).collect();
            let mut out = vec![0.0; columns];
            reduction.columns.apply(&ramp, &mut out);
            for (x, value) in out.iter().enumerate().skip(1).take(columns.saturating_sub(2)) {
                let exact = ((x as f64 + 0.5) * reduction.scale() - 0.5) * 0.125;
                assert!((f64::from(*value) - exact).abs() < 1e-3, "{width}: {x}: {value} is not {exact}");
            }
        }
    }

    #[test]
    fn weights_of_one_output_sum_to_one() {
        for inputs in [961, 1000, 1441, 2879] {
            let filter = ReductionFilter::new(inputs, inputs as f64 / 960.0);
            for output in 0..filter.outputs() {
                let sum: f32 = filter.of(output).1.iter().sum();
                assert!((sum - 1.0).abs() < 1e-5, "{inputs} → 960, output {output}: {sum}");
            }
        }
    }

    #[test]
    fn two_to_one_is_the_mean_of_four() {
        let (width, height) = (1922, 4);
        let data: Vec<u8> = (0..width * height).map(|i| (i * 37 % 251) as u8).collect();
        let plane = Plane::new(&data, PlaneLayout::packed(width, height, SampleFormat::U8)).unwrap();
        // 1922 is not a multiple of 960: the general case.
        assert!(!reduction(width, height).columns.whole);
        let narrow = PlaneLayout { width: 1920, ..*plane.layout() };
        let plane = Plane::new(&data, narrow).unwrap();
        let reduction = reduction(1920, height);
        let (mut grey, mut scratch) = (Level::default(), Vec::new());
        for cpu in CpuLevel::supported() {
            assert!(reduction.reduce(cpu, &plane.into(), &mut grey, &mut scratch));
            for (y, x) in [(0usize, 0usize), (1, 0), (0, 959), (1, 480)] {
                let at = |dx, dy| u32::from(data[(2 * y + dy) * width + 2 * x + dx]);
                let mean = (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) as f32 / 4.0;
                assert!((grey.pixel(x as i32, y as i32) - mean).abs() < 1e-4);
            }
        }
    }
}
