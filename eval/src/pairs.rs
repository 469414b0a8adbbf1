// SPDX-License-Identifier: MIT OR Apache-2.0

//! Two-frame clips with a global-shutter truth, as public data sets have them.
//!
//! | data set | rolling frames | global frame at the middle row |
//! |---|---|---|
//! | a clip alone | `rs_0`, `rs_1` | `gs_1_m` |
//! | Carla-RS (P. Liu et al., *Deep shutter unrolling network*, CVPR 2020) | `0000_rs`, `0001_rs`, … | `0001_gs_m` |
//! | Fastec-RS (the same) | `000_rolling`, `001_rolling`, … | `001_global_middle` |
//! | BS-RSC (M. Cao et al., *Learning adaptive warping for real-world rolling shutter correction*, CVPR 2022) | `RS/00000000`, `RS/00000001`, … | `GS/00000001` |
//!
//! Every two frames with successive numbers are a clip, where the second has its truth. It is the
//! second that is rectified, from these two frames alone, as the data sets' authors do it.

use crate::metrics::colour::{psnr, ssim};
use crate::metrics::resample::rectified;
use crate::shutter::Shutter;
use crate::systems::product::{corrected, motions};
use anyhow::{Context, Result, ensure};
use indicatif::{ProgressBar, ProgressIterator};
use render::scene::Frame;
use rsrectify::Rectifier;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Nominal seconds between two frames; only the readout's share of it matters.
const PERIOD: f64 = 1.0 / 30.0;

/// The three pictures of a clip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Its folder below the one searched, and the number of its second frame.
    pub name: String,
    /// The two rolling-shutter frames.
    pub rolling: [PathBuf; 2],
    /// What a global shutter saw in the middle of the second one's readout.
    pub global: PathBuf,
}

/// How like the truth a picture is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Peak signal-to-noise ratio in dB.
    pub psnr: f64,
    /// Mean structural similarity.
    pub ssim: f64,
}

/// How a clip fared, inside the part of the picture that the rectified frame covers.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// The clip.
    pub name: String,
    /// The frame as it arrived.
    pub input: Likeness,
    /// The frame as the library rectified it.
    pub rectified: Likeness,
    /// The library's trust in its motion, 0 to 1.
    pub confidence: f64,
}

/// What is there of a numbered frame.
#[derive(Default)]
struct Numbered {
    rolling: Option<PathBuf>,
    global: Option<PathBuf>,
}

#[derive(Clone, Copy)]
enum Role {
    Rolling,
    Global,
}

/// Finds the clips in a folder and the folders below it, in order.
///
/// # Errors
/// If a folder cannot be read or there is no clip.
pub fn find(folder: &Path) -> Result<Vec<Pair>> {
    let mut frames = BTreeMap::<(PathBuf, usize), Numbered>::new();
    collect(folder, &mut frames)?;
    let pairs: Vec<Pair> = frames
        .iter()
        .filter_map(|((place, number), second)| {
            let first = frames.get(&(place.clone(), number.checked_sub(1)?))?;
            let below = place.strip_prefix(folder).unwrap_or(place);
            Some(Pair {
                name: below.join(number.to_string()).display().to_string(),
                rolling: [first.rolling.clone()?, second.rolling.clone()?],
                global: second.global.clone()?,
            })
        })
        .collect();
    ensure!(
        !pairs.is_empty(),
        "no two-frame clip in {}: it takes rs_0, rs_1 and gs_1_m, or NNNN_rs and NNNN_gs_m, or NNN_rolling and \
         NNN_global_middle, or RS/NNN and GS/NNN (.png or .jpg)",
        folder.display()
    );
    Ok(pairs)
}

fn collect(folder: &Path, frames: &mut BTreeMap<(PathBuf, usize), Numbered>) -> Result<()> {
    let unreadable = || format!("cannot read the folder {}", folder.display());
    for entry in fs::read_dir(folder).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        if path.is_dir() {
            collect(&path, frames)?;
        } else if let Some((place, number, role)) = recognised(&path) {
            let frame = frames.entry((place, number)).or_default();
            match role {
                Role::Rolling => frame.rolling = Some(path),
                Role::Global => frame.global = Some(path),
            }
        }
    }
    Ok(())
}

/// The sequence (its folder), number and role that the name of a picture tells.
fn recognised(path: &Path) -> Option<(PathBuf, usize, Role)> {
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    if !["png", "jpg", "jpeg"].contains(&extension.as_str()) {
        return None;
    }
    let (folder, stem) = (path.parent()?, path.file_stem()?.to_str()?);
    let suffixes = [
        ("_rs", Role::Rolling),
        ("_gs_m", Role::Global),
        ("_rolling", Role::Rolling),
        ("_global_middle", Role::Global),
    ];
    for (suffix, role) in suffixes {
        if let Some(number) = stem.strip_suffix(suffix) {
            return Some((folder.into(), number.parse().ok()?, role));
        }
    }
    match stem {
        "rs_0" => return Some((folder.into(), 0, Role::Rolling)),
        "rs_1" => return Some((folder.into(), 1, Role::Rolling)),
        "gs_1_m" => return Some((folder.into(), 1, Role::Global)),
        _ => {}
    }
    let role = match folder.file_name()?.to_str()? {
        "RS" => Role::Rolling,
        "GS" => Role::Global,
        _ => return None,
    };
    Some((folder.parent()?.into(), stem.parse().ok()?, role))
}

/// Rectifies the second frame of each clip and judges it, with a progress bar.
///
/// # Errors
/// If the shutter is nonsense, or a picture cannot be read or is of another size than the others.
pub fn score(pairs: &[Pair], shutter: &Shutter) -> Result<Vec<Score>> {
    let bar = ProgressBar::new(pairs.len() as u64);
    pairs.iter().progress_with(bar).map(|pair| scored(pair, shutter)).collect()
}

fn scored(pair: &Pair, shutter: &Shutter) -> Result<Score> {
    let [first, second] = [read(&pair.rolling[0])?, read(&pair.rolling[1])?];
    let truth = read(&pair.global)?;
    let size = |frame: &Frame| (frame.width, frame.height);
    ensure!(
        size(&first) == size(&second) && size(&second) == size(&truth),
        "the pictures of {} are of different sizes",
        pair.name
    );
    let settings = shutter.settings(PERIOD, 1)?;
    let mut rectifier = Rectifier::new(settings, truth.width, truth.height, Some(PERIOD))?;
    let solutions = motions(&mut rectifier, [(&first, 0.0), (&second, PERIOD)])?;
    let solution = &solutions[1];
    let rectified = rectified(&second, &move |pixel| corrected(solution, pixel));
    let likeness = |picture: &Frame| -> Option<Likeness> {
        let mask = &rectified.inside;
        Some(Likeness { psnr: psnr(picture, &truth, mask)?, ssim: ssim(picture, &truth, mask)? })
    };
    let covered = || format!("the rectified frame of {} covers nothing", pair.name);
    Ok(Score {
        name: pair.name.clone(),
        input: likeness(&second).with_context(covered)?,
        rectified: likeness(&rectified.frame).with_context(covered)?,
        confidence: solution.confidence,
    })
}

fn read(path: &Path) -> Result<Frame> {
    let picture = image::open(path).with_context(|| format!("cannot read the picture {}", path.display()))?;
    let rgb = picture.into_rgb8();
    Ok(Frame { width: rgb.width() as usize, height: rgb.height() as usize, rgb: rgb.into_raw() })
}

/// The scores and their means as a Markdown table.
pub fn table(scores: &[Score]) -> String {
    let mut table = String::from(
        "| clip | input dB | rectified dB | gain dB | input SSIM | rectified SSIM | confidence |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for score in scores {
        row(&mut table, &score.name, score.input, score.rectified, score.confidence);
    }
    let mean = |of: &dyn Fn(&Score) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
    let likeness = |of: &dyn Fn(&Score) -> Likeness| Likeness {
        psnr: mean(&|score| of(score).psnr),
        ssim: mean(&|score| of(score).ssim),
    };
    let name = format!("**mean of {}**", scores.len());
    let (input, rectified) = (likeness(&|score| score.input), likeness(&|score| score.rectified));
    row(&mut table, &name, input, rectified, mean(&|score| score.confidence));
    table
}

fn row(table: &mut String, name: &str, input: Likeness, rectified: Likeness, confidence: f64) {
    let gain = rectified.psnr - input.psnr;
    writeln!(
        table,
        "| {name} | {:.2} | {:.2} | {gain:+.2} | {:.4} | {:.4} | {confidence:.2} |",
        input.psnr, rectified.psnr, input.ssim, rectified.ssim
    )
    .expect("a string takes any text");
}

#[cfg(test)]
mod tests {
    use super::*;
    use render::sequence::{Sequence, Settings, named};
    use std::sync::OnceLock;

    /// The first two frames of a sequence, and what a global shutter sees at the second one's middle.
    fn pictures() -> &'static [Frame; 3] {
        static PICTURES: OnceLock<[Frame; 3]> = OnceLock::new();
        PICTURES.get_or_init(|| {
            let settings = Settings { width: 320, height: 240, frames: 2, ..named("rot1_B40").unwrap() };
            let sequence = Sequence::new(settings);
            let global = sequence.global(1);
            [sequence.frame(0), sequence.frame(1), global]
        })
    }

    fn save(folder: &Path, names: [&str; 3]) {
        for (frame, name) in pictures().iter().zip(names) {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            let (width, height) = (frame.width as u32, frame.height as u32);
            image::save_buffer(path, &frame.rgb, width, height, image::ColorType::Rgb8).unwrap();
        }
    }

    #[test]
    fn every_layout_is_found_and_gains() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name| folder.path().join(name);
        save(&place("alone"), ["rs_0.png", "rs_1.png", "gs_1_m.png"]);
        save(&place("carla/town/seq"), ["0004_rs.png", "0005_rs.png", "0005_gs_m.png"]);
        save(&place("fastec"), ["009_rolling.png", "010_rolling.png", "010_global_middle.png"]);
        save(&place("street"), ["RS/00000000.png", "RS/00000001.png", "GS/00000001.png"]);
        fs::write(place("alone").join("meta.log"), "not a picture").unwrap();
        let pairs = find(folder.path()).unwrap();
        let names: Vec<&str> = pairs.iter().map(|pair| pair.name.as_str()).collect();
        assert_eq!(names, ["alone/1", "carla/town/seq/5", "fastec/10", "street/1"]);
        let scores = score(&pairs, &Shutter { delay: Some(20.0), ..Shutter::default() }).unwrap();
        for score in &scores {
            let gain = score.rectified.psnr - score.input.psnr;
            assert!(gain > 3.0 && score.rectified.ssim > score.input.ssim + 0.1, "{score:?}");
            assert_eq!((score.input, score.rectified), (scores[0].input, scores[0].rectified));
        }
        assert_eq!(table(&scores).lines().count(), 2 + 4 + 1);
    }

    #[test]
    fn the_wrong_readout_direction_loses() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), ["rs_0.png", "rs_1.png", "gs_1_m.png"]);
        let pairs = find(folder.path()).unwrap();
        let with = |ratio| Shutter { readout_ratio: Some(ratio), ..Shutter::default() };
        let gain = |ratio| {
            let score = &score(&pairs, &with(ratio)).unwrap()[0];
            score.rectified.psnr - score.input.psnr
        };
        assert!(gain(-0.92) < 0.0, "{} dB", gain(-0.92));
        assert!(gain(0.0).abs() < 0.01, "a global shutter has nothing to rectify");
    }

    #[test]
    fn means_are_worked_by_hand() {
        let score = |input, rectified| Score {
            name: "a".into(),
            input: Likeness { psnr: input, ssim: 0.5 },
            rectified: Likeness { psnr: rectified, ssim: 0.75 },
            confidence: 1.0,
        };
        let table = table(&[score(20.0, 26.0), score(22.0, 30.0)]);
        let mean = table.lines().last().unwrap();
        assert_eq!(mean, "| **mean of 2** | 21.00 | 28.00 | +7.00 | 0.5000 | 0.7500 | 1.00 |");
    }

    #[test]
    fn wrong_folders_are_told_plainly() {
        let folder = tempfile::tempdir().unwrap();
        assert!(find(folder.path()).unwrap_err().to_string().contains("no two-frame clip in"));
        let missing = find(&folder.path().join("missing")).unwrap_err().to_string();
        assert!(missing.contains("cannot read the folder"), "{missing}");
        for name in ["rs_0.png", "rs_1.png", "gs_1_m.png"] {
            fs::write(folder.path().join(name), "text").unwrap();
        }
        let error = score(&find(folder.path()).unwrap(), &Shutter::default()).unwrap_err();
        assert!(error.to_string().contains("cannot read the picture"), "{error}");
    }
}
