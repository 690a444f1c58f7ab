//! A field of a picture, as it is published or kept.

use fpga_model::input::Picture;
use protocol::fields::{FieldHeader, FieldPicture};

/// A field that is to be published.
pub(crate) struct Field<'a> {
    pub(crate) header: FieldHeader,
    pub(super) picture: &'a Picture,
    /// First line and step in the picture.
    pub(super) lines: [usize; 2],
}

impl Field<'_> {
    /// All lines of the field, as a picture.
    pub(crate) fn whole(&self) -> Picture {
        let height = self.header.height as usize;
        let mut whole = Picture { width: self.picture.width, height, ..Picture::default() };
        for y in 0..height {
            let (luma, blue, red) = self.picture.line(self.lines[0] + y * self.lines[1]);
            whole.luma.extend_from_slice(luma);
            whole.blue.extend_from_slice(blue);
            whole.red.extend_from_slice(red);
        }
        whole
    }

    /// Writes the pixels into a payload.
    pub(crate) fn write(&self, payload: &mut [u8]) {
        let to = FieldPicture::in_payload_mut(&self.header, payload);
        let (width, chroma, [first, step]) = (to.width, to.width / 2, self.lines);
        for y in 0..to.height {
            let (luma, blue, red) = self.picture.line(first + y * step);
            to.luma[y * width..][..width].copy_from_slice(&luma[..width]);
            to.blue[y * chroma..][..chroma].copy_from_slice(&blue[..chroma]);
            to.red[y * chroma..][..chroma].copy_from_slice(&red[..chroma]);
        }
    }
}
