//! The cameras' view of what the tracker matched, as Foxglove's image annotations: a circle about every
//! blob in the colour of what became of it, a white point where its marker was predicted, and a white
//! point where a marker was predicted and not seen.

use foxglove::messages::points_annotation::Type;
use foxglove::messages::{CircleAnnotation, Color, ImageAnnotations, Point2, PointsAnnotation, Timestamp};
use protocol::limits::MAX_CAMERAS;
use protocol::matches::{BlobUse, MatchFrame, MatchedBlob, MatchedField};

/// A frame is shown in so much time, ns: ten a second are enough to look at, and the whole stands on `matches`.
const EVERY_NS: u64 = 100_000_000;
/// Diameter of a blob's circle, px.
const DIAMETER_PX: f64 = 14.0;

/// One frame in so many is shown, where cameras have this period.
pub(crate) fn one_in(period_ns: u64) -> u64 {
    ((EVERY_NS + period_ns / 2) / period_ns.max(1)).max(1)
}

/// Annotations by camera, of one frame in `every`; none for frames that are not shown.
pub(super) fn of_frame(
    frame: &MatchFrame,
    every: u64,
    timestamp: Option<Timestamp>,
) -> impl Iterator<Item = (usize, ImageAnnotations)> {
    let shown = frame.fields().iter().filter(move |_| frame.frame.is_multiple_of(every));
    let known = shown.filter(|field| (field.camera as usize) < MAX_CAMERAS);
    known.map(move |field| (field.camera as usize, of_field(field, timestamp)))
}

fn of_field(field: &MatchedField, timestamp: Option<Timestamp>) -> ImageAnnotations {
    let predicted = field.blobs().iter().filter_map(MatchedBlob::predicted_px);
    let missed = field.missed().iter().map(|m| [m.x_px, m.y_px]);
    let points: Vec<Point2> = predicted.chain(missed).map(point).collect();
    let predictions = PointsAnnotation {
        r#type: Type::Points as i32,
        points,
        outline_color: Some(Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 }),
        thickness: 2.0,
        ..PointsAnnotation::default()
    };
    ImageAnnotations {
        timestamp,
        circles: field.blobs().iter().map(circle).collect(),
        points: vec![predictions],
        ..ImageAnnotations::default()
    }
}

fn point([x, y]: [f32; 2]) -> Point2 {
    Point2 { x: f64::from(x), y: f64::from(y) }
}

fn circle(blob: &MatchedBlob) -> CircleAnnotation {
    CircleAnnotation {
        position: Some(point([blob.x_px, blob.y_px])),
        diameter: DIAMETER_PX,
        thickness: 2.0,
        outline_color: Some(colour(blob.outcome())),
        ..CircleAnnotation::default()
    }
}

/// Green: used; yellow: used in part; red: rejected by a fit; blue: near a marker and not its blob; grey: the
/// rest.
fn colour(outcome: BlobUse) -> Color {
    let [r, g, b] = match outcome {
        BlobUse::Used => [0.0, 1.0, 0.0],
        BlobUse::UsedInPart => [1.0, 1.0, 0.0],
        BlobUse::Outlier | BlobUse::BadFit => [1.0, 0.0, 0.0],
        BlobUse::Duplicate | BlobUse::Gated | BlobUse::WrongSize => [0.25, 0.5, 1.0],
        _ => [0.5; 3],
    };
    Color { r, g, b, a: 1.0 }
}

#[cfg(test)]
mod tests {
    use super::one_in;

    #[test]
    fn ten_frames_a_second_are_shown_at_every_rate() {
        let periods = [40_000_000, 20_000_000, 16_666_667, 5_000_000, 2_000_000];
        assert_eq!(periods.map(one_in), [3, 5, 6, 20, 50]);
        assert_eq!([one_in(0), one_in(u64::MAX / 2)], [100_000_000, 1]);
    }
}
