//! How peers and product were compiled, for the head of each benchmark: a peer compiled worse loses for no
//! merit of ours.

use std::fmt::Write;

/// The workspace's manifest, by whose release profile benchmarks are built too.
const MANIFEST: &str = include_str!("../../../Cargo.toml");

/// One line: optimisation level and codegen units of each of these crates in the release profile.
///
/// # Panics
/// If the manifest has no release profile.
pub fn line(crates: &[&str]) -> String {
    let manifest: toml::Table = MANIFEST.parse().expect("the manifest was read by cargo");
    let release = &manifest["profile"]["release"];
    let mut line = format!("compiled (link-time optimisation {}):", release["lto"]);
    for name in crates {
        let own = release.get("package").and_then(|packages| packages.get(name));
        let figure = |key: &str| own.and_then(|own| own.get(key)).or_else(|| release.get(key)).cloned();
        let [level, units] = ["opt-level", "codegen-units"]
            .map(|key| figure(key).map_or_else(|| "default".to_owned(), |value| value.to_string()));
        // Writing to a string cannot fail.
        let _ = write!(line, " {name} level {level}, {units} unit(s);");
    }
    line.pop();
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Peers run in `validation` and in parry: as well compiled as what they are compared with.
    #[test]
    fn peers_are_compiled_as_well_as_the_product() {
        let line = line(&["collision", "tissue", "validation", "parry3d"]);
        assert_eq!(line.matches("level 3, 1 unit(s)").count(), 4, "{line}");
    }
}
