//! How well the library finds the readout from the picture alone.

use crate::correspondences::{Follower, Source, of_run};
use crate::footage::Footage;
use crate::media::Clip;
use crate::metrics::readout::{error, signed_ratio};
use anyhow::Result;
use rsrectify::readout::{Readout, ReadoutTime};
use rsrectify::solve::shutter::{ReadoutEstimate, ShutterEstimator};

/// The heading of the rows of [`row`].
pub const HEADING: &str = "| sequence | seed | true ratio | found | ± | verdict | confidence | error |\n\
                           |---|---|---|---|---|---|---|---|";

/// What the library finds in rendered footage, given all of it.
///
/// # Errors
/// If the frames cannot be followed.
pub fn of_footage(footage: &Footage) -> Result<Option<ReadoutEstimate>> {
    let settings = footage.settings();
    let mut estimator = ShutterEstimator::new(settings.width, settings.height);
    for run in footage.runs() {
        let pairs = of_run(footage, &run, Source::Sampler)?;
        for (pair, frames) in pairs.iter().zip(run.windows(2)) {
            estimator.push(pair, footage.stamps[frames[1]] - footage.stamps[frames[0]]);
        }
        estimator.reset_pair();
    }
    Ok(estimator.estimate())
}

/// What the library finds in a real clip.
///
/// # Errors
/// If the frames cannot be followed.
pub fn of_clip(clip: &Clip) -> Result<Option<ReadoutEstimate>> {
    let mut estimator = ShutterEstimator::new(clip.width, clip.height);
    let mut follower = Follower::new(clip.width, clip.height);
    for frame in &clip.frames {
        if let Some(pairs) = follower.follow(frame)? {
            estimator.push(&pairs, 1.0 / clip.fps);
        }
    }
    Ok(estimator.estimate())
}

/// Direction and signed ratio, standard error in periods, verdict and confidence, as cells of a table;
/// `fps` are the frames a second.
pub fn cells(found: &ReadoutEstimate, size: [usize; 2], fps: f64) -> String {
    let ratio = signed_ratio(&readout(found, size, fps), 1.0 / fps);
    let ReadoutEstimate { direction, verdict, confidence, .. } = found;
    let error = found.standard_error * fps;
    format!("{direction:?} {ratio:+.3} | {error:.3} | {verdict:?} | {confidence:.2}")
}

/// A row of the table: ratios are signed, the error is that of [`error`], in frame periods.
///
/// # Errors
/// If the frames cannot be followed.
pub fn row(footage: &Footage) -> Result<String> {
    let (settings, truth) = (footage.settings(), footage.readout());
    let (size, fps) = ([settings.width, settings.height], settings.delivered_fps());
    let ratio = signed_ratio(&truth, 1.0 / fps);
    let found = of_footage(footage)?.map_or("– | – | – | – | –".into(), |found| {
        let distance = error(&readout(&found, size, fps), &truth, 1.0 / fps);
        format!("{} | {distance:.3}", cells(&found, size, fps))
    });
    Ok(format!("| {} | {} | {:?} {ratio:+.3} | {found} |", settings.name, settings.seed, truth.direction()))
}

fn readout(found: &ReadoutEstimate, [width, height]: [usize; 2], fps: f64) -> Readout {
    Readout::new(width, height, found.direction, ReadoutTime::Seconds(found.time), 1.0 / fps)
        .expect("estimates are finite and not negative")
}
