//! Progress bars, shown on standard error if it is a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;

fn styled(length: Option<u64>, template: &str, what: &'static str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("a valid template"));
    bar.with_message(what)
}

/// A bar over a known amount of bytes.
pub fn bytes_bar(bytes: u64, what: &'static str) -> ProgressBar {
    styled(Some(bytes), "{msg} {wide_bar} {bytes}/{total_bytes} {eta}", what)
}

/// A bar over a known number of files or trials.
pub fn files_bar(files: u64, what: &'static str) -> ProgressBar {
    styled(Some(files), "{msg} {wide_bar} {pos}/{len} {eta}", what)
}

/// A counter without a known total.
pub fn counter(what: &'static str) -> ProgressBar {
    styled(None, "{spinner} {human_pos} {msg} ({per_sec})", what)
}

/// A bar over a known number of pictures.
pub fn pictures_bar(pictures: u64, what: &'static str) -> ProgressBar {
    styled(Some(pictures), "{msg} {wide_bar} {pos}/{len} {per_sec} {eta}", what)
}
