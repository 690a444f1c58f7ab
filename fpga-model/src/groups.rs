//! Which cameras are exposed together, and what is to be done next. Pure: the time is an argument.
//!
//! Genlocked cameras are one group; a free-running camera is a group of its own. A group's field is
//! computed as soon as its field before has left, ahead of the instant at which its blobs are due; it is
//! not begun just before another group's field has to leave.

use crate::cameras::Cameras;
use crate::faults::timing::Clock;

/// Room that is left before a field is due, ns: drawing and scanning one takes about 1 ms.
const ROOM_NS: u64 = 3_000_000;

/// Cameras that share a clock.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Places in the rig.
    pub cameras: Vec<usize>,
    /// Their clock.
    pub clock: Clock,
    /// Number of the field that is exposed next.
    pub next: u64,
    /// From an exposure until its first blobs are due, ns.
    out_after_ns: u64,
    /// When the field exposed last has left, ns after the start.
    busy_until_ns: u64,
}

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Expose the next field of this group.
    Expose(usize),
    /// Wait until so many ns after the start; something is due then.
    Wait(u64),
    /// Nothing more comes.
    Over,
}

/// All groups of a rig.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups(pub Vec<Group>);

impl Groups {
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
                groups.push(Group { cameras: vec![i], clock, next: 0, out_after_ns, busy_until_ns: 0 });
            }
        }
        Groups(groups)
    }

    /// Begins anew.
    pub fn reset(&mut self) {
        self.0.iter_mut().for_each(|g| (g.next, g.busy_until_ns) = (0, 0));
    }

    /// What is to be done `elapsed_ns` after the start, where `send_ns` is when something has to be sent.
    /// No field is exposed from `duration_ns` on.
    pub fn step(&self, elapsed_ns: u64, send_ns: Option<u64>, duration_ns: u64) -> Step {
        let lives = |g: &&Group| g.clock.exposed_ns(g.next) < duration_ns;
        let is_free = |g: &Group| g.busy_until_ns <= elapsed_ns;
        let all = self.0.iter().filter(lives);
        let free = (0..self.0.len()).filter(|&i| lives(&&self.0[i]) && is_free(&self.0[i]));
        if let Some(i) = free.min_by_key(|&i| self.0[i].due_ns()) {
            let urgent = |send: u64| send <= elapsed_ns.saturating_add(ROOM_NS) && send <= self.0[i].due_ns();
            return match send_ns.filter(|&send| urgent(send)) {
                Some(send) => Step::Wait(send),
                None => Step::Expose(i),
            };
        }
        let wake = all.map(|g| g.busy_until_ns).chain(send_ns).min();
        wake.map_or(Step::Over, Step::Wait)
    }

    /// Leaves out the fields of group `i` that a machine too slow has missed; returns how many.
    pub fn leave_out_missed(&mut self, i: usize, elapsed_ns: u64) -> u64 {
        let group = &mut self.0[i];
        let missed = elapsed_ns.saturating_sub(group.due_ns()) / group.clock.period_ns.max(1);
        group.next += missed;
        missed
    }

    /// Notes that the next field of group `i` was exposed; returns its number.
    pub fn exposed(&mut self, i: usize) -> u64 {
        let group = &mut self.0[i];
        group.busy_until_ns = group.due_ns();
        group.next += 1;
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
    fn genlocked_cameras_are_one_group() {
        let mut groups = Groups::from_clocks([20, 19, 21].into_iter().map(|ms| (clock(0), ms * MS)));
        assert_eq!(groups.0.len(), 1);
        assert_eq!(groups.step(0, None, 100 * MS), Step::Expose(0), "ahead of its time");
        assert_eq!(groups.exposed(0), 0);
        assert_eq!(groups.step(2 * MS, Some(20 * MS), 100 * MS), Step::Wait(19 * MS));
        assert_eq!(groups.step(19 * MS, Some(20 * MS), 100 * MS), Step::Wait(20 * MS), "not just before");
        assert_eq!(groups.step(21 * MS, None, 100 * MS), Step::Expose(0));
        assert_eq!(groups.step(21 * MS, None, 20 * MS), Step::Over);
        assert_eq!(
            groups.step(21 * MS, Some(30 * MS), 20 * MS),
            Step::Wait(30 * MS),
            "late ones still leave"
        );
    }

    #[test]
    fn a_free_running_camera_does_not_hold_up_another() {
        let mut groups = Groups::from_clocks([0, 10].into_iter().map(|ms| (clock(ms * MS), 20 * MS)));
        assert_eq!(groups.0.len(), 2);
        let mut order = Vec::new();
        let (mut elapsed, mut outbox) = (0, Vec::new());
        while order.len() < 6 {
            match groups.step(elapsed, outbox.first().copied(), u64::MAX) {
                Step::Expose(i) => {
                    let number = groups.exposed(i);
                    outbox.push(number * 20 * MS + groups.0[i].clock.phase_ns + 20 * MS);
                    outbox.sort_unstable();
                    elapsed += MS;
                }
                Step::Wait(until) => {
                    elapsed = elapsed.max(until);
                    while outbox.first().is_some_and(|&due| due <= elapsed) {
                        assert_eq!(elapsed, outbox[0], "in time");
                        order.push(outbox.remove(0) / MS);
                    }
                }
                Step::Over => panic!("it goes on for ever"),
            }
        }
        assert_eq!(order, [20, 30, 40, 50, 60, 70]);
    }

    #[test]
    fn what_a_slow_machine_missed_is_left_out() {
        let mut groups = Groups::from_clocks([(clock(0), 20 * MS)].into_iter());
        assert_eq!(groups.leave_out_missed(0, 39 * MS), 0);
        assert_eq!(groups.leave_out_missed(0, 85 * MS), 3);
        assert_eq!(groups.exposed(0), 3);
        groups.reset();
        assert_eq!(groups.exposed(0), 0);
    }

    #[test]
    fn dropped_fields_keep_the_beat() {
        let mut groups = Groups::from_clocks([(clock(0), 20 * MS)].into_iter());
        groups.exposed(0);
        // Nothing was sent, yet the next field waits for its turn.
        assert_eq!(groups.step(5 * MS, None, u64::MAX), Step::Wait(20 * MS));
    }
}
