//! `vitreo hardware`: registers, memories and clocks of the extractor, for given table sizes.

use crate::hardware::{Clocks, Resource, clocks, resources};
use crate::scan::limits::{CAMERA, Limits, PICTURE, PIXEL_CLOCK_HZ};
use anyhow::Result;
use outputs::{print, println};

/// Set of tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Tables {
    /// The camera hardware: PAL fields, 64 blobs.
    Camera,
    /// Pictures of up to 8192 × 8192 px, for vitreo blobs.
    Picture,
}

/// Arguments of `hardware`.
#[derive(Debug, Clone, clap::Args)]
pub struct HardwareArgs {
    /// Sizes of the tables.
    #[arg(long, value_enum, default_value = "camera")]
    pub tables: Tables,
    /// Maximum number of runs per line, instead of that of --tables.
    #[arg(long, value_parser = settings::commands::numbers::whole::<u16>(1, 4096))]
    pub runs: Option<u16>,
    /// Maximum number of simultaneous components, instead of that of --tables.
    #[arg(long, value_parser = settings::commands::numbers::whole::<u16>(1, 4096))]
    pub labels: Option<u16>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

impl HardwareArgs {
    fn limits(&self) -> Limits {
        let set = match self.tables {
            Tables::Camera => CAMERA,
            Tables::Picture => PICTURE,
        };
        let or = |own: Option<u16>, set: usize| own.map_or(set, usize::from);
        Limits { runs: or(self.runs, set.runs), labels: or(self.labels, set.labels), ..set }
    }
}

/// Prints the tables.
///
/// # Errors
/// Where the standard output cannot be written.
pub fn run(args: &HardwareArgs) -> Result<()> {
    let limits = args.limits();
    let (resources, clocks) = (resources(&limits), clocks(&limits));
    if args.json {
        let all = serde_json::json!({ "resources": resources, "clocks": clocks });
        println!("{all}");
    } else {
        print!("{}", text(&limits, &resources, &clocks));
    }
    Ok(())
}

fn text(limits: &Limits, resources: &[Resource], clocks: &Clocks) -> String {
    let mut text = format!(
        "fields up to {} × {} px, {} runs per line, {} components at a time, {} blobs per field\n\n",
        limits.width, limits.lines, limits.runs, limits.labels, limits.blobs
    );
    text += &format!("{:<40} {:<9} {:>6} {:>6} {:>10}\n", "item", "kind", "words", "bits", "bits in all");
    for r in resources {
        text += &format!("{:<40} {:<9} {:>6} {:>6} {:>10}\n", r.name, r.kind, r.depth, r.width, r.bits());
    }
    for kind in ["register", "memory"] {
        let bits: u64 = resources.iter().filter(|r| r.kind == kind).map(Resource::bits).sum();
        text += &format!("{:<64} {bits:>10}\n", format!("{kind} bits in total"));
    }
    let us = |clocks: u64| clocks as f64 * 1e6 / PIXEL_CLOCK_HZ as f64;
    let fits =
        if clocks.labelling_at_most <= clocks.line { "keeps up" } else { "too slow for a live camera" };
    text += &format!("\nclocks of 13.5 MHz\n{:<64} {:>10}\n", "line with blanking", clocks.line);
    text += &format!("{:<64} {:>10}   {fits}\n", "labelling of a line, maximum", clocks.labelling_at_most);
    text += &format!("{:<64} {:>10}\n", "divider, per component", clocks.divider);
    text += &format!("{:<64} {:>10}\n", "divider, extra for two touching markers", clocks.split);
    let [least, most] = clocks.latency;
    text += &format!(
        "from a blob's last pixel to its output: {least} to {most} ({:.1} to {:.1} µs), and the divider's \
         time for each blob that waits before it\n",
        us(least),
        us(most)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_names_every_resource_and_adds_them_up() {
        let (resources, clocks) = (resources(&CAMERA), clocks(&CAMERA));
        let text = text(&CAMERA, &resources, &clocks);
        for r in &resources {
            let row = text.lines().find(|l| l.starts_with(r.name)).expect(r.name);
            assert!(row.ends_with(&r.bits().to_string()), "{row}");
        }
        assert!(text.contains("keeps up") && text.contains("640"), "{text}");
    }
}
