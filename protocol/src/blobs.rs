//! `blobs`: the marker blobs of one camera-field.

use crate::limits::MAX_BLOBS;
use crate::message::{Invalid, Message, all_finite, require};
use crate::time::Nanos;
use crate::wire::Wire;
use bytemuck::{Pod, Zeroable};

/// Colour class of a marker, as in the camera's look-up table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(u32)]
#[allow(missing_docs)]
pub enum Colour {
    Red = 1,
    Yellow = 2,
    Green = 3,
    Cyan = 4,
    Blue = 5,
    Magenta = 6,
    White = 7,
}

impl Colour {
    /// Every class.
    pub const ALL: [Colour; 7] = {
        use Colour::*;
        [Red, Yellow, Green, Cyan, Blue, Magenta, White]
    };

    /// From the wire.
    pub fn from_wire(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&c| c as u32 == code)
    }

    /// Name as in rig files and blob streams.
    pub fn name(self) -> &'static str {
        match self {
            Colour::Red => "red",
            Colour::Yellow => "yellow",
            Colour::Green => "green",
            Colour::Cyan => "cyan",
            Colour::Blue => "blue",
            Colour::Magenta => "magenta",
            Colour::White => "white",
        }
    }

    /// Y, Cb, Cr of a well lit marker.
    pub const fn reference(self) -> [u8; 3] {
        match self {
            Colour::Red => [114, 100, 194],
            Colour::Yellow => [184, 63, 145],
            Colour::Green => [141, 82, 73],
            Colour::Cyan => [165, 151, 64],
            Colour::Blue => [95, 197, 108],
            Colour::Magenta => [118, 168, 190],
            Colour::White => [200, 128, 128],
        }
    }

    /// From its name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name() == name)
    }
}

/// Two blobs of one colour probably grew into one.
pub const BLOB_MERGED: u32 = 1;
/// The blob touches the border of the frame.
pub const BLOB_CLIPPED: u32 = 2;
/// The blob holds saturated pixels.
pub const BLOB_SATURATED: u32 = 4;

/// The parity of a field that is a whole frame, of a camera that is not interlaced.
pub const WHOLE_FRAME: u32 = 2;

/// Line of the frame of a line of a field of `parity`, px: `2 * y_field + parity`, or the same line of a
/// [`WHOLE_FRAME`].
pub fn frame_line(y_field_px: f64, parity: u32) -> f64 {
    if parity == WHOLE_FRAME { y_field_px } else { 2.0 * y_field_px + f64::from(parity) }
}

/// Line of a field of `parity` of a line of the frame, px: the inverse of [`frame_line`].
pub fn field_line(y_frame_px: f64, parity: u32) -> f64 {
    if parity == WHOLE_FRAME { y_frame_px } else { (y_frame_px - f64::from(parity)) / 2.0 }
}

/// The variance assumed where a stream gives none, px² of the frame (0.05 px, σ²).
pub const DEFAULT_VARIANCE_PX2: f64 = 0.0025;

/// One bright region of one colour.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Wire, Zeroable)]
pub struct Blob {
    /// Centre, px; column in the frame.
    #[wire(tag = 1)]
    pub x_px: f64,
    /// Centre, px; **line of the field** ([`frame_line`]).
    #[wire(tag = 2)]
    pub y_field_px: f64,
    /// Area, px of the field.
    #[wire(tag = 3)]
    pub area_px: f64,
    /// Width of the bounding box, px.
    #[wire(tag = 4)]
    pub width_px: f64,
    /// Height of the bounding box, field lines.
    #[wire(tag = 5)]
    pub height_px: f64,
    /// Variance of `x_px`, px².
    #[wire(tag = 6)]
    pub var_x_px2: f64,
    /// Variance of the centre's line **in the frame**, px².
    #[wire(tag = 7)]
    pub var_y_px2: f64,
    /// Covariance of the two, px².
    #[wire(tag = 8)]
    pub cov_xy_px2: f64,
    /// [`Colour`] on the wire.
    #[wire(tag = 9)]
    pub colour: u32,
    /// Bits `BLOB_…`.
    #[wire(tag = 10)]
    pub flags: u32,
}

/// All blobs of one camera-field.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Wire, Zeroable)]
pub struct BlobField {
    /// Field number of this camera; stamped at the camera.
    #[wire(tag = 1)]
    pub field: u64,
    /// Middle of the exposure.
    #[wire(tag = 2)]
    pub exposed_ns: Nanos,
    /// Last line left the sensor.
    #[wire(tag = 3)]
    pub read_out_ns: Nanos,
    /// When the blobs were sent; on a replayed stream, when they were received.
    #[wire(tag = 4)]
    pub blobs_out_ns: Nanos,
    /// Camera id of the rig.
    #[wire(tag = 5)]
    pub camera: u32,
    /// 0: even lines, 1: odd lines, 2: all lines ([`WHOLE_FRAME`]).
    #[wire(tag = 6)]
    pub parity: u32,
    /// Blobs in use.
    pub count: u32,
    /// Blobs seen beyond the capacity.
    #[wire(tag = 7)]
    pub blobs_left_out: u32,
    /// The blobs; the first `count` are meaningful.
    #[wire(tag = 8, count = count)]
    pub blobs: [Blob; MAX_BLOBS],
}

impl BlobField {
    /// The blobs in use.
    pub fn blobs(&self) -> &[Blob] {
        &self.blobs[..(self.count as usize).min(MAX_BLOBS)]
    }

    /// Adds a blob, or counts it where there is no room.
    pub fn push(&mut self, blob: Blob) {
        if (self.count as usize) < MAX_BLOBS {
            self.blobs[self.count as usize] = blob;
            self.count += 1;
        } else {
            self.blobs_left_out = self.blobs_left_out.saturating_add(1);
        }
    }

    /// Line of the frame of a blob of this field, px.
    pub fn y_frame_px(&self, blob: &Blob) -> f64 {
        frame_line(blob.y_field_px, self.parity)
    }

    /// Area of a blob of this field as a field of every second line would have it, px: half of that in a
    /// whole frame. Areas are compared in these.
    pub fn area_of_half_px(&self, blob: &Blob) -> f64 {
        if self.parity == WHOLE_FRAME { 0.5 * blob.area_px } else { blob.area_px }
    }
}

impl Message for BlobField {
    const CHANNEL: &'static str = "blobs";
    const VERSION: u32 = 1;
    const QUEUE: usize = 256;

    fn validate(&self) -> Result<(), Invalid> {
        let check = |holds, field, expected, found| require(holds, "BlobField", field, expected, found);
        check(self.count as usize <= MAX_BLOBS, "count", "at most 64", f64::from(self.count))?;
        check(self.parity <= WHOLE_FRAME, "parity", "0 or 1, or 2 of a whole frame", f64::from(self.parity))?;
        check(self.exposed_ns > 0, "exposed_ns", "an instant", 0.0)?;
        for blob in self.blobs() {
            let n = [blob.x_px, blob.y_field_px, blob.area_px, blob.width_px, blob.height_px];
            check(all_finite(&n), "blobs.x_px…height_px", "finite numbers", f64::NAN)?;
            let v = [blob.var_x_px2, blob.var_y_px2, blob.cov_xy_px2];
            check(all_finite(&v), "blobs.var_x_px2…", "finite numbers", f64::NAN)?;
            let known = Colour::from_wire(blob.colour).is_some();
            check(known, "blobs.colour", "a colour class 1 to 7", f64::from(blob.colour))?;
        }
        Ok(())
    }
}

const _: () = assert!(size_of::<Blob>() == 72 && size_of::<BlobField>() == 48 + 72 * MAX_BLOBS);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_fields_and_of_whole_frames_come_back() {
        assert_eq!([0, 1, WHOLE_FRAME].map(|parity| frame_line(10.25, parity)), [20.5, 21.5, 10.25]);
        for parity in [0, 1, WHOLE_FRAME] {
            assert_eq!(field_line(frame_line(7.5, parity), parity), 7.5);
            let blob = Blob { area_px: 8.0, y_field_px: 3.0, colour: 1, ..Blob::zeroed() };
            let mut field = BlobField { parity, exposed_ns: 1, ..BlobField::zeroed() };
            field.push(blob);
            assert!(field.validate().is_ok());
            assert_eq!(field.area_of_half_px(&blob), if parity == 2 { 4.0 } else { 8.0 });
        }
        let odd = BlobField { parity: 3, exposed_ns: 1, ..BlobField::zeroed() };
        assert_eq!(odd.validate().unwrap_err().field, "parity");
    }
}
