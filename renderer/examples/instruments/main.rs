//! Makes the instruments' meshes: `cargo run --release -p renderer --example instruments -- FOLDER`
//! (`make instruments`) writes a glTF file for each tool. Measures that the simulation shares come
//! from `protocol::handles`. The tests prove that the shipped meshes are these.

mod glb;
mod shapes;

use anyhow::{Context, Result};
use std::path::PathBuf;

fn main() -> Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).context("usage: instruments FOLDER")?);
    std::fs::create_dir_all(&folder)?;
    for tool in shapes::all() {
        let path = folder.join(format!("{}.glb", tool.name));
        std::fs::write(&path, glb::bytes(&tool)).with_context(|| path.display().to_string())?;
        let triangles: usize = tool.parts.iter().flat_map(|p| &p.surfaces).map(|s| s.triangles.len()).sum();
        println!("{}: {triangles} triangles", path.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_meshes_are_reproduced_to_the_byte() {
        for shape in shapes::all() {
            let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/instruments"))
                .join(format!("{}.glb", shape.name));
            let shipped = std::fs::read(&path).unwrap();
            assert!(
                glb::bytes(&shape) == shipped,
                "{} differs; renew it with `make instruments`",
                path.display()
            );
        }
    }

    #[test]
    fn files_are_in_metres_with_y_up() {
        for shape in shapes::all() {
            let gltf = gltf::Gltf::from_slice(&glb::bytes(&shape)).unwrap();
            let scene = gltf.default_scene().unwrap();
            let roots: Vec<_> = scene.nodes().collect();
            assert_eq!(roots.len(), 1);
            let matrix = glam::Mat4::from_cols_array_2d(&roots[0].transform().matrix());
            let end = matrix.transform_point3(glam::Vec3::Z * 60.0);
            assert!(end.distance(glam::Vec3::Y * 0.06) < 1e-6, "a shaft of 60 mm points upwards: {end}");
            let names: Vec<_> = roots[0].children().map(|n| n.name().unwrap().to_owned()).collect();
            let wanted: Vec<_> = shape.parts.iter().map(|p| p.name.to_owned()).collect();
            assert_eq!(names, wanted);
        }
    }
}
