//! Soft tissue of the eye: what it is made of and how it moves, tears, adheres and flows.
//!
//! ```text
//! sheet    ──▶ springs and triangles with all that acts on them: the membrane, and the retina's mesh
//! retina   ──▶ the sheet on the choroid: blebs, their fluid, the front where it comes off
//! vitreous ──▶ the gel, a chain mail of elements
//! elements ──▶ finite elements and implicit integrators: a membrane of published stiffness, and validation
//! needle, vitrector ──▶ the tools that do more to tissue than push it
//! ```
//!
//! Everything here is pure: no transport, no clock, no randomness. Units are mm, g, s, hence µN and
//! Pa; places are in the eye frame. Results are the same to the bit in every build: no fused
//! operations, fixed order of sums, transcendentals from `libm`.

pub mod constants;
pub mod elements;
pub mod needle;
pub mod pod_serde;
pub mod retina;
pub mod sheet;
pub mod vitrector;
pub mod vitreous;
