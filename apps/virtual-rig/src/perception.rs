//! What a scripted surgeon perceives in a live run: the scene that the simulation sent last, and
//! the goals that its events reported as reached.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use protocol::events::{Event, EventKind};
use protocol::scene::{NODE_FREE, SceneBody, SceneHeader, SceneNode, section};
use surgeon::script::{PerceivedBody, Perception};

/// Bodies, tissue and goals as the simulation published them.
#[derive(Debug, Clone, Default)]
pub struct ScenePerception {
    bodies: Vec<SceneBody>,
    nodes: Vec<SceneNode>,
    /// A bit for each goal that is reached.
    reached: u64,
}

impl ScenePerception {
    /// Takes in a scene; a damaged one is passed over.
    pub fn take_scene(&mut self, header: &SceneHeader, payload: &[u8]) {
        let found = section(payload, header.bodies).ok().zip(section(payload, header.nodes).ok());
        if let Some((bodies, nodes)) = found {
            self.bodies.clear();
            self.bodies.extend_from_slice(bodies);
            self.nodes.clear();
            self.nodes.extend_from_slice(nodes);
        }
    }

    /// Takes in an event.
    pub fn take_event(&mut self, event: &Event) {
        if event.kind == EventKind::TaskStarted as u32 {
            self.reached = 0;
        } else if event.kind == EventKind::GoalReached as u32 {
            self.reached |= 1u64.checked_shl(event.subject).unwrap_or(0);
        }
    }
}

impl ScenePerception {
    /// A bit for each goal that is reached.
    pub fn goals_reached(&self) -> u64 {
        self.reached
    }

    /// Takes over the goals that a predecessor saw reached.
    pub fn take_goals(&mut self, reached: u64) {
        self.reached |= reached;
    }
}

impl Perception for ScenePerception {
    fn reached(&self, goal: usize) -> bool {
        self.reached.checked_shr(goal as u32).is_some_and(|bits| bits & 1 == 1)
    }

    fn body(&self, number: usize) -> Option<PerceivedBody> {
        let body = self.bodies.get(number)?;
        let q = body.rotation_xyzw.map(f64::from);
        let turn = UnitQuaternion::try_new(Quaternion::new(q[3], q[0], q[1], q[2]), 1e-6)?;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| turn * axis);
        let at = Vector3::from(body.position_mm.map(f64::from));
        Some(PerceivedBody::new(at, axes, body.half_extents_mm.map(f64::from)))
    }

    fn tissue_near(&self, place_in_eye_mm: &Vector3<f64>) -> Option<Vector3<f64>> {
        let free = self.nodes.iter().filter(|n| u32::from(n.flag) == NODE_FREE);
        let places = free.map(|n| Vector3::from(n.position_mm.map(f64::from)));
        places.min_by(|a, b| {
            (a - place_in_eye_mm).norm_squared().total_cmp(&(b - place_in_eye_mm).norm_squared())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn goals_bodies_and_tissue_are_seen() {
        let mut seen = ScenePerception::default();
        let told = |kind: EventKind, subject| Event { kind: kind as u32, subject, ..Event::zeroed() };
        seen.take_event(&told(EventKind::GoalReached, 3));
        seen.take_event(&told(EventKind::GoalReached, 4_000_000));
        assert_eq!([2, 3, 4, 400].map(|goal| seen.reached(goal)), [false, true, false, false]);
        seen.take_event(&told(EventKind::TaskStarted, 0));
        assert!(!seen.reached(3), "a new attempt");
        seen.nodes = [(0.0, NODE_FREE), (1.0, 16), (3.0, NODE_FREE)]
            .map(|(x, flag)| SceneNode { position_mm: [x, 0.0, 0.0], flag: flag as u16, dye: 0 })
            .to_vec();
        let near = seen.tissue_near(&Vector3::new(1.2, 0.0, 0.0));
        assert_eq!(near, Some(Vector3::zeros()), "what is held is not taken again");
        let half = libm::sqrt(0.5) as f32;
        seen.bodies = vec![SceneBody {
            position_mm: [1.0, 2.0, 3.0],
            rotation_xyzw: [0.0, 0.0, half, half],
            half_extents_mm: [0.6, 0.3, 0.3],
            ..SceneBody::zeroed()
        }];
        let body = seen.body(0).unwrap();
        assert!((body.along_in_eye - Vector3::y()).norm() < 1e-6, "{body:?}");
        assert!(seen.body(1).is_none());
    }
}
