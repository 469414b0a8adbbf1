//! The element's settings and their property descriptions.
//!
//! Names, types and defaults are stored in project files and presets: never change one.

use super::enums::{BorderMode, Estimator, Interpolation, Model, ReadoutDirection};
use gst::glib;
use gst::prelude::*;
use rsrectify::motion::FrameMotion;
use rsrectify::readout::ReadoutTime;
use rsrectify::{rectifier, warp};
use std::sync::LazyLock;

const DEFAULT_GRID_COLUMNS: u32 = 32;
const DEFAULT_GRID_ROWS: u32 = 24;
const DEFAULT_INTER_FRAME_DELAY: f64 = -1.0;
const DEFAULT_LOOKAHEAD: u32 = 4;
const DEFAULT_FOCAL_LENGTH: f64 = 0.0;
const DEFAULT_REFERENCE_ROW: f64 = 0.5;
const DEFAULT_BORDER_COLOR: u32 = 0xff00_0000;
const DEFAULT_CROP: f64 = 5.0;
const DEFAULT_STRENGTH: f64 = 1.0;

/// What the user has set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    grid_columns: u32,
    grid_rows: u32,
    inter_frame_delay: f64,
    readout_time: u64,
    readout_direction: ReadoutDirection,
    lookahead: u32,
    estimator: Estimator,
    model: Model,
    focal_length: f64,
    reference_row: f64,
    interpolation: Interpolation,
    border_mode: BorderMode,
    /// Colour of `border-mode=constant`, 0xAARRGGBB.
    pub border_color: u32,
    crop: f64,
    strength: f64,
    /// Worker threads; 0: as many as there are cores.
    pub threads: u32,
    /// Whether each frame's motion is posted on the bus.
    pub post_messages: bool,
    /// Whether each frame's motion is attached to its buffer.
    pub attach_meta: bool,
    /// Latency that is reported for the work on a frame, in nanoseconds.
    pub processing_deadline: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            grid_columns: DEFAULT_GRID_COLUMNS,
            grid_rows: DEFAULT_GRID_ROWS,
            inter_frame_delay: DEFAULT_INTER_FRAME_DELAY,
            readout_time: 0,
            readout_direction: ReadoutDirection::default(),
            lookahead: DEFAULT_LOOKAHEAD,
            estimator: Estimator::default(),
            model: Model::default(),
            focal_length: DEFAULT_FOCAL_LENGTH,
            reference_row: DEFAULT_REFERENCE_ROW,
            interpolation: Interpolation::default(),
            border_mode: BorderMode::default(),
            border_color: DEFAULT_BORDER_COLOR,
            crop: DEFAULT_CROP,
            strength: DEFAULT_STRENGTH,
            threads: 0,
            post_messages: false,
            attach_meta: false,
            processing_deadline: 0,
        }
    }
}

impl Settings {
    /// How the stream is analysed.
    ///
    /// What is known for certain wins: a readout time, else a delay.
    pub fn analysis(&self) -> rectifier::Settings {
        let readout_time = if self.readout_time != 0 {
            ReadoutTime::Seconds(self.readout_time as f64 * 1e-9)
        } else if self.inter_frame_delay >= 0.0 {
            ReadoutTime::DelayRows(self.inter_frame_delay)
        } else {
            ReadoutTime::Unknown
        };
        let mut settings = rectifier::Settings::default();
        settings.grid_columns = self.grid_columns as usize;
        settings.grid_rows = self.grid_rows as usize;
        settings.lookahead = self.lookahead as usize;
        settings.estimator = self.estimator.into();
        settings.model = self.model.into();
        settings.focal_length = (self.focal_length > 0.0).then_some(self.focal_length);
        settings.direction = self.readout_direction.into();
        settings.readout_time = readout_time;
        settings
    }

    /// How a frame is rectified.
    pub fn warp(&self) -> warp::WarpSettings {
        let zoom = match self.border_mode {
            BorderMode::Crop => 1.0 / (1.0 - self.crop / 100.0),
            _ => 1.0,
        };
        let mut settings = warp::WarpSettings::default();
        settings.interpolation = self.interpolation.into();
        settings.border = self.border_mode.into();
        settings.reference_row = self.reference_row;
        settings.strength = self.strength;
        settings.zoom = zoom;
        settings
    }

    /// Whether a frame with this motion comes out as it went in.
    pub fn leaves_untouched(&self, motion: &FrameMotion) -> bool {
        (motion.is_still() || self.strength == 0.0) && self.warp().zoom == 1.0
    }

    /// The value of a property; `None` for a name that is not a setting.
    pub fn get(&self, name: &str) -> Option<glib::Value> {
        Some(match name {
            "grid-columns" => self.grid_columns.to_value(),
            "grid-rows" => self.grid_rows.to_value(),
            "inter-frame-delay" => self.inter_frame_delay.to_value(),
            "readout-time" => self.readout_time.to_value(),
            "readout-direction" => self.readout_direction.to_value(),
            "lookahead" => self.lookahead.to_value(),
            "estimator" => self.estimator.to_value(),
            "model" => self.model.to_value(),
            "focal-length" => self.focal_length.to_value(),
            "reference-row" => self.reference_row.to_value(),
            "interpolation" => self.interpolation.to_value(),
            "border-mode" => self.border_mode.to_value(),
            "border-color" => self.border_color.to_value(),
            "crop" => self.crop.to_value(),
            "strength" => self.strength.to_value(),
            "threads" => self.threads.to_value(),
            "post-messages" => self.post_messages.to_value(),
            "attach-meta" => self.attach_meta.to_value(),
            "processing-deadline" => self.processing_deadline.to_value(),
            _ => return None,
        })
    }

    /// Sets a property; its type and range have been checked against its description.
    pub fn set(&mut self, name: &str, value: &glib::Value) {
        match name {
            "grid-columns" => assign(&mut self.grid_columns, value),
            "grid-rows" => assign(&mut self.grid_rows, value),
            "inter-frame-delay" => assign(&mut self.inter_frame_delay, value),
            "readout-time" => assign(&mut self.readout_time, value),
            "readout-direction" => assign(&mut self.readout_direction, value),
            "lookahead" => assign(&mut self.lookahead, value),
            "estimator" => assign(&mut self.estimator, value),
            "model" => assign(&mut self.model, value),
            "focal-length" => assign(&mut self.focal_length, value),
            "reference-row" => assign(&mut self.reference_row, value),
            "interpolation" => assign(&mut self.interpolation, value),
            "border-mode" => assign(&mut self.border_mode, value),
            "border-color" => assign(&mut self.border_color, value),
            "crop" => assign(&mut self.crop, value),
            "strength" => assign(&mut self.strength, value),
            "threads" => assign(&mut self.threads, value),
            "post-messages" => assign(&mut self.post_messages, value),
            "attach-meta" => assign(&mut self.attach_meta, value),
            "processing-deadline" => assign(&mut self.processing_deadline, value),
            _ => (),
        }
    }
}

fn assign<'a, T: glib::value::FromValue<'a>>(setting: &mut T, value: &'a glib::Value) {
    if let Ok(value) = value.get() {
        *setting = value;
    }
}

/// The description of every property.
pub fn specs() -> &'static [glib::ParamSpec] {
    static SPECS: LazyLock<Vec<glib::ParamSpec>> =
        LazyLock::new(|| [analysis_specs(), warp_specs(), running_specs()].concat());
    &SPECS
}

fn analysis_specs() -> Vec<glib::ParamSpec> {
    vec![
        glib::ParamSpecUInt::builder("grid-columns")
            .nick("Grid columns")
            .blurb("Columns of the grid of points that are followed from frame to frame")
            .minimum(2)
            .maximum(256)
            .default_value(DEFAULT_GRID_COLUMNS)
            .mutable_ready()
            .build(),
        glib::ParamSpecUInt::builder("grid-rows")
            .nick("Grid rows")
            .blurb("Rows of the grid of points that are followed from frame to frame")
            .minimum(2)
            .maximum(256)
            .default_value(DEFAULT_GRID_ROWS)
            .mutable_ready()
            .build(),
        glib::ParamSpecDouble::builder("inter-frame-delay")
            .nick("Inter-frame delay")
            .blurb("Blank time between a frame's last row and the next frame's first, in rows (columns where the sensor is read sideways); -1: not known, see readout-time")
            .minimum(-1.0)
            .maximum(1e9)
            .default_value(DEFAULT_INTER_FRAME_DELAY)
            .mutable_playing()
            .build(),
        glib::ParamSpecUInt64::builder("readout-time")
            .nick("Readout time")
            .blurb("Time that the readout of all rows takes, in nanoseconds; wins over inter-frame-delay; 0: found from the picture (sequential: taken as the frame duration); 1: a global shutter")
            .maximum(gst::ClockTime::SECOND.nseconds())
            .mutable_playing()
            .build(),
        glib::ParamSpecEnum::builder_with_default("readout-direction", ReadoutDirection::default())
            .nick("Readout direction")
            .blurb("Which edge of the frame, as it arrives here, the sensor reads first; auto: found from the picture (sequential: top-to-bottom)")
            .mutable_playing()
            .build(),
        glib::ParamSpecUInt::builder("lookahead")
            .nick("Lookahead")
            .blurb("Frames waited for before a frame is given out: the element's latency, in frames; 8 for strong shake, 0 for none at a loss of accuracy")
            .maximum(64)
            .default_value(DEFAULT_LOOKAHEAD)
            .mutable_ready()
            .build(),
        glib::ParamSpecEnum::builder_with_default("estimator", Estimator::default())
            .nick("Estimator")
            .blurb("How the motion of the frames is estimated: continuous finds the readout too; sequential gives each frame one rotation and must be told the readout")
            .mutable_playing()
            .build(),
        glib::ParamSpecEnum::builder_with_default("model", Model::default())
            .nick("Model")
            .blurb("What motion the picture can have; the sequential estimator always takes rotation, of which translation is a case")
            .mutable_playing()
            .build(),
        glib::ParamSpecDouble::builder("focal-length")
            .nick("Focal length")
            .blurb("Focal length in frame widths, for models with perspective of the continuous estimator; 0: found from the picture")
            .minimum(0.0)
            .maximum(1e3)
            .default_value(DEFAULT_FOCAL_LENGTH)
            .mutable_playing()
            .build(),
    ]
}

fn warp_specs() -> Vec<glib::ParamSpec> {
    vec![
        glib::ParamSpecDouble::builder("reference-row")
            .nick("Reference row")
            .blurb(
                "The instant that the output shows, as a share of the readout: 0 is the row read first, 1 the \
                 last",
            )
            .minimum(0.0)
            .maximum(1.0)
            .default_value(DEFAULT_REFERENCE_ROW)
            .mutable_playing()
            .controllable()
            .build(),
        glib::ParamSpecEnum::builder_with_default("interpolation", Interpolation::default())
            .nick("Interpolation")
            .blurb("How samples between pixels are made")
            .mutable_playing()
            .build(),
        glib::ParamSpecEnum::builder_with_default("border-mode", BorderMode::default())
            .nick("Border mode")
            .blurb("What is shown where the frame saw nothing")
            .mutable_playing()
            .build(),
        glib::ParamSpecUInt::builder("border-color")
            .nick("Border colour")
            .blurb("Colour of border-mode=constant, as 0xAARRGGBB")
            .default_value(DEFAULT_BORDER_COLOR)
            .mutable_playing()
            .controllable()
            .build(),
        glib::ParamSpecDouble::builder("crop")
            .nick("Crop")
            .blurb("Share of the width and height that border-mode=crop cuts away, in per cent")
            .minimum(0.0)
            .maximum(50.0)
            .default_value(DEFAULT_CROP)
            .mutable_playing()
            .controllable()
            .build(),
        glib::ParamSpecDouble::builder("strength")
            .nick("Strength")
            .blurb("How much of the correction is applied: 0 none (the latency stays), 1 all")
            .minimum(0.0)
            .maximum(1.0)
            .default_value(DEFAULT_STRENGTH)
            .mutable_playing()
            .controllable()
            .build(),
    ]
}

fn running_specs() -> Vec<glib::ParamSpec> {
    vec![
        glib::ParamSpecUInt::builder("threads")
            .nick("Threads")
            .blurb("Worker threads; 0: one for each core, shared with all elements of this kind")
            .maximum(256)
            .mutable_playing()
            .build(),
        glib::ParamSpecBoolean::builder("post-messages")
            .nick("Post messages")
            .blurb("Post an element message \"rsrectify\" with the motion and confidence of each frame")
            .mutable_playing()
            .build(),
        glib::ParamSpecBoolean::builder("attach-meta")
            .nick("Attach meta")
            .blurb("Attach a custom meta \"RsRectifyMeta\" with its motion, readout and confidence to each frame")
            .mutable_playing()
            .build(),
        glib::ParamSpecUInt64::builder("processing-deadline")
            .nick("Processing deadline")
            .blurb("Time in nanoseconds that the work on a frame may take in a live pipeline: latency beside that of lookahead; grows by itself where frames come late because of the work")
            .maximum(gst::ClockTime::SECOND.nseconds())
            .mutable_ready()
            .build(),
        glib::ParamSpecBoxed::builder::<gst::Structure>("stats")
            .nick("Statistics")
            .blurb("Frames so far, what was found in the last one (readout-time with its readout-deviation, readout-direction, confidence ...), and mean milliseconds per stage")
            .read_only()
            .build(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rsrectify::Rectifier;
    use rsrectify::motion::MotionPath;
    use rsrectify::readout::Readout;

    #[test]
    fn a_known_readout_time_wins_over_a_delay() {
        let mut settings = Settings::default();
        assert_eq!(settings.analysis().readout_time, ReadoutTime::Unknown);
        settings.inter_frame_delay = 40.0;
        assert_eq!(settings.analysis().readout_time, ReadoutTime::DelayRows(40.0));
        settings.readout_time = 33_000_000;
        assert_eq!(settings.analysis().readout_time, ReadoutTime::Seconds(0.033));
    }

    #[test]
    fn whatever_is_set_can_be_analysed() {
        // The ranges of the properties; a double property takes a NaN whatever its range.
        for inter_frame_delay in [-1.0, -0.5, 0.0, 1e9, f64::NAN] {
            for focal_length in [0.0, f64::MIN_POSITIVE, 1e3, f64::NAN] {
                for readout_time in [0, 1, gst::ClockTime::SECOND.nseconds()] {
                    for (grid_columns, grid_rows, lookahead) in [(2, 256, 0), (256, 2, 64)] {
                        let settings = Settings {
                            inter_frame_delay,
                            focal_length,
                            readout_time,
                            grid_columns,
                            grid_rows,
                            lookahead,
                            ..Settings::default()
                        };
                        let rectifier = Rectifier::new(settings.analysis(), 64, 48, Some(0.04));
                        assert!(rectifier.is_ok(), "{settings:?}: {rectifier:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn crop_enlarges_in_its_own_mode_only() {
        let mut settings = Settings { crop: 20.0, ..Settings::default() };
        assert_eq!(settings.warp().zoom, 1.0);
        let still = FrameMotion::new(Readout::global_shutter(8, 4), MotionPath::STILL);
        assert!(settings.leaves_untouched(&still));
        settings.border_mode = BorderMode::Crop;
        assert_eq!(settings.warp().zoom, 1.25);
        assert!(!settings.leaves_untouched(&still));
    }

    #[test]
    fn every_setting_can_be_read_and_written() {
        let mut settings = Settings::default();
        for spec in specs().iter().filter(|spec| spec.name() != "stats") {
            let default = settings.get(spec.name()).expect("a setting");
            assert_eq!(format!("{default:?}"), format!("{:?}", spec.default_value()), "{}", spec.name());
            settings.set(spec.name(), &default);
        }
        assert_eq!(settings, Settings::default());
    }
}
