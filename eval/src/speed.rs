// SPDX-License-Identifier: MIT OR Apache-2.0

//! How long the library takes for a frame, from luma to the three rectified planes.

use anyhow::{Context, Result, bail};
use rsrectify::rectifier::{Effort, FrameSolution};
use rsrectify::{Duplicate, FrameLayout, Rectifier, SampleFormat, Settings, WarpSettings, Warper};
use std::collections::VecDeque;
use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

/// Time of one frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Reduction of the luma, correspondences and solution.
    pub analysis: Duration,
    /// Rectification of the planes.
    pub warp: Duration,
}

impl Cost {
    fn whole(&self) -> Duration {
        self.analysis + self.warp
    }
}

/// The three planes of a frame.
type Planes = [Vec<u8>; 3];

/// Rectifies an 8-bit 4:2:0 YUV4MPEG2 file in memory and tells what each frame cost; reading is left
/// out.
pub fn of_file(path: &Path, lookahead: usize, effort: Effort) -> Result<Vec<Cost>> {
    let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut decoder = y4m::decode(std::io::BufReader::new(file))?;
    let (width, height) = (decoder.get_width(), decoder.get_height());
    let format = decoder.get_colorspace();
    if decoder.get_bytes_per_sample() != 1 || !format!("{format:?}").starts_with("C420") {
        bail!("the file is {format:?}; 8-bit 4:2:0 is needed");
    }
    let period = decoder.get_framerate().den as f64 / decoder.get_framerate().num as f64;
    let mut job = Job::new(width, height, period, lookahead, effort)?;
    let mut costs = Vec::new();
    loop {
        match decoder.read_frame() {
            Ok(frame) => {
                let planes = [frame.get_y_plane(), frame.get_u_plane(), frame.get_v_plane()];
                costs.push(job.frame(planes.map(<[u8]>::to_vec))?);
            }
            Err(y4m::Error::EOF) => return Ok(costs),
            Err(error) => return Err(error.into()),
        }
    }
}

/// A stream that is being rectified.
struct Job {
    layout: FrameLayout,
    period: f64,
    rectifier: Rectifier,
    warper: Warper,
    waiting: VecDeque<Planes>,
    output: Planes,
    pushed: usize,
}

impl Job {
    fn new(width: usize, height: usize, period: f64, lookahead: usize, effort: Effort) -> Result<Self> {
        let (luma, chroma) = (width * height, width.div_ceil(2) * height.div_ceil(2));
        let mut settings = Settings::default();
        (settings.lookahead, settings.effort) = (lookahead, effort);
        Ok(Self {
            layout: FrameLayout::yuv420(width, height, SampleFormat::U8),
            period,
            rectifier: Rectifier::new(settings, width, height, Some(period))?,
            warper: Warper::new(),
            waiting: VecDeque::new(),
            output: [luma, chroma, chroma].map(|bytes| vec![0; bytes]),
            pushed: 0,
        })
    }

    fn frame(&mut self, planes: Planes) -> Result<Cost> {
        let started = Instant::now();
        self.rectifier.push(
            &self.layout.luma(&planes)?,
            Some(self.pushed as f64 * self.period),
            Duplicate::Detect,
        )?;
        self.pushed += 1;
        let analysed = Instant::now();
        self.waiting.push_back(planes);
        if let Some(solution) = self.rectifier.pop() {
            self.warp(&solution)?;
        }
        Ok(Cost { analysis: analysed - started, warp: analysed.elapsed() })
    }

    fn warp(&mut self, solution: &FrameSolution) -> Result<()> {
        let planes = self.waiting.pop_front().context("a motion without its frame")?;
        let frame = self.warper.prepare(&solution.motion, &WarpSettings::default());
        Ok(frame.warp_frame(&self.layout, &planes, &mut self.output)?)
    }
}

/// Milliseconds of the median frame, of its analysis, of its warp and of the slowest frame; the mean of all frames; the
/// 95th percentile. A line of headings, then one of figures.
///
/// Medians and percentile leave out the first frames, which have nothing to be compared with or wait for the lookahead.
pub fn table(costs: &[Cost], lookahead: usize) -> String {
    let steady = || costs.iter().skip(lookahead + 2);
    let mean = costs.iter().map(|cost| milliseconds(cost.whole())).sum::<f64>() / costs.len() as f64;
    let figures = [
        median_ms(steady().map(Cost::whole)),
        median_ms(steady().map(|cost| cost.analysis)),
        median_ms(steady().map(|cost| cost.warp)),
        quantile_ms(costs.iter().map(Cost::whole), 1.0),
        mean,
        quantile_ms(steady().map(Cost::whole), 0.95),
    ];
    let line = |cells: [String; 6]| cells.map(|cell| format!("{cell:>8}")).join(" ");
    let headings = ["median", "analysis", "warp", "slowest", "mean", "p95"].map(String::from);
    format!("{}\n{}\n", line(headings), line(figures.map(|figure| format!("{figure:.2}"))))
}

/// Number and milliseconds of each frame, a line each.
pub fn frames(costs: &[Cost]) -> String {
    let line = |(number, cost): (usize, &Cost)| format!("{number:>8} {:>8.2}\n", milliseconds(cost.whole()));
    costs.iter().enumerate().map(line).collect()
}

/// The median, in milliseconds.
pub fn median_ms(times: impl Iterator<Item = Duration>) -> f64 {
    quantile_ms(times, 0.5)
}

/// The time that this share of the times are below, in milliseconds.
fn quantile_ms(times: impl Iterator<Item = Duration>, share: f64) -> f64 {
    let mut times: Vec<f64> = times.map(milliseconds).collect();
    times.sort_by(f64::total_cmp);
    let index = ((times.len() as f64 * share) as usize).min(times.len().saturating_sub(1));
    times.get(index).copied().unwrap_or(f64::NAN)
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
