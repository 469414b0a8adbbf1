use eval::readout;
use eval::sequence;
fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().collect();
    let mode = &args[1];
    let frames: usize = args[2].parse()?;
    let seeds: Vec<u64> = args[3].split(',').map(|s| s.parse().unwrap()).collect();
    let names: Vec<String> = if args.len() > 4 {
        args[4..].to_vec()
    } else {
        sequence::catalogue().iter().map(|s| s.name.clone()).collect()
    };
    for name in names {
        for seed in &seeds {
            let mut settings = sequence::named(&name).unwrap();
            settings.frames = frames;
            settings.seed = *seed;
            let runs =
                if mode == "exact" { readout::exact(&settings, 0.1)? } else { readout::sampled(&settings)? };
            let truth = readout::truth(&settings);
            let start = std::time::Instant::now();
            let found = readout::estimates(&settings, &runs, &[15, 30]);
            let ms = start.elapsed().as_secs_f64() * 1e3 / frames as f64;
            print!("{name:16} {seed} [{:+.3} {:+.3}]", truth[0], truth[1]);
            for e in found {
                match e {
                    None => print!(" | -"),
                    Some(e) => {
                        let r = e.raw;
                        print!(
                            " | {:+.3}±{:.3} {:+.3}±{:.3} z {:+.1} {:+.1} p {:.2} {:.2} {:.2}",
                            r[0],
                            r[1],
                            r[2],
                            r[3],
                            (r[0] - truth[0]) / r[1],
                            (r[2] - truth[1]) / r[3],
                            e.probability[0],
                            e.probability[1],
                            e.probability[2]
                        );
                    }
                }
            }
            println!(" ({ms:.2} ms)");
        }
    }
    Ok(())
}
