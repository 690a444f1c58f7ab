//! A membrane from a Wavefront file: loaded beside its scene, simulated, recorded whole, refused by
//! element.

use scene::{MeshScene, Pinned, SceneFile};
use simcore::world::{World, no_clock};
use std::fmt::Write;
use std::path::Path;
use surgeon::rehearsal::Rehearsal;
use tissue::sheet::mesh::SheetMesh;
use tissue::sheet::tearing::check_mesh;

/// The shipped sheet as a mesh, its triangles turned over: whoever draws one need not know which
/// side is front.
fn mesh() -> MeshScene {
    let sheet = SheetMesh::new(&SceneFile::load("peel").unwrap()).unwrap();
    let state = sheet.start();
    let positions_mm = (0..sheet.nodes()).map(|n| state.position(n).into()).collect();
    let triangles = sheet.triangles.iter().rev().map(|[a, b, c]| [*a, *c, *b]).collect();
    MeshScene { positions_mm, triangles, ..MeshScene::default() }
}

fn as_obj(mesh: &MeshScene) -> String {
    let mut text = String::from("# the shipped sheet\n");
    for [x, y, z] in &mesh.positions_mm {
        writeln!(text, "v {x} {y} {z}").unwrap();
    }
    for [a, b, c] in mesh.triangles.iter().map(|t| t.map(|n| n + 1)) {
        writeln!(text, "f {a} {b} {c}").unwrap();
    }
    text
}

/// The text of the shipped scene with a table in place of its squares.
fn with_table(table: &str) -> String {
    let mut scene = SceneFile::load("peel").unwrap();
    let m = scene.membrane.as_mut().unwrap();
    (m.towards_in_eye, m.size_mm, m.squares, m.lift_mm) = Default::default();
    // Any mesh will do for the text: the table comes instead.
    m.mesh = Some(MeshScene { obj: Some("here".into()), ..MeshScene::default() });
    let text = scene.to_toml();
    let begin = text.find("[membrane.mesh]").unwrap();
    let end = begin + text[begin + 1..].find("\n[").unwrap() + 1;
    format!("{}[membrane.mesh]\n{table}{}", &text[..begin], &text[end..])
}

fn load_from(folder: &Path, table: &str) -> Result<SceneFile, String> {
    let path = folder.join("own.toml");
    std::fs::write(&path, with_table(table)).unwrap();
    SceneFile::load(path.to_str().unwrap()).map_err(|e| e.to_string())
}

fn hashes(scene: &SceneFile) -> (World, Vec<u64>) {
    let (rehearsal, mut world) = (Rehearsal::shipped(scene), World::new(scene).unwrap());
    let hashes =
        (250..300).map(|field| world.step(&rehearsal.inputs(field).input(), &mut no_clock).state_hash);
    let hashes = hashes.collect();
    (world, hashes)
}

#[test]
fn a_mesh_beside_the_scene_is_held_by_its_edge_grabbed_and_recorded_whole() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("sheet.obj"), as_obj(&mesh())).unwrap();
    let scene = load_from(folder.path(), "obj = \"sheet.obj\"\n").unwrap();
    let recorded = SceneFile::parse(&scene.to_toml(), "a recording's scene").unwrap();
    assert_eq!(recorded, scene);
    let (world, first) = hashes(&scene);
    assert_eq!(hashes(&recorded).1, first);
    let (squares, own) = (SheetMesh::new(&SceneFile::load("peel").unwrap()).unwrap(), world.sheet());
    assert_eq!((own.rim.len(), own.triangles.len()), (squares.rim.len(), squares.triangles.len()));
    assert!(!world.state().membrane.held[0].is_empty(), "the jaws take it as they take the squares");
    assert_eq!(check_mesh(own, &world.state().membrane), Ok(()));
    let [a, b, c] = own.triangles[0].map(|n| world.state().membrane.position(n as usize));
    assert!((b - a).cross(&(c - a)).dot(&a) < 0.0, "turned so that its front looks into the eye");
}

/// What is done to a good mesh, and what must be reported.
type Spoiled<'a> = (&'a dyn Fn(&mut MeshScene), String);

#[test]
fn what_cannot_be_a_sheet_is_refused_by_its_element() {
    let refused = |change: &dyn Fn(&mut MeshScene)| {
        let mut scene = SceneFile::load("peel").unwrap();
        let m = scene.membrane.as_mut().unwrap();
        (m.towards_in_eye, m.size_mm, m.squares, m.lift_mm) = Default::default();
        let mut own = mesh();
        change(&mut own);
        m.mesh = Some(own);
        let scene = SceneFile::parse(&scene.to_toml(), "own.toml").map_err(|e| e.to_string());
        scene.and_then(|s| World::new(&s).map(|_| ()).map_err(|e| e.to_string())).unwrap_err()
    };
    let last = mesh().triangles.len() - 1;
    let cases: [Spoiled; 6] = [
        (&|m| m.triangles.push(m.triangles[3]), "expected at most two triangles, found 3".into()),
        (&|m| m.triangles[5] = [7, 7, 8], "triangle 5 names node 7 twice".into()),
        (&|m| m.triangles[last][0] = 1_000_000, format!("triangle {last} names node 1000000")),
        (
            &|m| m.positions_mm[9] = m.positions_mm[10],
            "spring between nodes [9, 10] has length 0e0 mm".into(),
        ),
        (&|m| m.triangles[3].swap(0, 1), "wound in opposite senses".into()),
        (&|m| m.positions_mm.clear(), "membrane.mesh.positions_mm: expected 3 to".into()),
    ];
    for (change, expected) in cases {
        let told = refused(change);
        assert!(told.contains(&expected) && told.contains("membrane.mesh"), "{told}");
    }
}

#[test]
fn a_table_that_contradicts_itself_or_its_file_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("broken.obj"), "v 0 0 -11\nv 1 0\n").unwrap();
    let told = |table: &str| load_from(folder.path(), table).unwrap_err();
    assert!(told("obj = \"gone.obj\"\n").contains("gone.obj"));
    let broken = told("obj = \"broken.obj\"\n");
    assert!(broken.contains("broken.obj: line 2: expected \"v\" and three numbers"), "{broken}");
    assert!(told("pinned = \"glue\"\n").contains("pinned"));
    let mut scene = SceneFile::load("peel").unwrap();
    scene.membrane.as_mut().unwrap().mesh = Some(MeshScene { pinned: Pinned::Nothing, ..mesh() });
    let both = SceneFile::parse(&scene.to_toml(), "both.toml").unwrap_err().to_string();
    assert!(both.contains("no such key with membrane.mesh"), "{both}");
}
