//! How well the library finds the readout from the picture.

use crate::cache::Cache;
use crate::correspondences::{GRID, Source, of_run};
use crate::footage::{Footage, direction};
use crate::sequence::{Sequence, Settings};
use anyhow::Result;
use nalgebra::Vector2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rsrectify::correspond::Correspondence;
use rsrectify::solve::shutter::{ReadoutEstimate, ShutterEstimator};

/// Pairs.
pub type Runs = Vec<Vec<(Vec<Correspondence>, f64)>>;

/// From the truth with noise.
pub fn exact(settings: &Settings, noise: f64) -> Result<Runs> {
    let sequence = Sequence::new(settings.clone());
    let deliveries = sequence.deliveries();
    let mut frames: Vec<usize> = (0..deliveries.len()).collect();
    frames.dedup_by_key(|index| deliveries[*index].capture);
    let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
    let normal = Normal::new(0.0, noise)?;
    let mut runs: Runs = vec![vec![]];
    for pair in frames.windows(2) {
        let (a, b) = (deliveries[pair[0]], deliveries[pair[1]]);
        if sequence.take_index(a.capture) != sequence.take_index(b.capture) {
            runs.push(vec![]);
            continue;
        }
        let mut found =
            sequence.capture(a.capture).exact_correspondences(&sequence.capture(b.capture), GRID[0], GRID[1]);
        for c in &mut found {
            c.to += Vector2::new(normal.sample(&mut random), normal.sample(&mut random));
        }
        runs.last_mut().unwrap().push((found, b.stamp - a.stamp));
    }
    Ok(runs)
}

/// From pictures.
pub fn sampled(settings: &Settings) -> Result<Runs> {
    let footage = Footage::load(settings, None, &Cache::in_default_folder()?)?;
    let mut runs = Vec::new();
    for run in footage.runs() {
        let found = of_run(&footage, &run, Source::Sampler)?;
        let stamps = run.windows(2).map(|p| footage.stamps[p[1]] - footage.stamps[p[0]]);
        runs.push(found.into_iter().zip(stamps).collect());
    }
    Ok(runs)
}

/// Estimates after each checkpoint.
pub fn estimates(settings: &Settings, runs: &Runs, checkpoints: &[usize]) -> Vec<Option<ReadoutEstimate>> {
    let mut estimator = ShutterEstimator::new(settings.width, settings.height);
    let mut out = vec![];
    let mut n = 0;
    for run in runs {
        for (c, dt) in run {
            estimator.push(c, *dt);
            n += 1;
            if checkpoints.contains(&n) {
                out.push(estimator.estimate());
            }
        }
        estimator.reset_pair();
    }
    out.push(estimator.estimate());
    out
}

/// Truth signed: rows, columns.
pub fn truth(settings: &Settings) -> [f64; 2] {
    let d = direction(settings.first);
    let g = settings.readout_time() * settings.delivered_fps();
    let g = if d.is_reversed() { -g } else { g };
    if d.is_by_rows() { [g, 0.0] } else { [0.0, g] }
}
