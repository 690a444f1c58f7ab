//! Names of pixel formats, as GenICam and its makers have them.

use super::refused;
use anyhow::{Result, anyhow};
use aravis::prelude::*;
use fpga_model::input::packed::Packing;
use protocol::fields::PixelFormat;

/// Names of a packing, the present one first.
fn names(packing: Packing) -> &'static [&'static str] {
    match packing {
        Packing::Yuyv => &["YCbCr422_8", "YUV422_8", "YUV422_YUYV_Packed", "YUYVPacked"],
        Packing::Uyvy => &["YCbCr422_8_CbYCrY", "YUV422_8_UYVY", "YUV422Packed"],
        Packing::Plain(PixelFormat::Y8) => &["Mono8"],
        Packing::Plain(PixelFormat::Rgb8) => &["RGB8", "RGB8Packed"],
        Packing::Plain(PixelFormat::BayerRg8) => &["BayerRG8"],
        Packing::Plain(PixelFormat::BayerBg8) => &["BayerBG8"],
        Packing::Plain(PixelFormat::BayerGr8) => &["BayerGR8"],
        Packing::Plain(PixelFormat::BayerGb8) => &["BayerGB8"],
        Packing::Plain(PixelFormat::Yuyv) => &[],
    }
}

/// The packing of a format by its name, where it is understood.
pub(super) fn packing(name: &str) -> Option<Packing> {
    Packing::ALL.into_iter().find(|packing| names(*packing).contains(&name))
}

/// The formats that a camera has.
pub(super) fn offered(camera: &aravis::Camera) -> Result<Vec<String>> {
    let all = camera.dup_available_pixel_formats_as_strings().map_err(refused)?;
    Ok(all.iter().map(ToString::to_string).collect())
}

/// Sets the best of the formats that suit the rig's.
pub(super) fn choose(camera: &aravis::Camera, format: PixelFormat) -> Result<Packing> {
    let offered = offered(camera)?;
    let (packing, name) = best(&offered, format).ok_or_else(|| {
        let wanted = Packing::wanted(format).iter().flat_map(|p| names(*p)).copied();
        let wanted = wanted.collect::<Vec<_>>().join(", ");
        anyhow!(
            "delivers {}; the rig's format is {}, which needs {wanted}",
            offered.join(", "),
            format.name()
        )
    })?;
    camera.set_pixel_format_from_string(name).map_err(refused)?;
    Ok(packing)
}

/// The first of the wanted formats that is offered.
fn best(offered: &[String], format: PixelFormat) -> Option<(Packing, &'static str)> {
    let wanted = Packing::wanted(format).iter().flat_map(|p| names(*p).iter().map(|name| (*p, *name)));
    wanted.into_iter().find(|(_, name)| offered.iter().any(|o| o == name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_format_that_suits_the_rig_is_chosen() {
        let offered = ["Mono16", "YUV422Packed", "RGB8Packed", "YUV422_8", "BayerGB8"].map(String::from);
        let chosen = |format| best(&offered, format);
        assert_eq!(chosen(PixelFormat::Yuyv), Some((Packing::Yuyv, "YUV422_8")));
        assert_eq!(chosen(PixelFormat::Rgb8).map(|(_, name)| name), Some("RGB8Packed"));
        assert_eq!(chosen(PixelFormat::BayerGb8).map(|(_, name)| name), Some("BayerGB8"));
        assert_eq!(chosen(PixelFormat::Y8), None);
        assert_eq!((packing("Mono16"), packing("BayerGB8").is_some()), (None, true));
    }
}
