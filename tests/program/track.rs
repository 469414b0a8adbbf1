// SPDX-License-Identifier: MIT OR Apache-2.0

//! `rsrectify track`, run as a user runs it.

use crate::common::shake::{shake, write_shaken};
use crate::shared::{CLIP, Folder, rsrectify, undocumented};
use serde_json::Value;
use std::path::Path;
use std::process::Output;

fn track(clip: &Path, options: &[&str]) -> Output {
    rsrectify("track").arg(clip).args(options).output().unwrap()
}

/// The lines of a file of numbers after the line that ends its header; what is no number is not one.
fn numbers(path: &Path, header: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().skip_while(|line| *line != header).skip(1);
    lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect()
}

/// How fast the picture of the shaken film moves, px/s.
fn truth(time: f64) -> [f64; 2] {
    let step = 1e-4;
    let (before, after) = (shake(time - step), shake(time + step));
    [(after.0 - before.0) / (2.0 * step), (after.1 - before.1) / (2.0 * step)]
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / f64::from(count)).sqrt()
}

#[test]
fn rows_and_gyroscope_follow_a_shaken_camera() {
    let folder = Folder::new("track");
    let clip = folder.file("shaken.mp4");
    write_shaken(&clip, 1.5);
    let [rows, gcsv, json, csv] =
        ["rows.csv", "shaken.gcsv", "all.json", "frames.csv"].map(|name| folder.file(name));
    let file = |path: &Path| path.to_str().unwrap().to_owned();
    let (rows_file, gcsv_file) = (file(&rows), file(&gcsv));
    let (json_file, csv_file) = (file(&json), file(&csv));
    let options = [
        "--rows-csv",
        &rows_file,
        "--gcsv",
        &gcsv_file,
        "--json",
        &json_file,
        "--csv",
        &csv_file,
        "--focal-length",
        "2",
        "--readout-time",
        "20",
        "--readout-direction",
        "bottom-to-top",
    ];
    let output = track(&clip, &options);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let frames = numbers(&csv, std::fs::read_to_string(&csv).unwrap().lines().next().unwrap()).len();
    assert!(frames >= 44);
    let rows = numbers(&rows, "frame,line,time,dx,dy,vx,vy,omega");
    assert_eq!(rows.len(), frames * 240);
    for (axis, column) in [(0, 5), (1, 6)] {
        let speed = root_mean_square(rows.iter().map(|row| truth(row[2])[axis]));
        let error = root_mean_square(rows.iter().map(|row| row[column] - truth(row[2])[axis]));
        assert!(error < 0.15 * speed, "axis {axis}: {error} of {speed} px/s");
    }
    // The bottom row is read first.
    assert!((rows[239][2] - 20e-3 * 0.5 / 240.0).abs() < 1e-5 && rows[0][2] > 19.9e-3);

    // Through a long lens a shift across the frame of f pixels is a turn of a radian; Gyroflow's times count from
    // mid-readout, and its first axis points up, its second to the left.
    let text = std::fs::read_to_string(&gcsv).unwrap();
    assert!(text.starts_with("GYROFLOW IMU LOG\nversion,1.3\nid,rsrectify\norientation,XYZ\n"), "{text}");
    assert!(text.contains("\nframe_readout_time,20.000\nframe_readout_direction,1\n"));
    assert!(text.contains("\ntscale,0.000001\ngscale,1.0\nt,gx,gy,gz\n"));
    let turns = numbers(&gcsv, "t,gx,gy,gz");
    let focal = 2.0 * 320.0;
    for (axis, column, sign) in [(0, 1, 1.0), (1, 2, -1.0)] {
        let turn = |row: &Vec<f64>| sign * truth(row[0] * 1e-6 + 10e-3)[axis] / focal;
        let speed = root_mean_square(turns.iter().map(turn));
        let error = root_mean_square(turns.iter().map(|row| row[column] - turn(row)));
        assert!(error < 0.15 * speed, "axis {axis}: {error} of {speed} rad/s");
    }

    let all: Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    let (list, last) = (all.as_array().unwrap(), frames - 1);
    assert_eq!((list.len(), list[last]["rows"].as_array().unwrap().len()), (frames, 240));
    let row = &list[last]["rows"][7];
    assert!((row["vx"].as_f64().unwrap() - rows[last * 240 + 7][5]).abs() < 1e-3);
    assert_eq!(list[0]["readout_direction"], "bottom-to-top");
    assert!(list.iter().all(|frame| frame["as_recorded"].is_null()));
    assert_eq!(undocumented(&all, "## rsrectify track"), [""; 0]);
    let text = std::fs::read_to_string(&csv).unwrap();
    let columns: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    assert!(columns.iter().all(|column| list[0].get(column).is_some()), "{columns:?}");
}

#[test]
fn what_cannot_be_written_is_refused() {
    let folder = Folder::new("refused-track");
    let clip = folder.clip("still.mp4", "mp4mux", CLIP);
    let gcsv = folder.file("still.gcsv");
    let output = track(&clip, &["--gcsv", gcsv.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("--focal-length"), "{said}");
    let csv = folder.file("there.csv");
    std::fs::write(&csv, "mine").unwrap();
    let output = track(&clip, &["--csv", csv.to_str().unwrap()]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("--overwrite"));
    assert_eq!((output.status.code(), std::fs::read_to_string(&csv).unwrap().as_str()), (Some(1), "mine"));
    assert_eq!(folder.names(), ["still.mp4", "there.csv"]);
    // Without a file, a line for each frame is printed.
    let output = track(&clip, &["--readout-time", "10"]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert_eq!(printed.lines().count(), 31, "{printed}");
    assert!(printed.starts_with("frame,time,"), "{printed}");
    // The clip has no texture to follow.
    assert!(printed.lines().skip(1).all(|line| line.ends_with(",no motion was found")), "{printed}");
}

/// Against the gyroscope of the phone that recorded a clip.
#[test]
fn a_phones_gyroscope_bears_out_axes_and_times() {
    let Some(data) = std::env::var_os("RSRECTIFY_DATA") else {
        eprintln!("skipped: RSRECTIFY_DATA does not name the folder with the phone clip");
        return;
    };
    let phone = Path::new(&data).join("phone");
    let folder = Folder::new("phone");
    let gcsv = folder.file("phone.gcsv");
    let output = track(&phone.join("phone.mp4"), &["--gcsv", gcsv.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(&gcsv).unwrap();
    let readout = text.lines().find_map(|line| line.strip_prefix("frame_readout_time,")).unwrap();
    let readout: f64 = readout.parse::<f64>().unwrap() * 1e-3;
    let turns = numbers(&gcsv, "t,gx,gy,gz");
    let gyro = numbers(&phone.join("gyro.csv"), "wx_rad_s,wy_rad_s,wz_rad_s,t_s");
    let measured = |time: f64, axis: usize| {
        let next = gyro.partition_point(|sample| sample[3] < time).clamp(1, gyro.len() - 1);
        let (before, after) = (&gyro[next - 1], &gyro[next]);
        let share = (time - before[3]) / (after[3] - before[3]);
        before[axis] + share * (after[axis] - before[axis])
    };
    // The gyroscope's clock is 0 when the readout of the first frame begins, Gyroflow's in its middle.
    let difference = |axis: usize, offset: f64| {
        root_mean_square(turns.iter().map(|row| row[1 + axis] - measured(row[0] * 1e-6 + offset, axis)))
    };
    let turn = |axis| root_mean_square(turns.iter().map(|row| measured(row[0] * 1e-6 + readout / 2.0, axis)));
    for (axis, name) in ["gx", "gy", "gz"].into_iter().enumerate() {
        let (left, whole) = (difference(axis, readout / 2.0), turn(axis));
        println!("{name}: RMS difference {left:.4} rad/s of {whole:.4} rad/s");
    }
    // About its own upward axis the phone hardly turns: there the picture moves because the car drives on.
    assert!(difference(1, readout / 2.0) < 0.3 * turn(1));
    assert!(difference(2, readout / 2.0) < turn(2));
    for offset in [0.0, readout] {
        assert!(difference(1, offset) > 1.5 * difference(1, readout / 2.0), "{offset}");
    }
}
