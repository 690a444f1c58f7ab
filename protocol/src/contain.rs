//! Calls of decoders that panic on damaged data, where an error is due.
//!
//! `zune-jpeg` 0.5, which `image` reads JPEG with, does so
//! (<https://github.com/etemesi254/zune-image/issues/361>).

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static CONTAINED: Cell<bool> = const { Cell::new(false) };
}
static HOOK: Once = Once::new();

/// What `decode` returns, or the message that it panicked with, of which nothing is printed.
///
/// # Errors
/// Where it panics.
pub fn contain<T>(decode: impl FnOnce() -> T) -> Result<T, String> {
    HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !CONTAINED.get() {
                before(info);
            }
        }));
    });
    let outer = CONTAINED.replace(true);
    let result = panic::catch_unwind(AssertUnwindSafe(decode));
    CONTAINED.set(outer);
    result.map_err(|payload| format!("the decoder gave up: {}", message(&*payload)))
}

fn message(payload: &(dyn Any + Send)) -> &str {
    let formatted = payload.downcast_ref::<String>().map(String::as_str);
    formatted.or(payload.downcast_ref::<&str>().copied()).unwrap_or("no reason given")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error() {
        assert_eq!(contain(|| 7), Ok(7));
        let none = || [1, 2].into_iter().find(|n| *n > 2).expect("a number");
        assert_eq!(contain(none), Err("the decoder gave up: a number".into()));
        assert_eq!(contain(|| contain(none).is_err()), Ok(true));
        assert!(!CONTAINED.get(), "the next panic is reported");
    }
}
