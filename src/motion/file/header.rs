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
#[derive(Clone, Debug, Default, PartialEq, Eq)]
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
            "{TITLE}{major}.{minor}\nclip: {name}\nclip-bytes: {}\nturned: {}\nframes: {frames}\ntimes-fnv1a: {times:016x}\nindex: {index}\n",
            clip.bytes, clip.turned
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
        let times = u64::from_str_radix(value("times-fnv1a")?, 16);
        Ok(Self {
            clip: Clip { name: value("clip")?.to_owned(), bytes: number("clip-bytes")?, turned },
            frames: number("frames")?,
            times: times.map_err(|_| MotionFileError::Header("times-fnv1a"))?,
            index: number("index")?,
        })
    }
}

/// The 64-bit FNV-1a hash of times, each as eight little-endian bytes.
pub(super) fn hash(times: impl IntoIterator<Item = i64>) -> u64 {
    let bytes = times.into_iter().flat_map(i64::to_le_bytes);
    // Offset basis and prime of the hash's definition.
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        let clip = Clip { name: "Straße 1.mp4".to_owned(), bytes: 123_456, turned: 270 };
        Header { clip, frames: 103, times: 0x0123_4567_89ab_cdef, index: 98_765 }
    }

    #[test]
    fn a_header_comes_back() {
        let text = header().text();
        assert_eq!(text.len(), HEADER_BYTES);
        assert!(text.starts_with(
            "rsrectify motion 1.0\nclip: Straße 1.mp4\nclip-bytes: 123456\nturned: 270\nframes: 103\n"
        ));
        assert_eq!(Header::parse(text.as_bytes()).unwrap(), header());
        let clip = Clip { name: "ä\n".repeat(2000), bytes: 0, turned: 0 };
        let text = Header { clip, ..header() }.text();
        assert_eq!(text.len(), HEADER_BYTES);
        assert_eq!(Header::parse(text.as_bytes()).unwrap().frames, 103);
    }

    #[test]
    fn newer_minor_versions_are_read_and_other_major_ones_refused() {
        let newer =
            header().text().replace("1.0\n", "1.7\n").replace("index: 98765\n      ", "index: 98765\nzoom: ");
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
        for key in ["clip", "clip-bytes", "turned", "frames", "times-fnv1a", "index"] {
            let text = header().text().replace(&format!("\n{key}: "), &format!("\n{}- ", key));
            let error = Header::parse(text.as_bytes()).unwrap_err();
            assert!(error.to_string().ends_with(key), "{error}");
        }
        let cut = header().text();
        assert!(matches!(Header::parse(&cut.as_bytes()[..900]), Err(MotionFileError::Header(_))));
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        // Published values of the hash of nothing and of the bytes 'a', 'b', … 'h'.
        assert_eq!(hash([]), 0xcbf2_9ce4_8422_2325);
        let by_hand = b"abcdefgh".iter().fold(14_695_981_039_346_656_037_u64, |hash, byte| {
            (hash ^ u64::from(*byte)).wrapping_mul(1_099_511_628_211)
        });
        assert_eq!(hash([i64::from_le_bytes(*b"abcdefgh")]), by_hand);
    }
}
