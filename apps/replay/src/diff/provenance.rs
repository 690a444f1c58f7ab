//! What differs in the provenance of two recordings, key by key.

pub use calibration::causes::catalogue::Part;

use super::side::Side;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// A key whose values differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KeyDifference {
    /// Where.
    pub part: Part,
    /// Path of the key, as `cameras.1.fx` or `membrane.size_mm`; lists by the `id` or `name` of their
    /// elements where these have one.
    pub key: String,
    /// Value in the first recording; none where the key is absent.
    pub a: Option<Value>,
    /// Value in the second.
    pub b: Option<Value>,
}

impl KeyDifference {
    /// Relative change of a number.
    pub fn ratio(&self) -> Option<f64> {
        let number = |v: &Option<Value>| v.as_ref()?.as_f64().filter(|v| *v != 0.0);
        Some(number(&self.b)? / number(&self.a)?)
    }
}

/// Every key whose values differ, part by part.
pub fn compare(a: &Side, b: &Side) -> Vec<KeyDifference> {
    let (p, q) = (&a.provenance, &b.provenance);
    let rigs = [&p.rig_json, &q.rig_json].map(|text| serde_json::from_str(text).unwrap_or(Value::Null));
    let scenes = [&p.scene_toml, &q.scene_toml].map(|text| toml::from_str(text).unwrap_or(Value::Null));
    let map = |pairs: &BTreeMap<String, String>| {
        Value::Object(pairs.iter().map(|(k, v)| (k.clone(), Value::String(v.clone()))).collect())
    };
    let parts = [
        (Part::Rig, rigs),
        (Part::Scene, scenes),
        (Part::Config, [map(&p.config), map(&q.config)]),
        (Part::Seeds, [map(&p.seeds), map(&q.seeds)]),
        (Part::Versions, [map(&p.versions), map(&q.versions)]),
    ];
    parts.into_iter().flat_map(|(part, values)| differences(part, &values)).collect()
}

/// The leaves that differ of two documents.
fn differences(part: Part, documents: &[Value; 2]) -> Vec<KeyDifference> {
    let [a, b] = documents.each_ref().map(|document| {
        let mut leaves = BTreeMap::new();
        collect(String::new(), document, &mut leaves);
        leaves
    });
    let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
    keys.sort_unstable();
    keys.dedup();
    let value = |side: &BTreeMap<String, Value>, key: &String| side.get(key).cloned();
    let differing = keys.into_iter().filter(|key| a.get(*key) != b.get(*key));
    differing
        .map(|key| KeyDifference { part, key: key.clone(), a: value(&a, key), b: value(&b, key) })
        .collect()
}

/// Adds the leaves below `value`: what is no table, and lists of numbers as a whole.
fn collect(path: String, value: &Value, leaves: &mut BTreeMap<String, Value>) {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    match value {
        Value::Object(map) => map.iter().for_each(|(name, v)| collect(below(name), v, leaves)),
        Value::Array(elements) if elements.iter().any(Value::is_object) => {
            for (number, element) in elements.iter().enumerate() {
                let name = element.get("name").or_else(|| element.get("id"));
                let name = match name {
                    Some(Value::String(name)) => name.clone(),
                    Some(Value::Number(id)) => id.to_string(),
                    _ => number.to_string(),
                };
                collect(below(&name), element, leaves);
            }
        }
        leaf => drop(leaves.insert(path, leaf.clone())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn keys_are_named_by_the_ids_of_their_elements() {
        let a = json!({"cameras": [{"id": 4, "fx": 2.0, "t": [0, 1]}], "unit": "mm", "old": 1});
        let b = json!({"cameras": [{"id": 4, "fx": 3.0, "t": [0, 2]}], "unit": "mm"});
        let found = differences(Part::Rig, &[a.clone(), b]);
        let keys: Vec<&str> = found.iter().map(|d| d.key.as_str()).collect();
        assert_eq!(keys, ["cameras.4.fx", "cameras.4.t", "old"]);
        assert_eq!((found[0].ratio(), found[1].ratio(), &found[2].b), (Some(1.5), None, &None));
        assert!(differences(Part::Rig, &[a.clone(), a]).is_empty());
    }
}
