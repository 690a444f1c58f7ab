//! `vitreo colours`: learns, shows and checks colour classes.

use crate::colours::convert::{GREY, rgb_of_ycc};
use crate::colours::file::ColourFile;
use crate::colours::learn::{Region, Samples, apart_deg, hue_deg};
use crate::colours::{CLASSES, Class, ColourTable};
use crate::input::source::{Reading, Source};
use crate::input::{Picture, overlay, still};
use anyhow::{Context, Result, bail, ensure};
use ipc::logging::{inform, warn};
use outputs::{Force, Outputs, println};
use protocol::blobs::Colour;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Learn, show and check colour classes.
#[derive(Debug, Clone, clap::Args)]
pub struct ColoursArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: Action,
}

/// What to do with classes.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Action {
    /// Learn classes from sample pictures, for instance red=ball.jpg@310,95,80,60. Without a region, the most
    /// colourful part of the picture is used; several samples of a colour are combined.
    Learn {
        /// Colour (red, yellow, green, cyan, blue, magenta or white), picture, and region in it.
        #[arg(required = true, value_name = "NAME=PICTURE[@X,Y,W,H]", value_parser = Sample::parse)]
        samples: Vec<Sample>,
        /// File for the classes.
        #[arg(short, long, value_name = "FILE.toml")]
        output: PathBuf,
        /// `--force`.
        #[command(flatten)]
        force: Force,
    },
    /// Show classes as a table, and the chroma plane as a picture.
    Show {
        /// Colour file [default: the shipped classes].
        #[arg(value_name = "FILE.toml")]
        file: Option<PathBuf>,
        /// Draw the chroma plane: true colours on the left, classes on the right.
        #[arg(long, value_name = "OUT.png")]
        picture: Option<PathBuf>,
        /// Print JSON.
        #[arg(long)]
        json: bool,
        /// `--force`.
        #[command(flatten)]
        force: Force,
    },
    /// Print the fraction of each picture's pixels per class.
    Check {
        /// Colour file.
        #[arg(value_name = "FILE.toml")]
        file: PathBuf,
        /// Pictures or clips.
        #[arg(required = true, value_name = "PICTURE")]
        pictures: Vec<PathBuf>,
        /// Print JSON, one line per picture.
        #[arg(long)]
        json: bool,
    },
}

/// A picture that shows a colour.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    colour: Colour,
    picture: PathBuf,
    region: Option<Region>,
}

impl Sample {
    fn parse(text: &str) -> Result<Self, String> {
        let (name, rest) = text.split_once('=').ok_or("expected NAME=PICTURE[@X,Y,W,H]")?;
        let colour = Colour::from_name(name).ok_or_else(|| {
            let names = Colour::ALL.map(Colour::name).join(", ");
            format!("expected one of {names}; found {name:?}")
        })?;
        let region = rest.rsplit_once('@').and_then(|(path, at)| Some((path, parse_region(at)?)));
        let (path, region) = region.map_or((rest, None), |(path, region)| (path, Some(region)));
        if path.is_empty() {
            return Err("expected a picture after the colour".into());
        }
        Ok(Sample { colour, picture: path.into(), region })
    }
}

fn parse_region(text: &str) -> Option<Region> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers?[..] {
        [x, y, width, height] => Some(Region { x, y, width, height }),
        _ => None,
    }
}

/// Runs the command.
///
/// # Errors
/// Where a picture or a colour file is refused, samples make no class, or an output cannot be
/// written.
pub fn run(args: &ColoursArgs) -> Result<()> {
    match &args.action {
        Action::Learn { samples, output, force } => learn(samples, output, *force),
        Action::Show { file, picture, json, force } => {
            show(file.as_deref(), picture.as_deref(), *json, *force)
        }
        Action::Check { file, pictures, json } => check(file, pictures, *json),
    }
}

fn learn(samples: &[Sample], output: &Path, force: Force) -> Result<()> {
    let mut outputs = Outputs::new(force.force).reading_all(samples.iter().map(|s| &s.picture));
    outputs.claim(output)?;
    let mut learnt: BTreeMap<Colour, Samples> = BTreeMap::new();
    let mut picture = Picture::default();
    for sample in samples {
        still::read(&sample.picture, None, &mut picture)?;
        if let Some(defect) = sample.region.and_then(|r| r.defect(&picture)) {
            bail!("{}: {defect}", sample.picture.display());
        }
        learnt.entry(sample.colour).or_default().take(&picture, sample.region, sample.colour);
    }
    let classes: Result<Vec<Class>, String> = learnt.iter().map(|(&c, samples)| samples.class(c)).collect();
    let classes = classes.map_err(anyhow::Error::msg)?;
    warn_of_neighbours(&classes);
    let text = ColourFile::of_classes(&classes).text();
    // The file must be readable; a class darker than black, for instance, is refused.
    let name = output.display().to_string();
    ColourFile::parse(&text, &name).context("the samples do not make a colour file")?;
    outputs.write(output, text)?;
    inform(&format!("{name}: {} classes", classes.len()));
    Ok(())
}

fn warn_of_neighbours(classes: &[Class]) {
    let coloured = || classes.iter().filter(|c| c.colour != Colour::White);
    for (i, a) in coloured().enumerate() {
        for b in coloured().skip(i + 1) {
            let apart = apart_deg(hue_deg(&a.reference), hue_deg(&b.reference));
            if apart < 20.0 {
                let names = [a, b].map(|c| c.colour.name());
                warn(&format!("{} and {} are only {apart:.0} degrees of hue apart", names[0], names[1]));
            }
        }
    }
}

/// Share of the chroma plane that a class has.
fn share_of_plane(table: &ColourTable, colour: Colour) -> f64 {
    let cells = (0..=u16::MAX).map(|i| i.to_be_bytes());
    cells.filter(|&[cb, cr]| table.class(cb, cr) == colour as u8).count() as f64 / 65_536.0
}

fn show(file: Option<&Path>, picture: Option<&Path>, json: bool, force: Force) -> Result<()> {
    let mut outputs = Outputs::new(force.force).reading_all(file);
    picture.map_or(Ok(()), |path| outputs.claim(path))?;
    let file = ColourFile::load_or_shipped(file)?;
    let table = file.table();
    for class in file.classes() {
        let Class { colour, reference, least_chroma, tolerance_deg } = class;
        let [r, g, b] = rgb_of_ycc(reference);
        let (name, share) = (colour.name(), share_of_plane(&table, colour));
        if json {
            let line = serde_json::json!({
                "colour": name, "reference": reference, "rgb": [r, g, b], "hue_deg": hue_deg(&reference),
                "least_chroma": least_chroma, "tolerance_deg": tolerance_deg, "share_of_plane": share,
            });
            println!("{line}");
        } else {
            let [y, cb, cr] = reference;
            let hue = hue_deg(&reference);
            println!(
                "{name:<8} Y {y:3}  Cb {cb:3}  Cr {cr:3}  #{r:02x}{g:02x}{b:02x}  hue {hue:6.1} ± {tolerance_deg:3.0} degrees  chroma from {least_chroma:3}  {:4.1} % of the plane",
                100.0 * share
            );
        }
    }
    if let Some(path) = picture {
        let image = plane(&file.classes(), &table);
        outputs.write(path, overlay::png(&image)?)?;
    }
    Ok(())
}

/// The chroma plane at middle luma beside the same plane in classes; Cb to the right, Cr upwards.
/// References are marked by small squares.
fn plane(classes: &[Class], table: &ColourTable) -> image::RgbImage {
    let class_of = |code: u8| classes.iter().find(|c| c.colour as u8 == code);
    let mut image = image::RgbImage::from_fn(512, 256, |x, y| {
        let (cb, cr) = ((x % 256) as u8, 255 - y as u8);
        let class = if x < 256 { None } else { class_of(table.class(cb, cr)) };
        image::Rgb(rgb_of_ycc(match class {
            Some(class) => class.reference,
            None if x < 256 => [GREY, cb, cr],
            None => [60, GREY, GREY],
        }))
    });
    for class in classes {
        let [_, cb, cr] = class.reference;
        for (dx, dy) in (-3..=3i32).flat_map(|a| [(a, -3), (a, 3), (-3, a), (3, a)]) {
            for left in [0, 256] {
                let x = left + (i32::from(cb) + dx).clamp(0, 255);
                let y = (255 - i32::from(cr) + dy).clamp(0, 255);
                image.put_pixel(x as u32, y as u32, image::Rgb([255; 3]));
            }
        }
    }
    image
}

fn check(file: &Path, pictures: &[PathBuf], json: bool) -> Result<()> {
    let file = ColourFile::load_or_shipped(Some(file))?;
    let table = file.table();
    let mut source = Source::open(pictures, None, &Reading::default())?;
    while let Some(shot) = source.take()? {
        let mut counts = [0u64; CLASSES];
        let height = shot.view.height();
        for y in 0..height {
            let (luma, blue, red) = shot.view.line(y);
            for (x, &value) in luma.iter().enumerate() {
                let lit = value >= file.black.saturating_add(file.low);
                let class = table.class(blue[x / 2], red[x / 2]);
                counts[usize::from(class) % CLASSES] += u64::from(lit);
            }
        }
        let pixels = (shot.view.picture.width * height) as f64;
        ensure!(pixels > 0.0, "{}: expected pixels, found none", shot.file);
        let coloured = file.classes().into_iter().map(|c| c.colour).filter(|&c| c != Colour::White);
        let shares = coloured.map(|c| (c.name(), counts[c as usize] as f64 / pixels));
        print_shares(shot.file, shot.head.seq, shares.collect(), json);
    }
    Ok(())
}

fn print_shares(file: &str, picture: u64, shares: Vec<(&'static str, f64)>, json: bool) {
    if json {
        let shares: BTreeMap<_, _> = shares.into_iter().collect();
        println!("{}", serde_json::json!({ "file": file, "picture": picture, "shares": shares }));
    } else {
        let listed: Vec<String> =
            shares.iter().map(|(name, s)| format!("{name} {:.2} %", 100.0 * s)).collect();
        println!("{file}, picture {picture}: {}", listed.join(", "));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_told_by_colour_picture_and_region() {
        let sample = Sample::parse("red=a=b@2.png@1,2,3,4").unwrap();
        assert_eq!((sample.colour, sample.picture.to_str()), (Colour::Red, Some("a=b@2.png")));
        assert_eq!(sample.region, Some(Region { x: 1, y: 2, width: 3, height: 4 }));
        assert_eq!(Sample::parse("blue=a@b.png").unwrap().picture.to_str(), Some("a@b.png"));
        for text in ["red", "pink=a.png", "red=", "red=@1,2,3,4"] {
            assert!(Sample::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_plane_shows_each_class_at_its_reference() {
        let classes = Colour::ALL.map(Class::of_reference);
        let image = plane(&classes, &ColourTable::default());
        for class in classes.iter().filter(|c| c.colour != Colour::White) {
            let [_, cb, cr] = class.reference.map(u32::from);
            assert_eq!(image.get_pixel(256 + cb, 255 - cr).0, rgb_of_ycc(class.reference), "{class:?}");
        }
    }
}
