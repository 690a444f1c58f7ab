//! What the judge of causes says, in figures and in words.

use super::Cause;
use super::judge::FEWEST;
use super::measure::START_NS;
use serde::Serialize;

/// Share of the blobs without a marker that is said.
const STRANGERS: f64 = 0.15;
/// What no cause explains is reported at the end of a run only above this, px RMS above the noise: lenses of real cameras
/// leave less that no cause of the catalogue stands for, in every run.
const REPORTED_PX: f64 = 0.1;

/// A cause with its evidence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanation {
    /// The cause.
    #[serde(flatten)]
    pub cause: Cause,
    /// Root mean square of what is left in the pictures with its remedy, px; of the blobs that measure poses, where many
    /// others belong to no marker.
    pub left_px: f64,
    /// Blobs by which it was judged.
    pub blobs: u64,
}

/// What the judge says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// There was too little to judge.
    TooLittle,
    /// The rig holds.
    NothingWrong,
    /// Something is wrong, and no cause of the catalogue explains it.
    Unknown,
    /// The causes named explain it, one as well as another.
    Explained,
    /// Something is wrong; the search for its cause was stopped.
    Stopped,
}

/// What is wrong with a recording, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// In short.
    pub verdict: Verdict,
    /// Reprojection residual, root mean square, px; a blob that no marker explains counts as 2 px.
    pub left_px: f64,
    /// The same of the blobs that measured poses.
    pub used_px: f64,
    /// Number of blobs, explained or not.
    pub blobs: u64,
    /// Exposure of the first affected field, s after the first field; 0 from the start.
    pub since_s: f64,
    /// True where the rig holds: the residual is the noise of the stream.
    pub holds: bool,
    /// Root mean square of the residual that errors of the rig add to the noise, px; the whole residual where the noise is
    /// not known.
    pub above_px: f64,
    /// Share of the blobs that no marker explains.
    pub unexplained: f64,
    /// The causes that explain it alike, those with the fewest parameters first.
    pub explanations: Vec<Explanation>,
    /// Causes that were tried.
    pub tried: usize,
}

impl Judgement {
    /// In a sentence.
    pub fn text(&self) -> String {
        let left = format!("reprojection residual {:.2} px RMS over {} blobs", self.left_px, self.blobs);
        let since = format!("{left} from {:.1} s", self.since_s);
        match self.verdict {
            Verdict::TooLittle => format!("too little to judge: {}", self.blobs_needed()),
            Verdict::NothingWrong if self.unexplained > STRANGERS => format!(
                "no fault found in the rig; {:.0} % of {} blobs belong to no marker (reflections, or an instrument \
                 that is hidden in part)",
                100.0 * self.unexplained,
                self.blobs
            ),
            Verdict::NothingWrong => format!(
                "no fault found: reprojection residual {:.2} px RMS over {} blobs; {:.1} % of the blobs belong to no marker",
                self.used_px,
                self.blobs,
                100.0 * self.unexplained
            ),
            Verdict::Unknown => format!("{since}; no known cause explains it"),
            Verdict::Stopped => format!("{since}; the search was stopped before a cause was found"),
            Verdict::Explained => {
                let named = self
                    .explanations
                    .iter()
                    .map(|e| format!("{} ({:.2} px with it corrected)", e.cause, e.left_px));
                format!("{since}: {}{}", named.collect::<Vec<_>>().join(", or "), self.what_helps())
            }
        }
    }

    /// How many blobs there were and how many are needed, if there were too few to judge.
    pub fn shortage(&self) -> Option<String> {
        (self.verdict == Verdict::TooLittle).then(|| self.blobs_needed())
    }

    fn blobs_needed(&self) -> String {
        let start_s = START_NS as f64 * 1e-9;
        format!("{} blobs after the first {start_s:.1} s, at least {FEWEST} are needed", self.blobs)
    }

    /// True for what is said at the end of a run: a cause, or much that none explains.
    pub fn is_reported(&self) -> bool {
        match self.verdict {
            Verdict::TooLittle | Verdict::NothingWrong => false,
            Verdict::Unknown => !self.holds && self.above_px > REPORTED_PX,
            Verdict::Explained | Verdict::Stopped => !self.holds,
        }
    }

    /// For the end of a run: the likely cause, since when, and what helps; `None` where the rig holds or there
    /// was too little to judge. `starts_s`: instant of the first field that was judged, s after the run's first.
    pub fn paragraph(&self, starts_s: f64) -> Option<String> {
        let since = match starts_s + self.since_s {
            at if at > 0.0 => format!("since {at:.1} s"),
            _ => "from the start".into(),
        };
        let left = format!("reprojection residual {:.2} px RMS {since}", self.left_px);
        if !self.is_reported() {
            return None;
        }
        match self.verdict {
            Verdict::TooLittle | Verdict::NothingWrong => None,
            Verdict::Unknown => Some(format!("{left}; no known cause explains it")),
            Verdict::Stopped => Some(format!("{left}; the search was stopped before a cause was found")),
            Verdict::Explained => {
                Some(format!("likely cause: {} ({left}){}", self.named(), self.what_helps()))
            }
        }
    }

    /// The causes that explain it alike: "A, or B".
    pub fn named(&self) -> String {
        let named: Vec<String> = self.explanations.iter().map(|e| e.cause.to_string()).collect();
        named.join(", or ")
    }

    /// What helps; each remedy once.
    pub fn remedies(&self) -> String {
        let mut remedies: Vec<&str> = Vec::new();
        for remedy in self.explanations.iter().filter_map(|e| e.cause.remedy()) {
            if !remedies.contains(&remedy) {
                remedies.push(remedy);
            }
        }
        remedies.join("; or: ")
    }

    /// The same as the end of a sentence.
    fn what_helps(&self) -> String {
        let remedies = self.remedies();
        if remedies.is_empty() { remedies } else { format!(". Remedy: {remedies}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_cause_explains_is_reported_at_the_end_where_it_is_much() {
        let judgement = |verdict, above_px| Judgement {
            verdict,
            left_px: 0.3,
            used_px: 0.2,
            blobs: 5000,
            since_s: 0.0,
            holds: false,
            above_px,
            unexplained: 0.0,
            explanations: Vec::new(),
            tried: 29,
        };
        let shortage = |verdict| judgement(verdict, 0.0).shortage();
        let little = judgement(Verdict::Unknown, 0.03);
        assert_eq!(little.paragraph(0.0), None);
        assert!(little.text().contains("no known cause explains it"), "who asks for it is answered");
        let much = judgement(Verdict::Unknown, 0.2).paragraph(0.0).expect("a paragraph");
        assert!(much.contains("no known cause explains it"), "{much}");
        assert!(judgement(Verdict::Stopped, 0.03).paragraph(0.0).is_some());
        assert_eq!(shortage(Verdict::Unknown), None);
        let short = shortage(Verdict::TooLittle).expect("too little");
        assert_eq!(short, "5000 blobs after the first 0.3 s, at least 200 are needed");
    }
}
