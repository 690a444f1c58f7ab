//! The paper's Table 4 (Wagner, Schill, Männer 2002, section 4.6; 1,000 triangles, 1,500 springs) with the
//! medians of a run. Pure.

use crate::run::latency_stats::{Durations, LatencyStats};
use serde::Serialize;
use std::fmt::Write;

/// A line of the table: the paper's figure and the median of this run, ms.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PaperLine {
    /// Name of the measured part.
    pub task: &'static str,
    /// The paper's figure, ms; `None` for lines that are not in the sum.
    pub paper_ms: Option<f64>,
    /// Median of this run, ms; `None` if nothing was measured.
    pub today_ms: Option<f64>,
    /// Number of steps or frames in the median; 0 for the sum.
    pub count: u64,
    /// What the figure includes, or what the sum lacks.
    pub note: String,
}

/// Computes the table. "Overall" is the sum of the lines above it, as in the paper; its note names the lines
/// without a measurement. A line without a counterpart in the paper follows it.
pub fn paper_table_4(latencies: &LatencyStats) -> Vec<PaperLine> {
    let line = |task, paper_ms, d: &Durations, note: &str| PaperLine {
        task,
        paper_ms,
        today_ms: (d.count() > 0).then(|| d.at_ms(50.0)),
        count: d.count(),
        note: note.into(),
    };
    let p = &latencies.paper;
    let mut lines = vec![
        line("collision detection", Some(2.3), &p.contact, "all substeps of a step that ends in contact"),
        line("tissue simulation", Some(1.5), &p.tissue, "membrane and retina, all substeps of a step"),
        line("geometry transfer", Some(1.7), &p.transfer, "upload calls, host's clock"),
        line(
            "misc",
            Some(1.0),
            &p.misc,
            "all else of a step: bodies, tools, vitreous, task, hash, scene block",
        ),
        line("graphics rendering", Some(15.0), &p.drawing, "without the upload calls"),
    ];
    let overall = overall(&lines);
    lines.push(overall);
    lines.push(line("collision, no contact", None, &p.no_contact, "not in the sum"));
    lines
}

fn overall(lines: &[PaperLine]) -> PaperLine {
    let today_ms = lines.iter().filter_map(|l| l.today_ms).reduce(|a, b| a + b);
    let lacks: Vec<&str> = lines.iter().filter(|l| l.today_ms.is_none()).map(|l| l.task).collect();
    let note = if lacks.is_empty() { String::new() } else { format!("lacks {}", lacks.join(", ")) };
    PaperLine { task: "overall", paper_ms: Some(22.0), today_ms, count: 0, note }
}

/// Writes the table as text.
pub(super) fn write(lines: &[PaperLine], out: &mut String) -> std::fmt::Result {
    writeln!(out, "\nWagner et al., Table 4, ms      2002   today (median)   count")?;
    for line in lines {
        let paper = line.paper_ms.map_or("–".into(), |ms| format!("{ms:.1}"));
        let today = line.today_ms.map_or("–".into(), |ms| format!("{ms:.3}"));
        let count = if line.count == 0 { "–".into() } else { line.count.to_string() };
        let of_line = format!("{:<29} {paper:>6} {today:>10} {count:>13}  {}", line.task, line.note);
        writeln!(out, "{}", of_line.trim_end())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use protocol::frames::FrameRecord;
    use protocol::steps::{StepProfile, StepRecord};

    fn warm() -> LatencyStats {
        let mut latencies = LatencyStats::default();
        latencies.warm_from(1);
        latencies
    }

    fn note_step(latencies: &mut LatencyStats, contacts: u64, collision_ns: u64) {
        let profile = StepProfile {
            collision_ns,
            tissue_ns: 150_000,
            bodies_ns: 10_000,
            tools_ns: 20_000,
            vitreous_ns: 30_000,
            task_ns: 4_000,
            hash_ns: 5_000,
            transfer_ns: 6_000,
            misc_ns: 25_000,
        };
        let mut step = StepRecord { profile, contacts, ..StepRecord::zeroed() };
        step.instants.exposed = 10;
        latencies.note_step(&step);
    }

    fn note_frame(latencies: &mut LatencyStats, transfer_ns: u64, drawn_ns: u64) {
        let mut frame = FrameRecord { frame_start: 1_000, transfer_ns, ..FrameRecord::zeroed() };
        (frame.instants.exposed, frame.drawn) = (10, 1_000 + drawn_ns);
        latencies.note_frame(&frame);
    }

    fn near(found: Option<f64>, expected_ms: f64) {
        let found = found.expect("a figure");
        assert!((found - expected_ms).abs() <= 2e-3 * expected_ms, "{found}, expected {expected_ms}");
    }

    #[test]
    fn idle_steps_do_not_dilute_the_collision_detection() {
        let mut latencies = warm();
        (0..90).for_each(|_| note_step(&mut latencies, 0, 1_000));
        (0..10).for_each(|_| note_step(&mut latencies, 1, 800_000));
        let lines = paper_table_4(&latencies);
        near(lines[0].today_ms, 0.8);
        near(lines[6].today_ms, 0.001);
        assert_eq!((lines[0].count, lines[6].count, lines[6].paper_ms), (10, 90, None));
        near(lines[1].today_ms, 0.15);
        near(lines[3].today_ms, 0.1);
        near(lines[5].today_ms, 1.05);
    }

    #[test]
    fn the_transfer_is_not_counted_with_the_rendering_too() {
        let mut latencies = warm();
        note_step(&mut latencies, 1, 50_000);
        note_frame(&mut latencies, 300_000, 5_300_000);
        let lines = paper_table_4(&latencies);
        near(lines[2].today_ms, 0.3);
        near(lines[4].today_ms, 5.0);
        near(lines[5].today_ms, 5.6);
        assert_eq!(lines[5].note, "");
        let paper: f64 = lines[..5].iter().filter_map(|l| l.paper_ms).sum();
        assert!((paper - 22.0).abs() < 1.0, "the paper rounds 21.5 to 22");
    }

    #[test]
    fn overall_names_what_it_lacks() {
        let mut latencies = warm();
        note_step(&mut latencies, 0, 50_000);
        let lines = paper_table_4(&latencies);
        assert_eq!(lines[5].note, "lacks collision detection, geometry transfer, graphics rendering");
        near(lines[5].today_ms, 0.25);
        let mut text = String::new();
        write(&lines, &mut text).unwrap();
        // A dash for the figure and count of three unmeasured lines, for the paper's figure of one line, and
        // for the count of the sum.
        assert_eq!(text.matches('–').count(), 8, "{text}");
        assert!(paper_table_4(&LatencyStats::default()).iter().all(|l| l.today_ms.is_none()));
    }
}
