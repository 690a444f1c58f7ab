//! The library by which programs of other makers take part in a run of vitreo: `libvitreo.so`, with a header for C.
//!
//! A program opens a [`driver::Driver`] in a running instance and says what it sends and reads. From then on it is a
//! process of the run: [`heart`] sends the launcher ten heartbeats a second, and receives its commands. What C
//! sees is in [`ffi`], the one module with `unsafe`; every call of it ends with one of the [`code::Code`]s.
//!
//! What crosses the border are the wire structs of crate `protocol` themselves, as declared in `vitreo.h`.

pub mod code;
pub mod driver;
pub mod ffi;
mod heart;
pub mod layout;
pub mod roles;
mod seats;
