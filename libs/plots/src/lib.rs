//! Pictures of figures, drawn with plotters in our font: as PNG or SVG by the name of their file.

pub mod histogram;
pub mod line_plot;
pub mod page;

use anyhow::anyhow;
use font::truetype;
use image::{ImageFormat, RgbImage};
use outputs::exit::WrongUse;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::io::Cursor;
use std::path::Path;

/// Name of our font in drawings; the viewer of an SVG takes one of its own.
pub const FONT: &str = "sans-serif";
/// Colours that people with any colour vision can distinguish (Okabe and Ito 2008).
pub const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
    RGBColor(120, 120, 120),
];

/// The area of a drawing.
pub type Area<B> = DrawingArea<B, Shift>;
/// What drawing returns.
pub type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// Something that can be drawn.
pub trait Figure {
    /// Width and height, px.
    fn size_px(&self) -> (u32, u32);

    /// Draws it on a white area.
    ///
    /// # Errors
    /// Those of the back end.
    fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B>;
}

/// How a picture is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Pixels.
    Png,
    /// Lines and text.
    Svg,
}

impl Format {
    /// By the name of a file.
    ///
    /// # Errors
    /// Where it ends in neither `.png` nor `.svg`.
    pub fn of(path: &Path) -> Result<Self, WrongUse> {
        let end = path.extension().and_then(|end| end.to_str()).unwrap_or_default().to_lowercase();
        match end.as_str() {
            "png" => Ok(Format::Png),
            "svg" => Ok(Format::Svg),
            _ => Err(WrongUse(format!("{}: expected a name that ends in .png or .svg", path.display()))),
        }
    }
}

/// The bytes of a picture's file.
///
/// # Errors
/// Where the drawing fails, which it does not for finite figures.
pub fn bytes(figure: &impl Figure, format: Format) -> anyhow::Result<Vec<u8>> {
    if format == Format::Svg {
        register_font();
        let mut text = String::new();
        drawn(&SVGBackend::with_string(&mut text, figure.size_px()).into_drawing_area(), figure)?;
        return Ok(text.into_bytes());
    }
    let mut file = Cursor::new(Vec::new());
    pixels(figure)?.write_to(&mut file, ImageFormat::Png)?;
    Ok(file.into_inner())
}

/// A figure in pixels, for a window.
///
/// # Errors
/// Where the drawing fails, which it does not for finite figures.
pub fn pixels(figure: &impl Figure) -> anyhow::Result<RgbImage> {
    register_font();
    let (width, height) = figure.size_px();
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    drawn(&BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area(), figure)?;
    Ok(RgbImage::from_raw(width, height, pixels).expect("three bytes a pixel"))
}

/// Registered again for each picture; one that is there stays.
fn register_font() {
    let _ = plotters::style::register_font(FONT, FontStyle::Normal, truetype());
}

fn drawn<B: DrawingBackend>(area: &Area<B>, figure: &impl Figure) -> anyhow::Result<()> {
    let fail = |e: DrawingAreaErrorKind<B::ErrorType>| anyhow!("cannot draw: {e}");
    area.fill(&WHITE).map_err(fail)?;
    figure.draw(area).map_err(fail)?;
    area.present().map_err(fail)
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Cross;

    impl Figure for Cross {
        fn size_px(&self) -> (u32, u32) {
            (90, 60)
        }

        fn draw<B: DrawingBackend>(&self, area: &Area<B>) -> Drawn<B> {
            area.draw(&PathElement::new(vec![(0, 0), (89, 59)], COLOURS[0]))?;
            area.draw(&Text::new("0.5 µm", (20, 20), (FONT, 14)))
        }
    }

    #[test]
    fn a_figure_becomes_a_picture_with_our_font_in_both_formats() {
        let png = bytes(&Cross, Format::of(Path::new("a.PNG")).unwrap()).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!(picture.dimensions(), (90, 60));
        let dark = picture.pixels().filter(|p| p.0.iter().all(|v| *v < 100)).count();
        assert!(dark > 20, "{dark} pixels of text");
        let svg = String::from_utf8(bytes(&Cross, Format::of(Path::new("a.svg")).unwrap()).unwrap()).unwrap();
        assert!(svg.contains("<svg") && svg.contains("0.5 µm"), "{svg}");
        assert!(Format::of(Path::new("a.jpg")).is_err() && Format::of(Path::new("png")).is_err());
    }
}
