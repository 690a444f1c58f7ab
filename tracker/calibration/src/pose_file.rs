//! Reading poses for exchange (`poses.csv`): `t_ns,…,body,valid,x,y,z,qw,qx,qy,qz`, columns in any
//! order; rows that are not valid, and predictions (`kind` other than `meas`), are passed over.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use protocol::limits::BODIES;
use protocol::poses::BODY_NAMES;
use std::collections::BTreeMap;
use std::path::Path;

/// Why a file of poses was refused.
#[derive(Debug, thiserror::Error)]
pub enum PosesError {
    /// The file cannot be read.
    #[error("poses {file}: {source}")]
    Read {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line makes no sense.
    #[error("poses {file}, line {line}: {problem}")]
    Line {
        /// The file.
        file: String,
        /// Counted from 1.
        line: usize,
        /// What was expected and what was found.
        problem: String,
    },
}

/// Poses `world_from_body` of all bodies at one instant.
pub type Poses = [Option<Isometry3<f64>>; BODIES];

/// Columns that must be there; the first seven numbers make the pose.
const COLUMNS: [&str; 10] = ["x", "y", "z", "qw", "qx", "qy", "qz", "t_ns", "body", "valid"];

/// Reads measured poses, by instant.
pub fn load(path: &Path) -> Result<Vec<Poses>, PosesError> {
    let file = path.display().to_string();
    let text = std::fs::read(path).map_err(|source| PosesError::Read { file: file.clone(), source })?;
    parse(&String::from_utf8_lossy(&text), &file)
}

/// Parses the text of a file of poses; `file` is for messages.
pub fn parse(text: &str, file: &str) -> Result<Vec<Poses>, PosesError> {
    let refuse = |line: usize, problem: String| PosesError::Line { file: file.into(), line, problem };
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty());
    let (at, header) = lines.next().ok_or_else(|| refuse(1, "expected a header, found nothing".into()))?;
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    let column = |name: &str| names.iter().position(|n| *n == name);
    let mut columns = [0; COLUMNS.len()];
    for (slot, name) in columns.iter_mut().zip(COLUMNS) {
        *slot = column(name).ok_or_else(|| refuse(at, format!("expected a column {name}")))?;
    }
    let kind = column("kind");
    let mut instants: BTreeMap<u64, Poses> = BTreeMap::new();
    for (line, row) in lines {
        let fields: Vec<&str> = row.split(',').map(str::trim).collect();
        if fields.len() != names.len() {
            return Err(refuse(line, format!("expected {} fields, found {}", names.len(), fields.len())));
        }
        let field = |i: usize| fields[columns[i]];
        if field(9) == "0" || kind.is_some_and(|k| !matches!(fields[k], "meas" | "")) {
            continue;
        }
        let body = BODY_NAMES.iter().position(|b| *b == field(8));
        let body = body
            .ok_or_else(|| refuse(line, format!("body: expected inst0, inst1 or eye, found {}", field(8))))?;
        let t_ns: u64 = field(7)
            .parse()
            .map_err(|_| refuse(line, format!("t_ns: expected a whole number, found {}", field(7))))?;
        let mut numbers = [0.0; 7];
        for (i, slot) in numbers.iter_mut().enumerate() {
            let value = field(i).parse::<f64>().ok().filter(|v| v.is_finite() && v.abs() < 1e6);
            let expected =
                || refuse(line, format!("{}: expected a finite number, found {}", COLUMNS[i], field(i)));
            *slot = value.ok_or_else(expected)?;
        }
        let [x, y, z, qw, qx, qy, qz] = numbers;
        let turn = Quaternion::new(qw, qx, qy, qz);
        if (turn.norm() - 1.0).abs() > 1e-3 {
            return Err(refuse(
                line,
                format!("expected a unit quaternion, found one of length {}", turn.norm()),
            ));
        }
        let rotation = UnitQuaternion::from_quaternion(turn);
        let pose = Isometry3::from_parts(Translation3::from(Vector3::new(x, y, z)), rotation);
        instants.entry(t_ns).or_default()[body] = Some(pose);
    }
    Ok(instants.into_values().collect())
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
