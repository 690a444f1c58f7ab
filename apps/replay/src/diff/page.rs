//! A comparison as a plot, and as a page that needs no network.

use super::comparison::Comparison;
use super::instant::{BodyThere, Instant};
use super::pictures::Drawn;
use super::poses::{both_measured, displacement_um};
use super::text::text;
use plots::line_plot::{Line, LinePlot};
use plots::page::{base64, escaped};
use plots::{Format, bytes};
use protocol::poses::BODY_NAMES;
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
     h1{font-size:1.4em}h2{font-size:1.1em;margin-top:2em}pre{background:#f6f6f6;padding:1em;overflow:auto;font-size:13px}\
     .same{color:#060}.differ{color:#a30}svg{max-width:100%;height:auto}\
     .two{display:flex;gap:1em;flex-wrap:wrap}.two>div{flex:1 1 380px;min-width:0}.two img{width:100%;height:auto}\
     .none{background:#eee;padding:3em 1em;text-align:center}table{border-collapse:collapse;font-size:13px}\
     td,th{border:1px solid #ddd;padding:.2em .6em;text-align:left}";

/// Distances of the poses over time.
pub fn plot(c: &Comparison) -> LinePlot {
    let of_body = |body: usize| {
        let both = c.frames.iter().filter(|pair| both_measured(pair, body));
        let point = |pair: &super::poses::FramePair| {
            let at_s = super::causes::seconds(c.start_ns, pair.a.exposed_ns);
            [at_s, displacement_um(body, &pair.a.bodies[body], &pair.b.bodies[body]).norm()]
        };
        Line { name: BODY_NAMES[body].into(), points: both.map(point).collect() }
    };
    LinePlot {
        title: "Distance of the poses".into(),
        across: "s from the start of A".into(),
        up: "µm (the eye: at its wall)".into(),
        lines: (0..BODY_NAMES.len()).map(of_body).collect(),
    }
}

/// The page; with the instant at which the recordings differ most, drawn.
///
/// # Errors
/// Where the plot cannot be drawn.
pub fn html(c: &Comparison, worst: Option<(&Instant, &[Drawn; 2])>) -> anyhow::Result<String> {
    let svg = String::from_utf8(bytes(&plot(c), Format::Svg)?)?;
    let verdict =
        if c.same { ("same", "The recordings are the same") } else { ("differ", "The recordings differ") };
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>vitreo diff</title>\
         <style>{STYLE}</style></head><body>\n<h1 class=\"{}\">{}</h1>\n",
        verdict.0, verdict.1
    );
    // Writing into a string cannot fail.
    let _ = writeln!(out, "<p>A {}<br>B {}</p>", escaped(&c.a), escaped(&c.b));
    causes(c, &mut out);
    if let Some((at, drawn)) = worst {
        instant(at, drawn, &mut out);
    }
    let _ = writeln!(
        out,
        "<h2>Poses</h2>\n{svg}\n<h2>Figures</h2>\n<pre>{}</pre>\n</body></html>",
        escaped(&text(c))
    );
    Ok(out)
}

fn causes(c: &Comparison, out: &mut String) {
    if c.causes.is_empty() {
        return;
    }
    let _ = writeln!(out, "<h2>Causes</h2><ul>");
    for finding in &c.causes {
        let _ = writeln!(out, "<li>{}</li>", escaped(&finding.text()));
    }
    let _ = writeln!(out, "</ul>");
}

/// Both pictures beside each other, and what is known of the instant.
fn instant(at: &Instant, drawn: &[Drawn; 2], out: &mut String) {
    let _ =
        writeln!(out, "<h2>Where they differ most</h2>\n<p>{}</p>\n<div class=\"two\">", escaped(&at.why));
    for (side, name) in ["A", "B"].into_iter().enumerate() {
        let field = at.fields[side].map_or("no frame near it".into(), |field| format!("field {field}"));
        let _ = writeln!(out, "<div><h3>{name} at {:.3} s, {field}</h3>", at.at_s[side]);
        picture(name, &drawn[side], out);
        let _ = writeln!(out, "</div>");
    }
    let _ = writeln!(out, "</div>\n<table><tr><th></th><th>A</th><th>B</th><th>apart, µm</th></tr>");
    for BodyThere { body, poses: [a, b], apart_um } in &at.bodies {
        let apart = apart_um.map_or(String::new(), |um| format!("{um:.2}"));
        let _ = writeln!(out, "<tr><th>{body}</th><td>{a}</td><td>{b}</td><td>{apart}</td></tr>");
    }
    let _ = writeln!(out, "</table>");
    if !at.differs.is_empty() {
        let differs: Vec<String> = at.differs.iter().map(|what| escaped(what)).collect();
        let _ = writeln!(out, "<p>First differs here: {}</p>", differs.join("; "));
    }
}

/// A picture within the page, or why there is none.
fn picture(name: &str, drawn: &Drawn, out: &mut String) {
    match drawn {
        Drawn::Jpeg { bytes, note } => {
            let data = base64(bytes);
            let _ = writeln!(out, "<img alt=\"{name}\" src=\"data:image/jpeg;base64,{data}\">");
            if let Some(note) = note {
                let _ = writeln!(out, "<p>{}</p>", escaped(note));
            }
        }
        Drawn::Not(why) => {
            let _ = writeln!(out, "<p class=\"none\">no picture: {}</p>", escaped(why));
        }
    }
}
