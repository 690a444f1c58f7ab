//! Contact of instruments with tissue, with the retina's sphere and with rigid bodies. Pure: no
//! transport, no clock, no state of its own between two steps but caches.
//!
//! | module | query |
//! |---|---|
//! | [`zcoll`] | image-based collision with a sheet, from two depth images drawn in integers |
//! | [`exact`] | pairs of triangles that intersect, decided in integers by [`tritri`] |
//! | [`suction`] | triangles in the suction cone of a vitrector's port |
//! | [`continuous`] | time of impact of moving points, triangles and edges |
//! | [`eyeball`] | a tip against the retina's sphere (the paper's case 2) |
//! | [`rigid`] | instruments against convex bodies (case 3) |
//!
//! [`surface`] is the mesh that the queries take, and culls it; [`quantize`] rounds vertices to
//! whole numbers; [`raster`] draws triangles; [`tool_mesh`] holds the instruments' shapes and
//! [`instrument_image`] their depth images; [`gpu`] does ZCOLL in compute shaders, and [`backend`]
//! chooses between processor and adapter. See `docs/collision.md`.

pub mod backend;
pub mod continuous;
pub mod exact;
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
pub mod tritri;
pub mod zcoll;
