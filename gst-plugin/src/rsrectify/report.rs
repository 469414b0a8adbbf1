//! What the element tells others: latency, position, quality of service, statistics, messages.

use super::enums::ReadoutDirection;
use gst::prelude::*;
use rsrectify::motion::image_centre;
use rsrectify::rectifier::{FrameSolution, Origin, Timings};
use std::time::Duration;

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

/// What the sink has said of its lateness.
#[derive(Clone, Copy, Debug)]
struct Quality {
    earliest: gst::ClockTime,
    proportion: f64,
}

/// What other threads may ask for while a frame is worked on. Only ever locked for an instant.
#[derive(Debug, Default)]
pub struct Report {
    /// The latency that was announced last.
    pub latency: gst::ClockTime,
    /// Stream time of the frame given out last.
    pub position: Option<gst::ClockTime>,
    /// The nominal frame duration; 0 where the rate varies.
    pub period: gst::ClockTime,
    /// Whether the source is live, as upstream last said when asked for its latency.
    live: bool,
    quality: Option<Quality>,
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
}

impl Report {
    /// Notes a QoS event.
    ///
    /// A sink that is late by some time will be so for the next frames too: twice its lateness is
    /// skipped, so that it can catch up.
    pub fn note_quality(&mut self, event: &gst::event::Qos) {
        let (_, proportion, diff, timestamp) = event.get();
        self.quality = timestamp.map(|timestamp| {
            let lateness = gst::ClockTime::from_nseconds(diff.unsigned_abs());
            let earliest = if diff > 0 {
                timestamp.saturating_add(lateness.saturating_mul(2)).saturating_add(self.period)
            } else {
                timestamp.saturating_sub(lateness)
            };
            Quality { earliest, proportion }
        });
    }

    /// Forgets position and lateness: another segment begins.
    pub fn start_segment(&mut self) {
        self.quality = None;
        self.position = None;
    }

    /// The QoS message of a frame that would come too late if it were rectified.
    pub fn late_message(&mut self, source: &impl IsA<gst::Object>, time: &FrameTime) -> Option<gst::Message> {
        let quality = self.quality?;
        let running = time.running.filter(|&running| running <= quality.earliest)?;
        self.stats.late += 1;
        let jitter = quality.earliest.nseconds().saturating_sub(running.nseconds());
        let message = gst::message::Qos::builder(self.live)
            .src(source)
            .running_time(running)
            .stream_time(time.stream)
            .timestamp(time.pts)
            .duration(time.duration)
            .values(i64::try_from(jitter).unwrap_or(i64::MAX), quality.proportion, 1_000_000)
            .stats::<gst::format::Buffers>(
                gst::format::Buffers::from_u64(self.stats.rectified),
                gst::format::Buffers::from_u64(self.stats.late),
            );
        Some(message.build())
    }

    /// Notes whether the source is live; the element's own latency.
    pub fn note_source(&mut self, live: bool) -> gst::ClockTime {
        self.live = live;
        self.latency
    }

    /// Counts a frame that came in and the time that its analysis took.
    pub fn count_input(&mut self, time: Timings) {
        self.stats.analysed += 1;
        self.count_analysis(time);
    }

    /// Counts time that analysis takes when no frame comes in: at the end of a stretch.
    pub fn count_analysis(&mut self, time: Timings) {
        self.stats.analysis.correspond += time.correspond;
        self.stats.analysis.solve += time.solve;
    }

    /// Counts the time that rectifying a frame took.
    pub fn count_warp(&mut self, time: Duration) {
        self.stats.rectified += 1;
        self.stats.warp += time;
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
        let Stats { analysed, frames, rectified, late, last, analysis, warp } = &self.stats;
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
    let readout = &solution.readout;
    structure.set("correspondences", u32::try_from(solution.correspondences).unwrap_or(u32::MAX));
    structure.set("inliers", u32::try_from(solution.inliers).unwrap_or(u32::MAX));
    structure.set("residual", solution.residual);
    structure.set("confidence", solution.confidence);
    structure.set("readout-time", (readout.time * 1e9).round() as u64);
    structure.set("readout-deviation", solution.readout_deviation);
    structure.set("readout-direction", ReadoutDirection::from(readout.direction));
}

/// The structure of the element message about one frame.
pub fn frame_message(time: &FrameTime, solution: &FrameSolution) -> gst::Structure {
    let twist = solution.path.mean_twist();
    let mut message = gst::Structure::builder("rsrectify")
        .field("timestamp", time.pts)
        .field("duration", time.duration)
        .field("stream-time", time.stream)
        .field("running-time", time.running)
        .field("omega", twist.omega)
        .field("vx", twist.velocity.x)
        .field("vy", twist.velocity.y)
        .field("origin", origin_name(solution.origin))
        .build();
    if let Some(centre) = twist.centre() {
        let centre = centre + image_centre(solution.readout.width, solution.readout.height);
        message.set("centre-x", centre.x);
        message.set("centre-y", centre.y);
    }
    add_solution(&mut message, solution);
    message
}

fn origin_name(origin: Origin) -> &'static str {
    match origin {
        Origin::Initial => "initial",
        Origin::Forward => "forward",
        Origin::Backward => "backward",
        Origin::Continuous => "continuous",
        Origin::Repeated => "repeated",
        Origin::Untouched => "untouched",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::motion::{MotionPath, Twist};
    use rsrectify::readout;

    fn solution(twist: Twist) -> FrameSolution {
        let direction = readout::ReadoutDirection::TopToBottom;
        FrameSolution {
            readout: readout::Readout::new(101, 51, direction, readout::ReadoutTime::Seconds(0.02), 0.04),
            path: MotionPath::uniform(twist, 0.02),
            confidence: 0.75,
            weight: 1.0,
            origin: Origin::Forward,
            correspondences: 700,
            inliers: 650,
            residual: 0.25,
            readout_deviation: 0.0,
        }
    }

    #[test]
    fn a_message_names_the_centre_in_pixels() {
        gst::init().unwrap();
        let time = FrameTime { pts: Some(gst::ClockTime::SECOND), ..FrameTime::default() };
        // ω = 2 about the point 10 px right of and 5 px above the image centre (50, 25).
        let twist = Twist::new(2.0, -10.0, -20.0);
        let message = frame_message(&time, &solution(twist));
        assert_eq!(message.get::<f64>("centre-x").unwrap(), 60.0);
        assert_eq!(message.get::<f64>("centre-y").unwrap(), 20.0);
        assert_eq!(message.get::<u64>("readout-time").unwrap(), 20_000_000);
        assert_eq!(message.get::<&str>("origin").unwrap(), "forward");
        assert_eq!(message.get::<gst::ClockTime>("timestamp").unwrap(), gst::ClockTime::SECOND);
        assert!(!frame_message(&time, &solution(Twist::new(0.0, 3.0, 0.0))).has_field("centre-x"));
    }

    #[test]
    fn frames_before_the_earliest_useful_time_are_late() {
        gst::init().unwrap();
        let ms = gst::ClockTime::from_mseconds;
        let mut report = Report { period: ms(40), ..Report::default() };
        let bin = gst::Bin::new();
        let event = gst::event::Qos::new(gst::QOSType::Underflow, 1.5, 20_000_000, ms(100));
        let gst::EventView::Qos(event) = event.view() else { unreachable!() };
        report.note_quality(event);
        let mut late = |running| {
            let time = FrameTime { running: Some(ms(running)), ..FrameTime::default() };
            report.late_message(&bin, &time).is_some()
        };
        assert!(late(180), "100 + 2 · 20 + 40 ms are past help");
        assert!(!late(181));
        assert_eq!(report.stats().get::<u64>("late").unwrap(), 1);
        report.start_segment();
        let time = FrameTime { running: Some(ms(0)), ..FrameTime::default() };
        assert!(report.late_message(&bin, &time).is_none());
    }
}
