use eval::cache::Cache; use eval::footage::Footage; use eval::sequence::named; use nalgebra::{DMatrix, DVector, Vector2};
use rsrectify::motion::image_centre; use rsrectify::solve::continuous::generators;
fn main() {
    let cache = Cache::in_default_folder().unwrap();
    for name in std::env::args().skip(1) { for seed in 1..=3 {
        let mut set = named(&name).unwrap(); set.seed = seed;
        let f = Footage::load(&set, None, &cache).unwrap();
        let r = f.readout(); let c = image_centre(r.width, r.height); let rad = r.width as f64 / 2.0;
        let (mut left, mut all, mut n) = ([0.0; 2], 0.0, 0);
        for t in &f.truth {
            for (which, cols) in [(0, vec![0usize,1,2,3,4,5,6,7]), (1, vec![2,3,4])] {
            let rows = 2 * t.samples.len();
            let mut a = DMatrix::zeros(rows, cols.len()); let mut b = DVector::zeros(rows);
            for (i, s) in t.samples.iter().enumerate() {
                let share = 0.5 - r.share(s.seen.x, s.seen.y);
                let fl = generators::fields((s.seen - c) / rad, 0.25);
                for k in 0..2 { for (q, j) in cols.iter().enumerate() { a[(2 * i + k, q)] = fl[k][*j] * share; } }
                let d: Vector2<f64> = s.truth - s.seen; b[2 * i] = d.x; b[2 * i + 1] = d.y;
            }
            let x = (a.transpose() * &a + DMatrix::identity(cols.len(), cols.len()) * 1e-9).cholesky().unwrap().solve(&(a.transpose() * &b));
            left[which] += (&a * x - &b).norm_squared(); if which == 0 { all += b.norm_squared(); n += rows / 2; }
            }
        }
        println!("{name} {seed}: {:.2} px, homography velocity {:.1} %, twist {:.1} %", (all / n as f64).sqrt(), 100.0 * (left[0] / all).sqrt(), 100.0 * (left[1] / all).sqrt());
    } }
}
