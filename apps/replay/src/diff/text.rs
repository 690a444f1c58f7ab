//! A comparison for people: the verdict and the figures first, then the causes, which take longer to find.

use super::comparison::{Comparison, StageDifference};
use super::outcome::ScoreFigures;
use super::spectrum::BANDS;
use std::fmt::Write;

/// Unpaired events and keys that are listed.
const LISTED: usize = 10;

/// The comparison as text.
pub fn text(c: &Comparison) -> String {
    recorded(c) + &causes(c)
}

/// The causes, each with what helps. Writing into a string cannot fail.
pub fn causes(c: &Comparison) -> String {
    let mut out = String::new();
    if !c.causes.is_empty() {
        let _ = writeln!(out, "\ncauses");
    }
    for finding in &c.causes {
        let _ = writeln!(out, "cause: {}", finding.text());
        // A difference that was made on purpose needs none.
        if let Some(remedy) = finding.cause.remedy().filter(|_| finding.is_a_defect()) {
            let _ = writeln!(out, "       what helps: {remedy}");
        }
    }
    out
}

/// What was recorded, as text. Writing into a string cannot fail.
pub fn recorded(c: &Comparison) -> String {
    let mut out = format!("A {}\nB {}\n", c.a, c.b);
    verdict(c, &mut out);
    provenance(c, &mut out);
    inputs(c, &mut out);
    poses(c, &mut out);
    states_and_events(c, &mut out);
    if let Some(score) = &c.score {
        scores(score, &mut out);
    }
    latencies(c, &mut out);
    out
}

fn verdict(c: &Comparison, out: &mut String) {
    let within = if c.tolerance_um > 0.0 { format!(" within {} µm", c.tolerance_um) } else { String::new() };
    match (c.same, c.stages.first()) {
        (true, _) => drop(writeln!(out, "same{within}: {} compared", compared(c))),
        (false, Some(first)) => drop(writeln!(out, "differ{within}, first in {}", place(first))),
        (false, None) => drop(writeln!(out, "differ{within}")),
    }
    for stage in c.stages.iter().skip(usize::from(!c.same)) {
        let _ = writeln!(out, "  also in {}", place(stage));
    }
}

fn compared(c: &Comparison) -> String {
    let (fields, frames, states) = (c.inputs.fields_compared, c.poses.frames_compared, c.states.compared);
    let events = c.events.identical + c.events.shifted;
    format!("{fields} camera-fields, {frames} frames, {states} states, {events} events")
}

fn place(stage: &StageDifference) -> String {
    let name = stage.name();
    let at = stage.at_s.map(|at| format!(" at {at:.2} s")).unwrap_or_default();
    let field = stage.field.map(|field| format!(" (field {field})")).unwrap_or_default();
    format!("{name}{at}{field}: {}", stage.entry)
}

fn provenance(c: &Comparison, out: &mut String) {
    if !c.provenance.is_empty() {
        let _ = writeln!(out, "\nprovenance: {} keys differ", c.provenance.len());
    }
    for key in c.provenance.iter().take(LISTED) {
        let value = |v: &Option<serde_json::Value>| {
            let text = v.as_ref().map_or("absent".into(), ToString::to_string);
            if text.chars().count() > 60 {
                text.chars().take(57).chain("...".chars()).collect()
            } else {
                text
            }
        };
        let ratio = key.ratio().map(|r| format!(" (× {r:.4})")).unwrap_or_default();
        let _ = writeln!(
            out,
            "  {:<13} {}: {} → {}{ratio}",
            key.part.name(),
            key.key,
            value(&key.a),
            value(&key.b)
        );
    }
    if c.provenance.len() > LISTED {
        let _ = writeln!(out, "  and {} more (--json lists them)", c.provenance.len() - LISTED);
    }
}

fn inputs(c: &Comparison, out: &mut String) {
    let i = &c.inputs;
    let _ = writeln!(out, "\ninputs");
    let _ = writeln!(
        out,
        "  camera-fields {} compared, {} in one recording only, blobs of {} differ, timestamps of {} differ",
        i.fields_compared, i.fields_missing, i.blobs_differ, i.stamps_differ
    );
    let _ = writeln!(
        out,
        "  handles {} compared, {} differ; pedal {} compared, {} differ; clock of B {:+.6} s",
        i.handles_compared, i.handles_differ, i.pedals_compared, i.pedals_differ, i.clock_offset_s
    );
    for (name, losses) in ["A", "B"].iter().zip(&c.losses) {
        if let Some(first) = losses.first() {
            let _ = writeln!(out, "  {name} lacks by its own account, {} times: {first}", losses.len());
        }
    }
}

fn poses(c: &Comparison, out: &mut String) {
    let p = &c.poses;
    let _ = writeln!(
        out,
        "\nposes: {} of {} frames identical, {} in one recording only",
        p.identical, p.frames_compared, p.frames_missing
    );
    for body in p.bodies.iter().filter(|b| b.max_um > 0.0 || b.measured_by_one > 0) {
        let _ = writeln!(
            out,
            "  {:<6} RMS {:.2}  p99 {:.2}  max {:.2} µm at {:.2} s (field {});  RMS {:.3}  p99 {:.3}  max {:.3} mrad",
            body.body,
            body.rms_um,
            body.p99_um,
            body.max_um,
            body.max_at_s,
            body.max_field,
            body.rms_mrad,
            body.p99_mrad,
            body.max_mrad
        );
        let bands: Vec<String> =
            BANDS.iter().zip(body.bands_um).map(|((name, ..), um)| format!("{name}: {um:.2}")).collect();
        let _ = writeln!(out, "         µm RMS in {}", bands.join(", "));
        if body.measured_by_one > 0 {
            let _ =
                writeln!(out, "         measured by one recording only in {} frames", body.measured_by_one);
        }
    }
}

fn states_and_events(c: &Comparison, out: &mut String) {
    let (s, e) = (&c.states, &c.events);
    match &s.incomparable {
        Some(why) => drop(writeln!(out, "\nstates: not compared, {why}")),
        None => drop(writeln!(out, "\nstates: {} of {} identical", s.identical, s.compared)),
    }
    let _ = writeln!(
        out,
        "events: {} identical, {} with different values, {} in one recording only",
        e.identical, e.shifted, e.unpaired
    );
    for event in e.unpaired_list.iter().take(LISTED) {
        let _ = writeln!(
            out,
            "  only in {} at {:.2} s: {} ({})",
            event.only_in, event.at_s, event.text, event.kind
        );
    }
    for (kind, [a, b]) in &e.counts_differ {
        let _ = writeln!(out, "  {kind}: {a} times in A, {b} in B");
    }
}

fn scores(score: &ScoreFigures, out: &mut String) {
    let [a, b] = score.totals;
    let [sigma_a, sigma_b] = score.sigmas;
    let _ = writeln!(out, "\nscore: {a:.2} ± {sigma_a:.2} and {b:.2} ± {sigma_b:.2} of 100");
    for category in &score.categories {
        let [a, b] = category.points;
        let _ = writeln!(out, "  {:<22} {a:>7.2} {b:>7.2} {:>+7.2}", category.name, b - a);
        for metric in &category.made_by {
            let value = |v: Option<f64>| v.map_or("none".into(), |v| format!("{v:.3}"));
            let [from, to] = metric.values.map(value);
            let points = metric.points[1] - metric.points[0];
            let _ = writeln!(out, "    {:<32} {from} → {to} {:<12} {points:>+7.2}", metric.name, metric.unit);
        }
    }
    for (injury, [a, b]) in &score.injuries_differ {
        let _ = writeln!(out, "    {injury}: {a} times in A, {b} in B");
    }
}

fn latencies(c: &Comparison, out: &mut String) {
    if !c.latencies.is_empty() {
        let _ = writeln!(out, "\nlatencies, ms       p50 A   p50 B   p99 A   p99 B");
    }
    for l in &c.latencies {
        let ([p50_a, p50_b], [p99_a, p99_b]) = (l.p50_ms, l.p99_ms);
        let _ = writeln!(out, "  {:<14} {p50_a:>8.2}{p50_b:>8.2}{p99_a:>8.2}{p99_b:>8.2}", l.stage);
    }
}
