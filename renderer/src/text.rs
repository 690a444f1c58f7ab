//! Text over the picture: where its lines stand ([`layout`]), and their pixels ([`canvas`]). Pure;
//! the device's part is `passes::text`.

pub mod canvas;
pub mod layout;
mod page;
mod wrap;
