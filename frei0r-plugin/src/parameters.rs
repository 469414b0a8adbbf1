// SPDX-License-Identifier: MIT OR Apache-2.0

//! The parameters of the filter.

use crate::clock::{ClockSettings, Unit};
use rsrectify::warp::{BorderMode, Fill, Interpolation, WarpSettings};
use std::ffi::{CStr, CString};

/// Black, opaque, in frei0r's blue, green, red, alpha.
const BLACK: BorderMode = BorderMode::Constant(Fill::packed([0, 0, 0, 255]));

/// What values a parameter takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number; hosts scale from 0 to 1.
    Number,
    /// A text.
    Text,
}

/// A parameter: its name and kind, and what it is.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Named as the property of the GStreamer element.
    pub name: &'static CStr,
    /// What values it takes.
    pub kind: Kind,
    /// A sentence for users.
    pub explanation: &'static CStr,
}

/// All parameters. Projects and command lines name them by their places here: new ones go to the end.
pub const PARAMETERS: [Parameter; 8] = [
    Parameter {
        name: c"motion-file",
        kind: Kind::Text,
        explanation: c"The file that `rsrectify track CLIP --motion FILE` has written of the clip",
    },
    Parameter {
        name: c"time-unit",
        kind: Kind::Text,
        explanation: c"What the host counts time in: seconds, milliseconds, frames (it has no times: the frames of the file are taken one after another), or auto",
    },
    Parameter {
        name: c"strength",
        kind: Kind::Number,
        explanation: c"How much of the correction is applied: 0 none, 1 all",
    },
    Parameter {
        name: c"interpolation",
        kind: Kind::Text,
        explanation: c"How samples between pixels are made: nearest, linear, cubic or lanczos",
    },
    Parameter {
        name: c"border-mode",
        kind: Kind::Text,
        explanation:
            c"What is shown where the frame saw nothing: replicate, mirror, constant (black), crop, or auto: what the motion file says, a crop or replicate",
    },
    Parameter {
        name: c"crop",
        kind: Kind::Number,
        explanation: c"Share of the width and height that border-mode=crop cuts away, 0 to 0.5",
    },
    Parameter {
        name: c"start",
        kind: Kind::Text,
        explanation: c"Time of the clip, in seconds, at which the host's time 0 is: where it counts from the beginning of a trimmed clip",
    },
    Parameter {
        name: c"speed",
        kind: Kind::Text,
        explanation: c"Seconds of the clip in a second of the host's time, where the host plays it faster or slower",
    },
];

/// Places of the parameters.
pub(crate) const MOTION_FILE: usize = 0;
pub(crate) const TIME_UNIT: usize = 1;
pub(crate) const STRENGTH: usize = 2;
pub(crate) const INTERPOLATION: usize = 3;
pub(crate) const BORDER_MODE: usize = 4;
pub(crate) const CROP: usize = 5;
pub(crate) const START: usize = 6;
pub(crate) const SPEED: usize = 7;
/// Those that are texts.
const TEXTS: [usize; 6] = [MOTION_FILE, TIME_UNIT, INTERPOLATION, BORDER_MODE, START, SPEED];

/// Largest share that can be cut away.
const MOST_CROP: f64 = 0.5;

/// The values of the parameters.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Values {
    /// As hosts have set them; some ask for them again.
    texts: [CString; TEXTS.len()],
    strength: f64,
    crop: f64,
}

impl Default for Values {
    /// The defaults of the element, but for the border.
    fn default() -> Self {
        let texts = [c"", c"auto", c"cubic", c"auto", c"0", c"1"].map(CString::from);
        Self { texts, strength: 1.0, crop: 0.05 }
    }
}

impl Values {
    /// A text parameter.
    pub(crate) fn text(&self, index: usize) -> Option<&CStr> {
        let place = TEXTS.iter().position(|text| *text == index)?;
        self.texts.get(place).map(CString::as_c_str)
    }

    /// Sets a text parameter.
    pub(crate) fn set_text(&mut self, index: usize, value: &CStr) {
        let place = TEXTS.iter().position(|text| *text == index);
        if let Some(text) = place.and_then(|place| self.texts.get_mut(place)) {
            *text = value.to_owned();
        }
    }

    /// A number parameter.
    pub(crate) fn number(&self, index: usize) -> Option<f64> {
        match index {
            STRENGTH => Some(self.strength),
            CROP => Some(self.crop),
            _ => None,
        }
    }

    /// Sets a number parameter; NaN is ignored.
    pub(crate) fn set_number(&mut self, index: usize, value: f64) {
        match index {
            STRENGTH if !value.is_nan() => self.strength = value.clamp(0.0, 1.0),
            CROP if !value.is_nan() => self.crop = value.clamp(0.0, MOST_CROP),
            _ => {}
        }
    }

    /// A number that is set as text; hosts have numbers from 0 to 1 only.
    fn parsed(&self, index: usize) -> Option<f64> {
        let text = self.text(index)?.to_str().ok()?;
        text.trim().parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// What the host counts time in, and where it counts from.
    pub(crate) fn clock(&self) -> ClockSettings {
        let unit = match self.text(TIME_UNIT).and_then(|text| text.to_str().ok()) {
            Some("seconds") => Some(Unit::Seconds),
            Some("milliseconds") => Some(Unit::Milliseconds),
            Some("frames") => Some(Unit::Frames),
            _ => None,
        };
        ClockSettings {
            unit,
            start: self.parsed(START).unwrap_or(0.0),
            speed: self.parsed(SPEED).filter(|speed| *speed > 0.0).unwrap_or(1.0),
        }
    }

    /// How frames are rectified by a file that states this zoom; names that do not exist count as the default.
    pub(crate) fn warp(&self, zoom: f64) -> WarpSettings {
        let name = |index| self.text(index).and_then(|text| text.to_str().ok()).unwrap_or_default();
        let mut settings = WarpSettings::default();
        settings.strength = self.strength;
        settings.interpolation = match name(INTERPOLATION) {
            "nearest" => Interpolation::Nearest,
            "linear" => Interpolation::Linear,
            "lanczos" => Interpolation::Lanczos,
            _ => Interpolation::Cubic,
        };
        settings.border = match name(BORDER_MODE) {
            "mirror" => BorderMode::Mirror,
            "constant" => BLACK,
            _ => BorderMode::Replicate,
        };
        settings.zoom = match name(BORDER_MODE) {
            "replicate" | "mirror" | "constant" => 1.0,
            "crop" => 1.0 / (1.0 - self.crop),
            _ => zoom,
        };
        settings.hide_borders = settings.zoom > 1.0;
        settings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_the_settings_of_the_warp() {
        let mut values = Values::default();
        assert_eq!(values.warp(1.0), WarpSettings::default());
        assert_eq!(values.warp(1.3).zoom, 1.3);
        values.set_number(STRENGTH, 7.0);
        values.set_number(CROP, f64::NAN);
        assert_eq!((values.number(STRENGTH), values.number(CROP)), (Some(1.0), Some(0.05)));
        values.set_number(STRENGTH, 0.25);
        values.set_number(CROP, 0.2);
        values.set_text(INTERPOLATION, c"lanczos");
        values.set_text(BORDER_MODE, c"crop");
        let warp = values.warp(1.3);
        assert_eq!((warp.strength, warp.zoom, warp.interpolation), (0.25, 1.25, Interpolation::Lanczos));
        values.set_text(BORDER_MODE, c"constant");
        assert_eq!((values.warp(1.3).border, values.warp(1.3).zoom), (BLACK, 1.0));
        assert_eq!(values.text(BORDER_MODE), Some(c"constant"));
    }

    #[test]
    fn each_parameter_has_a_value_of_its_kind() {
        let values = Values::default();
        for (index, parameter) in PARAMETERS.iter().enumerate() {
            let is_text = parameter.kind == Kind::Text;
            assert_eq!((values.text(index).is_some(), values.number(index).is_some()), (is_text, !is_text));
        }
        assert!(values.text(PARAMETERS.len()).is_none() && values.number(usize::MAX).is_none());
    }
}
