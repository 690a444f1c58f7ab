//! The epiretinal membrane: a sheet of springs and triangles before the retina.
//!
//! [`sheet`] is what never changes (connections, rest lengths), the state's
//! [`MembraneState`](crate::state::MembraneState) what does; [`solver`] moves it ([`implicit`] where springs are
//! too stiff for that, [`strain`] where they must not grow too long) and [`tear`]
//! removes springs, triangles and nodes so that the mesh stays consistent.

pub mod adhesion;
pub mod curl;
mod grid;
pub mod implicit;
pub mod lanes;
pub mod mesh;
mod order;
pub mod sheet;
pub mod solver;
pub mod stain;
pub mod strain;
pub mod tear;
pub mod tissue;
pub mod web;
