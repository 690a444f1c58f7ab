//! A membrane of any shape: key `membrane.mesh`.

use super::{Defect, SceneError, refuse};
use protocol::file::{MAX_TABLE_BYTES, looks_like, read_bytes};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Corners that a mesh may have; the largest sheet of squares has as many.
const MAX_NODES: usize = 641_601;
/// A corner may lie so far behind the retina: files that lay a mesh onto it are rounded, mm.
const BEHIND_MM: f64 = 0.01;

/// A triangle mesh in place of a sheet of squares. It must be manifold and wound one way; which way
/// is up does not matter.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshScene {
    /// Wavefront file with its corners and triangles, beside the scene file. When the scene is
    /// loaded they take its place below, so that a recording holds the mesh.
    pub obj: Option<String>,
    /// What holds it from the start.
    #[serde(default)]
    pub pinned: Pinned,
    /// Corners in the eye frame, mm.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub positions_mm: Vec<[f32; 3]>,
    /// Corners of each triangle, counted from 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub triangles: Vec<[u32; 3]>,
}

/// Nodes of a mesh that are attached to the retina where they are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pinned {
    /// Those on its edge.
    #[default]
    Edge,
    /// None: adhesion holds it, or nothing.
    Nothing,
}

impl MeshScene {
    /// Reads the file that is named, if one is, from the folder of the scene file `scene`.
    pub(super) fn resolve(&mut self, scene: &str) -> Result<(), SceneError> {
        let Some(obj) = self.obj.take() else { return Ok(()) };
        let path = Path::new(scene).parent().unwrap_or(Path::new("")).join(&obj);
        let name = path.display().to_string();
        let bytes = read_bytes(&path, MAX_TABLE_BYTES)
            .map_err(|source| SceneError::Read { name: name.clone(), source })?;
        let refused = |field: String, expected: &str, found| SceneError::Value {
            name,
            field,
            expected: expected.into(),
            found,
        };
        let text = std::str::from_utf8(&bytes).ok().filter(|text| !text.starts_with("ply"));
        let Some(text) = text else {
            let found = looks_like(&bytes).to_owned();
            return Err(refused("contents".into(), "a Wavefront file (text with lines v and f)", found));
        };
        (self.positions_mm, self.triangles) = parse_obj(text)
            .map_err(|(line, expected, found)| refused(format!("line {line}"), expected, found))?;
        Ok(())
    }

    /// What is wrong in an eye of this radius.
    pub(super) fn defect(&self, retina_radius_mm: f64) -> Option<Defect> {
        if let Some(obj) = &self.obj {
            let expected = "a scene that is loaded from a file in the mesh's folder";
            return refuse("membrane.mesh.obj", expected, obj);
        }
        let nodes = self.positions_mm.len();
        if !(3..=MAX_NODES).contains(&nodes) {
            return refuse("membrane.mesh.positions_mm", format!("3 to {MAX_NODES} corners"), nodes);
        }
        let triangles = self.triangles.len();
        if !(1..=2 * MAX_NODES).contains(&triangles) {
            return refuse("membrane.mesh.triangles", format!("1 to {} triangles", 2 * MAX_NODES), triangles);
        }
        self.outside(retina_radius_mm)
    }

    /// The corner that lies farthest behind the retina, or is no place at all.
    fn outside(&self, retina_radius_mm: f64) -> Option<Defect> {
        let beyond = |p: &[f32; 3]| {
            let squares: f64 = p.iter().map(|c| f64::from(*c) * f64::from(*c)).sum();
            let mm = squares.sqrt() - retina_radius_mm;
            if mm.is_finite() { mm } else { f64::INFINITY }
        };
        let all = self.positions_mm.iter().map(beyond).enumerate();
        let (corner, mm) = all.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, mm)| *mm > BEHIND_MM)?;
        let expected = format!("corners within the eye, whose retina has a radius of {retina_radius_mm} mm");
        let [x, y, z] = self.positions_mm[corner];
        let found = format!("corner {} at ({x}, {y}, {z}), {mm:.3} mm outside", corner + 1);
        refuse("membrane.mesh.positions_mm", expected, found)
    }
}

/// Corners, mm, and triangles.
pub type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A line that was refused: its number, what was expected, what it says.
pub type Refused = (usize, &'static str, String);

/// Corners and triangles of a Wavefront text: its `v` and `f` lines, faces with more corners as
/// fans. Texture and normal numbers are passed over, as are all other lines.
///
/// # Errors
/// The first line that is refused.
pub fn parse_obj(text: &str) -> Result<Mesh, Refused> {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for (number, line) in text.lines().enumerate() {
        let refused = |expected| (number + 1, expected, line.trim().chars().take(80).collect());
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let numbers: Vec<f32> = words.map_while(|w| w.parse().ok()).take(3).collect();
                let position: [f32; 3] =
                    numbers.try_into().map_err(|_| refused("\"v\" and three numbers, mm"))?;
                positions.push(position);
            }
            Some("f") => {
                let corner = |w: &str| corner(w, positions.len());
                let corners: Option<Vec<u32>> = words.map(corner).collect();
                let corners = corners.filter(|c| c.len() >= 3);
                let corners =
                    corners.ok_or_else(|| refused("\"f\" and at least three corners that come before it"))?;
                triangles.extend(corners[1..].windows(2).map(|pair| [corners[0], pair[0], pair[1]]));
            }
            _ => {}
        }
    }
    Ok((positions, triangles))
}

/// Number of a corner, from 0, of those so far: `7`, `7/1`, `7//3`, or `-1` for the last.
fn corner(word: &str, count: usize) -> Option<u32> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let from_zero = if number < 0 { number + count as i64 } else { number - 1 };
    (0..count as i64).contains(&from_zero).then_some(from_zero as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn corners_and_fans_are_read() {
        let text =
            "# a square\nv 0 0 -11\nv 1 0 -11 1.0\nv 1 1 -11\nv 0 1 -11\nvn 0 0 1\nf 1/1 2/2/2 3//3 -1\n";
        let (positions, triangles) = parse_obj(text).unwrap();
        assert_eq!((positions.len(), positions[2]), (4, [1.0, 1.0, -11.0]));
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, line) in [("v 0 0\n", 1), ("v 0 0 0\nf 1 2 3\n", 2), ("v 0 0 x", 1), ("\nf 0 0 0", 2)] {
            assert_eq!(parse_obj(text).unwrap_err().0, line, "{text}");
        }
    }

    /// The shipped scene with `mesh` in a folder, as its error or as it was read.
    fn with_mesh(obj: &[u8]) -> Result<crate::SceneFile, String> {
        let folder = tempfile::tempdir().unwrap();
        let mut scene = crate::SceneFile::load("peel").unwrap();
        let m = scene.membrane.as_mut().unwrap();
        (m.towards_in_eye, m.size_mm, m.squares, m.lift_mm) = Default::default();
        m.loose_edge = false;
        m.mesh = Some(MeshScene { obj: Some("sheet.obj".into()), ..MeshScene::default() });
        std::fs::write(folder.path().join("sheet.obj"), obj).unwrap();
        let file = folder.path().join("scene.toml");
        std::fs::write(&file, scene.to_toml()).unwrap();
        crate::SceneFile::load(file.to_str().unwrap()).map_err(|e| e.to_string())
    }

    #[test]
    fn a_mesh_of_another_kind_is_named() {
        let binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nend_header\n\xff\xfe\x00";
        for (file, what) in [(&binary[..], "a binary PLY mesh"), (b"ply\nformat ascii 1.0\n", "a PLY mesh")] {
            let error = with_mesh(file).unwrap_err();
            let expected = format!(
                "sheet.obj: contents: expected a Wavefront file (text with lines v and f), found {what}"
            );
            assert!(error.contains(&expected), "{error}");
        }
    }

    #[test]
    fn a_mesh_outside_the_eye_is_refused_with_its_corner() {
        let sheet = "v -1 -1 -11\nv 1 -1 -11\nv 0 1 -11\nf 1 2 3\n";
        assert_eq!(with_mesh(sheet.as_bytes()).unwrap().membrane.unwrap().mesh.unwrap().triangles.len(), 1);
        let error = with_mesh(sheet.replacen("0 1 -11", "0 0 -28", 1).as_bytes()).unwrap_err();
        let expected = "found corner 3 at (0, 0, -28), 16.500 mm outside";
        assert!(error.contains("membrane.mesh.positions_mm") && error.contains(expected), "{error}");
        for strange in ["nan", "inf", "1e39"] {
            let error = with_mesh(sheet.replacen("0 1 -11", &format!("0 0 {strange}"), 1).as_bytes());
            assert!(error.as_ref().unwrap_err().contains("corner 3"), "{error:?}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "([vf]( -?[0-9]{1,3}(/[0-9])?){0,5}\n|.{0,20}\n){0,20}") {
            if let Ok((positions, triangles)) = parse_obj(&text) {
                prop_assert!(triangles.iter().flatten().all(|&n| (n as usize) < positions.len()));
            }
        }
    }
}
