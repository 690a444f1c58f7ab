//! Files that are read, and files that are refused.

use super::*;

#[test]
fn shipped_rig_round_trips() {
    let rig = Rig::parse(SHIPPED, "assets/rig.json").unwrap();
    assert_eq!(rig, Rig::parse(&rig.to_json(), "again").unwrap());
    let value = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
    assert_eq!(value(&rig.to_json()), value(SHIPPED), "nothing is added to what a file says");
    assert_eq!(rig.field_period_ns(), 20_000_000);
    assert_eq!(rig.read_out_ns(), 2_000_000 + 288 * 64_000);
}

#[test]
fn other_files_and_formats_are_named() {
    let cases = [
        (
            "t_ns,cam,x,y\n1,2,3,4\n",
            "expected a rig: one JSON object, which begins with {, found a table (CSV)",
        ),
        ("[eye]\n", "found TOML"),
        ("", "found an empty file"),
        ("{\"format\": \"vitreo-rig-2\", \"eyes\": 2}", "found vitreo-rig-2, the format of a newer vitreo"),
    ];
    for (text, named) in cases {
        let error = Rig::parse(text, "r.json").unwrap_err().to_string();
        assert!(error.contains("r.json") && error.contains(named), "{error}");
    }
    assert!(Rig::parse(&format!("\u{feff}{SHIPPED}"), "with a byte order mark").is_ok());
    let error = Rig::load(Path::new("/dev/zero")).unwrap_err().to_string();
    assert_eq!(error, "rig file /dev/zero: expected at most 1 MiB, found more");
}

#[test]
fn the_page_lists_every_key() {
    fn keys(value: &serde_json::Value, found: &mut Vec<String>) {
        match value {
            serde_json::Value::Object(map) => map.iter().for_each(|(key, value)| {
                found.push(key.clone());
                keys(value, found);
            }),
            serde_json::Value::Array(list) => list.iter().for_each(|value| keys(value, found)),
            _ => {}
        }
    }
    let page = include_str!("../../../docs/rig.md");
    let mut found = Vec::new();
    keys(&serde_json::from_str(SHIPPED).unwrap(), &mut found);
    let mut rig = Rig::parse(SHIPPED, "shipped").unwrap();
    (rig.scan, rig.shutter, rig.pixel_format) = (Scan::Progressive, Shutter::Rolling, PixelFormat::Rgb8);
    let camera = &mut rig.cameras[0];
    (camera.scan, camera.shutter, camera.pixel_format) =
        (Some(rig.scan), Some(rig.shutter), Some(rig.pixel_format));
    (camera.field_hz, camera.line_ns, camera.exposure_ns) = (Some(50.0), Some(1), Some(1));
    keys(&serde_json::from_str(&rig.to_json()).unwrap(), &mut found);
    found.sort();
    found.dedup();
    assert_eq!(found.len(), 40, "{found:?}");
    for key in found {
        let named = [format!("`{key}`"), format!(".{key}`")].iter().any(|name| page.contains(name));
        assert!(named, "docs/rig.md lacks {key}");
    }
}

#[test]
fn defects_are_named() {
    let cases = [
        ("\"unit\": \"mm\"", "\"unit\": \"inch\"", "unit"),
        ("\"field_hz\": 50.0", "\"field_hz\": 0.0", "field_hz"),
        ("\"field_hz\"", "\"field_herz\"", "field_herz"),
        ("\"fx\": 1600.0", "\"fx\": -1.0", "cameras[0]"),
        ("\"colour\": \"red\"", "\"colour\": \"pink\"", "pink"),
        ("\"name\": \"inst1\"", "\"name\": \"inst0\"", "inst0"),
    ];
    for (from, to, named) in cases {
        let broken = SHIPPED.replacen(from, to, 1);
        assert_ne!(broken, SHIPPED, "{from} is not in the rig");
        let error = Rig::parse(&broken, "r.json").unwrap_err().to_string();
        assert!(error.contains("r.json") && error.contains(named), "{error}");
    }
}
