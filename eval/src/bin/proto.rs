use eval::cache::Cache;
use eval::correspondences::{self, Source};
use eval::footage::Footage;
use eval::methods::Correction;
use eval::metrics::displacement;
use eval::sequence::named;
use nalgebra::Vector2;
use rsrectify::motion::image_centre;
use rsrectify::solve::continuous::{generators::COUNT, pair::Match, path::Flow, running::Running, window::{Pair, Solver, Tuning}};
type V2 = Vector2<f64>;
fn env(name: &str, default: f64) -> f64 { std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default) }

struct Frame { flow: Flow, centre: V2, size: [f64; 2], rows: bool, stamp: f64, readout: f64, radius: f64 }
impl Frame { fn share(&self, p: V2) -> f64 { share(p, self.size, self.rows) } }
fn share(p: V2, size: [f64; 2], rows: bool) -> f64 { if rows { (p.y + 0.5) / size[1] } else { (p.x + 0.5) / size[0] } }
impl Correction for Frame {
    fn correct(&self, pixel: V2) -> V2 {
        let t = self.stamp + self.readout * self.share(pixel);
        self.flow.carry((pixel - self.centre) / self.radius, t, self.stamp + 0.5 * self.readout) * self.radius + self.centre
    }
}

fn main() {
    let names: Vec<String> = std::env::args().skip(1).collect();
    let (past, ahead) = (env("PAST", 4.0) as usize, env("AHEAD", 4.0) as usize);
    let exact = env("EXACT", 0.0) > 0.0;
    let per = env("PER", 1.0);
    let cache = Cache::in_default_folder().unwrap();
    for name in names { for seed in 1..=env("SEEDS", 1.0) as u64 {
        let mut set = named(&name).unwrap();
        set.seed = seed;
        if env("FRAMES", 0.0) > 0.0 { set.frames = env("FRAMES", 0.0) as usize; }
        let footage = Footage::load(&set, None, &cache).unwrap();
        let run: Vec<usize> = footage.runs()[0].clone();
        let found = correspondences::of_run(&footage, &run, if exact { Source::Exact } else { Source::Sampler }).unwrap();
        let r = footage.readout();
        let period = 1.0 / footage.settings().fps;
        let c = image_centre(r.width, r.height);
        let size = [r.width as f64, r.height as f64];
        let rows = r.direction.is_by_rows();
        let truth = per * r.time / period * if r.direction.is_reversed() { -1.0 } else { 1.0 };
        let radius = r.width as f64 / 2.0;
        let pairs: Vec<Pair> = found.iter().enumerate().map(|(k, list)| Pair { stamps: [per * k as f64, per * (k + 1) as f64], matches: list.iter().map(|p| Match {
            from: (p.from - c) / radius, to: (p.to - c) / radius, from_share: share(p.from, size, rows), to_share: share(p.to, size, rows) }).collect() }).collect();
        let unknown = env("UNKNOWN", 0.0) > 0.0;
        let unknown_f = env("UNKNOWNF", 0.0) > 0.0;
        let tuning = Tuning { noise: env("SIGMA", 0.03), active: [true; COUNT], first_bend: env("QF", 1.0), slow_bend: env("QS", 0.01), rate: env("RATE", 100.0), share: 1.0 / (past + ahead) as f64 };
        let readout = if unknown { Running::new(env("G0", 0.0), env("GS", 0.5)) } else { Running::new(truth, 1e-6) };
        let f = env("F", 1.0) * size[0].max(size[1]);
        let kappa = if unknown_f { Running::new(0.3, 0.3) } else { Running::new((radius / f).powi(2), 1e-6) };
        let mut solver = Solver::new(tuning, radius, readout, kappa);
        let n = run.len();
        let mut corrections: Vec<Box<dyn Correction>> = Vec::new();
        let (mut time, mut steps) = (0.0, 0);
        let mut moved = false;
        for k in 0..n {
            let lo = k.saturating_sub(past);
            let hi = (k + ahead).min(n - 1);
            let list: Vec<&Pair> = pairs[lo..hi].iter().collect();
            if list.is_empty() { corrections.push(Box::new(|x: V2| x)); continue; }
            let iters = if k < 2 { env("FIRST", 12.0) as usize } else { env("ITERS", 1.0) as usize };
            let t0 = std::time::Instant::now();
            let mut it = 0; let most = iters.max(env("MOST", 6.0) as usize);
            while it < iters || (it < most && moved) { let g = solver.shared[0]; if solver.step(&list).is_none() { println!("frame {k}: not solved"); } moved = (solver.shared[0] - g).abs() > 0.01; it += 1; }
            solver.remember();
            time += t0.elapsed().as_secs_f64(); steps += it;
            let [from, to] = solver.span(&list).unwrap();
            let g = solver.shared[0];
            corrections.push(Box::new(Frame { flow: solver.flow(from.min(per * k as f64 + g.min(0.0)), to.max(per * k as f64 + g.max(0.0)) + 0.1), centre: c, size, rows, stamp: per * k as f64, readout: g, radius }));
            if env("VERB", 0.0) > 0.0 { print!("{:.3}±{:.3} ", g / per, solver.readout.deviation() / per); }
        }
        let truths: Vec<_> = run.iter().map(|i| footage.truth[*i].clone()).collect();
        let left = displacement::left(&truths, &corrections);
        let from = env("FROM", 0.0) as usize;
        let late = displacement::left(&truths[from..], &corrections[from..]);
        let u = footage.uncorrected();
        let db = |v: [f64; COUNT]| v.map(|v| (v.log10() * 10.0).round() / 10.0);
        println!("{name} {seed}: {:.2} -> {:.3} px = {:.1} % (late {:.1} %)  {:.1} ms/step  gamma {:.4}±{:.4} ({:.4}) kappa {:.3}±{:.3} ({:.3}) sigma {:.3} bend {:?}", u.rms, left.rms, 100.0 * left.rms / u.rms.max(1e-9), 100.0 * late.rms / u.rms.max(1e-9), 1e3 * time / steps as f64,
            solver.shared[0] / per, solver.readout.deviation() / per, truth / per, solver.shared[1], solver.kappa.deviation(), (radius / f).powi(2), solver.sigma, db(solver.bend));
        if env("PERFRAME", 0.0) > 0.0 {
            for k in 0..n { print!("{:.2} ", displacement::left(&truths[k..k+1], &corrections[k..k+1]).rms); }
            println!();
        }
    } }
}
