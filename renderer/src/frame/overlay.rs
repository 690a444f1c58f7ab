//! Lines of text over the picture: the scene's own, the process's status, and a user's overlay.

use crate::latch::Latched;
use protocol::scene_text::{Place, push_line};

/// Text over the picture, from every source; [`Self::collect`] joins it for a frame.
#[derive(Debug, Default)]
pub struct OverlayText {
    scene: String,
    status: String,
    held: String,
    overlay: String,
    hides_scene_text: bool,
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

    /// Sets the text that belongs to the scene; text that is not UTF-8 counts as none.
    pub fn set_scene(&mut self, text: &[u8]) {
        self.scene.clear();
        self.scene.push_str(std::str::from_utf8(text).unwrap_or_default());
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

    /// Sets lines of `protocol::scene_text`; `hides_scene_text`: in place of the scene's.
    pub fn set_overlay(&mut self, lines: &str, hides_scene_text: bool) {
        self.overlay.clear();
        self.overlay.push_str(lines);
        self.hides_scene_text = hides_scene_text;
    }

    /// Every line of the next frame.
    pub fn collect(&mut self, latched: &Latched) -> &str {
        self.lines.clear();
        for line in self.status.lines() {
            push_line(&mut self.lines, Place::TopLeft, line);
        }
        push_line(&mut self.lines, Place::Bottom, &self.held);
        push_line(&mut self.lines, Place::Bottom, lost_text(latched));
        self.lines.push_str(&self.overlay);
        if !self.hides_scene_text {
            self.lines.push_str(&self.scene);
        }
        &self.lines
    }
}

/// Names the bodies that are not tracked.
fn lost_text(latched: &Latched) -> &'static str {
    match (latched.tracked, latched.eye_tracked) {
        ([true, true], true) => "",
        ([false, true], true) => "TRACKING LOST: INST0",
        ([true, false], true) => "TRACKING LOST: INST1",
        ([false, false], true) => "TRACKING LOST: INST0 INST1",
        ([true, true], false) => "TRACKING LOST: EYE",
        ([false, true], false) => "TRACKING LOST: INST0 EYE",
        ([true, false], false) => "TRACKING LOST: INST1 EYE",
        ([false, false], false) => "TRACKING LOST: INST0 INST1 EYE",
    }
}
