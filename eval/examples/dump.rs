//! dump
use eval::readout;
use eval::sequence;
use std::io::Write;
fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().collect();
    let mode = &args[1];
    let frames: usize = args[2].parse()?;
    let seeds: Vec<u64> = args[3].split(',').map(|s| s.parse().unwrap()).collect();
    let names: Vec<String> = if args.len() > 4 { args[4..].to_vec() } else { sequence::catalogue().iter().map(|s| s.name.clone()).collect() };
    for seed in &seeds {
        for name in &names {
            let path = format!("/tmp/shutter/{name}.{seed}.{mode}.{frames}");
            if std::fs::exists(&path)? { continue; }
            let (w, h, fps, truth, runs);
            if name == "phone" {
                let clip = eval::media::decode("/work/shared/data/phone/phone.mp4".as_ref())?;
                let mut follower = eval::correspondences::Follower::new(clip.width, clip.height);
                let csv = std::fs::read_to_string("/work/shared/data/phone/frames.csv")?;
                let stamps: Vec<f64> = csv.lines().skip(1).map(|l| l.split(',').nth(1).unwrap().parse().unwrap()).collect();
                let mut run = vec![];
                for (k, f) in clip.frames.iter().enumerate() {
                    if let Some(c) = follower.follow(f)? { run.push((c, stamps[k] - stamps[k - 1])); }
                }
                (w, h, fps, truth, runs) = (clip.width, clip.height, 30.0, [0.9, 0.0], vec![run]);
            } else {
                let mut settings = sequence::named(name).unwrap();
                if frames > 0 { settings.frames = frames; }
                settings.seed = *seed;
                runs = if mode == "exact" { readout::exact(&settings, 0.1)? } else { readout::sampled(&settings)? };
                (w, h, fps, truth) = (settings.width, settings.height, settings.delivered_fps(), readout::truth(&settings));
            }
            let mut out = std::io::BufWriter::new(std::fs::File::create(format!("{path}.new"))?);
            let mut put = |v: f64| out.write_all(&v.to_le_bytes());
            for v in [w as f64, h as f64, fps, truth[0], truth[1], runs.len() as f64] { put(v)?; }
            for run in &runs {
                put(run.len() as f64)?;
                for (c, dt) in run {
                    put(*dt)?;
                    put(c.len() as f64)?;
                    for c in c { for v in [c.from.x, c.from.y, c.to.x, c.to.y] { put(v)?; } }
                }
            }
            out.flush()?;
            std::fs::rename(format!("{path}.new"), &path)?;
        }
    }
    Ok(())
}
