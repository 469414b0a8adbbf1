// SPDX-License-Identifier: MIT OR Apache-2.0

//! What the element tells others: latency, position, quality of service, statistics, messages.

use super::enums::ReadoutDirection;
use super::latency::Latency;
use super::load::{Finding, Load};
use gst::glib;
use gst::prelude::*;
use rsrectify::rectifier::{FrameSolution, Timings};
use std::sync::Once;
use std::time::Duration;

/// A number of nanoseconds as a time; the largest number stands for no time in GStreamer.
pub fn clock_time(nanoseconds: u64) -> gst::ClockTime {
    gst::ClockTime::from_nseconds(nanoseconds.min(u64::MAX - 1))
}

/// The times of a frame in its segment, none of which need exist.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameTime {
    /// The buffer's timestamp.
    pub pts: Option<gst::ClockTime>,
    /// The buffer's duration.
    pub duration: Option<gst::ClockTime>,
    /// Time in the medium.
    pub stream: Option<gst::ClockTime>,
    /// Time since the pipeline runs.
    pub running: Option<gst::ClockTime>,
}

impl FrameTime {
    /// The times of `buffer` in `segment`.
    pub fn new(segment: &gst::Segment, buffer: &gst::BufferRef) -> Self {
        let (pts, duration) = (buffer.pts(), buffer.duration());
        match segment.downcast_ref::<gst::ClockTime>() {
            Some(segment) => Self {
                pts,
                duration,
                stream: segment.to_stream_time(pts),
                running: segment.to_running_time(pts),
            },
            None => Self { pts, duration, ..Self::default() },
        }
    }
}

/// What other threads may ask for while a frame is worked on. Only ever locked for an instant.
#[derive(Debug)]
pub struct Report {
    /// The latency that is reported, and how long frames may be held.
    pub latency: Latency,
    /// Whether there is time for the work.
    pub load: Load,
    /// Stream time of the frame given out last.
    pub position: Option<gst::ClockTime>,
    stats: Stats,
}

#[derive(Debug, Default)]
struct Stats {
    analysed: u64,
    frames: u64,
    rectified: u64,
    late: u64,
    last: Option<FrameSolution>,
    analysis: Timings,
    warp: Duration,
    /// Time that rectifying the last frame took.
    newest_warp: Duration,
}

impl Report {
    /// The report of a stream whose caps are not known yet.
    pub fn new(latency: Latency) -> Self {
        Self { latency, load: Load::default(), position: None, stats: Stats::default() }
    }

    /// Sets the latency of a stream with new caps.
    pub fn set_latency(&mut self, latency: Latency) {
        self.load.set_interval(latency.interval());
        self.latency = latency;
    }

    /// Takes in a QoS event; whether more latency must be reported.
    pub fn note_quality(&mut self, event: &gst::event::Qos) -> bool {
        let (kind, _, lateness, running) = event.get();
        // A sink that throttles wants fewer frames, it is not late.
        let Some(running) = running.filter(|_| kind != gst::QOSType::Throttle) else { return false };
        match self.load.note(running.nseconds(), lateness) {
            Finding::Behind(time) if self.latency.is_live() => self.latency.add_work(time),
            _ => false,
        }
    }

    /// Forgets position and lateness: another segment begins.
    pub fn start_segment(&mut self) {
        self.load.interrupt();
        self.latency.interrupt();
        self.position = None;
    }

    /// The QoS message of a frame that is not rectified for want of time; counts it.
    pub fn overload_message(&mut self, source: &impl IsA<gst::Object>, time: &FrameTime) -> gst::Message {
        self.stats.late += 1;
        let interval = self.latency.interval().max(1) as f64;
        gst::message::Qos::builder(self.latency.is_live())
            .src(source)
            .running_time(time.running)
            .stream_time(time.stream)
            .timestamp(time.pts)
            .duration(time.duration)
            .values(self.load.lateness(), self.load.work() as f64 / interval, 0)
            .stats::<gst::format::Buffers>(
                gst::format::Buffers::from_u64(self.stats.rectified),
                gst::format::Buffers::from_u64(self.stats.late),
            )
            .build()
    }

    /// Counts a frame that was analysed and the time that it took.
    pub fn count_analysed(&mut self, time: Timings) {
        self.stats.analysed += 1;
        self.count_analysis(time);
        let work = time.correspond + time.solve + self.stats.newest_warp;
        self.load.count_work(u64::try_from(work.as_nanos()).unwrap_or(u64::MAX));
    }

    /// Counts time that analysis takes when no frame is analysed: at the end of a stretch.
    pub fn count_analysis(&mut self, time: Timings) {
        self.stats.analysis.correspond += time.correspond;
        self.stats.analysis.solve += time.solve;
    }

    /// Counts the time that rectifying a frame took.
    pub fn count_warp(&mut self, time: Duration) {
        self.stats.rectified += 1;
        self.stats.warp += time;
        self.stats.newest_warp = time;
    }

    /// Counts a frame given out.
    pub fn count_frame(&mut self, time: &FrameTime, solution: Option<&FrameSolution>) {
        self.stats.frames += 1;
        self.stats.last = solution.cloned().or(self.stats.last.take());
        self.position = time.stream.or(self.position);
    }

    /// The `stats` property; times are means: of analysis a frame that came in, of the warp a
    /// rectified one.
    pub fn stats(&self) -> gst::Structure {
        let Stats { analysed, frames, rectified, late, last, analysis, warp, .. } = &self.stats;
        let mean_ms = |time: &Duration, count: u64| time.as_secs_f64() * 1e3 / count.max(1) as f64;
        let mut stats = gst::Structure::builder("rsrectify-stats")
            .field("frames", *frames)
            .field("rectified", *rectified)
            .field("late", *late)
            .field("correspond-ms", mean_ms(&analysis.correspond, *analysed))
            .field("solve-ms", mean_ms(&analysis.solve, *analysed))
            .field("warp-ms", mean_ms(warp, *rectified))
            .build();
        if let Some(solution) = last {
            add_solution(&mut stats, solution);
        }
        stats
    }
}

/// Fields common to `stats` and the element message.
fn add_solution(structure: &mut gst::StructureRef, solution: &FrameSolution) {
    let readout = solution.motion.readout();
    structure.set("correspondences", u32::try_from(solution.correspondences).unwrap_or(u32::MAX));
    structure.set("inliers", u32::try_from(solution.inliers).unwrap_or(u32::MAX));
    structure.set("residual", solution.residual);
    structure.set("confidence", solution.confidence);
    if let Some(error) = solution.expected_error {
        structure.set("expected-error", error);
    }
    structure.set("readout-time", (readout.time() * 1e9).round() as u64);
    structure.set("readout-deviation", solution.readout_deviation);
    structure.set("readout-direction", ReadoutDirection::from(readout.direction()));
    structure.set("stabilised", solution.timing.stabilised_name());
    structure.set("timeline", solution.timing.timeline.to_string());
}

/// Name of the custom meta that holds a frame's motion.
pub const META: &str = "RsRectifyMeta";

/// Registers the custom meta. It has no tags: what it says stays true when the picture is converted, scaled or
/// turned later, for it tells of the frame as it came.
pub fn register_meta() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| gst::meta::CustomMeta::register(META, &[]));
}

/// Attaches a frame's motion, of which a share was `applied`, to its buffer.
pub fn attach_meta(
    buffer: &mut gst::BufferRef,
    solution: &FrameSolution,
    applied: f64,
) -> Result<(), glib::BoolError> {
    let mut meta = gst::meta::CustomMeta::add(buffer, META)?;
    add_motion(meta.mut_structure(), solution, applied);
    Ok(())
}

/// The structure of the element message about one frame, of whose motion a share was `applied`.
pub fn frame_message(time: &FrameTime, solution: &FrameSolution, applied: f64) -> gst::Structure {
    let mut message = gst::Structure::builder("rsrectify")
        .field("timestamp", time.pts)
        .field("duration", time.duration)
        .field("stream-time", time.stream)
        .field("running-time", time.running)
        .build();
    add_motion(&mut message, solution, applied);
    message
}

/// Fields common to the element message and the custom meta.
fn add_motion(structure: &mut gst::StructureRef, solution: &FrameSolution, applied: f64) {
    let twist = solution.motion.path().mean_twist();
    structure.set("origin", solution.origin.name());
    structure.set("applied", applied);
    if let Some(reason) = solution.as_recorded {
        structure.set("as-recorded", reason.to_string());
    }
    if !solution.region_errors.is_empty() {
        structure.set("region-errors", gst::Array::new(&solution.region_errors));
    }
    structure.set("omega", twist.omega);
    structure.set("vx", twist.velocity.x);
    structure.set("vy", twist.velocity.y);
    if let Some(centre) = twist.centre() {
        let centre = centre + solution.motion.centre();
        structure.set("centre-x", centre.x);
        structure.set("centre-y", centre.y);
    }
    add_solution(structure, solution);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::motion::{FrameMotion, MotionPath, Twist};
    use rsrectify::plane::{Plane, PlaneLayout, SampleFormat};
    use rsrectify::readout;
    use rsrectify::rectifier::{Duplicate, Origin, Rectifier};

    fn solution(twist: Twist) -> FrameSolution {
        let direction = readout::ReadoutDirection::TopToBottom;
        let time = readout::ReadoutTime::Seconds(0.02);
        let readout = readout::Readout::new(101, 51, direction, time, 0.04).unwrap();
        let mut rectifier = Rectifier::new(Default::default(), 101, 51, None).unwrap();
        let layout = PlaneLayout::packed(101, 51, SampleFormat::U8);
        rectifier.push(&Plane::new(&[0; 101 * 51], layout).unwrap().into(), None, Duplicate::Detect).unwrap();
        let mut solution = rectifier.pop_early().unwrap();
        solution.motion = FrameMotion::new(readout, MotionPath::uniform(twist, 0.02));
        solution.confidence = 0.75;
        solution.origin = Origin::Forward;
        (solution.correspondences, solution.inliers, solution.residual) = (700, 650, 0.25);
        solution
    }

    #[test]
    fn a_message_names_the_centre_in_pixels() {
        gst::init().unwrap();
        let time = FrameTime { pts: Some(gst::ClockTime::SECOND), ..FrameTime::default() };
        // ω = 2 about the point 10 px right of and 5 px above the image centre (50, 25).
        let twist = Twist::new(2.0, -10.0, -20.0);
        let message = frame_message(&time, &solution(twist), 1.0);
        assert_eq!(message.get::<f64>("centre-x").unwrap(), 60.0);
        assert_eq!(message.get::<f64>("centre-y").unwrap(), 20.0);
        assert_eq!(message.get::<u64>("readout-time").unwrap(), 20_000_000);
        assert_eq!(message.get::<&str>("origin").unwrap(), "forward");
        assert_eq!(message.get::<gst::ClockTime>("timestamp").unwrap(), gst::ClockTime::SECOND);
        assert!(!frame_message(&time, &solution(Twist::new(0.0, 3.0, 0.0)), 1.0).has_field("centre-x"));
    }
}
