// SPDX-License-Identifier: MIT OR Apache-2.0

//! What `rsrectify fix` keeps in which container: the table of `docs/program.md` is what is seen here.
//!
//! With `RSRECTIFY_RECORD=1` the table is written there.

use crate::content::Content;
use crate::shared::{Folder, READOUT, rsrectify};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

const DOCUMENT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/program.md");
const BEGIN: &str = "<!-- Written by tests/program/kept.rs. -->\n";
const END: &str = "<!-- To here. -->\n";

/// A row of the table: its name, the properties of kept.rs that it stands for, and a word that a warning of its loss has.
type Row = (&'static str, &'static [&'static str], &'static str);

const ROWS: [Row; 20] = [
    ("every frame, its time", &["frames", "times", "start of the video", "video against audio"], "frame"),
    ("size as shown, pixel aspect", &["size as shown", "pixel aspect"], "size"),
    ("orientation, as a flag", &["orientation"], ""),
    ("range, primaries, transfer, matrix", &["colour"], "colour"),
    ("codec", &["codec"], "codec: "),
    ("bits and chroma", &["bits", "chroma"], "bits"),
    ("mastering display, light level", &["mastering display", "content light level"], "light"),
    ("AAC", &["audio aac"], "audio/mpeg"),
    ("AC-3", &["audio ac3"], "audio/x-ac3"),
    ("Opus", &["audio opus"], "audio/x-opus"),
    ("FLAC", &["audio flac"], "audio/x-flac"),
    ("PCM", &["audio pcm"], "audio/x-raw"),
    ("text subtitles", &["subtitles"], "text/"),
    ("chapters", &["chapters"], "chapters"),
    ("timecode", &["timecode"], "timecode"),
    ("timed metadata, such as telemetry", &["data tracks"], "timed metadata"),
    ("cover picture", &["cover"], "cover picture"),
    ("creation time", &["creation time"], "time"),
    ("place, maker and model of the camera", &["place", "maker", "model"], "place and camera"),
    ("title", &["title"], "tags"),
];

/// What is lost in part without a warning: the column, the row, and what its cell has. One that is kept, or warned of, must be taken
/// off the list.
const PARTLY: [(&str, &str, &str); 10] = [
    // GStreamer's demuxer leaves out packets that an edit list cuts.
    ("MP4 → MOV", "AAC", CUT),
    ("MP4 → MOV", "AC-3", CUT),
    ("MP4 → MKV", "AAC", CUT),
    ("MP4 → MKV", "AC-3", CUT),
    ("MOV → MP4", "AAC", CUT),
    ("MOV → MKV", "AAC", CUT),
    // Its muxer takes the duration of the line before.
    ("MP4 → MOV", "text subtitles", LAST_LINE),
    ("MOV → MP4", "text subtitles", LAST_LINE),
    ("MKV → MP4", "text subtitles", LAST_LINE),
    ("MKV → MOV", "text subtitles", LAST_LINE),
];
const CUT: &str = "kept, but for packets that an edit list cuts";
const LAST_LINE: &str = "kept, the last line for as long as the one before";

/// Clips as they come from phones, from editing programs, and as films: their names, and the arguments of ffmpeg.
const CLIPS: [(&str, &str); 3] = [
    (
        "phone.mp4",
        "-map 3:s -vf scale=out_range=pc,format=yuv420p,setsar=4/3 -c:v libx264 -preset ultrafast \
         -color_range pc -colorspace bt709 -color_primaries bt709 -color_trc bt709 -c:a:0 aac -c:a:1 ac3 -c:s mov_text \
         -movflags use_metadata_tags",
    ),
    (
        "edit.mov",
        "-c:v prores_ks -pix_fmt yuv422p10le -c:a:0 pcm_s16le -c:a:1 aac -c:s mov_text -timecode 01:02:03:04",
    ),
    (
        "film.mkv",
        "-c:v libx265 -pix_fmt yuv420p10le -color_range tv -colorspace bt2020nc -color_primaries bt2020 \
         -color_trc smpte2084 -x265-params log-level=none:max-cll=1000,400:master-display=\
         G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)L(10000000,50) -c:a:0 flac -c:a:1 libopus -c:s srt \
         -attach cover.png -metadata:s:t mimetype=image/png",
    ),
];

/// Runs ffmpeg in a folder.
fn ffmpeg(folder: &Folder, arguments: &str) {
    let mut command = Command::new("ffmpeg");
    command.current_dir(&folder.0).args(["-nostdin", "-v", "error", "-y"]).args(arguments.split_whitespace());
    let output = command.output().expect("the tests need ffmpeg");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Writes a clip.
fn clip(folder: &Folder, name: &str, arguments: &str) -> PathBuf {
    let lines = "1\n00:00:00,100 --> 00:00:00,400\nfish\n\n2\n00:00:00,500 --> 00:00:00,900\nthe end\n";
    std::fs::write(folder.file("lines.srt"), lines).unwrap();
    let chapter = |start: u32, title: &str| {
        format!("[CHAPTER]\nTIMEBASE=1/1000\nSTART={start}\nEND={}\ntitle={title}\n", start + 500)
    };
    let about = [
        ";FFMETADATA1\ntitle=A title\nmake=Maker\nmodel=Model\nlocation=+52.5200+013.4050/\n",
        "creation_time=2021-03-04T05:06:07Z\n",
        &chapter(0, "first"),
        &chapter(500, "second"),
    ];
    std::fs::write(folder.file("about.txt"), about.concat()).unwrap();
    ffmpeg(folder, "-f lavfi -i color=red:size=64x64 -frames:v 1 cover.png");
    ffmpeg(
        folder,
        &format!(
            "-f lavfi -i testsrc2=size=320x180:rate=30:duration=1 -f lavfi -i sine=440:duration=1 \
             -f lavfi -i sine=880:duration=1 -i lines.srt -i about.txt \
             -map 0:v -map 1:a -map 2:a -map 3:s -map_metadata 4 -map_chapters 4 {arguments} {name}"
        ),
    );
    let path = folder.file(name);
    if name.ends_with("mp4") {
        turned_with_telemetry(folder, name);
    }
    path
}

/// Turns a clip by a quarter, gives it a timecode, and makes timed metadata of its second track of subtitles.
fn turned_with_telemetry(folder: &Folder, name: &str) {
    // The flag of orientation and the timecode of one track go only into a copy.
    let tracks = "-map 0:v -map 0:a -map 0:s";
    ffmpeg(
        folder,
        &format!(
            "-i {name} {tracks} -c copy -movflags use_metadata_tags -metadata:s:v:0 rotate=90 \
             -metadata creation_time=2021-03-04T05:06:07Z -timecode 01:02:03:04 turned.mp4"
        ),
    );
    let mut bytes = std::fs::read(folder.file("turned.mp4")).unwrap();
    let mut rename = |from: &[u8], to: &[u8; 4]| {
        let at = bytes.windows(from.len()).rposition(|window| window == from);
        let at = at.unwrap_or_else(|| panic!("{}", String::from_utf8_lossy(from)));
        bytes[at..at + 4].copy_from_slice(to);
    };
    rename(b"tx3g", b"mett");
    rename(b"sbtl", b"meta");
    std::fs::write(folder.file(name), bytes).unwrap();
}

/// The property as a row has it: of sound by its codec.
fn is_of(row: &Row, property: &str, value: Option<&str>) -> bool {
    row.1.iter().any(|listed| match listed.strip_prefix("audio ") {
        Some(codec) => property.starts_with("audio ") && value.is_some_and(|value| value.starts_with(codec)),
        None => property.starts_with(listed),
    })
}

/// What became of a row: an empty cell where the clip has nothing of it.
fn cell(row: &Row, before: &Content, after: &Content, told: &str) -> Result<&'static str, String> {
    let properties = &before.properties;
    if !properties.iter().any(|(property, value)| is_of(row, property, Some(value))) {
        return Ok("");
    }
    let all = before.differences(after);
    let all: Vec<_> = all.iter().filter(|one| is_of(row, &one.property, one.before.as_deref())).collect();
    if all.is_empty() {
        return Ok("kept");
    }
    let is_upright = row.2.is_empty() && !all.iter().any(|one| one.after.is_some());
    if is_upright {
        return Ok("turned upright");
    }
    if !told
        .lines()
        .any(|line| ["warning", "codec"].iter().any(|kind| line.starts_with(kind)) && line.contains(row.2))
    {
        return Err(format!("{}: {all:?} without a warning:\n{told}", row.0));
    }
    Ok(if all.iter().any(|one| one.after.is_some()) { "changed, said" } else { "left out, said" })
}

/// Rectifies into a container; all that is in the twin, and what was said.
fn fix(clip: &Path, container: &str) -> (Content, String) {
    let twin = clip.with_extension(format!("twin.{container}"));
    let mut command = rsrectify("fix");
    command.arg(clip).args(READOUT).arg("--output").arg(&twin);
    let output = command.output().unwrap();
    let told = String::from_utf8([output.stderr, output.stdout].concat()).unwrap();
    assert!(output.status.success(), "{told}");
    (content(&twin), told)
}

/// All that is in a file, its codec too.
fn content(file: &Path) -> Content {
    let mut content = Content::of(file).expect("the file can be decoded");
    content.properties.insert("codec".into(), content.codec.clone());
    content
}

#[test]
fn what_is_kept_is_as_the_table_states() {
    let folder = Folder::new("kept");
    let mut columns = Vec::new();
    let mut faults = String::new();
    for (name, arguments) in CLIPS {
        let clip = clip(&folder, name, arguments);
        let before = content(&clip);
        for container in ["mp4", "mov", "mkv"] {
            let (after, told) = fix(&clip, container);
            let (_, from) = name.rsplit_once('.').unwrap();
            let heading = format!("{} → {}", from.to_uppercase(), container.to_uppercase());
            let cells = ROWS.iter().map(|row| {
                let partly = PARTLY.iter().find(|partly| partly.0 == heading && partly.1 == row.0);
                match (cell(row, &before, &after, &told), partly) {
                    (Err(_), Some((_, _, cell))) => cell,
                    (Ok(cell), None) => cell,
                    (Ok(cell), Some((_, _, listed))) => {
                        writeln!(faults, "{heading}: {}: {cell} now, but listed as {listed}", row.0).unwrap();
                        cell
                    }
                    (Err(fault), None) => {
                        writeln!(faults, "{heading}: {fault}").unwrap();
                        "lost"
                    }
                }
            });
            let cells = cells.collect::<Vec<_>>();
            columns.push((heading, cells));
        }
    }
    let mut table =
        format!("\n| |{}\n|---|", columns.iter().map(|(h, _)| format!(" {h} |")).collect::<String>());
    table += &"---|".repeat(columns.len());
    for (number, (name, ..)) in ROWS.iter().enumerate() {
        let cells = columns.iter().map(|(_, cells)| format!(" {} |", cells[number])).collect::<String>();
        write!(table, "\n| {name} |{cells}").unwrap();
    }
    table += "\n\n";
    if !faults.is_empty() {
        panic!("\n{faults}\n{table}");
    }
    let document = std::fs::read_to_string(DOCUMENT).unwrap();
    let (start, rest) = document.split_once(BEGIN).expect("the mark where the table begins");
    let (written, end) = rest.split_once(END).expect("the mark where the table ends");
    if std::env::var_os("RSRECTIFY_RECORD").is_some() {
        std::fs::write(DOCUMENT, [start, BEGIN, &table, END, end].concat()).unwrap();
    } else {
        assert_eq!(written, table, "RSRECTIFY_RECORD=1 writes what is seen now");
    }
}
