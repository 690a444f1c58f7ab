//! Which number a picture has, and when it was taken. Pure: the present instant is an argument.
//!
//! A pipe has no instants. The instant at which every source has brought its first picture is the
//! start; the field with number `k` of a camera counts as read out at start + `k` · its period, and
//! what a source brings one after the other has one number after the other. A source that is opened
//! again goes on with the number whose time it then is. What comes more than [`LATE_PERIODS`] after
//! its time is left out: a writer that was held up and catches up is then in step with the others
//! again. One that lags and does not catch up is accepted again, as if it had been opened again.

use protocol::time::Nanos;

/// A field that comes later than so many periods after it was read out is left out.
pub const LATE_PERIODS: u64 = 2;
/// Late fields in a row, none of which had waited, after which the numbers follow the source.
const LAGS_AFTER: u32 = 10;

/// Instants of the fields of a rig.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// The field with number 0 is read out, and every source has brought its first picture.
    pub start_ns: Nanos,
    /// Time between two fields, ns: of the fastest camera, or of the one whose clock this is.
    pub period_ns: u64,
    /// From the first line until the last has left the slowest sensor, ns.
    pub lines_ns: u64,
    /// Longest wait of a field for one of another camera, after its read-out.
    pub patience_ns: u64,
}

/// Time that the camera hardware needs after a field is published, with what the machine may add, ns.
const HARDWARE_NS: u64 = 1_500_000;

/// How long a field waits for those of other cameras: half a period, and no longer than leaves its blobs
/// within `budget_ns` of mid-exposure, which was `exposed_before_ns` before the field was read out.
pub fn patience_ns(period_ns: u64, exposed_before_ns: u64, budget_ns: u64) -> u64 {
    (period_ns / 2).min(budget_ns.saturating_sub(exposed_before_ns + HARDWARE_NS))
}

impl Clock {
    /// When the last line of a field has left the sensor.
    pub fn read_out(&self, number: u64) -> Nanos {
        self.start_ns.saturating_add(number.saturating_mul(self.period_ns))
    }

    /// Its first line leaves the sensor.
    pub fn first_line(&self, number: u64) -> Nanos {
        self.read_out(number).saturating_sub(self.lines_ns)
    }

    /// The number of the first field that is read out at `instant` or later.
    pub fn first_from(&self, instant: Nanos) -> u64 {
        instant.saturating_sub(self.start_ns).div_ceil(self.period_ns)
    }

    /// The number of a field that came unexpectedly: the newest that was read out by then. A quarter of
    /// a period is allowed for a start that was announced late.
    pub fn number_at(&self, arrived: Nanos) -> u64 {
        (arrived.saturating_add(self.period_ns / 4).saturating_sub(self.start_ns)) / self.period_ns
    }
}

/// What becomes of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// It has this number, and arrived this long after its read-out.
    Taken {
        /// Its number.
        number: u64,
        /// Its delay, ns; 0 for one that waited to be read.
        delay_ns: u64,
    },
    /// It came too late.
    Late,
    /// It was taken before the start.
    Before,
    /// Its camera is faster than the rig says: there is no number for it.
    Surplus,
}

/// The numbers of one camera's fields.
#[derive(Debug, Clone, Copy, Default)]
pub struct Numbering {
    /// Of the field that comes next.
    next: u64,
    /// The next field is the first after the source was opened.
    reopened: bool,
    /// The lag of the first of the late fields in a row, ns, and their count.
    lag: Option<(u64, u32)>,
    last_arrived: Nanos,
    /// The newest field that a camera has stamped: its instant and number.
    stamped: Option<(Nanos, u64)>,
}

/// A field keeps the number that follows from the one before it while its instant is at most so far from
/// that number's, as a share of a period: one that lies halfway between two numbers does not waver.
const STEADY: f64 = 0.75;

impl Numbering {
    /// The source was opened: what comes next has the number whose time it is.
    pub fn opened(&mut self) {
        self.reopened = true;
    }

    /// Number of the field that comes next, if its source goes on.
    pub fn next(&self) -> u64 {
        self.next
    }

    /// When the next field is published: as its first line leaves the sensor where all cameras have
    /// theirs, else [`Clock::patience_ns`] after it was read out at the latest, so that one that comes a
    /// little late is still of the same frame. That of a source that was opened is published when it comes.
    pub fn due(&self, clock: &Clock, all_there: bool) -> Nanos {
        match (self.reopened, all_there) {
            (true, _) => 0,
            (_, true) => clock.first_line(self.next),
            _ => clock.read_out(self.next).saturating_add(clock.patience_ns),
        }
    }

    /// The number of a field that its camera says was read out at `read_out`; `None` before the start.
    pub fn number_of(&self, clock: &Clock, read_out: Nanos) -> Option<u64> {
        let after = |from: Nanos| (read_out as f64 - from as f64) / clock.period_ns as f64;
        let place = after(clock.start_ns);
        let follows =
            self.stamped.filter(|_| !self.reopened).map(|(at, number)| number as f64 + after(at).round());
        let steady = follows.filter(|number| (number - place).abs() <= STEADY);
        let number = steady.unwrap_or(place.round());
        (number >= 0.0).then_some(number as u64)
    }

    /// When a field that was read out at `read_out` by its camera's stamp is published: at once where those
    /// of the others are there, else [`Clock::patience_ns`] after it was read out at the latest.
    pub fn stamped_due(&self, clock: &Clock, read_out: Nanos, awaited: Nanos) -> Nanos {
        let number = self.number_of(clock, read_out);
        let wait = !self.reopened && number.is_some_and(|number| clock.read_out(number) >= awaited);
        if wait { read_out.saturating_add(clock.patience_ns) } else { 0 }
    }

    /// Numbers a field that was read out at `read_out` by its camera's stamp, was there at `arrived` and is
    /// looked at now.
    pub fn place_stamped(&mut self, clock: &Clock, read_out: Nanos, arrived: Nanos, now: Nanos) -> Place {
        let Some(number) = self.number_of(clock, read_out) else { return Place::Before };
        self.reopened = false;
        if number < self.next {
            return Place::Surplus;
        }
        self.stamped = Some((read_out, number));
        self.next = number + 1;
        if now.saturating_sub(read_out) > LATE_PERIODS * clock.period_ns {
            return Place::Late;
        }
        Place::Taken { number, delay_ns: arrived.saturating_sub(read_out) }
    }

    /// Numbers a field that was there at `arrived` and is looked at now.
    pub fn place(&mut self, clock: &Clock, arrived: Nanos, now: Nanos) -> Place {
        if std::mem::take(&mut self.reopened) {
            self.next = self.next.max(clock.number_at(arrived));
            self.lag = None;
        }
        let gap_ns = arrived.saturating_sub(std::mem::replace(&mut self.last_arrived, arrived));
        let number = self.next;
        self.next += 1;
        let read_out = clock.read_out(number);
        let late_ns = LATE_PERIODS * clock.period_ns;
        if now.max(arrived).saturating_sub(read_out) <= late_ns {
            self.lag = None;
            return Place::Taken { number, delay_ns: arrived.saturating_sub(read_out) };
        }
        self.note_lag(arrived.saturating_sub(read_out), gap_ns, clock.period_ns);
        Place::Late
    }

    /// Looks whether a source that brings late fields catches up.
    fn note_lag(&mut self, lag_ns: u64, gap_ns: u64, period_ns: u64) {
        let waited = gap_ns < period_ns / 2;
        let (first_ns, count) = self.lag.filter(|_| !waited).unwrap_or((lag_ns, 0));
        let catches_up = lag_ns.saturating_add(period_ns) < first_ns;
        self.lag = (!waited && !catches_up).then_some((first_ns, count + 1));
        if count + 1 >= LAGS_AFTER && self.lag.is_some() {
            self.opened();
        }
    }
}

#[cfg(test)]
mod tests;
