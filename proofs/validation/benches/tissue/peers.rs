//! Other ways to do a substep of the same springs, as textbooks and engines do it. All get the
//! nodes in our order, which spares them the cache misses of a shuffled mesh; `edge-loop-shuffled`
//! shows those.

use protocol::random::Random;
use tissue::sheet::mesh::SheetMesh;

const STIFFNESS: f32 = 400.0;
const DAMPING: f32 = 0.15;
const FLUID: f32 = 15.0;
const MASS: f32 = 0.01;
const DT: f32 = 1e-3;
const TEAR: f32 = 300.0;

/// A substep of a method.
pub trait Peer {
    fn name(&self) -> &'static str;
    fn step(&mut self);
    /// Sum of the positions, so that the work cannot be left out and paths can be compared.
    fn sum(&self) -> f64;
}

/// Nodes as arrays of vectors, springs as a list of ends.
#[derive(Clone)]
struct Particles {
    x: Vec<[f32; 3]>,
    v: Vec<[f32; 3]>,
    f: Vec<[f32; 3]>,
    free: Vec<f32>,
    ends: Vec<[u32; 2]>,
    rest: Vec<f32>,
    torn: usize,
}

impl Particles {
    fn new(sheet: &SheetMesh) -> Self {
        let state = sheet.start();
        let nodes = state.nodes();
        let mut free = vec![1.0; nodes];
        sheet.rim.iter().for_each(|&n| free[n as usize] = 0.0);
        Particles {
            x: (0..nodes).map(|i| state.position(i).into()).collect(),
            v: vec![[0.0; 3]; nodes],
            f: vec![[0.0; 3]; nodes],
            free,
            ends: sheet.springs[..sheet.structural].to_vec(),
            rest: sheet.rest_mm[..sheet.structural].to_vec(),
            torn: 0,
        }
    }

    fn force(&self, a: usize, b: usize, rest: f32) -> ([f32; 3], f32) {
        let (xa, xb, va, vb) = (self.x[a], self.x[b], self.v[a], self.v[b]);
        let d = [xb[0] - xa[0], xb[1] - xa[1], xb[2] - xa[2]];
        let u = [vb[0] - va[0], vb[1] - va[1], vb[2] - va[2]];
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let inverse = 1.0 / length;
        let rate = (u[0] * d[0] + u[1] * d[1] + u[2] * d[2]) * inverse;
        let pull = STIFFNESS * (length - rest);
        let f = (pull + DAMPING * rate) * inverse;
        ([f * d[0], f * d[1], f * d[2]], pull)
    }

    fn integrate(&mut self) {
        for i in 0..self.x.len() {
            for k in 0..3 {
                let a = self.f[i][k] / MASS - FLUID * self.v[i][k];
                self.v[i][k] += a * DT * self.free[i];
                self.x[i][k] += self.v[i][k] * DT;
            }
        }
    }

    fn sum(&self) -> f64 {
        self.x.iter().flatten().map(|&c| f64::from(c)).sum()
    }
}

/// The loop of every textbook: for each edge, add the force here and take it away there.
pub struct EdgeLoop(Particles, &'static str);

impl EdgeLoop {
    pub fn new(sheet: &SheetMesh) -> Self {
        EdgeLoop(Particles::new(sheet), "edge-loop")
    }

    /// The edges in random order.
    pub fn shuffled(sheet: &SheetMesh) -> Self {
        let mut particles = Particles::new(sheet);
        let mut random = Random::from_seed(5);
        for i in (1..particles.ends.len()).rev() {
            let j = random.below(i + 1);
            particles.ends.swap(i, j);
            particles.rest.swap(i, j);
        }
        EdgeLoop(particles, "edge-loop-shuffled")
    }
}

impl Peer for EdgeLoop {
    fn name(&self) -> &'static str {
        self.1
    }

    fn step(&mut self) {
        let p = &mut self.0;
        p.f.fill([0.0; 3]);
        for s in 0..p.ends.len() {
            let [a, b] = p.ends[s].map(|n| n as usize);
            let (f, pull) = p.force(a, b, p.rest[s]);
            p.torn += usize::from(pull > TEAR * p.rest[s]);
            for (k, part) in f.into_iter().enumerate() {
                p.f[a][k] += part;
                p.f[b][k] -= part;
            }
        }
        p.integrate();
    }

    fn sum(&self) -> f64 {
        self.0.sum()
    }
}

/// Each node adds up the forces of its springs; every spring is computed twice, nothing is
/// scattered.
pub struct Gather {
    particles: Particles,
    start: Vec<u32>,
    around: Vec<(u32, f32)>,
}

impl Gather {
    pub fn new(sheet: &SheetMesh) -> Self {
        let particles = Particles::new(sheet);
        let mut lists = vec![Vec::new(); particles.x.len()];
        for (&[a, b], &rest) in particles.ends.iter().zip(&particles.rest) {
            lists[a as usize].push((b, rest));
            lists[b as usize].push((a, rest));
        }
        let mut gather = Gather { particles, start: vec![0], around: Vec::new() };
        for list in lists {
            gather.around.extend(list);
            gather.start.push(gather.around.len() as u32);
        }
        gather
    }
}

impl Peer for Gather {
    fn name(&self) -> &'static str {
        "adjacency-gather"
    }

    fn step(&mut self) {
        for node in 0..self.particles.x.len() {
            let mut sum = [0.0; 3];
            for &(other, rest) in &self.around[self.start[node] as usize..self.start[node + 1] as usize] {
                let (f, pull) = self.particles.force(node, other as usize, rest);
                self.particles.torn += usize::from(pull > TEAR * rest);
                (0..3).for_each(|k| sum[k] += f[k]);
            }
            self.particles.f[node] = sum;
        }
        self.particles.integrate();
    }

    fn sum(&self) -> f64 {
        self.particles.sum()
    }
}

/// One iteration of extended position-based dynamics over the edges (Macklin, Müller, Chentanez
/// 2016).
pub struct Xpbd {
    particles: Particles,
    before: Vec<[f32; 3]>,
    lambda: Vec<f32>,
}

impl Xpbd {
    pub fn new(sheet: &SheetMesh) -> Self {
        let particles = Particles::new(sheet);
        Xpbd { before: particles.x.clone(), lambda: vec![0.0; particles.ends.len()], particles }
    }
}

impl Peer for Xpbd {
    fn name(&self) -> &'static str {
        "xpbd-edge-loop"
    }

    fn step(&mut self) {
        let p = &mut self.particles;
        for i in 0..p.x.len() {
            self.before[i] = p.x[i];
            (0..3).for_each(|k| p.x[i][k] += p.v[i][k] * DT * (1.0 - FLUID * DT) * p.free[i]);
        }
        self.lambda.fill(0.0);
        let compliance = 1.0 / (STIFFNESS * DT * DT);
        for s in 0..p.ends.len() {
            let [a, b] = p.ends[s].map(|n| n as usize);
            let (xa, xb) = (p.x[a], p.x[b]);
            let d = [xb[0] - xa[0], xb[1] - xa[1], xb[2] - xa[2]];
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            let (wa, wb) = (p.free[a] / MASS, p.free[b] / MASS);
            let change = -(length - p.rest[s] + compliance * self.lambda[s]) / (wa + wb + compliance);
            self.lambda[s] += change;
            p.torn += usize::from(STIFFNESS * (length - p.rest[s]) > TEAR * p.rest[s]);
            let share = change / length;
            for (k, d) in d.into_iter().enumerate() {
                p.x[a][k] -= wa * share * d;
                p.x[b][k] += wb * share * d;
            }
        }
        for i in 0..p.x.len() {
            (0..3).for_each(|k| p.v[i][k] = (p.x[i][k] - self.before[i][k]) / DT);
        }
    }

    fn sum(&self) -> f64 {
        self.particles.sum()
    }
}
