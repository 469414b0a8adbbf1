// SPDX-License-Identifier: MIT OR Apache-2.0

//! The text at the beginning of a motion file.

use super::clip::Clip;
use super::error::MotionFileError;

/// Bytes of the header.
pub(super) const HEADER_BYTES: usize = 1024;
/// Begins the first line.
const TITLE: &str = "rsrectify motion ";
/// The version that is written.
const VERSION: [u32; 2] = [1, 0];
/// Bytes of a clip's name that are kept; names of files have at most 255.
const NAME_BYTES: usize = 512;

/// What the header states.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Header {
    pub(super) clip: Clip,
    pub(super) frames: u64,
    /// FNV-1a hash of the frames' times.
    pub(super) times: u64,
    /// Offset of the index.
    pub(super) index: u64,
}

impl Header {
    /// The header as text of [`HEADER_BYTES`] bytes.
    pub(super) fn text(&self) -> String {
        let printable = |letter: char| if letter.is_control() { '\u{fffd}' } else { letter };
        let mut name: String = self.clip.name.chars().map(printable).collect();
        while name.len() > NAME_BYTES {
            name.pop();
        }
        let ([major, minor], Self { clip, frames, times, index }) = (VERSION, self);
        let mut text = format!(
            "{TITLE}{major}.{minor}\nclip: {name}\nclip-bytes: {}\nturned: {}\nmirrored: {}\npixel-aspect: {}:{}\n\
             zoom: {}\nframes: {frames}\ntimes-fnv1a: {times:016x}\nindex: {index}\n",
            clip.bytes,
            clip.turned,
            if clip.mirrored { "yes" } else { "no" },
            clip.pixel_aspect[0],
            clip.pixel_aspect[1],
            clip.zoom
        );
        let padding = HEADER_BYTES.saturating_sub(text.len() + 1);
        text.extend(std::iter::repeat_n(' ', padding));
        text.push('\n');
        text
    }

    /// Reads a header.
    pub(super) fn parse(bytes: &[u8]) -> Result<Self, MotionFileError> {
        // Another major version may have another header: its first line is read alone.
        let end = bytes.iter().position(|byte| *byte == b'\n').ok_or(MotionFileError::NotMotion)?;
        let first = bytes.get(..end).and_then(|line| std::str::from_utf8(line).ok());
        let version = first.and_then(|line| line.strip_prefix(TITLE)).and_then(|version| {
            let (major, minor) = version.split_once('.')?;
            Some((major.parse().ok()?, minor.parse().ok()?))
        });
        let (major, minor) = version.ok_or(MotionFileError::NotMotion)?;
        if major != VERSION[0] {
            return Err(MotionFileError::Version { major, minor });
        }
        let text = bytes.get(..HEADER_BYTES).and_then(|bytes| std::str::from_utf8(bytes).ok());
        let text = text.ok_or(MotionFileError::Header("its version in 1024 bytes of text"))?;
        let value = |key: &'static str| {
            let found = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(": "));
            found.ok_or(MotionFileError::Header(key))
        };
        let number = |key| value(key)?.parse::<u64>().map_err(|_| MotionFileError::Header(key));
        let turned = number("turned")?;
        let turned = [0, 90, 180, 270].into_iter().find(|degrees| u64::from(*degrees) == turned);
        let turned = turned.ok_or(MotionFileError::Header("turned"))?;
        let mirrored = match value("mirrored")? {
            "yes" => true,
            "no" => false,
            _ => return Err(MotionFileError::Header("mirrored")),
        };
        let aspect = value("pixel-aspect")?.split_once(':').and_then(|(width, height)| {
            let side = |text: &str| text.parse().ok().filter(|side| *side > 0);
            Some([side(width)?, side(height)?])
        });
        let pixel_aspect = aspect.ok_or(MotionFileError::Header("pixel-aspect"))?;
        let zoom = value("zoom")?.parse().ok().filter(|zoom: &f64| zoom.is_finite() && *zoom >= 1.0);
        let zoom = zoom.ok_or(MotionFileError::Header("zoom"))?;
        let times = u64::from_str_radix(value("times-fnv1a")?, 16);
        let clip = Clip::new(value("clip")?, number("clip-bytes")?);
        Ok(Self {
            clip: Clip { turned, mirrored, pixel_aspect, zoom, ..clip },
            frames: number("frames")?,
            times: times.map_err(|_| MotionFileError::Header("times-fnv1a"))?,
            index: number("index")?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        let clip = Clip::new("Straße 1.mp4", 123_456);
        let clip = Clip { turned: 270, mirrored: true, pixel_aspect: [64, 45], zoom: 1.125, ..clip };
        Header { clip, frames: 103, times: 0x0123_4567_89ab_cdef, index: 98_765 }
    }

    #[test]
    fn a_header_comes_back() {
        let text = header().text();
        assert_eq!(text.len(), HEADER_BYTES);
        assert!(text.starts_with(
            "rsrectify motion 1.0\nclip: Straße 1.mp4\nclip-bytes: 123456\nturned: 270\nmirrored: yes\n\
             pixel-aspect: 64:45\nzoom: 1.125\nframes: 103\n"
        ));
        assert_eq!(Header::parse(text.as_bytes()).unwrap(), header());
        let clip = Clip::new("ä\n".repeat(2000), 0);
        let text = Header { clip, ..header() }.text();
        assert_eq!(text.len(), HEADER_BYTES);
        assert_eq!(Header::parse(text.as_bytes()).unwrap().frames, 103);
    }

    #[test]
    fn newer_minor_versions_are_read_and_other_major_ones_refused() {
        let newer =
            header().text().replace("1.0\n", "1.7\n").replace("index: 98765\n      ", "index: 98765\nlens: ");
        assert_eq!(newer.len(), HEADER_BYTES);
        assert_eq!(Header::parse(newer.as_bytes()).unwrap(), header());
        let error = Header::parse(b"rsrectify motion 2.3\nall else differs").unwrap_err();
        assert!(matches!(error, MotionFileError::Version { major: 2, minor: 3 }), "{error}");
        for other in
            ["", "\n", "rsrectify motion \n", "rsrectify motion 1\n", "rsrectify motion 1.x\n", "%PDF-1.4\n"]
        {
            assert!(matches!(Header::parse(other.as_bytes()), Err(MotionFileError::NotMotion)), "{other}");
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        for key in [
            "clip",
            "clip-bytes",
            "turned",
            "mirrored",
            "pixel-aspect",
            "zoom",
            "frames",
            "times-fnv1a",
            "index",
        ] {
            let text = header().text().replace(&format!("\n{key}: "), &format!("\n{}- ", key));
            let error = Header::parse(text.as_bytes()).unwrap_err();
            assert!(error.to_string().ends_with(key), "{error}");
        }
        for (value, other) in
            [("64:45", "64:0"), ("64:45", "64"), ("mirrored: yes", "mirrored: maybe"), ("1.125", "0.5")]
        {
            assert!(Header::parse(header().text().replace(value, other).as_bytes()).is_err(), "{other}");
        }
        let cut = header().text();
        assert!(matches!(Header::parse(&cut.as_bytes()[..900]), Err(MotionFileError::Header(_))));
    }
}
