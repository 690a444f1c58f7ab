//! Rigid bodies of the abstract tasks: the paper's case 3 in the world. [`state`] is what is remembered of them, [`solve`] moves
//! them over a substep, [`grip`] is what forceps do. Shapes and their contacts are [`crate::collision::rigid`]'s.
//!
//! Instruments are moved by hands and yield to nothing; bodies yield to them, to each other and to the retina.

pub mod grip;
pub mod solve;
pub mod state;
