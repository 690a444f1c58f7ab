//! What became of the blobs of a field, for `vitreo trace`.

use protocol::matches::{MatchFrame, MatchedBlob, MissedMarker};
use protocol::poses::BODY_NAMES;
use serde_json::{Value, json};

/// Body and marker, as in tables.
fn name(body: u32, marker: u32) -> String {
    BODY_NAMES.get(body as usize).map_or("–".into(), |body| format!("{body} marker {marker}"))
}

/// A line a blob under a heading, then the markers that got none.
pub fn lines(matches: &MatchFrame) -> Vec<String> {
    let mut out = vec![format!(
        "{:<6} {:>4}  {:<15} {:<15} {:>8} {:>8} {:>15} {:>15} {:>7}",
        "camera", "blob", "outcome", "marker", "x px", "y px", "innovation px", "residual px", "NIS"
    )];
    for field in matches.fields() {
        out.extend(field.blobs().iter().map(|blob| blob_line(field.camera, blob)));
        out.extend(field.missed().iter().map(|missed| missed_line(field.camera, missed)));
    }
    out
}

fn blob_line(camera: u32, b: &MatchedBlob) -> String {
    let pair = |there: bool, x: f32, y: f32| if there { format!("{x:+.3} {y:+.3}") } else { String::new() };
    let innovation = pair(b.nis > 0.0, b.innovation_x_px, b.innovation_y_px);
    let residual = pair(b.outcome().is_matched(), b.residual_x_px, b.residual_y_px);
    let nis = if b.nis > 0.0 { format!("{:.2}", b.nis) } else { String::new() };
    format!(
        "{camera:<6} {:>4}  {:<15} {:<15} {:>8.2} {:>8.2} {innovation:>15} {residual:>15} {nis:>7}",
        b.blob,
        b.outcome().text(),
        name(b.body, b.marker),
        b.x_px,
        b.y_px
    )
    .trim_end()
    .to_owned()
}

fn missed_line(camera: u32, m: &MissedMarker) -> String {
    let (name, x, y) = (name(m.body, m.marker), m.x_px, m.y_px);
    format!("{camera:<6} {:>4}  {:<15} {name:<15} {x:>8.2} {y:>8.2}", "", "no blob")
}

/// The same for programs.
pub fn as_json(matches: &MatchFrame) -> Value {
    let blob = |b: &MatchedBlob| {
        json!({
            "blob": b.blob,
            "outcome": b.outcome().text(),
            "body": BODY_NAMES.get(b.body as usize),
            "marker": b.marker().map(|(_, marker)| marker),
            "px": [b.x_px, b.y_px],
            "innovation_px": (b.nis > 0.0).then_some([b.innovation_x_px, b.innovation_y_px]),
            "residual_px": b.outcome().is_matched().then_some([b.residual_x_px, b.residual_y_px]),
            "nis": (b.nis > 0.0).then_some(b.nis),
        })
    };
    let missed = |m: &MissedMarker| json!({"body": BODY_NAMES.get(m.body as usize), "marker": m.marker, "predicted_px": [m.x_px, m.y_px]});
    let fields = matches.fields().iter().map(|field| {
        json!({
            "camera": field.camera,
            "field": field.field,
            "blobs": field.blobs().iter().map(blob).collect::<Vec<_>>(),
            "missed": field.missed().iter().map(missed).collect::<Vec<_>>(),
        })
    });
    fields.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::matches::{BlobUse, NO_BODY};

    #[test]
    fn every_blob_and_every_missed_marker_has_a_line() {
        let mut frame = MatchFrame { field_count: 1, ..Zeroable::zeroed() };
        let field = &mut frame.fields_mut()[0];
        let used = MatchedBlob { body: 2, marker: 4, nis: 0.5, residual_x_px: -0.25, ..Zeroable::zeroed() };
        field.push(used);
        field.push(MatchedBlob {
            body: NO_BODY,
            outcome: BlobUse::NotTracked as u32,
            blob: 1,
            ..Zeroable::zeroed()
        });
        field.push_missed(MissedMarker { body: 1, marker: 3, x_px: 100.5, y_px: 9.0 });
        let lines = lines(&frame);
        assert_eq!(lines.len(), 4);
        assert!(lines[1].contains("eye marker 4") && lines[1].contains("-0.250 +0.000"), "{}", lines[1]);
        assert!(lines[2].contains("not tracked") && lines[3].contains("no blob"), "{lines:?}");
        let json = as_json(&frame);
        assert_eq!(
            (&json[0]["blobs"][0]["body"], &json[0]["blobs"][1]["residual_px"]),
            (&json!("eye"), &Value::Null)
        );
        assert_eq!(json[0]["missed"][0]["predicted_px"], json!([100.5, 9.0]));
    }
}
