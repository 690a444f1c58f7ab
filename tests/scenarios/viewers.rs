//! Layouts for viewers name topics and fields that recordings have.

use protocol::wire::{Kind, Layout};
use recording::{Item, VIEWER_TOPICS};
use serde_json::Value;
use vitreo_tests::repository;

fn read(name: &str) -> String {
    std::fs::read_to_string(repository().join("docs/viewers").join(name)).expect("a layout")
}

/// Every string in a layout, keys too.
fn strings(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::String(text) => found.push(text.clone()),
        Value::Array(all) => all.iter().for_each(|one| strings(one, found)),
        Value::Object(pairs) => {
            for (key, value) in pairs {
                found.push(key.clone());
                strings(value, found);
            }
        }
        _ => {}
    }
}

/// Whether a block has a field, by names one within the other; those of lists have numbers.
fn has_field(layout: &Layout, names: &[&str]) -> bool {
    let Some((first, rest)) = names.split_first() else { return true };
    let name = first.split('[').next().expect("a part");
    layout.recorded().filter(|field| field.name == name).any(|field| match (field.kind, rest.is_empty()) {
        (_, true) => true,
        (Kind::Struct(inner) | Kind::Array(&Kind::Struct(inner), _), false) => has_field(inner, rest),
        _ => false,
    })
}

/// Checks a path of topic and fields.
fn check(path: &str, between: char) {
    let names: Vec<&str> = path.split(between).collect();
    let layout = Item::layout(names[0]).unwrap_or_else(|| panic!("{path}: no topic {}", names[0]));
    assert!(has_field(layout, &names[1..]), "{path}: {} has no such field", layout.name);
}

#[test]
fn topics_and_fields_of_the_layouts_exist() {
    let layout: Value = serde_json::from_str(&read("foxglove-layout.json")).expect("JSON");
    let mut words = Vec::new();
    strings(&layout, &mut words);
    let topics: Vec<&String> = words.iter().filter(|word| word.starts_with('/')).collect();
    assert!(topics.len() >= 10, "{topics:?}");
    for topic in topics {
        assert!(VIEWER_TOPICS.contains(&topic.as_str()), "there is no topic {topic}");
    }
    let own = |word: &&String| Item::TOPICS.iter().any(|topic| word.starts_with(&format!("{topic}.")));
    let paths: Vec<&String> = words.iter().filter(own).collect();
    assert!(paths.len() >= 10, "{paths:?}");
    paths.iter().for_each(|path| check(path, '.'));
    let curves = read("plotjuggler-layout.xml");
    let names = curves.split("<curve name=\"").skip(1).map(|rest| rest.split('"').next().expect("a name"));
    let names: Vec<&str> = names.collect();
    assert!(names.len() >= 15, "{names:?}");
    names.iter().for_each(|name| check(name, '/'));
    let script = read("rerun_view.py");
    let origins = script.split("origin=\"").skip(1).map(|rest| rest.split('"').next().expect("a topic"));
    for origin in origins {
        let known = VIEWER_TOPICS.contains(&origin) || Item::TOPICS.contains(&&origin[1..]) || origin == "/";
        assert!(known, "there is no topic {origin}");
    }
}
