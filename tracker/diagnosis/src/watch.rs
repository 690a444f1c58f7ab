//! Findings that last, from when to when.

use crate::Finding;
use crate::finding::{CHECK_MARKERS, DISAGREE, FASTEN, NEVER, PLACE_OF, RECALIBRATE};
use crate::tracking::PERIOD_NS;
use serde::Serialize;

/// Periods in a row for which something must be wrong before it is reported.
const LASTS: u32 = 2;
/// Periods in a row after which it is over.
const OVER: u32 = 3;
/// Findings kept for the report.
const KEPT: usize = 100;

/// A finding that lasted.
#[derive(Debug, Clone, Serialize)]
pub struct Warning {
    /// Begin of the first period in which it was seen, s since the start.
    pub from_s: f64,
    /// End of the last one, s; `None` where it lasts.
    pub to_s: Option<f64>,
    /// What it is.
    #[serde(flatten)]
    pub finding: Finding,
}

/// A finding that may last.
#[derive(Debug)]
struct Candidate {
    finding: Finding,
    /// Begin of the first period in which it was seen, and end of the last, s.
    span_s: [f64; 2],
    seen: u32,
    absent: u32,
    /// Index of the warning, once it was reported.
    warning: Option<usize>,
}

/// Watches a run.
#[derive(Debug, Default)]
pub struct Watch {
    candidates: Vec<Candidate>,
    warnings: Vec<Warning>,
    /// End of the newest period, s.
    noted_s: f64,
}

impl Watch {
    /// Takes what was found in the period that ends at `at_s`; returns what is to be reported now for the first time.
    pub fn note(&mut self, at_s: f64, found: &[Finding]) -> Vec<Finding> {
        let begin_s = std::mem::replace(&mut self.noted_s, at_s);
        let mut news = Vec::new();
        for finding in found {
            let index = self.candidates.iter().position(|c| c.finding.subject == finding.subject);
            let index = index.unwrap_or_else(|| {
                let span_s = [begin_s, at_s];
                self.candidates.push(Candidate {
                    finding: finding.clone(),
                    span_s,
                    seen: 0,
                    absent: 0,
                    warning: None,
                });
                self.candidates.len() - 1
            });
            let candidate = &mut self.candidates[index];
            (candidate.seen, candidate.absent) = (candidate.seen + 1, 0);
            (candidate.finding, candidate.span_s[1]) = (finding.clone(), at_s);
            if candidate.seen >= LASTS && candidate.warning.is_none() && self.warnings.len() < KEPT {
                candidate.warning = Some(self.warnings.len());
                self.warnings.push(Warning {
                    from_s: candidate.span_s[0],
                    to_s: None,
                    finding: finding.clone(),
                });
                news.push(finding.clone());
            }
        }
        let present = |c: &Candidate| found.iter().any(|f| f.subject == c.finding.subject);
        for candidate in self.candidates.iter_mut().filter(|c| !present(c)) {
            candidate.absent += 1;
            if let Some(warning) = candidate.warning.filter(|_| candidate.absent == OVER) {
                self.warnings[warning].to_s = Some(candidate.span_s[1]);
            }
        }
        self.candidates.retain(|c| c.absent < if c.warning.is_some() { OVER } else { 1 });
        news
    }

    /// What is wrong now.
    pub fn present(&self) -> impl Iterator<Item = &Finding> {
        self.candidates.iter().filter(|c| c.warning.is_some()).map(|c| &c.finding)
    }

    /// Everything that was reported.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }
}

/// What the judgement of a rig says at the end of a run or replay.
#[derive(Debug, Clone)]
pub struct Judged {
    /// As a warning.
    pub warning: Warning,
    /// The cameras that its causes concern; none if nothing explains what does not fit.
    pub cameras: Vec<u32>,
}

/// Warnings with what the judgement of the rig says. If it names a cause, that is also the cause of what does not fit
/// the rig. A camera that disagrees with the others, and that the cause does not concern, stands where it did: then the
/// cameras disagree, and none is named.
pub fn with_judged(mut warnings: Vec<Warning>, judged: Option<Judged>) -> Vec<Warning> {
    let Some(Judged { warning: judged, cameras }) = judged else { return warnings };
    let is_of_rig = |finding: &Finding| [RECALIBRATE, FASTEN].contains(&&*finding.remedy);
    let concerned: Vec<String> = cameras.iter().map(|id| format!("camera {id}")).collect();
    let is_blamed = |finding: &Finding| {
        let camera = finding.subject.strip_prefix(PLACE_OF).unwrap_or(&finding.subject);
        camera.starts_with("camera ") && !concerned.iter().any(|own| own == camera)
    };
    for own in warnings.iter_mut().map(|w| &mut w.finding) {
        if is_of_rig(own) && is_blamed(own) {
            (own.what, own.subject) = (DISAGREE.into(), "cameras".into());
        }
        let cause = &judged.finding.cause;
        if is_of_rig(own) || own.what.ends_with(NEVER) {
            own.cause.clone_from(cause);
        } else if own.remedy == CHECK_MARKERS && !cameras.is_empty() {
            own.cause = format!("{cause}, or its markers are hidden or out of view");
        } else {
            continue;
        }
        own.remedy.clone_from(&judged.finding.remedy);
    }
    let mut warnings = joined(warnings);
    warnings.push(judged);
    warnings
}

/// Warnings of which those that the cameras disagree are one, from the first to the last.
fn joined(warnings: Vec<Warning>) -> Vec<Warning> {
    let mut all: Vec<Warning> = Vec::with_capacity(warnings.len());
    for warning in warnings {
        let same = |w: &&mut Warning| w.finding.what == DISAGREE && warning.finding.what == DISAGREE;
        match all.iter_mut().find(same) {
            Some(first) => {
                first.from_s = first.from_s.min(warning.from_s);
                first.to_s = first.to_s.zip(warning.to_s).map(|(a, b)| a.max(b));
            }
            None => all.push(warning),
        }
    }
    all
}

/// The warnings in sentences. `stated`: a cause with its remedy that stands above them already. The warning of that cause
/// itself is left out, and others of the same cause refer to it.
pub fn sentences(warnings: &[Warning], stated: Option<&Finding>) -> Vec<String> {
    let text = |finding: &Finding| match stated {
        Some(stated) if finding == stated => None,
        Some(stated) if finding.remedy == stated.remedy && finding.cause.starts_with(&stated.cause) => {
            let more = &finding.cause[stated.cause.len()..];
            Some(format!("{}: see the likely cause above{more}", finding.what))
        }
        _ => Some(finding.text()),
    };
    let sentence = |warning: &Warning| {
        let to = warning.to_s.map_or("the end".into(), |s| format!("{s:.0} s"));
        Some(format!("from {:.0} s to {to}: {}", warning.from_s, text(&warning.finding)?))
    };
    warnings.iter().filter_map(sentence).collect()
}

/// Least length of a run in which a problem can be reported, s: it must last for [`LASTS`] periods.
pub const SHORTEST_S: f64 = LASTS as f64 * PERIOD_NS as f64 * 1e-9;

/// Says that no warnings were asserted and nothing was judged. `shortage`: what there was, and what is needed.
pub fn unjudged(shortage: &str) -> String {
    format!("--assert-no-warnings: the stream is too short, or shows too little, to judge: {shortage}")
}

/// Says how many warnings there were, and the first of them; `None` without any.
pub fn warned(warnings: &[Warning]) -> Option<String> {
    let first = warnings.first()?;
    let (count, text) = (warnings.len(), first.finding.text());
    let others = if count > 1 { format!("{count} warnings; the first: ") } else { String::new() };
    Some(format!("{others}from {:.1} s on {text}", first.from_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(subject: &str) -> Finding {
        let [what, cause, remedy] = ["a", "b", "c"].map(String::from);
        Finding { what, cause, remedy, subject: subject.into() }
    }

    #[test]
    fn a_judgement_gives_its_cause_to_what_does_not_fit_the_rig_alone() {
        let warning = |finding| Warning { from_s: 1.0, to_s: None, finding };
        let of_rig = |subject| Finding { remedy: RECALIBRATE.into(), ..finding(subject) };
        let all = vec![warning(of_rig("camera 2")), warning(finding("picture"))];
        assert_eq!(with_judged(all.clone(), None).len(), 2);
        let judged = Finding { cause: "a clock".into(), remedy: "set it".into(), ..finding("rig") };
        let judged = Judged { warning: warning(judged), cameras: vec![2] };
        let found = with_judged(all, Some(judged));
        let causes: Vec<&str> = found.iter().map(|w| &*w.finding.cause).collect();
        assert_eq!(causes, ["a clock", "b", "a clock"]);
        assert_eq!((&*found[0].finding.remedy, &*found[0].finding.subject), ("set it", "camera 2"));
    }

    #[test]
    fn a_cause_that_was_stated_is_referred_to() {
        let of_rig = |what: &str, cause: &str| Finding {
            what: what.into(),
            cause: cause.into(),
            remedy: "set it".into(),
            subject: "rig".into(),
        };
        let warning = |from_s, finding| Warning { from_s, to_s: None, finding };
        let stated = of_rig("residuals", "a clock is late");
        let warnings = [
            warning(1.0, of_rig("camera 2 is excluded", "a clock is late")),
            warning(2.0, of_rig("eye was lost", "a clock is late, or its markers are hidden")),
            warning(3.0, finding("picture")),
            warning(0.0, stated.clone()),
        ];
        let said = [
            "from 1 s to the end: camera 2 is excluded: see the likely cause above",
            "from 2 s to the end: eye was lost: see the likely cause above, or its markers are hidden",
            "from 3 s to the end: a: b; c",
        ];
        assert_eq!(sentences(&warnings, Some(&stated)), said);
        let whole = sentences(&warnings, None);
        assert_eq!(whole[3], "from 0 s to the end: residuals: a clock is late; set it");
        assert!(whole[0].ends_with("camera 2 is excluded: a clock is late; set it"), "{whole:?}");
    }

    #[test]
    fn a_camera_that_no_cause_concerns_is_not_named() {
        let warning = |subject, from_s, to_s| {
            let finding = Finding { remedy: FASTEN.into(), ..finding(subject) };
            Warning { from_s, to_s, finding }
        };
        let all = vec![
            warning("camera 1", 2.0, Some(3.0)),
            warning("camera 0", 1.0, Some(4.0)),
            warning("place of camera 1", 5.0, None),
        ];
        let with = |cameras: &[u32]| {
            let judged = Judged { warning: warning("rig", 1.0, None), cameras: cameras.to_vec() };
            with_judged(all.clone(), Some(judged))
        };
        let found = with(&[0, 2]);
        let named = |w: &Warning| (w.finding.subject.clone(), w.from_s, w.to_s);
        let named: Vec<_> = found.iter().map(named).collect();
        let of = |subject: &str, from_s, to_s| (subject.to_owned(), from_s, to_s);
        assert_eq!(named, [of("cameras", 2.0, None), of("camera 0", 1.0, Some(4.0)), of("rig", 1.0, None)]);
        assert_eq!(found[0].finding.what, DISAGREE);
        assert_eq!(with(&[]).len(), 2, "none is known to be at fault");
        assert_eq!(with(&[0, 1]).len(), 4, "each is named");
    }

    #[test]
    fn what_lasts_is_told_once_and_ends() {
        let mut watch = Watch::default();
        let x = [finding("x")];
        assert!(watch.note(1.0, &x).is_empty(), "a moment is no news");
        assert_eq!(watch.note(2.0, &x).len(), 1);
        assert!(watch.note(3.0, &x).is_empty() && watch.note(4.0, &[]).is_empty());
        assert_eq!(watch.present().count(), 1, "a gap of a period is none");
        watch.note(5.0, &[]);
        watch.note(6.0, &[]);
        assert_eq!((watch.present().count(), watch.warnings().len()), (0, 1));
        assert_eq!((watch.warnings()[0].from_s, watch.warnings()[0].to_s), (0.0, Some(3.0)));
        watch.note(7.0, &x);
        assert_eq!(watch.warnings().len(), 1, "once is no news again");
        assert_eq!(watch.note(8.0, &x).len(), 1, "reported again when it comes again");
        assert_eq!((watch.warnings()[1].from_s, watch.warnings()[1].to_s), (6.0, None));
    }
}
