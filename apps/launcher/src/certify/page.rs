//! Writes a certificate as one page in the form of ASTM E3124 (setup, latency, static noise, range of
//! motion), as self-contained HTML or as Markdown. Pure.

use super::report::{Figures, Losses, Range, Report, Setup};
use plots::Format;
use plots::histogram::{Bin, Histogram};
use std::fmt::Write;

/// Longest bar of a text histogram, characters.
const BAR: usize = 50;

/// A table; all rows have as many cells as the header.
struct Table {
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

/// A section of the page.
struct Section {
    heading: &'static str,
    text: String,
    table: Table,
}

fn ms(value: f64) -> String {
    format!("{value:.3}")
}

fn figures(name: &str, of: &Figures) -> Vec<String> {
    let values = [of.p50_ms, of.p99_ms, of.p99_9_ms, of.max_ms, of.mean_ms].map(ms);
    [vec![name.into()], values.to_vec(), vec![of.count.to_string()]].concat()
}

fn losses(name: &str, of: &Losses) -> Vec<String> {
    let counts = [of.triples, of.drops, of.incomplete, of.blocks_lost, of.fields_refused];
    std::iter::once(name.to_owned()).chain(counts.map(|n| n.to_string())).collect()
}

fn sections(report: &Report) -> Vec<Section> {
    vec![setup(report), latency(report), drops(report), static_noise(report), motion(report), limits()]
}

fn setup(report: &Report) -> Section {
    let setup = &report.setup;
    let machine = &setup.machine;
    let mut rows = vec![
        ("program", format!("vitreo {}", setup.version)),
        ("machine", format!("{}, {} processors, {} MiB", machine.cpu, machine.cpus, machine.memory_mib)),
        ("system", format!("{}, {}", machine.kernel, machine.architecture)),
        ("began", setup.began.clone()),
        ("rig", format!("{}: {} cameras, {}", setup.rig, setup.cameras, rates(setup))),
        ("seen", format!("{} markers in every field, {} px of noise", setup.markers, setup.noise_px)),
        ("scheduling", setup.scheduling.clone()),
        ("load", setup.load.clone()),
        ("floor by", report.floor_tool.clone()),
    ];
    if let Some(percent) = setup.stolen_percent {
        rows.push((
            "taken by the host",
            format!("{percent:.3} % of the processors' time, in real time (steal)"),
        ));
    }
    if report.stopped {
        let of = format!("{} of {} triples were sent in real time", report.real_time.triples, report.asked);
        rows.push(("**stopped before its end**", of));
    }
    let text = "The poses of two instruments and of the eye, six degrees of freedom each, from the blobs of \
        synthetic cameras, so the true poses are known. Tracker, feeder, subscriber and the thread of the \
                floor are in one scheduling class, all use CLOCK_MONOTONIC.";
    Section {
        heading: "System and conditions",
        text: text.into(),
        table: Table {
            header: vec!["", ""],
            rows: rows.into_iter().map(|(name, value)| vec![name.into(), value]).collect(),
        },
    }
}

/// Field rate of the rig, or the rates of all cameras if they differ.
fn rates(setup: &Setup) -> String {
    let [slowest, fastest] = [setup.camera_hz.first(), setup.camera_hz.last()];
    if slowest == fastest {
        return format!("{} Hz", setup.field_hz);
    }
    let each: Vec<String> = setup.camera_hz.iter().map(|hz| format!("{hz:.4}")).collect();
    let each = each.iter().map(|hz| hz.trim_end_matches('0').trim_end_matches('.'));
    format!("{} Hz; a triple has the fields of its period", each.collect::<Vec<_>>().join(", "))
}

fn latency(report: &Report) -> Section {
    let goal = &report.goal;
    let verdict = if goal.kept { "kept" } else { "missed" };
    let mut text = format!(
        "From the instant at which the last blobs of a triple are given to the tracker until a subscriber has read \
         their poses, by the subscriber's own clock. Goal: p{} at most {} ms above that of the machine's own \
         wake-ups, the lower of both; it is {:+.3} ms: {verdict}. From the exposure on, the {} ms before the blobs are what the rig \
         states, not measured.",
        goal.percentile,
        goal.above_floor_ms,
        goal.found_ms,
        ms(report.setup.camera_ms)
    );
    let slowest = &report.slowest;
    let [taken, sent, read] = slowest.parts_ms.map(ms);
    let _ = write!(
        text,
        " The slowest thousandth, {} triples, took {} ms on average: {taken} until the tracker had the blobs, {sent} to \
         track them and {read} until the poses were read.",
        slowest.count,
        ms(slowest.mean_ms)
    );
    let mut rows = vec![figures("**last blobs sent → poses read**", &report.latency)];
    let floors = ["wake-up floor, before", "wake-up floor, after"].into_iter().zip(&report.floor);
    rows.extend(floors.map(|(name, of)| figures(name, of)));
    rows.extend(report.parts.iter().map(|(name, of)| figures(name, of)));
    rows.push(figures("middle of the exposure → poses read", &report.from_exposure));
    rows.push(figures("feeder later than due", &report.feeder_late));
    let header = vec!["ms", "p50", "p99", "p99.9", "max", "mean", "count"];
    Section { heading: "Latency", text, table: Table { header, rows } }
}

fn drops(report: &Report) -> Section {
    let mut rows = vec![losses("in real time", &report.real_time)];
    let mut text = "A triple whose poses the subscriber could not read is a drop.".to_owned();
    if let Some(fast) = &report.at_speed {
        rows.push(losses("at speed", &fast.losses));
        let _ = write!(
            text,
            " At speed: {:.0} triples a second with the pauses for other programs, tracking p50 {} and p99 {} ms.",
            fast.rate_hz,
            ms(fast.tracking.p50_ms),
            ms(fast.tracking.p99_ms)
        );
        if fast.asked > fast.losses.triples {
            let why = match report.stopped {
                true => "the command was stopped",
                false => "these are as many as fit between the machine's start and now",
            };
            let _ = write!(text, " {} were requested; {why}.", fast.asked);
        }
    }
    let header = vec!["", "triples", "drops", "not complete", "blocks lost", "fields refused"];
    Section { heading: "Drops", text, table: Table { header, rows } }
}

fn static_noise(report: &Report) -> Section {
    let row = |b: &super::tally::BodyFigures| {
        let noise =
            [b.static_noise_um, 1e3 * b.static_noise_mrad, b.static_offset_um].map(|v| format!("{v:.2}"));
        [vec![b.body.into()], noise.to_vec(), vec![b.static_frames.to_string()]].concat()
    };
    Section {
        heading: "Static noise",
        text: "Root mean square distance of poses from their mean while nothing moves, and distance of that mean \
               from the truth. The position of an instrument is that of its tip."
            .into(),
        table: Table {
            header: vec!["", "position, µm", "orientation, µrad", "offset, µm", "poses"],
            rows: report.bodies.iter().map(row).collect(),
        },
    }
}

fn motion(report: &Report) -> Section {
    let row = |b: &super::tally::BodyFigures| {
        let range = b.range_mm.map(|mm| format!("{mm:.2}"));
        let rest = [b.range_deg, b.moving_error_um, b.moving_error_mrad, 100.0 * b.measured_share];
        let rest = rest.map(|v| format!("{v:.2}"));
        [vec![b.body.into()], range.to_vec(), rest.to_vec(), vec![b.moving_frames.to_string()]].concat()
    };
    Section {
        heading: "Range of motion",
        text: "What the poses covered while the latency was measured, and their root mean square error in motion."
            .into(),
        table: Table {
            header: vec!["", "x, mm", "y, mm", "z, mm", "turn, °", "error, µm", "error, mrad", "measured, %", "poses"],
            rows: report.bodies.iter().map(row).collect(),
        },
    }
}

fn limits() -> Section {
    let text = "This page has the form of ASTM E3124, not its apparatus: no artefact was moved before real cameras. \
                Exposure, read-out and extraction of blobs, the simulation and the display are not part of \
                this measurement (vitreo run --report has them).";
    Section { heading: "What this is not", text: text.into(), table: Table { header: vec![], rows: vec![] } }
}

/// The histograms of latency and wake-up floor.
fn figure(report: &Report) -> Histogram {
    let bins = |ranges: &[Range]| {
        ranges.iter().map(|r| Bin { from: r.from_ms, to: r.to_ms, count: r.count }).collect()
    };
    Histogram {
        title: "Latency from the last blobs to the received poses, and of the machine's wake-ups".into(),
        across: "ms".into(),
        up: "count per bin".into(),
        series: vec![
            ("poses read".into(), bins(&report.latency_histogram)),
            ("wake-up floor".into(), bins(&report.floor_histogram)),
        ],
    }
}

/// Title of the page.
const TITLE: &str = "Latency certificate";

/// The page as Markdown, with the latency histogram as text.
pub fn markdown(report: &Report) -> String {
    let mut page = format!("# {TITLE}\n");
    for section in sections(report) {
        let _ = write!(page, "\n## {}\n\n{}\n", section.heading, section.text);
        let Table { header, rows } = section.table;
        if !header.is_empty() {
            let rule = "|---".repeat(header.len());
            let _ = write!(page, "\n| {} |\n{rule}|\n", header.join(" | "));
            for row in rows {
                let _ = writeln!(page, "| {} |", row.join(" | "));
            }
        }
        if section.heading == "Latency" {
            let _ = write!(page, "\n```\n{}```\n", bars(&report.latency_histogram));
        }
    }
    page
}

/// A histogram as text; the length of a bar is proportional to the logarithm of the count.
pub fn bars(ranges: &[Range]) -> String {
    let length = |count: u64| (count as f64 + 1.0).ln();
    let most = ranges.iter().map(|range| length(range.count)).fold(1.0, f64::max);
    let line = |range: &Range| {
        let bar = "#".repeat((length(range.count) / most * BAR as f64).round() as usize);
        format!("{:>9.3} to {:>9.3} ms {:>9} {bar}", range.from_ms, range.to_ms, range.count)
            .trim_end()
            .to_owned()
            + "\n"
    };
    ranges.iter().map(line).collect()
}

/// Escapes a text for HTML; text between `**` becomes strong.
fn escaped(text: &str) -> String {
    let plain = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let parts = plain.split("**").enumerate();
    parts.map(|(n, part)| if n % 2 == 1 { format!("<strong>{part}</strong>") } else { part.into() }).collect()
}

/// The page as self-contained HTML.
///
/// # Errors
/// If the histogram cannot be drawn.
pub fn html(report: &Report) -> anyhow::Result<String> {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{TITLE}</title><style>{STYLE}</style>\
         </head><body>\n<h1>{TITLE}</h1>\n"
    );
    for section in sections(report) {
        let _ = write!(page, "<h2>{}</h2>\n<p>{}</p>\n", section.heading, escaped(&section.text));
        let Table { header, rows } = section.table;
        if !header.is_empty() {
            let cells = |tag: &str, cells: &[String]| -> String {
                cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect()
            };
            let header: Vec<String> = header.into_iter().map(str::to_owned).collect();
            let _ = writeln!(page, "<table>\n<tr>{}</tr>", cells("th", &header));
            for row in rows {
                let _ = writeln!(page, "<tr>{}</tr>", cells("td", &row));
            }
            page.push_str("</table>\n");
        }
        if section.heading == "Latency" {
            page.push_str(&String::from_utf8(plots::bytes(&figure(report), Format::Svg)?)?);
        }
    }
    page.push_str("</body></html>\n");
    Ok(page)
}

/// Style sheet, which fits the page on one printed sheet.
const STYLE: &str = "body{font:14px sans-serif;max-width:62em;margin:2em auto}h1{font-size:1.5em}h2{font-size:1.1em;\
margin:1em 0 0}p{margin:.3em 0}table{border-collapse:collapse}td,th{border:1px solid #bbb;padding:.15em .6em;\
text-align:right}td:first-child,th:first-child{text-align:left}svg{max-width:100%;height:auto}";

#[cfg(test)]
mod tests {
    use super::super::report::tests::report;
    use super::*;

    #[test]
    fn both_pages_have_every_section_and_say_the_same() {
        let report = report(2);
        let [markdown, html] = [markdown(&report), html(&report).unwrap()];
        for page in [&markdown, &html] {
            for words in [
                "Latency",
                "Static noise",
                "Range of motion",
                "inst1",
                "p99.9",
                "kept",
                "0.200",
                "3.000",
                "0.040 %",
            ] {
                assert!(page.contains(words), "{words} is not in\n{page}");
            }
        }
        assert!(
            html.contains("a &lt;rig&gt;") && html.contains("<svg") && html.contains("<strong>last"),
            "{html}"
        );
        assert!(
            !html.contains("**") && !html.contains("href") && !html.contains("src="),
            "it needs nothing else"
        );
        assert!(markdown.contains("| in real time | 2000 | 2 | 0 | 0 | 0 |"), "{markdown}");
    }

    #[test]
    fn a_page_of_what_was_stopped_says_so_and_has_the_floors_there_are() {
        let mut report = report(0);
        assert!(!markdown(&report).contains("stopped"));
        (report.stopped, report.asked) = (true, 360_000);
        report.floor.pop();
        let page = markdown(&report);
        assert!(page.contains("2000 of 360000 triples were sent"), "{page}");
        assert!(page.contains("floor, before") && !page.contains("floor, after"), "{page}");
    }

    #[test]
    fn a_bar_is_there_for_one_and_not_for_none() {
        let range = |count| Range { from_ms: 0.1, to_ms: 0.2, count };
        let text = bars(&[range(10_000), range(0), range(1)]);
        let bars: Vec<usize> = text.lines().map(|line| line.matches('#').count()).collect();
        assert!(bars[0] == BAR && bars[1] == 0 && bars[2] > 0, "{text}");
        assert_eq!(super::bars(&[]), "");
    }
}
