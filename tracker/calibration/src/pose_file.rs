//! Reading poses for exchange (`poses.csv`): `t_ns,…,body,valid,x,y,z,qw,qx,qy,qz`, columns in any
//! order; rows that are not valid, and predictions (`kind` other than `meas`), are passed over.

use anyhow::{Context, Result, anyhow, ensure};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use protocol::file::{MAX_TABLE_BYTES, read_bytes, rows};
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use std::collections::BTreeMap;
use std::path::Path;

/// Poses `world_from_body` of all bodies at one instant.
pub type Poses = [Option<Isometry3<f64>>; BODIES];

/// Columns that must be there; the first seven numbers make the pose.
const COLUMNS: [&str; 10] = ["x", "y", "z", "qw", "qx", "qy", "qz", "t_ns", "body", "valid"];

/// Reads measured poses, by instant.
///
/// # Errors
/// A file that cannot be read; otherwise as [`parse`].
pub fn load(path: &Path) -> Result<Vec<Poses>> {
    let file = path.display().to_string();
    let text = read_bytes(path, MAX_TABLE_BYTES).map_err(|e| anyhow!("poses {file}: {e}"))?;
    parse(&String::from_utf8_lossy(&text), &file)
}

/// Parses the text of a file of poses; `file` is for messages.
///
/// # Errors
/// A header without one of the columns, or a line that does not hold a pose.
pub fn parse(text: &str, file: &str) -> Result<Vec<Poses>> {
    let mut lines = rows(text);
    let header = lines.next();
    let (at, names) =
        header.with_context(|| format!("poses {file}, line 1: expected a header, found nothing"))?;
    let column = |name: &str| names.iter().position(|n| n == name);
    let mut columns = [0; COLUMNS.len()];
    for (slot, name) in columns.iter_mut().zip(COLUMNS) {
        *slot = column(name).with_context(|| format!("poses {file}, line {at}: expected a column {name}"))?;
    }
    let kind = column("kind");
    let mut instants: BTreeMap<u64, Poses> = BTreeMap::new();
    for (line, row) in lines {
        let place = format!("poses {file}, line {line}");
        let (expected, found) = (names.len(), row.len());
        ensure!(found == expected, "{place}: expected {expected} fields, found {found}");
        let [pose @ .., t_ns, body, valid] = columns.map(|i| &row[i]);
        if valid == "0" || kind.is_some_and(|k| !matches!(&row[k], "meas" | "")) {
            continue;
        }
        let index = BODY_NAMES.iter().position(|b| *b == body);
        let index =
            index.with_context(|| format!("{place}: body: expected inst0, inst1 or eye, found {body}"))?;
        let t_ns: u64 =
            t_ns.parse().map_err(|_| anyhow!("{place}: t_ns: expected a whole number, found {t_ns}"))?;
        instants.entry(t_ns).or_default()[index] = Some(pose_of(pose, &place)?);
    }
    Ok(instants.into_values().collect())
}

/// The pose in the fields x, y, z, qw, qx, qy, qz.
fn pose_of(fields: [&str; 7], place: &str) -> Result<Isometry3<f64>> {
    let mut numbers = [0.0; 7];
    for ((slot, field), name) in numbers.iter_mut().zip(fields).zip(COLUMNS) {
        let value = field.parse::<f64>().ok().filter(|v| v.is_finite() && v.abs() < 1e6);
        *slot = value.with_context(|| format!("{place}: {name}: expected a finite number, found {field}"))?;
    }
    let [x, y, z, qw, qx, qy, qz] = numbers;
    let turn = Quaternion::new(qw, qx, qy, qz);
    let length = turn.norm();
    ensure!(
        (length - 1.0).abs() <= 1e-3,
        "{place}: expected a unit quaternion, found one of length {length}"
    );
    let rotation = UnitQuaternion::from_quaternion(turn);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::new(x, y, z)), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TEXT: &str = "t_ns,t_out_ns,body,valid,x,y,z,qw,qx,qy,qz,kind\n\
        20,30,inst0,1,1.5,2,3,1,0,0,0,meas\n20,30,eye,1,0,0,0,0,1,0,0,meas\n\
        20,30,inst1,0,9,9,9,1,0,0,0,meas\n40,50,inst0,1,9,9,9,1,0,0,0,pred\n";

    #[test]
    fn measured_rows_are_taken() {
        let instants = parse(TEXT, "p").unwrap();
        assert_eq!(instants.len(), 1);
        assert_eq!(instants[0][0].unwrap().translation.vector, Vector3::new(1.5, 2.0, 3.0));
        assert!(instants[0][1].is_none() && instants[0][2].is_some());
    }

    #[test]
    fn defects_are_named_with_their_line() {
        let cases = [
            ("valid,x", "x", "line 1: expected a column valid"),
            ("inst0,1,1.5", "lens,1,1.5", "line 2: body: expected inst0"),
            ("1.5", "inf", "line 2: x: expected a finite number"),
            ("20,30,eye", "-2,30,eye", "line 3: t_ns: expected a whole number"),
            ("0,1,0,0,meas", "0,1,1,0,meas", "line 3: expected a unit quaternion"),
            ("1,0,0,0,meas\n20,30,eye", "1,0,0,meas\n20,30,eye", "line 2: expected 12 fields, found 11"),
        ];
        for (from, to, named) in cases {
            let broken = TEXT.replacen(from, to, 1);
            assert_ne!(broken, TEXT, "{from}");
            let error = parse(&broken, "p.csv").unwrap_err().to_string();
            assert!(error.contains("p.csv") && error.contains(named), "{error}");
        }
        assert!(parse("", "p").is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_parsed_or_refused(text in "\\PC{0,60}", cut in 0..TEXT.len(), with in any::<char>()) {
            let _ = parse(&text, "f");
            let mut damaged: String = TEXT.chars().take(cut).collect();
            damaged.push(with);
            damaged.extend(TEXT.chars().skip(cut + 1));
            let _ = parse(&damaged, "f");
        }
    }
}
