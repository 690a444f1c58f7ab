//! Sheets of soft tissue: the epiretinal membrane, and the retina's mesh.
//!
//! [`mesh`] is what never changes (connections, rest lengths), [`state`] what does. [`body`] puts
//! together what acts on a sheet: [`solver`] moves it ([`implicit`] where springs are too stiff for
//! that, [`strain_limit`] where they must not grow too long), [`adhesion`] holds it, [`curl`] rolls
//! it up, [`tearing`] removes springs, triangles and nodes so that the mesh stays consistent,
//! [`grasp`] is what jaws do, [`cutter`] what a vitrector's port does, [`collider`] what every
//! instrument does by touching.

pub mod adhesion;
pub mod body;
pub mod collider;
pub mod curl;
mod cuthill_mckee;
pub mod cutter;
pub mod from_triangles;
pub mod grasp;
mod grid;
pub mod guard;
pub mod implicit;
pub mod material;
pub mod mesh;
pub mod simd;
pub mod solver;
pub mod spring_packing;
pub mod stain;
pub mod state;
pub mod step_counts;
pub mod strain_limit;
pub mod tearing;
