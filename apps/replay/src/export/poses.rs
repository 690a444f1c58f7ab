//! The table of poses: a row for each body of each tracker frame, with what the tracker says of how good it is.

use protocol::geometry::Validity;
use protocol::poses::{BODY_NAMES, BodyState, BodyStatus, TrackerFrame};

/// What the covariance is of: position in the world, mm, and rotation vector in the world, rad.
const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// Columns after the log time, with their units. `valid` is measured, predicted or lost; the pose is
/// `world_from_body`. The covariance is that of position and rotation vector in the world, its upper triangle
/// row by row.
pub fn header() -> String {
    let mut names =
        "frame,field,exposed_ns,tracked_ns,body,valid,status,x_mm,y_mm,z_mm,qw,qx,qy,qz".to_owned();
    for (row, a) in AXES.iter().enumerate() {
        for (column, b) in AXES.iter().enumerate().skip(row) {
            let unit = match (row < 3, column < 3) {
                (true, true) => "mm2",
                (true, false) => "mm_rad",
                _ => "rad2",
            };
            names += &format!(",cov_{a}_{b}_{unit}");
        }
    }
    names + ",residual_px,measured_ns,blobs,cameras"
}

/// The rows of a frame.
pub fn rows(frame: &TrackerFrame) -> Vec<String> {
    let of_body = |(body, name): (&BodyState, &str)| {
        let start = format!(
            "{},{},{},{},{name}",
            frame.frame, frame.field, frame.instants.exposed, frame.instants.tracked
        );
        let status = BodyStatus::from_wire(body.status).map_or("unknown", BodyStatus::text);
        let pose = body.world_from_body.position_mm.iter().chain(&body.world_from_body.rotation_wxyz);
        let numbers: Vec<String> = pose.chain(&body.covariance).map(f64::to_string).collect();
        format!(
            "{start},{},{status},{},{},{},{},{}",
            word(body.validity()),
            numbers.join(","),
            body.residual_px,
            body.measured_ns,
            body.blobs_used,
            body.cameras_used
        )
    };
    frame.bodies.iter().zip(BODY_NAMES).map(of_body).collect()
}

fn word(validity: Validity) -> &'static str {
    match validity {
        Validity::Measured => "measured",
        Validity::Predicted => "predicted",
        Validity::Lost => "lost",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn each_number_stands_under_its_name() {
        let mut frame = TrackerFrame { frame: 7, field: 9, ..Zeroable::zeroed() };
        let body = &mut frame.bodies[1];
        body.world_from_body.position_mm = [1.5, -2.0, 3.25];
        body.world_from_body.rotation_wxyz = [0.5, 0.5, -0.5, 0.5];
        // Number 6·row + column of the whole matrix, and its upper triangle row by row.
        let triangle = (0..6).flat_map(|row| (row..6).map(move |column| (6 * row + column) as f64));
        body.covariance.iter_mut().zip(triangle).for_each(|(entry, value)| *entry = value);
        (body.residual_px, body.blobs_used, body.cameras_used, body.measured_ns) = (0.125, 5, 2, 77);
        (body.validity, body.status) = (Validity::Measured as u32, BodyStatus::TooFewMarkers as u32);
        let (header, rows) = (header(), rows(&frame));
        let (names, cells): (Vec<&str>, Vec<&str>) =
            (header.split(',').collect(), rows[1].split(',').collect());
        assert!(rows.len() == 3 && rows.iter().all(|row| row.split(',').count() == names.len()));
        let of =
            |name: &str| cells[names.iter().position(|n| *n == name).unwrap_or_else(|| panic!("{name}"))];
        for (name, value) in [
            ("frame", "7"),
            ("body", "inst1"),
            ("valid", "measured"),
            ("status", "too few markers"),
            ("y_mm", "-2"),
            ("qy", "-0.5"),
            ("cov_x_x_mm2", "0"),
            ("cov_z_z_mm2", "14"),
            ("cov_y_rz_mm_rad", "11"),
            ("cov_ry_rz_rad2", "29"),
            ("cov_rz_rz_rad2", "35"),
            ("residual_px", "0.125"),
            ("measured_ns", "77"),
            ("blobs", "5"),
            ("cameras", "2"),
        ] {
            assert_eq!(of(name), value, "{name}");
        }
    }
}
