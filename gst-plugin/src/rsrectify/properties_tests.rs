// SPDX-License-Identifier: MIT OR Apache-2.0

//! The settings, and the properties of the element that change them.

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
fn stabilisation_may_use_half_of_what_is_cropped_on_each_side() {
    let mut settings = Settings { crop: 20.0, stabilization: 0.5, ..Settings::default() };
    let usual = rectifier::Settings::default().margin;
    assert_eq!((settings.analysis().stabilization, settings.analysis().margin), (0.5, usual));
    settings.border_mode = BorderMode::Crop;
    let margin = settings.analysis().margin;
    // The window that is shown is 1/zoom of the frame.
    assert!((margin - (1.0 - 1.0 / settings.warp().zoom) / 2.0).abs() < 1e-12);
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
