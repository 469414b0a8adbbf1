// SPDX-License-Identifier: MIT OR Apache-2.0

//! The file around the streams.

use crate::input::{Clip, Numbered};
use clap::ValueEnum;
use std::fmt;
use std::path::Path;

/// The file around the streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Container {
    /// .mp4
    Mp4,
    /// .mov, QuickTime
    Mov,
    /// .mkv, Matroska
    Mkv,
    /// .y4m, raw video alone
    Y4m,
    /// Numbered PNG images: by the name of the output only.
    #[value(skip)]
    Images,
}

impl fmt::Display for Container {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mp4 => "MP4",
            Self::Mov => "MOV",
            Self::Mkv => "MKV",
            Self::Y4m => "Y4M",
            Self::Images => "PNG",
        })
    }
}

impl Container {
    /// The container that a file's name asks for.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "mp4" | "m4v" => Some(Self::Mp4),
            "mov" | "qt" => Some(Self::Mov),
            "mkv" => Some(Self::Mkv),
            "y4m" => Some(Self::Y4m),
            "png" if Numbered::of(path).is_some() => Some(Self::Images),
            _ => None,
        }
    }

    /// The container that holds the streams of a clip best: its own kind, of MXF that of the same makers of films, else
    /// Matroska, which takes most.
    pub fn for_clip(clip: &Clip) -> Self {
        let extension = clip.path().extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("mp4" | "m4v" | "3gp" | "3g2" | "f4v") => Self::Mp4,
            Some("mov" | "qt" | "mxf") => Self::Mov,
            _ => Self::Mkv,
        }
    }

    /// The extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Mp4 => "mp4",
            Self::Mov => "mov",
            Self::Mkv => "mkv",
            Self::Y4m => "y4m",
            Self::Images => "png",
        }
    }

    /// Whether its files are made of boxes: this program writes them itself.
    pub fn is_isobmff(self) -> bool {
        matches!(self, Self::Mp4 | Self::Mov)
    }

    /// Whether it holds frames and nothing beside them.
    pub fn is_of_frames_only(self) -> bool {
        matches!(self, Self::Y4m | Self::Images)
    }

    /// The element that writes it; none of what holds frames only.
    pub fn muxer(self) -> Option<&'static str> {
        match self {
            Self::Mp4 => Some("mp4mux"),
            Self::Mov => Some("qtmux"),
            Self::Mkv => Some("matroskamux"),
            Self::Y4m | Self::Images => None,
        }
    }

    /// Whether its muxer takes streams of these caps on pads called `name`, such as `audio_%u`.
    pub fn takes(self, name: &str, caps: &gst::Caps) -> bool {
        self.taken(name, caps).is_some()
    }

    /// These caps as its muxer takes them on such pads, with all fields that it asks for; `None` where it does not.
    pub fn taken(self, name: &str, caps: &gst::Caps) -> Option<gst::Caps> {
        let factory = gst::ElementFactory::find(self.muxer()?)?;
        let mut templates = factory.static_pad_templates().into_iter();
        let template = templates.find(|template| template.name_template() == name)?;
        let mut taken = caps.intersect_with_mode(&template.caps(), gst::CapsIntersectMode::First);
        (!taken.is_empty()).then(|| {
            taken.fixate();
            taken
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ask_for_containers() {
        let of = |name: &str| Container::of(Path::new(name));
        assert_eq!(of("a/B.MP4"), Some(Container::Mp4));
        assert_eq!(of("b.m4v"), Some(Container::Mp4));
        assert_eq!(of("c.mov"), Some(Container::Mov));
        assert_eq!(of("d.mkv"), Some(Container::Mkv));
        assert_eq!((of("e.y4m"), of("f/%06d.png")), (Some(Container::Y4m), Some(Container::Images)));
        assert_eq!((of("e.avi"), of("mp4"), of("f.png"), of("%d.jpg")), (None, None, None, None));
    }
}
