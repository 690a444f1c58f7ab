//! Lines of text over the picture: the scene's own, the process's status, and a user's overlay.

use crate::latch::Latched;
use protocol::bindings::push_with_keys;
use protocol::scene_text::{Place, Row, lines, push_line, push_sentence};

/// Text over the picture, from every source; [`Self::collect`] joins it for a frame.
#[derive(Debug, Default)]
pub struct OverlayText {
    scene: String,
    status: String,
    held: String,
    overlay: String,
    hides_scene_text: bool,
    next_steps: String,
    /// A person works by mouse and keyboard: marks in the scene's text become keys.
    at_desk: bool,
    lines: String,
}

impl OverlayText {
    /// Empty, with room for the lines of a usual scene.
    pub fn new() -> Self {
        Self {
            scene: String::with_capacity(256),
            status: String::with_capacity(64),
            lines: String::with_capacity(512),
            ..Self::default()
        }
    }

    /// From the next text of the scene on its marks become the keys of a desk, or vanish.
    pub fn set_at_desk(&mut self, at_desk: bool) {
        self.at_desk = at_desk;
    }

    /// Sets the text that belongs to the scene; text that is not UTF-8 counts as none.
    pub fn set_scene(&mut self, text: &[u8]) {
        self.scene.clear();
        push_with_keys(std::str::from_utf8(text).unwrap_or_default(), self.at_desk, &mut self.scene);
    }

    /// Sets the lines in the top left corner; empty for none.
    pub fn set_status(&mut self, status: &str) {
        self.status.clear();
        self.status.push_str(status);
    }

    /// Sets the mark of a picture that is held; empty for none.
    pub fn set_held(&mut self, mark: &str) {
        self.held.clear();
        self.held.push_str(mark);
    }

    /// Sets what the page of an attempt that is over ends with; empty for nothing.
    pub fn set_next_steps(&mut self, steps: &str) {
        self.next_steps.clear();
        self.next_steps.push_str(steps);
    }

    /// Sets lines of `protocol::scene_text`; `hides_scene_text`: in place of the scene's.
    pub fn set_overlay(&mut self, lines: &str, hides_scene_text: bool) {
        self.overlay.clear();
        self.overlay.push_str(lines);
        self.hides_scene_text = hides_scene_text;
    }

    /// Joins every line of a frame.
    pub fn collect(&mut self, latched: &Latched) {
        self.lines.clear();
        for line in self.status.lines() {
            push_sentence(&mut self.lines, Place::TopLeft, line);
        }
        push_line(&mut self.lines, Place::Top, &self.held);
        push_line(&mut self.lines, Place::Top, lost_text(latched));
        self.lines.push_str(&self.overlay);
        if !self.hides_scene_text {
            self.lines.push_str(&self.scene);
            if !self.next_steps.is_empty() && shows_points(&self.scene) {
                push_line(&mut self.lines, Place::Page, &self.next_steps);
            }
        }
    }

    /// What was joined last.
    pub fn lines(&self) -> &str {
        &self.lines
    }
}

/// True for the page of an attempt that is over: it has bars of points.
fn shows_points(scene: &str) -> bool {
    lines(scene).any(|(place, line)| place == Place::Page && matches!(Row::of(line), Row::Bar { .. }))
}

/// Names the bodies that are not tracked.
fn lost_text(latched: &Latched) -> &'static str {
    match (latched.tracked, latched.eye_tracked) {
        ([true, true], true) => "",
        ([false, true], true) => "Tracking lost: instrument 1",
        ([true, false], true) => "Tracking lost: instrument 2",
        ([false, false], true) => "Tracking lost: both instruments",
        ([true, true], false) => "Tracking lost: eye",
        ([false, true], false) => "Tracking lost: instrument 1, eye",
        ([true, false], false) => "Tracking lost: instrument 2, eye",
        ([false, false], false) => "Tracking lost: both instruments, eye",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latch::latch_scene;
    use bytemuck::Zeroable;
    use protocol::scene::SceneHeader;

    #[test]
    fn every_source_has_its_place_and_an_end_page_says_what_to_do_next() {
        let mut overlay = OverlayText::new();
        let latched =
            Latched { tracked: [true, false], eye_tracked: true, ..latch_scene(&SceneHeader::zeroed()) };
        overlay.set_status("tier 6\nfixed by --tier");
        overlay.set_held("Picture held for 1.2 s");
        overlay.set_next_steps("N: next level");
        overlay.set_scene("_Next: the edge\n".as_bytes());
        overlay.collect(&latched);
        let begin = "<Tier 6\n<Fixed by --tier\n^Picture held for 1.2 s\n^Tracking lost: instrument 2\n";
        assert_eq!(overlay.lines(), format!("{begin}_Next: the edge\n"));
        overlay.set_scene("=#Before\n".as_bytes());
        overlay.collect(&latched);
        assert_eq!(overlay.lines(), format!("{begin}=#Before\n"), "nothing is over yet");
        overlay.set_scene("=#Over\n=|0.5|Efficiency|10 of 20\n".as_bytes());
        overlay.collect(&latched);
        let page = "=#Over\n=|0.5|Efficiency|10 of 20\n=N: next level\n";
        assert_eq!(overlay.lines(), format!("{begin}{page}"));
        overlay.set_scene("_Cut {use}\n".as_bytes());
        overlay.collect(&latched);
        assert_eq!(overlay.lines(), format!("{begin}_Cut\n"));
        overlay.set_at_desk(true);
        overlay.set_scene("_Cut {use}\n".as_bytes());
        overlay.collect(&latched);
        assert_eq!(overlay.lines(), format!("{begin}_Cut (Space)\n"));
        overlay.set_overlay("=help\n", true);
        overlay.collect(&latched);
        assert_eq!(overlay.lines(), format!("{begin}=help\n"), "in place of the scene's");
    }
}
