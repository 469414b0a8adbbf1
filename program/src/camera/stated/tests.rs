// SPDX-License-Identifier: MIT OR Apache-2.0

//! Files of each maker, as far as they can be made, whole and damaged; files of cameras, where `RSRECTIFY_DATA` has them.

use super::keys::keyed;
use super::*;
use crate::boxes::boxed;
use rsrectify::readout::ReadoutDirection;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a file of these bytes states.
fn stated(bytes: &[u8]) -> Stated {
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let name = format!("rsrectify-stated-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, bytes).unwrap();
    let found = read(&path);
    std::fs::remove_file(path).unwrap();
    found
}

fn with_user_data(content: &[Vec<u8>]) -> Vec<u8> {
    boxed(b"moov", &boxed(b"udta", &content.concat()))
}

fn gopro_file() -> Vec<u8> {
    use super::gopro::tests::{device, gpmf};
    let telemetry = device(&[
        gpmf(b"MINF", b'c', 1, b"HERO8 Black"),
        gpmf(b"SROT", b'f', 4, &11.2_f32.to_be_bytes()),
        gpmf(b"EISE", b'c', 1, b"N"),
    ]);
    with_user_data(&[boxed(b"GPMF", &telemetry)])
}

/// A film with the keys of a camera beside a track of this format.
fn film(format: &[u8; 4], samples: &[Vec<u8>]) -> Vec<u8> {
    tracks::film(b"meta", format, samples, &[])
}

fn sony_description() -> Vec<u8> {
    let xml = r#"<NonRealTimeMeta><Device manufacturer="Sony" modelName="ILCE-7SM3" serialNo="1"/></NonRealTimeMeta>"#;
    boxed(b"meta", &[vec![0; 4], boxed(b"xml ", &[&[0; 4], xml.as_bytes()].concat())].concat())
}

/// A file of each kind, with its camera and the readout that it states.
fn files() -> Vec<(Vec<u8>, &'static str, Option<f64>)> {
    let phone: [(&str, u32, &[u8]); 2] =
        [("com.apple.quicktime.make", 1, b"Apple"), ("com.apple.quicktime.model", 1, b"iPhone 4S")];
    let old_phone = {
        let own = keyed(
            &[("com.apple.quicktime.camera.framereadouttimeinmicroseconds", 22, &[0, 0, 0x76, 0x30])],
            &[],
        );
        let hdlr = boxed(b"hdlr", b"\0\0\0\0mhlrvide");
        boxed(b"trak", &[boxed(b"mdia", &hdlr), own].concat())
    };
    let android: [(&str, u32, &[u8]); 3] = [
        ("com.android.version", 1, b"14"),
        ("com.android.manufacturer", 1, b"Google"),
        ("com.android.model", 1, b"Pixel 8"),
    ];
    let user = [boxed(b"\xa9mak", b"\0\x05\0\0Canon"), boxed(b"\xa9mod", b"\0\x09\0\0EOS R5 C")];
    let packets = [camm::tests::packet(2, &[0, 0, 0]), camm::tests::packet(1, &[0, 16_600_000])];
    let dji = dji::tests::sample([8, 9, 11], Some(1));
    vec![
        (boxed(b"moov", &keyed(&phone, &[])), "Apple iPhone 4S", None),
        (boxed(b"moov", &[old_phone, keyed(&phone, &[])].concat()), "Apple iPhone 4S", Some(30.256)),
        (boxed(b"moov", &keyed(&android, &[0; 4])), "Google Pixel 8", None),
        (with_user_data(&user), "Canon EOS R5 C", None),
        (with_user_data(&[boxed(b"FIRM", b"HD5.02.02.00.00")]), "GoPro HERO5 Black", None),
        (gopro_file(), "GoPro HERO8 Black", Some(11.2)),
        ([boxed(b"moov", &[]), boxed(b"mdat", &[0; 9]), sony_description()].concat(), "Sony ILCE-7SM3", None),
        (
            [film(b"rtmd", &[acquisition::tests::sony()]), sony_description()].concat(),
            "Sony ILCE-7SM3",
            Some(8.7),
        ),
        (film(b"CNDM", &[acquisition::tests::canon()]), "Canon EOS R5 C", Some(15.5)),
        (film(b"djmd", &[dji]), "DJI Osmo Action 4", Some(7.8)),
        (film(b"camm", &packets), "", Some(16.6)),
        ([film(b"tmcd", &[]), insta360::records()].concat(), "Insta360 GO 2", Some(11.2)),
    ]
}

#[test]
fn each_kind_of_statement_is_read() {
    for (file, name, milliseconds) in files() {
        let stated = stated(&file);
        assert_eq!(stated.name().unwrap_or_default(), name);
        let found = stated.readout.map(|readout| readout.milliseconds);
        match (found, milliseconds) {
            (Some(found), Some(wanted)) => assert!((found - wanted).abs() < 1e-5, "{name}: {found}"),
            (found, wanted) => assert_eq!(found, wanted, "{name}"),
        }
    }
}

#[test]
fn files_that_state_nothing_have_no_statement() {
    for file in [with_user_data(&[boxed(b"FIRM", b"X1.02")]), b"no film".to_vec(), Vec::new()] {
        assert_eq!(stated(&file), Stated::default());
    }
}

#[test]
fn files_that_are_cut_or_damaged_do_no_harm() {
    // Any answer will do.
    for (file, ..) in files() {
        for end in (0..file.len()).step_by(3) {
            let _ = stated(&file[..end]);
        }
        for place in 0..file.len() {
            let mut bytes = file.clone();
            bytes[place] ^= if place % 2 == 0 { 0xff } else { 1 << (place % 8) };
            let _ = stated(&bytes);
        }
    }
}

#[test]
fn a_log_beside_the_clip_fills_what_the_file_leaves_open() {
    let folder = std::env::temp_dir().join(format!("rsrectify-gcsv-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let clip = folder.join("clip.mp4");
    let log =
        "GYROFLOW IMU LOG\nvendor,potatocam\nframe_readout_time,20\nframe_readout_direction,1\nt,gx,gy,gz\n";
    std::fs::write(folder.join("clip.gcsv"), log).unwrap();
    std::fs::write(&clip, film(b"tmcd", &[])).unwrap();
    let readout = read(&clip).readout.unwrap();
    assert_eq!((readout.milliseconds, readout.direction), (20.0, Some(ReadoutDirection::BottomToTop)));
    std::fs::write(&clip, gopro_file()).unwrap();
    assert_eq!(read(&clip).readout.unwrap().source, "GPMF SROT");
    std::fs::remove_dir_all(folder).unwrap();
}

/// A file among those of real cameras.
fn real(name: &str) -> Option<PathBuf> {
    let file = std::env::var_os("RSRECTIFY_DATA").map(|data| PathBuf::from(data).join("zoo").join(name));
    let file = file.filter(|file| file.exists());
    if file.is_none() {
        eprintln!("skipped: RSRECTIFY_DATA names no folder with zoo/{name}");
    }
    file
}

#[test]
fn files_of_cameras_are_read() {
    let Some(gopro) = real("gopro-max-hero.mp4") else { return };
    let stated = read(&gopro);
    assert_eq!(
        (stated.name().unwrap(), stated.orientation.unwrap()),
        ("GoPro Max".to_owned(), "up".to_owned())
    );
    assert!((stated.readout.unwrap().milliseconds - 20.6008).abs() < 1e-3);
    let stabilisation = stated.stabilisation.unwrap();
    assert!(stabilisation.is_on && stabilisation.name.unwrap() == "HS HLevel");
    for (name, milliseconds) in [("iphone4s-sideways.mov", 30.256), ("iphone5-portrait.mov", 28.512)] {
        let Some(phone) = real(name) else { return };
        let stated = read(&phone);
        assert_eq!(stated.name().unwrap(), "Apple iPhone 4S");
        assert!((stated.readout.unwrap().milliseconds - milliseconds).abs() < 1e-9, "{name}");
    }
}

#[test]
fn files_of_cameras_may_be_damaged() {
    let Some(gopro) = real("gopro-max-hero.mp4") else { return };
    let whole = std::fs::read(gopro).unwrap();
    let start = whole.windows(4).rposition(|name| name == b"moov").unwrap() - 4;
    // The index alone, so that many can be tried.
    let index = &whole[start..];
    assert!(stated(index).readout.is_some());
    for step in 0..400 {
        let place = index.len() * step / 400;
        let _ = stated(&index[..place]);
        let mut bytes = index.to_vec();
        bytes[place] ^= 0x5a;
        let _ = stated(&bytes);
    }
}
