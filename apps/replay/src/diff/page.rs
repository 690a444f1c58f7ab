//! A comparison as a plot, and as a page that needs no network.

use super::comparison::Comparison;
use super::poses::{both_measured, displacement_um};
use super::text::text;
use plots::line_plot::{Line, LinePlot};
use plots::{Format, bytes};
use protocol::poses::BODY_NAMES;
use std::fmt::Write;

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
     h1{font-size:1.4em}h2{font-size:1.1em;margin-top:2em}pre{background:#f6f6f6;padding:1em;overflow:auto;font-size:13px}\
     .same{color:#060}.differ{color:#a30}svg{max-width:100%;height:auto}";

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

/// The page.
///
/// # Errors
/// Where the plot cannot be drawn.
pub fn html(c: &Comparison) -> anyhow::Result<String> {
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
    if !c.causes.is_empty() {
        let _ = writeln!(out, "<h2>Causes</h2><ul>");
        for finding in &c.causes {
            let _ = writeln!(out, "<li>{}</li>", escaped(&finding.text()));
        }
        let _ = writeln!(out, "</ul>");
    }
    let _ = writeln!(
        out,
        "<h2>Poses</h2>\n{svg}\n<h2>Figures</h2>\n<pre>{}</pre>\n</body></html>",
        escaped(&text(c))
    );
    Ok(out)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
