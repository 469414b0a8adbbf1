// SPDX-License-Identifier: MIT OR Apache-2.0

//! Options of x264 and x265 that state colours and HDR in the stream.

use crate::colour::Colour;
use crate::picture::Picture;
use gst_video::{
    VideoChromaSite, VideoContentLightLevel, VideoMasteringDisplayInfo, VideoMasteringDisplayInfoCoordinate,
};

/// The names that x264 has for the code points of ITU-T H.273; empty where it has none.
const PRIMARIES: [&str; 13] = [
    "",
    "bt709",
    "undef",
    "",
    "bt470m",
    "bt470bg",
    "smpte170m",
    "smpte240m",
    "film",
    "bt2020",
    "smpte428",
    "smpte431",
    "smpte432",
];
const TRANSFERS: [&str; 19] = [
    "",
    "bt709",
    "undef",
    "",
    "bt470m",
    "bt470bg",
    "smpte170m",
    "smpte240m",
    "linear",
    "log100",
    "log316",
    "iec61966-2-4",
    "bt1361e",
    "iec61966-2-1",
    "bt2020-10",
    "bt2020-12",
    "smpte2084",
    "smpte428",
    "arib-std-b67",
];
const MATRICES: [&str; 15] = [
    "",
    "bt709",
    "undef",
    "",
    "fcc",
    "bt470bg",
    "smpte170m",
    "smpte240m",
    "YCgCo",
    "bt2020nc",
    "bt2020c",
    "smpte2085",
    "chroma-derived-nc",
    "chroma-derived-c",
    "ICtCp",
];

/// The options of x264.
pub fn x264(picture: &Picture) -> String {
    let name = |names: &[&'static str], code: u8| {
        let name = names.get(usize::from(code)).copied().unwrap_or_default();
        if name.is_empty() { "undef" } else { name }
    };
    let Colour { primaries, transfer, matrix, full_range } = picture.colour;
    let mut options = vec![
        format!("colorprim={}", name(&PRIMARIES, primaries)),
        format!("transfer={}", name(&TRANSFERS, transfer)),
        format!("colormatrix={}", name(&MATRICES, matrix)),
        format!("fullrange={}", if full_range == Some(true) { "on" } else { "off" }),
    ];
    let site = picture.info.as_ref().map(|info| info.chroma_site());
    // Left is meant where nothing is stated.
    if site == Some(VideoChromaSite::JPEG) {
        options.push("chromaloc=1".to_owned());
    } else if site == Some(VideoChromaSite::COSITED) {
        options.push("chromaloc=2".to_owned());
    }
    options.extend(mastering_display(picture).map(|display| format!("mastering-display={display}")));
    options.extend(light_level(picture).map(|level| format!("cll={level}")));
    options.join(":")
}

/// The options of x265.
pub fn x265(picture: &Picture) -> String {
    // In numbers: some of its names are others than those of x264.
    let Colour { primaries, transfer, matrix, full_range } = picture.colour;
    let mut options = vec![
        format!("colorprim={primaries}"),
        format!("transfer={transfer}"),
        format!("colormatrix={matrix}"),
        format!("range={}", if full_range == Some(true) { "full" } else { "limited" }),
    ];
    options.extend(mastering_display(picture).map(|display| format!("master-display={display}")));
    options.extend(light_level(picture).map(|level| format!("max-cll={level}")));
    if picture.mastering_display.is_some() || picture.light_level.is_some() {
        // Else they are in the headers only once, which some players pass over.
        options.extend(["hdr10=1".to_owned(), "repeat-headers=1".to_owned()]);
    }
    options.join(":")
}

/// In units of 0.00002 and 0.0001 cd/m².
fn mastering_display(picture: &Picture) -> Option<String> {
    let info = picture.mastering_display.as_ref()?.parse::<VideoMasteringDisplayInfo>().ok()?;
    let [red, green, blue] = info.display_primaries();
    let place = |point: VideoMasteringDisplayInfoCoordinate| format!("({},{})", point.x, point.y);
    let (most, least) = (info.max_display_mastering_luminance(), info.min_display_mastering_luminance());
    Some(format!(
        "G{}B{}R{}WP{}L({most},{least})",
        place(green),
        place(blue),
        place(red),
        place(info.white_point())
    ))
}

fn light_level(picture: &Picture) -> Option<String> {
    let level = picture.light_level.as_ref()?.parse::<VideoContentLightLevel>().ok()?;
    Some(format!("{},{}", level.max_content_light_level(), level.max_frame_average_light_level()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoders_are_told_what_gstreamer_cannot_name() {
        gst::init().unwrap();
        let mut picture = Picture::default();
        assert_eq!(x264(&picture), "colorprim=undef:transfer=undef:colormatrix=undef:fullrange=off");
        assert_eq!(x265(&picture), "colorprim=2:transfer=2:colormatrix=2:range=limited");
        picture.colour = Colour { primaries: 1, transfer: 11, matrix: 10, full_range: Some(true) };
        picture.mastering_display = Some("1:2:3:4:5:6:7:8:9:10".to_owned());
        picture.light_level = Some("1000:200".to_owned());
        let light = "G(3,4)B(5,6)R(1,2)WP(7,8)L(9,10)";
        assert_eq!(
            x264(&picture),
            format!(
                "colorprim=bt709:transfer=iec61966-2-4:colormatrix=bt2020c:fullrange=on:\
                 mastering-display={light}:cll=1000,200"
            )
        );
        assert_eq!(
            x265(&picture),
            format!(
                "colorprim=1:transfer=11:colormatrix=10:range=full:master-display={light}:max-cll=1000,200:\
                 hdr10=1:repeat-headers=1"
            )
        );
    }
}
