//! The forces of a substep, written once for every instruction set.
//!
//! Three things happen to each block of sixteen nodes:
//!
//! 1. Nodes are copied from arrays of x, y, z … into eight consecutive numbers each, so that a
//!    spring reads its far end
//!    with one load.
//! 2. In slot j each node has its j-th own spring: the near ends are consecutive, the far ends are
//!    fetched and transposed; the near ends'
//!    forces stay in registers, the springs' forces are written as blocks of x, y and z.
//! 3. Each node subtracts the forces of the springs whose far end it is, and divides by its mass.
//!    They are picked out of two springs' blocks at a
//!    time, in registers.
//!
//! All three go through the sheet together. Neighbours have near numbers, so that what one hands to
//! the next is still in the first cache, in rings of as many blocks as neighbours are apart.

use super::aligned::Aligned;
use super::{ABSENT, Isa, Lanes, NODE, Portable, WIDE};

/// Numbers of the force of a spring block, and of the sum of a node block: sixteen of x, y and z.
pub const TRIPLE: usize = 3 * WIDE;

/// Takes forces of two blocks of springs to the nodes of one block; see [`Lanes::gather`].
#[derive(Debug, Clone, Copy)]
pub struct Gather {
    /// Where the blocks begin in `force`.
    pub from: [u32; 2],
    /// Which of them goes to each lane.
    pub index: [u8; WIDE],
}

/// The nodes of a block are copied for springs that end in it.
pub const SPREAD: u8 = 1;
/// The forces of its own springs are computed.
pub const PULL: u8 = 2;
/// The forces on its nodes are added up.
pub const COLLECT: u8 = 4;

/// Springs in the order of the kernel; see [`crate::sheet::spring_packing`] for how it comes about.
#[derive(Debug, Default)]
pub struct Tables {
    /// Nodes.
    pub nodes: usize,
    /// Own springs of a node, at most.
    pub slots: usize,
    /// Blocks by which the far end of a spring lies ahead of its owner or behind, at most.
    pub reach: [usize; 2],
    /// What is to be done for each block: a sum of [`SPREAD`], [`PULL`] and [`COLLECT`].
    pub work: Vec<u8>,
    /// Blocks of the two ends of springs, the owner's first, each pair once.
    pub links: Vec<[u32; 2]>,
    /// For each block, slot and lane: where the far end begins in `node`, in numbers.
    pub far: Vec<u32>,
    /// Rest length, mm.
    pub rest: Aligned,
    /// Stiffness, µN/mm.
    pub stiffness: Aligned,
    /// Damping, µN·s/mm.
    pub damping: Aligned,
    /// Tension at which it tears, µN.
    pub limit: Aligned,
    /// Elastic pull, µN: a result.
    pub pull: Aligned,
    /// First pick of each block in `picks`; one more entry than blocks.
    pub gather_start: Vec<u32>,
    /// How each block fetches the forces of springs that end in it.
    pub gathers: Vec<Gather>,
    /// Work space, a ring: nodes.
    pub node: Aligned,
    /// Work space, a ring: sums of the forces of own springs.
    pub own: Aligned,
    /// Work space, a ring: forces of springs.
    pub force: Aligned,
}

/// What goes into the forces of a substep and what comes out; every slice has a number for each
/// node.
#[derive(Debug)]
#[allow(missing_docs)]
pub struct Forces<'a> {
    pub position: [&'a [f32]; 3],
    pub velocity: [&'a [f32]; 3],
    pub outer: [&'a [f32]; 3],
    pub mobile: &'a [f32],
    pub force: [&'a mut [f32]; 3],
    pub acceleration: [&'a mut [f32]; 3],
    pub acceleration2: &'a mut [f32],
    pub inverse_mass: f32,
    pub fluid_per_s: f32,
    /// Square of the acceleration at which nodes tear.
    pub tear2: f32,
    /// Added to squared lengths, mm².
    pub tiny2: f32,
}

/// What the forces of a substep demand besides moving.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Alarms {
    /// A node's acceleration is not a number, or infinite.
    pub not_finite: bool,
    /// A node's acceleration passes the limit of tearing.
    pub over_acceleration: bool,
    /// A spring's tension passes its limit.
    pub over_tension: bool,
}

impl Tables {
    fn blocks(&self) -> usize {
        self.nodes.div_ceil(WIDE)
    }

    /// Blocks in the rings.
    pub fn ring(&self) -> usize {
        (self.reach[0] + self.reach[1] + 1).min(self.blocks()).max(1)
    }

    /// Panics if the tables would lead a pass outside its arrays: whoever fills them calls this
    /// once.
    pub fn check(&self) {
        let (blocks, ring) = (self.blocks(), self.ring());
        let n = blocks * self.slots * WIDE;
        let lists = [&self.rest, &self.stiffness, &self.damping, &self.limit, &self.pull];
        assert!(lists.iter().all(|l| l.len() == n) && self.far.len() == n);
        assert_eq!(self.node.len(), ring * WIDE * NODE);
        assert_eq!(self.own.len(), ring * TRIPLE);
        assert_eq!(self.force.len(), ring * self.slots * TRIPLE);
        assert!(self.far.iter().all(|&at| at as usize + NODE <= self.node.len()));
        let inside = |at: u32| at as usize + TRIPLE <= self.force.len();
        assert!(self.gathers.iter().all(|p| p.from.into_iter().all(inside)));
        assert!(self.gathers.iter().flat_map(|p| p.index).all(|i| i <= ABSENT));
        assert_eq!((self.gather_start.len(), self.work.len()), (blocks + 1, blocks));
        assert!(self.gather_start.is_sorted());
        assert_eq!(self.gather_start[blocks] as usize, self.gathers.len());
    }

    /// Leaves out from now on what only matters to blocks of nodes of which none is `wanted`.
    pub fn work_for(&mut self, wanted: impl Fn(usize) -> bool) {
        self.work.fill(0);
        for node in (0..self.nodes).filter(|&node| wanted(node)) {
            self.work[node / WIDE] = COLLECT;
        }
        for [owner, end] in self.links.iter().map(|ends| ends.map(|b| b as usize)) {
            if (self.work[owner] | self.work[end]) & COLLECT != 0 {
                self.work[owner] |= PULL;
            }
        }
        // Empty slots end in their own block.
        for work in self.work.iter_mut().filter(|w| **w != 0) {
            *work |= PULL | SPREAD;
        }
        for [owner, end] in self.links.iter().map(|ends| ends.map(|b| b as usize)) {
            if self.work[owner] & PULL != 0 {
                self.work[end] |= SPREAD;
            }
        }
        // Springs that are left out do not pull.
        let of_block = self.pull.chunks_mut((self.slots * WIDE).max(1));
        let left_out = of_block.zip(&self.work).filter(|(_, work)| **work & PULL == 0);
        left_out.for_each(|(pulls, _)| pulls.fill(0.0));
    }

    /// Forces and accelerations with the instructions of `isa`, which must come from
    /// [`Isa::available`].
    pub fn accelerate(&mut self, isa: Isa, forces: &mut Forces) -> Alarms {
        let n = self.nodes;
        let read = forces.position.iter().chain(&forces.velocity).chain(&forces.outer);
        assert!(read.chain([&forces.mobile]).all(|v| v.len() == n));
        assert!(forces.force.iter().chain(&forces.acceleration).all(|v| v.len() == n));
        assert_eq!(forces.acceleration2.len(), n);
        // SAFETY: `check` and the assertions above hold every index; the processor has what `isa`
        // says.
        unsafe {
            match isa {
                #[cfg(target_arch = "x86_64")]
                Isa::Avx512 => accelerate_avx512(self, forces),
                #[cfg(target_arch = "x86_64")]
                Isa::Avx2 => accelerate_avx2(self, forces),
                _ => accelerate::<Portable>(self, forces),
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512dq,avx2")]
fn accelerate_avx512(tables: &mut Tables, forces: &mut Forces) -> Alarms {
    // SAFETY: as promised by the caller of this function.
    unsafe { accelerate::<super::Avx512>(tables, forces) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn accelerate_avx2(tables: &mut Tables, forces: &mut Forces) -> Alarms {
    // SAFETY: as promised by the caller of this function.
    unsafe { accelerate::<super::Avx2>(tables, forces) }
}

/// SAFETY: the processor has the instructions of `L`, the tables passed their check, the slices
/// have a number a node.
#[inline(always)]
unsafe fn accelerate<L: Lanes>(tables: &mut Tables, forces: &mut Forces) -> Alarms {
    let (nodes, blocks, ring) = (tables.nodes, tables.blocks(), tables.ring());
    let [ahead, behind] = tables.reach;
    let next = |at: usize| if at + 1 == ring { 0 } else { at + 1 };
    let (mut spread_at, mut pull_at, mut collect_at) = (0, 0, 0);
    let (mut tension, mut finite, mut over) = (0, u16::MAX, 0);
    // SAFETY: handed on. A ring's block is written again only after the last who reads it.
    unsafe {
        let sweep = Sweep::<L>::new(tables, forces);
        for step in 0..blocks + ahead + behind {
            let has = |behind: usize, work: u8| tables.work[step - behind] & work != 0;
            if step < blocks {
                if has(0, SPREAD) {
                    let parts = node_parts::<L>(&sweep, Span::new(step, nodes));
                    L::spread(sweep.node.add(spread_at * WIDE * NODE), parts);
                }
                spread_at = next(spread_at);
            }
            if step >= ahead && step < blocks + ahead {
                if has(ahead, PULL) {
                    tension |= pull(&sweep, Span::new(step - ahead, nodes), pull_at);
                }
                pull_at = next(pull_at);
            }
            if step >= ahead + behind {
                if has(ahead + behind, COLLECT) {
                    let span = Span::new(step - ahead - behind, nodes);
                    let (good, torn) = collect(&sweep, span, collect_at);
                    (finite, over) = (finite & good, over | torn);
                }
                collect_at = next(collect_at);
            }
        }
    }
    Alarms { not_finite: finite != u16::MAX, over_acceleration: over != 0, over_tension: tension != 0 }
}

/// A block of nodes; the last one may have fewer than sixteen.
#[derive(Clone, Copy)]
pub(super) struct Span {
    block: usize,
    at: usize,
    count: usize,
}

impl Span {
    #[inline(always)]
    pub(super) fn new(block: usize, nodes: usize) -> Self {
        let at = block * WIDE;
        Span { block, at, count: nodes - at }
    }

    /// Its numbers of a list; behind the end 0.
    #[inline(always)]
    pub(super) unsafe fn part<L: Lanes>(self, list: *const f32) -> L::V {
        // SAFETY: the caller's list has a number for each node.
        unsafe {
            let from = list.add(self.at);
            if self.count >= WIDE { L::load(from) } else { L::load_first(from, self.count) }
        }
    }

    /// Writes its numbers into a list.
    #[inline(always)]
    pub(super) unsafe fn put<L: Lanes>(self, list: *mut f32, v: L::V) {
        // SAFETY: the caller's list has room for a number for each node.
        unsafe {
            let to = list.add(self.at);
            if self.count >= WIDE { L::store(to, v) } else { L::store_first(to, self.count, v) }
        }
    }
}

/// Where everything lies, and the figures in all lanes: copied so that no write to an array can
/// seem to change them.
#[derive(Clone, Copy)]
struct Sweep<L: Lanes> {
    slots: usize,
    far: *const u32,
    rest: *const f32,
    stiffness: *const f32,
    damping: *const f32,
    limit: *const f32,
    pull: *mut f32,
    gather_start: *const u32,
    gathers: *const Gather,
    node: *mut f32,
    own: *mut f32,
    force: *mut f32,
    position: [*const f32; 3],
    velocity: [*const f32; 3],
    outer: [*const f32; 3],
    mobile: *const f32,
    force_un: [*mut f32; 3],
    acceleration: [*mut f32; 3],
    acceleration2: *mut f32,
    inverse_mass: L::V,
    fluid: L::V,
    tear2: L::V,
    tiny2: L::V,
}

impl<L: Lanes> Sweep<L> {
    #[inline(always)]
    unsafe fn new(tables: &mut Tables, forces: &mut Forces) -> Self {
        // SAFETY: the caller has the instructions.
        let splat = |x| unsafe { L::splat(x) };
        Sweep {
            slots: tables.slots,
            far: tables.far.as_ptr(),
            rest: tables.rest.as_ptr(),
            stiffness: tables.stiffness.as_ptr(),
            damping: tables.damping.as_ptr(),
            limit: tables.limit.as_ptr(),
            pull: tables.pull.as_mut_ptr(),
            gather_start: tables.gather_start.as_ptr(),
            gathers: tables.gathers.as_ptr(),
            node: tables.node.as_mut_ptr(),
            own: tables.own.as_mut_ptr(),
            force: tables.force.as_mut_ptr(),
            position: forces.position.map(<[f32]>::as_ptr),
            velocity: forces.velocity.map(<[f32]>::as_ptr),
            outer: forces.outer.map(<[f32]>::as_ptr),
            mobile: forces.mobile.as_ptr(),
            force_un: forces.force.each_mut().map(|list| list.as_mut_ptr()),
            acceleration: forces.acceleration.each_mut().map(|list| list.as_mut_ptr()),
            acceleration2: forces.acceleration2.as_mut_ptr(),
            inverse_mass: splat(forces.inverse_mass),
            fluid: splat(forces.fluid_per_s),
            tear2: splat(forces.tear2),
            tiny2: splat(forces.tiny2),
        }
    }
}

#[inline(always)]
unsafe fn node_parts<L: Lanes>(sweep: &Sweep<L>, span: Span) -> [L::V; 6] {
    let ([x, y, z], [u, v, w]) = (sweep.position, sweep.velocity);
    // SAFETY: the lists have a number for each node.
    unsafe {
        [
            span.part::<L>(x),
            span.part::<L>(y),
            span.part::<L>(z),
            span.part::<L>(u),
            span.part::<L>(v),
            span.part::<L>(w),
        ]
    }
}

/// f = k (l − l₀) + c u·Δv along u = d/l, with 1/l from [`super::rsqrt`] and l = l²·(1/l).
#[inline(always)]
unsafe fn pull<L: Lanes>(sweep: &Sweep<L>, span: Span, ring_at: usize) -> u16 {
    let mut over = 0;
    // SAFETY: `check` holds the lengths of the tables and every far end.
    unsafe {
        let [x, y, z, u, v, w] = node_parts(sweep, span);
        let mut sum = [L::splat(0.0); 3];
        for slot in 0..sweep.slots {
            let s = (span.block * sweep.slots + slot) * WIDE;
            let [bx, by, bz, bu, bv, bw] = L::neighbours(sweep.node, sweep.far.add(s));
            let (dx, dy, dz) = (L::sub(bx, x), L::sub(by, y), L::sub(bz, z));
            let (du, dv, dw) = (L::sub(bu, u), L::sub(bv, v), L::sub(bw, w));
            let length2 = L::add(L::add(L::mul(dx, dx), L::mul(dy, dy)), L::mul(dz, dz));
            let length2 = L::add(length2, sweep.tiny2);
            let inverse = L::rsqrt(length2);
            let length = L::mul(length2, inverse);
            let rate = L::add(L::add(L::mul(du, dx), L::mul(dv, dy)), L::mul(dw, dz));
            let rate = L::mul(rate, inverse);
            let stretch = L::sub(length, L::load(sweep.rest.add(s)));
            let elastic = L::mul(L::load(sweep.stiffness.add(s)), stretch);
            over |= L::above(elastic, L::load(sweep.limit.add(s)));
            L::store(sweep.pull.add(s), elastic);
            let f = L::mul(L::add(elastic, L::mul(L::load(sweep.damping.add(s)), rate)), inverse);
            let to = sweep.force.add((ring_at * sweep.slots + slot) * TRIPLE);
            let parts = [L::mul(f, dx), L::mul(f, dy), L::mul(f, dz)];
            store_triple::<L>(to, parts);
            sum = [L::add(sum[0], parts[0]), L::add(sum[1], parts[1]), L::add(sum[2], parts[2])];
        }
        store_triple::<L>(sweep.own.add(ring_at * TRIPLE), sum);
    }
    over
}

#[inline(always)]
unsafe fn store_triple<L: Lanes>(to: *mut f32, [x, y, z]: [L::V; 3]) {
    // SAFETY: the caller lends the room.
    unsafe {
        L::store(to, x);
        L::store(to.add(WIDE), y);
        L::store(to.add(2 * WIDE), z);
    }
}

/// a = (F/m − g v)·mobile, with F = own − incoming + outer. Returns lanes where all is finite, and
/// those beyond the limit of tearing.
#[inline(always)]
unsafe fn collect<L: Lanes>(sweep: &Sweep<L>, span: Span, ring_at: usize) -> (u16, u16) {
    // SAFETY: `check` holds the lengths of the tables and every pick.
    unsafe {
        let own = sweep.own.add(ring_at * TRIPLE);
        let mut sum = [L::load(own), L::load(own.add(WIDE)), L::load(own.add(2 * WIDE))];
        let last = *sweep.gather_start.add(span.block + 1) as usize;
        for at in *sweep.gather_start.add(span.block) as usize..last {
            let Gather { from, index } = &*sweep.gathers.add(at);
            let (index, [a, b]) = (L::index(index.as_ptr()), *from);
            let (a, b) = (sweep.force.add(a as usize), sweep.force.add(b as usize));
            for axis in 0..3 {
                sum[axis] = L::sub(sum[axis], L::gather(a.add(axis * WIDE), b.add(axis * WIDE), index));
            }
        }
        let mobile = span.part::<L>(sweep.mobile);
        let mut square = L::splat(0.0);
        for axis in 0..3 {
            let force = L::add(sum[axis], span.part::<L>(sweep.outer[axis]));
            span.put::<L>(sweep.force_un[axis], force);
            let drag = L::mul(sweep.fluid, span.part::<L>(sweep.velocity[axis]));
            let a = L::mul(L::sub(L::mul(force, sweep.inverse_mass), drag), mobile);
            span.put::<L>(sweep.acceleration[axis], a);
            square = L::add(square, L::mul(a, a));
        }
        span.put::<L>(sweep.acceleration2, square);
        (L::above(L::splat(f32::INFINITY), square), L::above(square, sweep.tear2))
    }
}
