// SPDX-License-Identifier: MIT OR Apache-2.0

//! What ffprobe finds in a file, to compare a clip with its rectified twin: GStreamer, which wrote the twin, has no say in it.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

/// How far apart the times of frames may be, in seconds: Matroska's clock has milliseconds.
const TIME: f64 = 0.0012;
/// How far video may move against the rest of the file, in seconds: half a frame of fast cameras.
const SHIFT: f64 = 0.012;
/// Tracks of hints for streaming (ISO/IEC 14496-12) and of MPEG-4 Systems (14496-14) describe the samples that were replaced.
const BOUND_TO_SAMPLES: [&str; 2] = ["rtp ", "mp4s"];

/// What a file has: the names of properties and their values, as far as it has them.
pub struct Content {
    pub properties: BTreeMap<String, String>,
    /// The codec of the main video.
    pub codec: String,
    /// When each frame of the main video is shown; `None` where the file does not say.
    times: Vec<Option<f64>>,
    file_start: f64,
    audio_start: Option<f64>,
}

/// A property that differs.
#[derive(Debug)]
pub struct Difference {
    pub property: String,
    pub before: Option<String>,
    pub after: Option<String>,
}

impl Content {
    /// Of a file; `None` where ffprobe can decode no frame of it.
    pub fn of(file: &Path) -> Option<Self> {
        let whole = probe(file, &["-show_streams", "-show_format", "-show_chapters"])?;
        let streams = whole["streams"].as_array()?;
        let is_cover = |stream: &Value| stream["disposition"]["attached_pic"] == 1;
        let of_kind = |kind: &str| -> Vec<&Value> {
            streams.iter().filter(|stream| stream["codec_type"] == kind && !is_cover(stream)).collect()
        };
        let [videos, audios, subtitles] = ["video", "audio", "subtitle"].map(of_kind);
        let video = *videos.first()?;
        let frames = probe(file, &["-select_streams", &video["index"].to_string(), "-show_frames"])?;
        let frames = frames["frames"].as_array().filter(|frames| !frames.is_empty())?;

        let mut properties = picture(video, frames.first()?);
        let mut set = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                properties.insert(name.to_owned(), value);
            }
        };
        let is_interlaced = frames.iter().any(|frame| frame["interlaced_frame"] == 1);
        set("fields", is_interlaced.then(|| "interlaced".to_owned()));
        set("frames", Some(frames.len().to_string()));
        set("video tracks", Some(videos.len().to_string()));
        set("audio tracks", Some(audios.len().to_string()));
        set("subtitle tracks", Some(subtitles.len().to_string()));
        for (number, audio) in audios.iter().enumerate() {
            set(&format!("audio {number}"), Some(sound(file, audio)));
        }
        for (number, subtitle) in subtitles.iter().enumerate() {
            set(&format!("subtitles {number}"), Some(cues(file, subtitle)));
        }
        set("chapters", chapters(&whole["chapters"]));
        let covers = streams.iter().filter(|stream| is_cover(stream)).count();
        set("cover", (covers > 0).then(|| covers.to_string()));
        let data = streams.iter().filter(|stream| stream["codec_type"] == "data");
        let tags = data.filter_map(|stream| stream["codec_tag_string"].as_str());
        // Timecode and chapters have rows of their own.
        let tags: Vec<_> =
            tags.filter(|tag| !["tmcd", "text"].contains(tag) && !BOUND_TO_SAMPLES.contains(tag)).collect();
        set("data tracks", (!tags.is_empty()).then(|| tags.join(", ")));
        let format = &whole["format"];
        // To the second; files that do not know it state the beginning of their era.
        let created =
            tag(format, &["creation_time"]).map(|time| time.replace(' ', "T").chars().take(19).collect());
        set(
            "creation time",
            created.filter(|time: &String| !["1904", "1970"].contains(&time.get(..4).unwrap_or(""))),
        );
        for (name, keys) in [
            ("place", &["location", "com.apple.quicktime.location.ISO6709"][..]),
            ("maker", &["make", "com.apple.quicktime.make"]),
            ("model", &["model", "com.apple.quicktime.model"]),
            ("title", &["title"]),
        ] {
            set(name, tag(format, keys));
        }
        let timecode = streams.iter().chain([format]).find_map(|part| tag(part, &["timecode"]));
        set("timecode", timecode);
        let time = |frame: &Value| seconds(&frame["best_effort_timestamp_time"]);
        Some(Self {
            properties,
            codec: video["codec_name"].as_str().unwrap_or("?").to_owned(),
            times: frames.iter().map(time).collect(),
            file_start: seconds(&format["start_time"]).unwrap_or(0.0),
            audio_start: audios.first().and_then(|audio| seconds(&audio["start_time"])),
        })
    }

    /// What another file has otherwise, or not at all. What only the other one states is no loss.
    pub fn differences(&self, other: &Self) -> Vec<Difference> {
        let mut all: Vec<_> = self
            .properties
            .iter()
            .filter(|(name, value)| {
                !other.properties.get(*name).is_some_and(|other| is_same(name, value, other))
            })
            .map(|(name, value)| Difference {
                property: name.clone(),
                before: Some(value.clone()),
                after: other.properties.get(name).cloned(),
            })
            .collect();
        // Progressive video must not become interlaced.
        if !self.properties.contains_key("fields")
            && let Some(after) = other.properties.get("fields")
        {
            all.push(Difference { property: "fields".into(), before: None, after: Some(after.clone()) });
        }
        all.extend(self.shifts(other).into_iter().map(|(property, shift)| Difference {
            property: property.into(),
            before: None,
            after: Some(format!("{:+.1} ms", 1e3 * shift)),
        }));
        all
    }

    /// Times that are not as they were.
    fn shifts(&self, other: &Self) -> Vec<(&'static str, f64)> {
        let pairs: Vec<_> =
            self.times.iter().zip(&other.times).filter_map(|(one, two)| (*one).zip(*two)).collect();
        let Some(&(first, other_first)) = pairs.first() else { return Vec::new() };
        let moved = |(one, two): &(f64, f64)| (two - other_first) - (one - first);
        let worst =
            pairs.iter().map(moved).fold(0.0, |one: f64, two| if two.abs() > one.abs() { two } else { one });
        let start = (other_first - other.file_start) - (first - self.file_start);
        let sound = self.audio_start.zip(other.audio_start);
        let sound = sound.map_or(0.0, |(one, two)| (other_first - two) - (first - one));
        let mut all = Vec::new();
        for (name, shift, limit) in [
            ("times", worst, TIME),
            ("start of the video", start, SHIFT),
            ("video against audio", sound, SHIFT),
        ] {
            if shift.abs() > limit {
                all.push((name, shift));
            }
        }
        all
    }
}

/// Properties of the picture: of its stream, or of its first frame where the stream does not state them.
fn picture(stream: &Value, frame: &Value) -> BTreeMap<String, String> {
    let number = |field: &str| stream[field].as_i64().unwrap_or(0);
    let (width, height) = (number("width"), number("height"));
    let side =
        |part: &'static str| stream[part].as_array().into_iter().chain(frame[part].as_array()).flatten();
    let side_data: Vec<&Value> = side("side_data_list").collect();
    let turn = side_data.iter().find_map(|data| data["rotation"].as_i64()).unwrap_or(0);
    let (width, height) = if turn % 180 == 0 { (width, height) } else { (height, width) };
    let mut all = BTreeMap::from([("size as shown".to_owned(), format!("{width} x {height}"))]);
    let mirrored = side_data.iter().find_map(|data| data["displaymatrix"].as_str()).is_some_and(is_mirrored);
    if turn != 0 || mirrored {
        all.insert("orientation".into(), format!("{turn}°{}", if mirrored { ", mirrored" } else { "" }));
    }
    let stated = |field: &str| {
        let texts = [&stream[field], &frame[field]].into_iter().filter_map(Value::as_str);
        texts
            .into_iter()
            .find(|text| !["unknown", "reserved", "N/A", "0:1"].contains(text))
            .map(str::to_owned)
    };
    let aspect = stated("sample_aspect_ratio").and_then(|ratio| {
        let (one, two) = ratio.split_once(':')?;
        let ratio = one.parse::<f64>().ok()? / two.parse::<f64>().ok()?;
        Some(format!("{:.2}", if turn % 180 == 0 { ratio } else { 1.0 / ratio }))
    });
    all.insert("pixel aspect".into(), aspect.unwrap_or("1.00".into()));
    for field in ["range", "primaries", "transfer", "space"] {
        if let Some(value) = stated(&format!("color_{field}")) {
            // Two names of one matrix.
            let value = if field == "space" && value == "bt470bg" { "smpte170m".into() } else { value };
            all.insert(format!("colour {field}"), value);
        }
    }
    if let Some(format) = stated("pix_fmt") {
        let bits = ["9", "10", "12", "14", "16"].into_iter();
        let mut bits = bits.filter(|bits| format.contains(&format!("p{bits}")));
        all.insert("bits".into(), bits.next().unwrap_or("8").into());
        let chroma = ["420", "422", "444", "411", "440", "410"];
        all.extend(
            chroma.into_iter().find(|kind| format.contains(kind)).map(|kind| ("chroma".into(), kind.into())),
        );
    }
    for data in side_data {
        let kind = data["side_data_type"].as_str().unwrap_or("");
        if ["Mastering display metadata", "Content light level metadata"].contains(&kind) {
            let values = data.as_object().into_iter().flatten().filter(|(name, _)| *name != "side_data_type");
            let values: Vec<_> = values.map(|(name, value)| format!("{name} {}", ratio(value))).collect();
            all.insert(kind.to_lowercase().replace(" metadata", ""), values.join(" "));
        }
    }
    all
}

/// Whether a display matrix has a negative determinant.
fn is_mirrored(matrix: &str) -> bool {
    let rows = matrix.lines().filter_map(|line| line.split_once(':'));
    let numbers =
        rows.flat_map(|(_, row)| row.split_whitespace()).filter_map(|text| text.parse::<f64>().ok());
    let numbers: Vec<f64> = numbers.collect();
    numbers.len() == 9 && numbers[0] * numbers[4] < numbers[1] * numbers[3]
}

/// A number or fraction, in three significant digits.
fn ratio(value: &Value) -> String {
    let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let number = match text.split_once('/') {
        Some((one, two)) => one.parse().unwrap_or(f64::NAN) / two.parse().unwrap_or(f64::NAN),
        None => text.parse().unwrap_or(f64::NAN),
    };
    format!("{number:.2e}")
}

/// Whether two values of a property are alike. Of sound either the packets or what they are decoded to: containers frame
/// packets of AAC and PCM each in its own way, and may state delays that others cannot.
fn is_same(property: &str, one: &str, other: &str) -> bool {
    if !property.starts_with("audio ") || property == "audio tracks" {
        return one == other;
    }
    let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let (one, other) = (words(one), words(other));
    one[0] == other[0] && one[1..].iter().zip(&other[1..]).any(|(one, other)| one == other)
}

/// Codec and two digests: of the packets, and of the samples that they are decoded to.
fn sound(file: &Path, audio: &Value) -> String {
    let codec = audio["codec_name"].as_str().unwrap_or("?");
    // Layers 2 and 3 have one name in GStreamer.
    let codec = if codec == "mp2" { "mp3" } else { codec };
    let [packets, samples] = ["copy", "pcm_s16le"].map(|how| digest(file, audio, &["-c:a", how]));
    format!("{codec} {packets} {samples}")
}

fn digest(file: &Path, stream: &Value, how: &[&str]) -> String {
    let map = format!("0:{}", stream["index"]);
    let input = ["-v", "quiet", "-i"];
    let mut command = Command::new("ffmpeg");
    command.args(input).arg(file).args(["-map", &map]).args(how).args(["-f", "md5", "-"]);
    text(&mut command).trim().to_owned()
}

/// The lines of a subtitle track with their times.
fn cues(file: &Path, subtitle: &Value) -> String {
    let map = format!("0:{}", subtitle["index"]);
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "quiet", "-i"]).arg(file).args(["-map", &map, "-f", "srt", "-"]);
    // Without their style: MP4 and MOV have one for all lines.
    let mut plain = String::new();
    let mut is_style = false;
    for letter in text(&mut command).chars() {
        is_style |= letter == '<';
        if !is_style {
            plain.push(letter);
        }
        is_style &= letter != '>';
    }
    plain
}

fn chapters(chapters: &Value) -> Option<String> {
    let chapters = chapters.as_array().filter(|chapters| !chapters.is_empty())?;
    let text = |chapter: &Value| {
        let start = seconds(&chapter["start_time"]).unwrap_or(f64::NAN);
        format!("{start:.2} {}", chapter["tags"]["title"].as_str().unwrap_or(""))
    };
    Some(chapters.iter().map(text).collect::<Vec<_>>().join(", "))
}

fn tag(part: &Value, keys: &[&str]) -> Option<String> {
    let tags = part["tags"].as_object()?;
    let value = |key: &&str| {
        let alike = || tags.iter().find(|(name, _)| name.eq_ignore_ascii_case(key));
        tags.get_key_value(*key).or_else(alike)
    };
    Some(keys.iter().find_map(value)?.1.as_str()?.to_owned())
}

fn seconds(value: &Value) -> Option<f64> {
    value.as_str()?.parse().ok()
}

/// What ffprobe prints; `None` where it fails.
fn probe(file: &Path, what: &[&str]) -> Option<Value> {
    let mut command = Command::new("ffprobe");
    command.args(["-v", "quiet", "-of", "json"]).args(what).arg(file);
    serde_json::from_str(&text(&mut command)).ok()
}

fn text(command: &mut Command) -> String {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output();
    String::from_utf8_lossy(&output.expect("the tests need ffmpeg").stdout).into_owned()
}
