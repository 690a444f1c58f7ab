//! What trees of bounding volumes have in common: nodes, and the descent of two of them together.

use crate::peers::triangle;
use crate::setting::Frame;
use validation::exact::tritri::{Corner, Triangle};

/// A node: a triangle, or two nodes that come before it. The root is the last.
#[derive(Debug, Clone, Copy)]
pub enum Below {
    /// A leaf.
    Triangle(u32),
    /// Children.
    Nodes(u32, u32),
}

/// Adds the pairs of a membrane's and the instrument's triangles that intersect. `meets` says whether the volumes of two
/// nodes do, `is_larger` whether the membrane's is the larger one, which is divided; `stack` is empty again afterwards.
pub fn intersecting(
    frame: &Frame,
    corners: &[Corner],
    [membrane, instrument]: [&[Below]; 2],
    stack: &mut Vec<(u32, u32)>,
    meets: impl Fn(usize, usize) -> bool,
    is_larger: impl Fn(usize, usize) -> bool,
    pairs: &mut Vec<(u32, u32)>,
) {
    stack.push((membrane.len() as u32 - 1, instrument.len() as u32 - 1));
    let mut last: (u32, Option<Triangle>) = (u32::MAX, None);
    while let Some((m, i)) = stack.pop() {
        if !meets(m as usize, i as usize) {
            continue;
        }
        match (membrane[m as usize], instrument[i as usize]) {
            (Below::Triangle(t), Below::Triangle(u)) => {
                if last.0 != t {
                    last = (t, triangle(frame, corners, t as usize));
                }
                let (other, number) = &frame.mesh.triangles()[u as usize];
                if last.1.is_some_and(|mine| mine.intersects(other)) {
                    pairs.push((t, *number));
                }
            }
            (Below::Nodes(l, r), Below::Triangle(_)) => stack.extend([(l, i), (r, i)]),
            (Below::Nodes(l, r), Below::Nodes(..)) if is_larger(m as usize, i as usize) => {
                stack.extend([(l, i), (r, i)]);
            }
            (_, Below::Nodes(l, r)) => stack.extend([(m, l), (m, r)]),
        }
    }
}
