//! How much successive pictures differ: `cargo run --release -p validation --example stability --
//! [--tier N] [SCENE FROM_S TO_S]` (`module NAME` for a module, its first level done by the expert).
//! Without a scene: those of `tests/stability.rs`.

use anyhow::{Context, Result};
use renderer::gpu::Gpu;
use scene::SceneFile;
use surgeon::skill::EXPERT;
use validation::moments::{REFERENCE_MAP_PX, ScenePlayer};
use validation::stability::{Shown, watch};

const SHIPPED: [(&str, f64, f64); 4] = [
    ("relocation", 4.0, 8.0),
    ("erm", 5.0, 8.0),
    ("module peeling", 8.0, 10.0),
    ("module relocation", 6.0, 8.0),
];

fn begin(name: &str) -> Result<ScenePlayer> {
    Ok(ScenePlayer::begin(match name.strip_prefix("module ") {
        Some(module) => surgeon::compose(&surgeon::load(module)?, 1, &EXPERT, 1)?,
        None => SceneFile::load(name)?,
    }))
}

fn main() -> Result<()> {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let mut tier = 6;
    if let Some(i) = args.iter().position(|a| a == "--tier") {
        tier = args.get(i + 1).context("a tier after --tier")?.parse()?;
        args.drain(i..i + 2);
    }
    let gpu = Gpu::headless()?;
    match &args[..] {
        [] => SHIPPED.iter().try_for_each(|&(name, from, to)| report(&gpu, tier, name, [from, to])),
        [name, from, to] => report(&gpu, tier, name, [from.parse()?, to.parse()?]),
        _ => anyhow::bail!("usage: stability [--tier N] [SCENE FROM_S TO_S]"),
    }
}

fn report(gpu: &Gpu, tier: usize, name: &str, span_s: [f64; 2]) -> Result<()> {
    for shown in [Shown::Whole, Shown::Tissue] {
        let found = watch(gpu, &mut begin(name)?, span_s, tier, REFERENCE_MAP_PX, shown);
        println!(
            "{name} from {} to {} s, tier {tier}, {shown:?}: mean {:.3}, 99.9 % under {}, largest jump {} px at {:.2} s",
            span_s[0], span_s[1], found.mean, found.most, found.patch.0, found.patch.1
        );
    }
    Ok(())
}
