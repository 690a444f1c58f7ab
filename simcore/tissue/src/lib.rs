//! Soft tissue of the eye: what it is made of and how it moves, tears, adheres and flows.
//!
//! ```text
//! membrane ──▶ springs and triangles, their solver, limits, tearing, adhesion, dye
//! retina   ──▶ the whole retina on the choroid: blebs, their fluid, the front where it comes off
//! vitreous ──▶ the gel, a chain mail of elements
//! elements ──▶ finite elements and implicit integrators: a membrane of published stiffness and validation
//! ```
//!
//! Everything here is pure: no transport, no clock, no randomness. Units are mm, g, s, hence µN and Pa; places are in
//! the eye frame. Results are the same to the bit in every build: no fused operations, fixed order of sums,
//! transcendentals from `libm`.

pub mod constants;
pub mod cutting;
pub mod elements;
pub mod forceps;
pub mod guard;
pub mod membrane;
pub mod needle;
pub mod pod_serde;
pub mod retina;
pub mod state;
pub mod vitrector;
pub mod vitreous;
