//! Who touches what.
//!
//! [`zcoll`] finds where an instrument has passed the membrane, from two small depth images that
//! [`raster`] draws in integers; [`instrument_image`] keeps the instrument's, [`tool_mesh`] is its
//! shape. It begins with [`surface`], the cull, and [`quantize`], vertices into whole numbers.
//! [`suction`] finds what a vitrector's port sees. [`continuous`] tests what happens between two
//! steps. [`eyeball`] compares the tip with the retina's sphere (the paper's case 2), [`rigid`]
//! instruments with convex bodies (case 3). `docs/collision.md` describes the whole.

pub mod backend;
pub mod continuous;
pub mod eyeball;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod instrument_image;
pub mod quantize;
pub mod raster;
pub mod rigid;
pub mod suction;
pub mod surface;
#[cfg(test)]
mod test_mesh;
pub mod tool_mesh;
pub mod zcoll;
