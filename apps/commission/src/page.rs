//! The report: one page, one file, with its pictures in it.

use crate::folder::{Record, State, Step};
use plots::page::{base64, escaped};
use std::fmt::Write;

const HEAD: &str = "<!doctype html>
<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Commissioning of a rig</title><style>
body { font: 15px/1.4 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; color: #222 }
h2 { border-top: 1px solid #bbb; padding-top: .6em; margin-bottom: .2em }
td { padding: .1em 1.5em .1em 0; vertical-align: top } .advice { color: #a33b00 } .todo { color: #777 }
figure { display: inline-block; margin: .6em 1em .6em 0 } img { max-width: 27em; border: 1px solid #ccc }
figcaption { font-size: 85%; color: #555 }
</style></head><body><h1>Commissioning of a rig</h1>
";

/// The page; `picture` gives the bytes of a PNG by its name.
pub fn of(state: &State, picture: &dyn Fn(&str) -> Option<Vec<u8>>) -> String {
    let mut out = HEAD.to_owned();
    for step in Step::ALL {
        let _ = writeln!(out, "<h2>{}</h2>", step.name());
        match state.steps.get(&step) {
            Some(record) => section(record, picture, &mut out),
            None => {
                let how = escaped(step.how());
                let _ = writeln!(out, "<p class=\"todo\">not done yet: vitreo commission FOLDER {how}</p>");
            }
        }
    }
    out.push_str("</body></html>\n");
    out
}

fn section(record: &Record, picture: &dyn Fn(&str) -> Option<Vec<u8>>, out: &mut String) {
    let _ = writeln!(out, "<p><b>{}</b></p>", escaped(&record.summary));
    let _ = writeln!(out, "<p>from {}</p>", escaped(&record.from.join(", ")));
    for advice in &record.advice {
        let _ = writeln!(out, "<p class=\"advice\">{}</p>", escaped(advice));
    }
    if !record.figures.is_empty() {
        out.push_str("<table>\n");
        for (name, value) in &record.figures {
            let _ = writeln!(out, "<tr><td>{}</td><td>{}</td></tr>", escaped(name), escaped(value));
        }
        out.push_str("</table>\n");
    }
    for note in &record.notes {
        let _ = writeln!(out, "<p>{}</p>", escaped(note));
    }
    for (name, caption) in &record.pictures {
        let caption = escaped(caption);
        let _ = match picture(name) {
            Some(bytes) => writeln!(
                out,
                "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption>\
                 </figure>",
                base64(&bytes)
            ),
            None => writeln!(out, "<p>{caption}: {} is missing</p>", escaped(name)),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_holds_what_was_found_and_what_is_to_do() {
        let mut state = State::default();
        let mut record = Record { summary: "5 colours".into(), ..Record::default() };
        record.advice.push("camera 2: <closer>".into());
        record.pictures.push(("gone.png".into(), "what is found".into()));
        state.steps.insert(Step::Colours, record);
        let page = of(&state, &|_| None);
        assert!(page.contains("<b>5 colours</b>") && page.contains("camera 2: &lt;closer&gt;"), "{page}");
        assert!(page.contains("gone.png is missing"), "{page}");
        assert_eq!(page.matches("not done yet").count(), 4, "{page}");
    }
}
