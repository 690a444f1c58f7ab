//! Rigid bodies of the abstract tasks: the paper's case 3 in the world. [`state`] is what is
//! remembered of them, [`solve`] moves them over a substep, [`grip`] is what forceps do. Shapes and
//! their contacts are [`collision::rigid`]'s.
//!
//! ```text
//! motion ──▶ contacts ──▶ push, a few rounds ──▶ motion
//!  weight     found        apart, friction        velocities
//! ```
//!
//! Instruments are moved by motions and yield to nothing; bodies yield to them, to each other and
//! to the retina.

mod contacts;
pub mod grip;
pub mod model;
pub mod motion;
mod push;
pub mod solve;
pub mod state;
