//! What a vitrector's port does to a sheet, membrane or retina: it draws what its camera sees, and
//! takes what is in it.

use super::mesh::SheetMesh;
use super::state::SheetState;
use super::tearing;
use crate::vitrector::Port;
use collision::suction::{PortCamera, SuctionCone};
use collision::surface::{CollisionError, Surface};
use nalgebra::Isometry3;
use scene::VitrectorScene;

/// What suction and cutting of a sheet need beside its state.
#[derive(Debug)]
pub struct SheetCutter {
    camera: PortCamera,
    view: SuctionCone,
    /// Area of each triangle at rest, µm², rounded.
    rest_um2: Vec<u32>,
    /// Area at rest of the triangles seen around each node, thirds added up, mm²; all 0 between two
    /// looks.
    share_mm2: Vec<f64>,
    nodes: Vec<u32>,
    /// Triangles in the port.
    caught: Vec<u32>,
}

impl SheetCutter {
    /// For a sheet.
    ///
    /// # Errors
    /// If the camera cannot draw the mesh.
    pub fn new(vitrector: &VitrectorScene, mesh: &SheetMesh) -> Result<Self, CollisionError> {
        let start = mesh.start();
        let area_um2 = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|n| start.position(n as usize).map(f64::from));
            (0.5e6 * (b - a).cross(&(c - a)).norm() + 0.5) as u32
        };
        Ok(SheetCutter {
            camera: PortCamera::new(vitrector.resolution as usize, &mesh.triangles, mesh.nodes())?,
            view: SuctionCone {
                tan_half_angle: libm::tan(vitrector.cone_half_angle_rad),
                reach_mm: vitrector.cone_reach_mm,
            },
            rest_um2: mesh.triangles.iter().map(area_um2).collect(),
            share_mm2: vec![0.0; mesh.nodes()],
            nodes: Vec::with_capacity(mesh.nodes()),
            caught: Vec::with_capacity(mesh.triangles.len()),
        })
    }

    /// Distance from a port's apex beyond which it sees nothing, mm.
    pub fn reach_mm(&self) -> f64 {
        let wide = libm::sqrt(1.0 + self.view.tan_half_angle * self.view.tan_half_angle);
        self.view.reach_mm * wide
    }

    /// Draws the image of the port of an instrument; `false` where it sees nothing.
    pub fn render(&mut self, eye_from_instrument: &Isometry3<f64>, surface: &Surface) -> bool {
        self.camera.render(&eye_from_instrument.inverse(), &self.view, surface).pixels > 0
    }

    /// Triangles that the last image saw.
    pub fn seen(&self) -> &[u32] {
        self.camera.triangles()
    }

    /// Adds to `outer_un` what an open port draws of its last image: on each node the pressure at
    /// its distance on its share of the area.
    pub fn suck(&mut self, port: &Port, mesh: &SheetMesh, state: &SheetState, outer_un: &mut [Vec<f32>; 3]) {
        for &t in self.camera.triangles() {
            let third = f64::from(self.rest_um2[t as usize]) * (1e-6 / 3.0);
            for &node in &mesh.triangles[t as usize] {
                let share = &mut self.share_mm2[node as usize];
                if *share == 0.0 {
                    self.nodes.push(node);
                }
                *share += third;
            }
        }
        for node in self.nodes.drain(..) {
            let n = node as usize;
            let way = port.cone.apex_in_eye_mm - state.position(n).map(f64::from);
            let pull = port.pull_un(&way, self.share_mm2[n]).map(|f| f as f32);
            self.share_mm2[n] = 0.0;
            for (axis, force) in outer_un.iter_mut().enumerate() {
                force[n] += pull[axis];
            }
        }
    }

    /// The blade takes every triangle that its port saw within itself, and every one seen that has
    /// a corner there. Returns the area that went, µm².
    pub fn cut(&mut self, port: &Port, mesh: &SheetMesh, state: &mut SheetState) -> u64 {
        self.catch(port, mesh, state);
        let before = state.removed.area_um2;
        for t in self.caught.drain(..).map(|t| t as usize) {
            if state.triangle_alive[t] != 0 {
                tearing::remove_triangle(mesh, state, t);
                state.removed.area_um2 += u64::from(self.rest_um2[t]);
                state.removed.triangles += 1;
            }
        }
        let cut_um2 = state.removed.area_um2 - before;
        state.removed.cuts += u64::from(cut_um2 > 0);
        cut_um2
    }

    fn catch(&mut self, port: &Port, mesh: &SheetMesh, state: &SheetState) {
        self.caught.clear();
        for spot in self.camera.pixels_seen() {
            let [along, aside] = self.camera.place_mm(&spot, &self.view);
            if along <= port.depth_mm && aside <= port.radius_mm {
                self.caught.push(spot.triangle);
            }
        }
        let at = |n: u32| state.position(n as usize).map(f64::from);
        for &t in self.camera.triangles() {
            if mesh.triangles[t as usize].iter().any(|&n| port.holds(&at(n))) {
                self.caught.push(t);
            }
        }
        self.caught.sort_unstable();
        self.caught.dedup();
    }
}
