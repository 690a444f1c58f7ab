//! What proves vitreo and is in none of its programs: random programmes over random scenes ([`soak`]), the whole chain in one process
//! ([`chain`]), moments of operations as pictures ([`surgery`]). Peers and studies are examples and benches.
//! Closed forms ([`closed_form`]) and exact rays ([`rays`]) are the truth that tissue and collision are held to.

pub mod chain;
pub mod closed_form;
pub mod moments;
pub mod rays;
pub mod soak;
