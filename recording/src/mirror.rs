//! Lossless copies between the plain blocks of the channels and their protobuf messages.
//!
//! A block and its message have fields of the same names. [`mirror!`] lists them once and makes
//! both directions; the compiler refuses a list that misses a field on either side.

use super::wire;
use bytemuck::Zeroable;
use protocol::geometry::Pose;
use protocol::handles::{HandleState, PedalState};
use protocol::poses::{BodyState, FieldUsed, Oscillator, Predictor};
use protocol::steps::{StepRecord, StepTimes};
use protocol::time::Instants;
use protocol::{blobs::Blob, events::Event, frames::FrameRecord};

/// A message lacks a part or has an array of the wrong length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected} elements, found {found}")]
pub struct Shape {
    /// Elements that the block has room for, or must have.
    pub expected: usize,
    /// Elements in the message.
    pub found: usize,
}

/// A value of a block with its form `W` in a message.
pub(super) trait Mirror<W>: Sized {
    /// The message's form.
    fn to_wire(&self) -> W;
    /// The block's form.
    fn from_wire(wire: &W) -> Result<Self, Shape>;
}

macro_rules! same {
    ($($type:ty),*) => { $(impl Mirror<$type> for $type {
        fn to_wire(&self) -> $type { *self }
        fn from_wire(wire: &$type) -> Result<Self, Shape> { Ok(*wire) }
    })* };
}
same!(u32, u64, f64);

impl Mirror<Option<f64>> for f64 {
    fn to_wire(&self) -> Option<f64> {
        Some(*self)
    }

    fn from_wire(wire: &Option<f64>) -> Result<Self, Shape> {
        Ok(wire.unwrap_or(0.0))
    }
}

impl<T: Mirror<W> + Copy + Zeroable, W, const N: usize> Mirror<Vec<W>> for [T; N] {
    fn to_wire(&self) -> Vec<W> {
        self.iter().map(T::to_wire).collect()
    }

    fn from_wire(wire: &Vec<W>) -> Result<Self, Shape> {
        let shape = Shape { expected: N, found: wire.len() };
        if wire.len() == N { filled(wire).map(|(array, _)| array) } else { Err(shape) }
    }
}

/// An array whose first elements come from a message, and how many; the rest is zero.
pub(super) fn filled<T, W, const N: usize>(wire: &[W]) -> Result<([T; N], u32), Shape>
where
    T: Mirror<W> + Copy + Zeroable,
{
    if wire.len() > N {
        return Err(Shape { expected: N, found: wire.len() });
    }
    let mut array = [T::zeroed(); N];
    for (slot, element) in array.iter_mut().zip(wire) {
        *slot = T::from_wire(element)?;
    }
    Ok((array, wire.len() as u32))
}

/// Makes `Mirror` for a block and a message with the same fields; `[f]` marks a field that is a
/// message of its own.
macro_rules! mirror {
    ($block:ident { $($field:ident),* } $([$($part:ident),*])?) => {
        impl Mirror<wire::$block> for $block {
            fn to_wire(&self) -> wire::$block {
                wire::$block {
                    $($field: self.$field.to_wire(),)*
                    $($($part: Some(self.$part.to_wire()),)*)?
                }
            }

            fn from_wire(wire: &wire::$block) -> Result<Self, Shape> {
                Ok($block {
                    $($field: Mirror::from_wire(&wire.$field)?,)*
                    $($($part: Mirror::from_wire(
                        wire.$part.as_ref().ok_or(Shape { expected: 1, found: 0 })?,
                    )?,)*)?
                })
            }
        }
    };
}

mirror!(Instants { exposed, read_out, blobs_out, taken, tracked, stepped });
mirror!(Blob {
    x_px,
    y_field_px,
    area_px,
    width_px,
    height_px,
    var_x_px2,
    var_y_px2,
    cov_xy_px2,
    colour,
    flags
});
mirror!(HandleState { seq, field, instant_ns, instrument, tool, jaw_rad });
mirror!(PedalState { seq, instant_ns, axes, buttons, mode });
mirror!(Pose { position_mm, rotation_wxyz });
mirror!(Oscillator { omega_rad_s, damping, position_mm, velocity_mm_s });
mirror!(Predictor {
    velocity_mm_s,
    acceleration_mm_s2,
    acceleration_tau_s,
    velocity_tau_s,
    angular_velocity_rad_s,
    oscillators
});
mirror!(BodyState {
    covariance, residual_px, measured_ns, validity, status, blobs_used, cameras_used
} [world_from_body, predictor]);
mirror!(FieldUsed { field, exposed_ns, camera, blobs_used });
mirror!(StepTimes { collision_ns, tissue_ns, transfer_ns, misc_ns });
mirror!(StepRecord {
    step, field, frame, handles_below, pedals_below, advanced_ns, state_hash, inputs_refused, frames_lost,
    membrane_cut_um2, retina_cut_um2, vitreous_removed_um3, vitreous_left_um3
} [instants, times]);
mirror!(Event {
    seq,
    field,
    exposed_ns,
    kind,
    severity,
    instrument,
    subject,
    value,
    limit,
    position_in_eye_mm
});
mirror!(
    FrameRecord {
        frame,
        field,
        scene_field,
        frame_start,
        latched,
        drawn,
        displayed,
        predicted_to,
        missed,
        tier,
        width_px,
        height_px,
        flags
    }[instants]
);
