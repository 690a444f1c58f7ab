//! Schedule of the exposures: groups of cameras that share a clock, and the next action. Pure: the
//! time is an argument.
//!
//! Genlocked cameras of one rate are one group; a free-running camera is a group of its own. A group's field is
//! made 7 ms ahead of the instant at which its blobs are due, or half a period where that is less:
//! making it takes 3 ms for three cameras, the scan of its blobs 1 ms. The time before belongs to those
//! who work on the field that has just left: real cameras take no processor from the picture. A field
//! is not begun just before another group's field has to leave.

use crate::cameras::Cameras;
use crate::faults::timing::Clock;

/// Time kept free before a send, ns; drawing a field takes less than 1 ms.
const ROOM_NS: u64 = 3_000_000;
/// How long before its blobs are due a field is made, ns; at most half a period.
const AHEAD_NS: u64 = 7_000_000;

/// Cameras that share a clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Indices in the rig.
    pub cameras: Vec<usize>,
    /// Their clock.
    pub clock: Clock,
    /// Number of the field that is exposed next.
    pub next: u64,
    /// From an exposure until its first blobs are due, ns.
    pub out_after_ns: u64,
    /// When the next field may be made at the earliest, ns after the start.
    not_before_ns: u64,
}

/// Next action of the process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Expose the next field of this group.
    Expose(usize),
    /// Wait until something is due, ns after the start.
    Wait(u64),
    /// No field is left.
    Over,
}

/// All groups of a rig.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule(pub Vec<Group>);

impl Schedule {
    /// The groups of some cameras.
    pub fn of(cameras: &Cameras) -> Self {
        let all = (0..cameras.len()).map(|i| (cameras.clock(i), cameras.out_after_ns(i)));
        Self::from_clocks(all)
    }

    fn from_clocks(cameras: impl Iterator<Item = (Clock, u64)>) -> Self {
        let mut groups: Vec<Group> = Vec::new();
        for (i, (clock, out_after_ns)) in cameras.enumerate() {
            if let Some(group) = groups.iter_mut().find(|g| g.clock == clock) {
                group.cameras.push(i);
                group.out_after_ns = group.out_after_ns.min(out_after_ns);
            } else {
                groups.push(Group { cameras: vec![i], clock, next: 0, out_after_ns, not_before_ns: 0 });
            }
        }
        Schedule(groups)
    }

    /// The group whose fields make the tracker's frames: the fastest, of several the first.
    pub fn leading(&self) -> usize {
        (0..self.0.len()).min_by_key(|&i| self.0[i].clock.period_ns).unwrap_or(0)
    }

    /// Starts again with field 0.
    pub fn reset(&mut self) {
        self.0.iter_mut().for_each(|g| (g.next, g.not_before_ns) = (0, 0));
    }

    /// Goes on with the first field of each group that is exposed later than `elapsed_ns` after the
    /// start.
    pub fn go_on_after(&mut self, elapsed_ns: u64) {
        for group in &mut self.0 {
            // A clock differs from its period by millionths.
            group.next = (elapsed_ns / group.clock.period_ns.max(1)).saturating_sub(2);
            while group.clock.exposed_ns(group.next) <= elapsed_ns {
                group.next += 1;
            }
        }
    }

    /// Next action `elapsed_ns` after the start, with the next send due at `send_ns`. No field is
    /// exposed from `duration_ns` on.
    pub fn next(&self, elapsed_ns: u64, send_ns: Option<u64>, duration_ns: u64) -> Action {
        let lives = |g: &&Group| g.clock.exposed_ns(g.next) < duration_ns;
        let is_free = |g: &Group| g.not_before_ns <= elapsed_ns;
        let all = self.0.iter().filter(lives);
        let free = (0..self.0.len()).filter(|&i| lives(&&self.0[i]) && is_free(&self.0[i]));
        if let Some(i) = free.min_by_key(|&i| self.0[i].due_ns()) {
            let urgent = |send: u64| send <= elapsed_ns.saturating_add(ROOM_NS) && send <= self.0[i].due_ns();
            return match send_ns.filter(|&send| urgent(send)) {
                Some(send) => Action::Wait(send),
                None => Action::Expose(i),
            };
        }
        let wake = all.map(|g| g.not_before_ns).chain(send_ns).min();
        wake.map_or(Action::Over, Action::Wait)
    }

    /// Leaves out the fields of group `i` that are overdue by a period or more; returns their
    /// number.
    pub fn leave_out_missed(&mut self, i: usize, elapsed_ns: u64) -> u64 {
        let group = &mut self.0[i];
        let missed = elapsed_ns.saturating_sub(group.due_ns()) / group.clock.period_ns.max(1);
        group.next += missed;
        missed
    }

    /// Marks the next field of group `i` as exposed; returns its number.
    pub fn exposed(&mut self, i: usize) -> u64 {
        let group = &mut self.0[i];
        group.next += 1;
        group.not_before_ns = group.due_ns().saturating_sub(AHEAD_NS.min(group.clock.period_ns / 2));
        group.next - 1
    }
}

impl Group {
    /// When the first blobs of the next field are due, ns after the start.
    fn due_ns(&self) -> u64 {
        self.clock.exposed_ns(self.next) + self.out_after_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn clock(phase_ns: u64) -> Clock {
        Clock { period_ns: 20 * MS, ppb: 0, phase_ns }
    }

    #[test]
    fn cameras_of_other_rates_are_groups_of_their_own_and_the_fastest_leads() {
        let of = |period_ms: u64| (Clock { period_ns: period_ms * MS, ppb: 0, phase_ns: 0 }, 4 * MS);
        let mut schedule = Schedule::from_clocks([20, 5, 10, 5].into_iter().map(of));
        let groups: Vec<_> = schedule.0.iter().map(|g| g.cameras.clone()).collect();
        assert_eq!((groups, schedule.leading()), (vec![vec![0], vec![1, 3], vec![2]], 1));
        let (mut now, mut exposed) = (0, vec![vec![]; 3]);
        while now < 40 * MS {
            match schedule.next(now, None, 40 * MS) {
                Action::Expose(i) => exposed[i].push(schedule.exposed(i)),
                Action::Wait(until) => now = until,
                Action::Over => break,
            }
        }
        let all = |count: u64| (0..count).collect::<Vec<_>>();
        assert_eq!(exposed, [all(2), all(8), all(4)], "each camera counts its own fields");
    }

    #[test]
    fn genlocked_cameras_are_one_group() {
        let mut schedule = Schedule::from_clocks([20, 19, 21].into_iter().map(|ms| (clock(0), ms * MS)));
        assert_eq!(schedule.0.len(), 1);
        assert_eq!(schedule.next(0, None, 100 * MS), Action::Expose(0), "ahead of its time");
        assert_eq!(schedule.exposed(0), 0);
        assert_eq!(schedule.next(2 * MS, Some(20 * MS), 100 * MS), Action::Wait(20 * MS));
        assert_eq!(schedule.next(21 * MS, None, 100 * MS), Action::Wait(32 * MS), "7 ms ahead");
        assert_eq!(schedule.next(32 * MS, Some(34 * MS), 100 * MS), Action::Wait(34 * MS), "not just before");
        assert_eq!(schedule.next(34 * MS, None, 100 * MS), Action::Expose(0));
        assert_eq!(schedule.next(21 * MS, None, 20 * MS), Action::Over);
        assert_eq!(
            schedule.next(21 * MS, Some(30 * MS), 20 * MS),
            Action::Wait(30 * MS),
            "late ones still leave"
        );
    }

    #[test]
    fn a_free_running_camera_does_not_hold_up_another() {
        let mut schedule = Schedule::from_clocks([0, 10].into_iter().map(|ms| (clock(ms * MS), 20 * MS)));
        assert_eq!(schedule.0.len(), 2);
        let mut order = Vec::new();
        let (mut elapsed, mut outbox) = (0, Vec::new());
        while order.len() < 6 {
            match schedule.next(elapsed, outbox.first().copied(), u64::MAX) {
                Action::Expose(i) => {
                    let number = schedule.exposed(i);
                    outbox.push(number * 20 * MS + schedule.0[i].clock.phase_ns + 20 * MS);
                    outbox.sort_unstable();
                    elapsed += MS;
                }
                Action::Wait(until) => {
                    elapsed = elapsed.max(until);
                    while outbox.first().is_some_and(|&due| due <= elapsed) {
                        assert_eq!(elapsed, outbox[0], "in time");
                        order.push(outbox.remove(0) / MS);
                    }
                }
                Action::Over => panic!("it goes on for ever"),
            }
        }
        assert_eq!(order, [20, 30, 40, 50, 60, 70]);
    }

    #[test]
    fn what_a_slow_machine_missed_is_left_out() {
        let mut schedule = Schedule::from_clocks([(clock(0), 20 * MS)].into_iter());
        assert_eq!(schedule.leave_out_missed(0, 39 * MS), 0);
        assert_eq!(schedule.leave_out_missed(0, 85 * MS), 3);
        assert_eq!(schedule.exposed(0), 3);
        schedule.reset();
        assert_eq!(schedule.exposed(0), 0);
    }

    #[test]
    fn numbers_go_on_where_they_stood() {
        let mut schedule = Schedule::from_clocks([0, 10].into_iter().map(|ms| (clock(ms * MS), 20 * MS)));
        schedule.go_on_after(40 * MS);
        assert_eq!([schedule.exposed(0), schedule.exposed(1)], [3, 2]);
        schedule.go_on_after(0);
        assert_eq!([schedule.exposed(0), schedule.exposed(1)], [1, 0]);
    }

    #[test]
    fn dropped_fields_keep_the_beat() {
        let mut schedule = Schedule::from_clocks([(clock(0), 20 * MS)].into_iter());
        schedule.exposed(0);
        // Nothing was sent, yet the next field waits for its turn.
        assert_eq!(schedule.next(5 * MS, None, u64::MAX), Action::Wait(33 * MS));
    }

    #[test]
    fn a_fast_camera_is_made_half_a_period_ahead() {
        let fast = Clock { period_ns: 5 * MS, ppb: 0, phase_ns: 0 };
        let mut schedule = Schedule::from_clocks([(fast, 4 * MS)].into_iter());
        schedule.exposed(0);
        assert_eq!(schedule.next(5 * MS, None, u64::MAX), Action::Wait(6_500_000));
    }
}
