//! Events of the step in progress, in a list of fixed capacity.

use crate::constants::MAX_EVENTS;
use protocol::events::{Event, EventDraft, Severity};
use protocol::time::Nanos;

/// The events of a step.
#[derive(Debug)]
pub struct EventLog {
    events: Vec<Event>,
    next_seq: u64,
    field: u64,
    exposed_ns: Nanos,
    left_out: u64,
    warning: u32,
}

impl Default for EventLog {
    fn default() -> Self {
        let events = Vec::with_capacity(MAX_EVENTS);
        EventLog { events, next_seq: 0, field: 0, exposed_ns: 0, left_out: 0, warning: 0 }
    }
}

impl EventLog {
    /// Empties the log for a step.
    pub fn begin(&mut self, next_seq: u64, field: u64, exposed_ns: Nanos) {
        self.events.clear();
        *self = EventLog {
            events: std::mem::take(&mut self.events),
            next_seq,
            field,
            exposed_ns,
            left_out: self.left_out,
            warning: 0,
        };
    }

    /// Adds an event; numbers that are not finite become 0.
    pub fn emit(&mut self, h: EventDraft) {
        let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
        let severity = h.kind.info().severity;
        if severity > Severity::Info {
            self.warning = h.kind as u32;
        }
        if self.events.len() == MAX_EVENTS {
            self.left_out += 1;
            return;
        }
        self.events.push(Event {
            seq: self.next_seq,
            field: self.field,
            exposed_ns: self.exposed_ns,
            kind: h.kind as u32,
            severity: severity as u32,
            instrument: h.instrument,
            subject: h.subject,
            value: finite(h.value),
            limit: finite(h.limit),
            position_in_eye_mm: h.position_in_eye_mm.map(finite),
        });
        self.next_seq += 1;
    }

    /// Adds an event that is no warning here, whatever it is elsewhere.
    pub fn emit_unwarned(&mut self, draft: EventDraft) {
        let warning = self.warning;
        self.emit(draft);
        self.warning = warning;
    }

    /// Events of this step.
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Number of the next event.
    pub fn next_seq(&self) -> u64 {
        self.next_seq
    }

    /// Events left out since the start, because a step had too many.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }

    /// Kind of the last warning of this step, 0 for none.
    pub fn warning(&self) -> u32 {
        self.warning
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::events::EventKind;

    #[test]
    fn overflow_is_counted_and_numbers_go_on() {
        let mut log = EventLog::default();
        log.begin(7, 1, 2);
        for _ in 0..MAX_EVENTS + 3 {
            log.emit(EventDraft::new(EventKind::TissueTorn, f64::NAN));
        }
        assert_eq!((log.events().len(), log.left_out()), (MAX_EVENTS, 3));
        assert_eq!(log.next_seq(), 7 + MAX_EVENTS as u64);
        assert_eq!(log.events()[0].value, 0.0);
        log.begin(log.next_seq(), 2, 3);
        assert!(log.events().is_empty());
    }
}
