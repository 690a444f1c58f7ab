//! Cameras and figures in sentences, so that what is true of several cameras is reported once.

/// Cameras by their ids: `camera 4`, `cameras 0, 2 and 5`.
pub fn cameras(ids: &[u32]) -> String {
    let text: Vec<String> = ids.iter().map(u32::to_string).collect();
    match text.split_last() {
        None => "no camera".into(),
        Some((last, [])) => format!("camera {last}"),
        Some((last, others)) => format!("cameras {} and {last}", others.join(", ")),
    }
}

/// Values from the least to the largest with some decimals: `1.5`, `1.2 to 1.5`. What is not a number counts as infinite.
pub fn span(values: impl IntoIterator<Item = f64>, decimals: usize) -> String {
    let ends = |[least, most]: [f64; 2], value: f64| {
        let value = if value.is_nan() { f64::INFINITY } else { value };
        [least.min(value), most.max(value)]
    };
    let ends = values.into_iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends);
    let [least, most] = ends.map(|value| format!("{value:.decimals$}"));
    if least == most { least } else { format!("{least} to {most}") }
}

/// Cameras grouped by what is true of them, in the order of its first camera.
pub fn grouped<T: PartialEq>(all: impl IntoIterator<Item = (u32, T)>) -> Vec<(Vec<u32>, T)> {
    let mut groups: Vec<(Vec<u32>, T)> = Vec::new();
    for (id, said) in all {
        match groups.iter_mut().find(|group| group.1 == said) {
            Some(group) => group.0.push(id),
            None => groups.push((vec![id], said)),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_and_figures_are_put_into_words() {
        assert_eq!(cameras(&[4]), "camera 4");
        assert_eq!(cameras(&[0, 2, 5]), "cameras 0, 2 and 5");
        assert_eq!(span([1.52, 1.49], 1), "1.5");
        assert_eq!(span([1.5, 0.25, 1.0], 2), "0.25 to 1.50");
        assert_eq!(span([f64::NAN, 7.0], 0), "7 to inf");
        assert_eq!(grouped([(0, 'a'), (1, 'b'), (2, 'a')]), [(vec![0, 2], 'a'), (vec![1], 'b')]);
    }
}
