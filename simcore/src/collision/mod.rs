//! Who touches what. [`zcoll`] finds where an instrument has passed the membrane, from two small
//! depth images that [`raster`] draws in integers; [`tool_mesh`] is the instrument's shape;
//! [`eyeball`] compares the tip with the retina's sphere.

pub mod continuous;
pub mod exact;
pub mod eyeball;
pub mod instrument_image;
pub mod placing;
pub mod raster;
pub mod surface;
pub mod tool_mesh;
pub mod tritri;
pub mod zcoll;
