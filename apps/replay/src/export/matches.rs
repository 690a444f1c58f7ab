//! The table of matches: a row for each blob, and one for each marker that was predicted in a camera's frame
//! and got none.

use protocol::matches::{MatchFrame, MatchedBlob, MatchedField};
use protocol::poses::BODY_NAMES;

/// Columns after the log time. `x_px`, `y_px` are the blob's place, of a marker without one its predicted
/// place; cells are empty where there is nothing.
pub const HEADER: &str = "frame,exposed_ns,camera,field,parity,blob,outcome,body,marker,x_px,y_px,innovation_x_px,innovation_y_px,residual_x_px,residual_y_px,nis";

/// The rows of a frame.
pub fn rows(matches: &MatchFrame) -> Vec<String> {
    let of_field = |field: &MatchedField| {
        let start = format!(
            "{},{},{},{},{}",
            matches.frame, matches.exposed_ns, field.camera, field.field, field.parity
        );
        let blobs = field.blobs().iter().map(|b| format!("{start},{}", of_blob(b)));
        let missed = field.missed().iter().map(|m| {
            let body = BODY_NAMES.get(m.body as usize).unwrap_or(&"");
            format!("{start},,no blob,{body},{},{},{},,,,,", m.marker, m.x_px, m.y_px)
        });
        blobs.chain(missed).collect::<Vec<_>>()
    };
    matches.fields().iter().flat_map(of_field).collect()
}

fn of_blob(b: &MatchedBlob) -> String {
    let cell = |there: bool, value: f32| if there { value.to_string() } else { String::new() };
    let (body, marker) = match b.marker() {
        Some((body, marker)) => (BODY_NAMES[body], marker.to_string()),
        None => ("", String::new()),
    };
    let predicted = b.nis > 0.0;
    let fitted = b.outcome().is_matched();
    format!(
        "{},{},{body},{marker},{},{},{},{},{},{},{}",
        b.blob,
        b.outcome().text(),
        b.x_px,
        b.y_px,
        cell(predicted, b.innovation_x_px),
        cell(predicted, b.innovation_y_px),
        cell(fitted, b.residual_x_px),
        cell(fitted, b.residual_y_px),
        cell(predicted, b.nis)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::matches::NO_BODY;

    #[test]
    fn every_row_has_a_cell_for_each_column() {
        let mut frame = MatchFrame { field_count: 2, ..Zeroable::zeroed() };
        let field = &mut frame.fields_mut()[1];
        field.push(MatchedBlob { body: 1, nis: 2.0, ..Zeroable::zeroed() });
        field.push(MatchedBlob { body: NO_BODY, outcome: 7, ..Zeroable::zeroed() });
        field.push_missed(Zeroable::zeroed());
        let rows = rows(&frame);
        let cells = |row: &str| row.split(',').count();
        assert!(rows.len() == 3 && rows.iter().all(|row| cells(row) == cells(HEADER)), "{rows:?}");
        assert!(rows[1].contains("unassigned,,,0,0,,,,,"), "{}", rows[1]);
    }
}
