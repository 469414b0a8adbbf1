//! The element's settings, and what they mean to the library. Names, types and ranges of their properties are in `imp`.
//!
//! Defaults are stored in project files and presets: never change one.

use super::enums::{BorderMode, Estimator, Interpolation, Model, ReadoutDirection};
use gst::glib;
use gst::prelude::*;
use rsrectify::motion::FrameMotion;
use rsrectify::readout::{ReadoutPrior, ReadoutTime};
use rsrectify::{rectifier, warp};

/// Standard deviation of an expected readout time for which none is given, as a share of it: that of values which one person
/// measured, see `readouts/README.md`.
const USUAL_DEVIATION: f64 = 0.1;

/// What the user has set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    pub grid_columns: u32,
    pub grid_rows: u32,
    pub inter_frame_delay: f64,
    pub readout_time: u64,
    pub readout_direction: ReadoutDirection,
    pub lookahead: u32,
    pub estimator: Estimator,
    pub model: Model,
    pub focal_length: f64,
    pub reference_row: f64,
    pub interpolation: Interpolation,
    pub border_mode: BorderMode,
    pub border_color: u32,
    pub crop: f64,
    pub strength: f64,
    pub threads: u32,
    pub post_messages: bool,
    pub attach_meta: bool,
    pub processing_deadline: u64,
    pub expected_readout_time: u64,
    pub expected_readout_deviation: u64,
    pub expected_readout_direction: ReadoutDirection,
}

impl Default for Settings {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Settings {
    /// What holds until the user sets something else.
    pub const DEFAULT: Self = Self {
        grid_columns: 32,
        grid_rows: 24,
        inter_frame_delay: -1.0,
        readout_time: 0,
        readout_direction: ReadoutDirection::Auto,
        lookahead: 4,
        estimator: Estimator::Auto,
        model: Model::Auto,
        focal_length: 0.0,
        reference_row: 0.5,
        interpolation: Interpolation::Cubic,
        border_mode: BorderMode::Replicate,
        border_color: 0xff00_0000,
        crop: 5.0,
        strength: 1.0,
        threads: 0,
        post_messages: false,
        attach_meta: false,
        processing_deadline: 0,
        expected_readout_time: 0,
        expected_readout_deviation: 0,
        expected_readout_direction: ReadoutDirection::Auto,
    };

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
        settings.readout_prior = self.readout_prior();
        settings
    }

    /// What is expected of the readout; `None` where nothing is.
    fn readout_prior(&self) -> Option<ReadoutPrior> {
        let time = self.expected_readout_time as f64 * 1e-9;
        let deviation = match self.expected_readout_deviation {
            0 => USUAL_DEVIATION * time,
            nanoseconds => nanoseconds as f64 * 1e-9,
        };
        let prior = ReadoutPrior::new(time, deviation, self.expected_readout_direction.into());
        prior.ok().filter(|_| self.expected_readout_time != 0)
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
}

/// The description of the property that is not a setting.
pub fn stats() -> glib::ParamSpec {
    glib::ParamSpecBoxed::builder::<gst::Structure>("stats")
            .nick("Statistics")
            .blurb("Frames so far, what was found in the last one (readout-time with its readout-deviation, readout-direction, confidence ...), and mean milliseconds per stage")
            .read_only()
            .build()
}

#[cfg(test)]
mod tests {
    use super::super::RsRectify;
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
    fn a_tenth_is_the_usual_deviation_of_what_is_expected() {
        use rsrectify::readout::ReadoutDirection::BottomToTop;
        let mut settings = Settings::default();
        assert_eq!(settings.analysis().readout_prior, None);
        settings.expected_readout_deviation = 1_000_000;
        assert_eq!(settings.analysis().readout_prior, None, "no time is expected");
        settings.expected_readout_time = 20_000_000;
        settings.expected_readout_direction = ReadoutDirection::BottomToTop;
        let stated = ReadoutPrior::new(0.02, 0.001, Some(BottomToTop)).unwrap();
        assert_eq!(settings.analysis().readout_prior, Some(stated));
        settings.expected_readout_deviation = 0;
        let usual = settings.analysis().readout_prior.unwrap();
        assert!((usual.deviation() - 0.002).abs() < 1e-12);
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
    fn every_setting_is_read_from_where_it_is_written() {
        gst::init().unwrap();
        let element: RsRectify = glib::Object::new();
        let own = |spec: &&glib::ParamSpec| spec.owner_type() == RsRectify::static_type();
        let specs = element.list_properties();
        let settings: Vec<_> = specs.iter().filter(own).filter(|spec| spec.name() != "stats").collect();
        let text = |name: &str| format!("{:?}", element.property_value(name));
        for spec in &settings {
            assert_eq!(text(spec.name()), format!("{:?}", spec.default_value()), "{}", spec.name());
        }
        // Within the range of each, and the default of none.
        let other = |of: glib::Type| match of {
            glib::Type::U32 => 3u32.to_value(),
            glib::Type::U64 => 7u64.to_value(),
            glib::Type::F64 => 0.25.to_value(),
            glib::Type::BOOL => true.to_value(),
            of => {
                let class = glib::EnumClass::with_type(of);
                class.and_then(|class| class.to_value(1)).unwrap_or_else(|| panic!("{of}"))
            }
        };
        for (index, spec) in settings.iter().enumerate() {
            element.set_property_from_value(spec.name(), &other(spec.default_value().type_()));
            for (later, spec) in settings.iter().enumerate() {
                let expected =
                    if later <= index { &other(spec.default_value().type_()) } else { spec.default_value() };
                assert_eq!(text(spec.name()), format!("{expected:?}"), "{}", spec.name());
            }
        }
    }
}
