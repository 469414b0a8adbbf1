// SPDX-License-Identifier: MIT OR Apache-2.0

//! A clip's own gyroscope: where each frame sees what is far away.

use super::tracks::Tracks;
use anyhow::{Context, Result, ensure};
use baselines::correspondences::Follower;
use nalgebra::{Rotation3, Vector3};
use render::media::Clip;
use render::scene::{FirstEdge, Lens, Pose, RollingCamera, Scene, Shutter, Surface};
use render::sequence::{Take, Warp};
use render::truth::Capture;
use rsrectify::correspond::Correspondence;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How far away everything is, in metres.
const FAR: f64 = 1e6;
/// Pixels within which the motion of a far point between two frames agrees: what the recording of a phone is off by.
const AGREED: f64 = 1.0;

/// The recording of a gyroscope and the camera that it sat in.
#[derive(clap::Args, Clone, Debug)]
pub struct Gyroscope {
    /// A folder with `gyro.csv`, rates wx, wy, wz in radians a second and the time in seconds, and `frames.csv`, the number of
    /// each frame and the start of its readout. What is seen in the direction n (x to the right, y downwards, z ahead) is seen in
    /// n + dt·ω × n after the time dt, ω = (wy, wx, wz).
    #[arg(long = "gyroscope", value_name = "FOLDER", required = false, requires_all = ["clip", "focal", "readout"])]
    pub folder: PathBuf,
    /// Focal length of the clip in pixels.
    #[arg(long, required = false, requires = "folder")]
    pub focal: f64,
    /// Its readout time in seconds, from the top row to the bottom one.
    #[arg(long, required = false, requires = "folder")]
    pub readout: f64,
}

impl Gyroscope {
    /// The far points of a clip's frames: those whose motion in the picture agrees with the gyroscope.
    ///
    /// # Errors
    /// If a file cannot be read, or there are fewer times than frames.
    pub(super) fn tracks(&self, clip: &Clip) -> Result<Tracks> {
        let rates = numbers(&self.folder.join("gyro.csv"))?;
        let starts = numbers(&self.folder.join("frames.csv"))?;
        ensure!(starts.len() >= clip.frames.len(), "{} times of {} frames", starts.len(), clip.frames.len());
        let starts: Vec<f64> = starts.iter().filter_map(|line| line.get(1).copied()).collect();
        let turns = turns(&rates)?;
        let wall = Surface::new(
            Vector3::new(-4.0 * FAR, -4.0 * FAR, FAR),
            Vector3::new(8.0 * FAR, 0.0, 0.0),
            Vector3::new(0.0, 8.0 * FAR, 0.0),
        );
        let camera = RollingCamera {
            lens: Lens::pinhole(clip.width, clip.height, self.focal),
            shutter: Shutter { first: FirstEdge::Top, readout: self.readout, open: 0.0 },
            path: Box::new(move |t: f64| Pose { rotation: turn_at(&turns, t), position: Vector3::zeros() }),
        };
        let take = Take { scene: Arc::new(Scene { surfaces: vec![wall], ..Scene::default() }), camera };
        let capture = |start: &f64| Capture { take: &take, start: *start, warp: Warp::default() };
        let run: Vec<_> = starts.iter().take(clip.frames.len()).map(capture).enumerate().collect();
        let mut follower = Follower::new(clip.width, clip.height);
        let pairs = clip.frames.iter().map(|frame| follower.follow(frame));
        let pairs: Vec<_> = pairs.filter_map(Result::transpose).collect::<Result<_>>()?;
        let mut tracks = Tracks::default();
        for (frames, pairs) in run.windows(3).zip(pairs.iter().skip(1)) {
            let [_, (_, own), (_, next)] = frames else { continue };
            let is_far = |pair: &&Correspondence| {
                own.seen_by(next, pair.from).is_some_and(|to| (to - pair.to).norm() < AGREED)
            };
            tracks.add_points(frames, pairs.iter().filter(is_far).map(|pair| pair.from));
        }
        Ok(tracks)
    }
}

/// Turns from the camera to the world, by time, from rates: they are taken to be even between two lines.
fn turns(rates: &[Vec<f64>]) -> Result<Vec<(f64, Rotation3<f64>)>> {
    let mut turns: Vec<(f64, Rotation3<f64>)> = Vec::with_capacity(rates.len());
    let mut last = Vector3::zeros();
    for line in rates {
        let [x, y, z, time] = line.as_slice() else {
            anyhow::bail!("gyro.csv: a line of {} numbers", line.len());
        };
        let rate = Vector3::new(*y, *x, *z);
        let turn = turns.last().map_or(Rotation3::identity(), |(before, turn)| {
            // The world turns by the rate as the camera sees it, the camera the other way.
            turn * Rotation3::new((rate + last) * (-0.5 * (time - before)))
        });
        turns.push((*time, turn));
        last = rate;
    }
    ensure!(turns.len() > 1, "gyro.csv has no rates");
    Ok(turns)
}

fn turn_at(turns: &[(f64, Rotation3<f64>)], time: f64) -> Rotation3<f64> {
    let after = turns.partition_point(|(at, _)| *at <= time).clamp(1, turns.len() - 1);
    let [(from, first), (to, second)] = [turns[after - 1], turns[after]];
    first.slerp(&second, ((time - from) / (to - from)).clamp(0.0, 1.0))
}

/// The lines of numbers of a file with a heading.
fn numbers(file: &Path) -> Result<Vec<Vec<f64>>> {
    let text = fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    let line = |line: &str| line.split(',').map(|value| Ok(value.trim().parse()?)).collect();
    text.lines().skip(1).map(line).collect::<Result<_>>().with_context(|| format!("{}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ahead_moves_as_the_rates_say() {
        let rates: Vec<Vec<f64>> = (0..100).map(|k| vec![0.1, -0.2, 0.3, f64::from(k) * 0.01]).collect();
        let turns = turns(&rates).unwrap();
        let (dt, n) = (1e-4, Vector3::new(0.2, 0.1, 1.0));
        let world = turn_at(&turns, 0.5) * n;
        let later = turn_at(&turns, 0.5 + dt).inverse() * world;
        let expected = Vector3::new(-0.2, 0.1, 0.3).cross(&n);
        assert!(((later - n) / dt - expected).norm() < 1e-3, "{}", (later - n) / dt);
    }
}
