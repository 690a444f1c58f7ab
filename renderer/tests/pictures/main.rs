//! Pictures that the renderer draws, against formulas written out here and against reference
//! pictures. Without a graphics driver each test says in one line that it is skipped, and passes.

mod arrangements;
mod device_lost;
mod edges;
mod focus;
mod geometry;
mod interfaces;
mod markers;
mod membranes;
mod optics;
mod picture;
mod reference;
mod shadows;
mod stage;
mod text;
mod timing;
mod vessels;
