//! Where the elements are at rest, which neighbours they have and how far each link may give:
//! everything about the vitreous that a scene fixes and a step never changes.
//!
//! The lattice is regular, axis-parallel in the eye frame and clipped to the eye's ball and to the
//! lens. All lengths are whole µm. Elements are numbered row by row along x; [`PAD`] unused numbers
//! on both sides let a loop over a row look at all six neighbours without testing for the ends.

use scene::{GelScene, SceneFile, Side, VitreousScene, ZoneScene};

/// Unused numbers before the first and after the last element; a row is never longer.
pub const PAD: usize = 96;
/// Elements of a row that are computed together: a number that the compiler knows and that divides
/// [`PAD`], so that a row's last ones may reach beyond it.
pub const TOGETHER: usize = 32;
/// Links of an element: −x, +x, −y, +y, −z, +z.
pub const LINKS: usize = 6;
/// Kinds of a link's limits, indices of [`Lattice::limit`].
pub const COMPRESS: usize = 0;
/// See [`COMPRESS`].
pub const STRETCH: usize = 1;
/// See [`COMPRESS`].
pub const SHEAR: usize = 2;
/// Angle between fovea and optic disc at the eye's centre, rad: 4.5 mm on a retina of 11.5 mm.
const DISC_RAD: f64 = 0.39;

/// A row of elements along x.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// First element.
    pub start: u32,
    /// Its place along x, in cells.
    pub x0: u16,
    /// Elements.
    pub len: u16,
    /// Place along y and z, in cells.
    pub yz: [u16; 2],
    /// From an element to its neighbours, where it has them.
    pub steps: [i32; LINKS],
    /// Rows beside it at −y, +y, −z and +z; itself where there is none.
    pub beside: [u16; 4],
}

/// The numbers of a list over elements from `at` on.
#[inline(always)]
pub fn block<T>(list: &[T], at: usize) -> &[T; TOGETHER] {
    list[at..].first_chunk().expect("the lattice's padding is longer")
}

/// How an element at the wall holds to the retina.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// Element.
    pub element: u32,
    /// Stress at which it lets go, Pa; infinite at the base.
    pub release_pa: f32,
    /// It belongs to the vitreous base.
    pub base: bool,
    /// It is detached from the start.
    pub detached: bool,
}

/// Square of a place's distance from the eye's centre.
fn square(place: [i32; 3]) -> i64 {
    place.iter().map(|&c| i64::from(c).pow(2)).sum()
}

/// The lattice at rest.
#[derive(Debug, Clone, Default)]
pub struct Lattice {
    /// Cells along an axis.
    pub cells: usize,
    /// Distance of neighbours at rest, µm; even.
    pub pitch_um: i32,
    /// Inner radius of the retina, µm.
    pub radius_um: i32,
    /// Back of the lens, µm.
    pub front_um: i32,
    /// Rows, by z and then y.
    pub rows: Vec<Row>,
    /// Row of an element.
    pub row_of: Vec<u16>,
    /// One bit per neighbour that exists.
    pub links: Vec<u8>,
    /// How far an element may go from its rest place, in whatever direction, and be inside the eye
    /// and behind the lens for sure, µm.
    pub room_um: Vec<u16>,
    /// Density that is drawn.
    pub density: Vec<u8>,
    /// Shear modulus, Pa.
    pub modulus_pa: Vec<f32>,
    /// How far the link from an element to its neighbour on the plus side may give, µm, by axis and
    /// kind.
    pub limit: [[Vec<u16>; 3]; 3],
    /// Elements that touch the retina, in order.
    pub walls: Vec<Wall>,
}

impl Lattice {
    /// The lattice of a scene's vitreous.
    pub fn new(scene: &SceneFile, vitreous: &VitreousScene) -> Self {
        let cells = vitreous.lattice as usize;
        let radius_um = (scene.eye.retina_radius_mm * 1e3) as i32;
        let pitch_um = 2 * ((radius_um + cells as i32 - 1) / cells as i32);
        let mut lattice = Lattice {
            cells,
            pitch_um,
            radius_um,
            front_um: (vitreous.front_mm * 1e3) as i32,
            ..Lattice::default()
        };
        lattice.add_rows();
        lattice.add_links();
        lattice.add_room();
        lattice.add_gel(vitreous);
        lattice.add_walls(scene, vitreous);
        lattice
    }

    /// Length of an array over elements, the unused numbers included.
    pub fn len(&self) -> usize {
        self.row_of.len()
    }

    /// True if there is no element.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Elements there are.
    pub fn elements(&self) -> usize {
        self.len() - 2 * PAD
    }

    /// Numbers of the elements.
    pub fn numbers(&self) -> std::ops::Range<usize> {
        PAD..self.len() - PAD
    }

    /// Volume of an element, µm³.
    pub fn cell_um3(&self) -> u64 {
        (self.pitch_um as u64).pow(3)
    }

    /// Place of cell `index` along an axis, µm.
    fn at(&self, index: i32) -> i32 {
        (2 * index + 1 - self.cells as i32) * (self.pitch_um / 2)
    }

    /// Place of an element in the lattice, cells.
    pub fn cell(&self, element: usize) -> [i32; 3] {
        let row = &self.rows[self.row_of[element] as usize];
        let x = i32::from(row.x0) + element as i32 - row.start as i32;
        [x, i32::from(row.yz[0]), i32::from(row.yz[1])]
    }

    /// Rest place of an element, eye frame, µm.
    pub fn rest_um(&self, element: usize) -> [i32; 3] {
        self.cell(element).map(|c| self.at(c))
    }

    /// The element of a cell, if there is one.
    pub fn element(&self, cell: [i32; 3]) -> Option<usize> {
        let row = self.rows.iter().find(|r| r.yz.map(i32::from) == [cell[1], cell[2]])?;
        let x = cell[0] - i32::from(row.x0);
        (0..i32::from(row.len)).contains(&x).then(|| row.start as usize + x as usize)
    }

    /// True if an element that is so far from its rest place, µm, is inside the eye and behind the
    /// lens by far: no need to compute where it is.
    pub fn has_room(&self, element: usize, shift_um: [i32; 3]) -> bool {
        shift_um.iter().map(|c| c.abs()).sum::<i32>() <= i32::from(self.room_um[element])
    }

    /// The neighbour of an element over link `k`; only where the link exists.
    pub fn neighbour(&self, element: usize, k: usize) -> usize {
        (element as i32 + self.rows[self.row_of[element] as usize].steps[k]) as usize
    }

    /// True if a place is inside the eye and behind the lens.
    pub fn is_inside(&self, at_um: [i32; 3]) -> bool {
        square(at_um) <= i64::from(self.radius_um).pow(2) && at_um[2] <= self.front_um
    }

    fn add_rows(&mut self) {
        let n = self.cells as i32;
        self.row_of = vec![0; PAD];
        for (z, y) in (0..n).flat_map(|z| (0..n).map(move |y| (z, y))) {
            let inside = |x: &i32| self.is_inside([self.at(*x), self.at(y), self.at(z)]);
            let Some(first) = (0..n).find(inside) else { continue };
            let len = (first..n).take_while(inside).count();
            let number = self.rows.len() as u16;
            self.rows.push(Row {
                start: self.row_of.len() as u32,
                x0: first as u16,
                len: len as u16,
                yz: [y as u16, z as u16],
                steps: [-1, 1, 0, 0, 0, 0],
                beside: [number; 4],
            });
            self.row_of.extend(std::iter::repeat_n(number, len));
        }
        self.row_of.extend([0; PAD]);
    }

    fn add_links(&mut self) {
        let n = self.cells;
        let mut number_of = vec![None; n * n];
        for (i, row) in self.rows.iter().enumerate() {
            number_of[row.yz[0] as usize + n * row.yz[1] as usize] = Some(i);
        }
        self.links = vec![0; self.len()];
        for i in 0..self.rows.len() {
            let row = self.rows[i];
            let [y, z] = row.yz.map(i32::from);
            for (k, (dy, dz)) in [(0, 0), (0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)].into_iter().enumerate() {
                let (y, z) = (y + dy, z + dz);
                let exists = [y, z].iter().all(|c| (0..n as i32).contains(c));
                let other = if exists { number_of[y as usize + n * z as usize] } else { None };
                let Some(other_row) = other else { continue };
                let other = self.rows[other_row];
                if k >= 2 {
                    self.rows[i].beside[k - 2] = other_row as u16;
                    let shift = i32::from(row.x0) - i32::from(other.x0);
                    self.rows[i].steps[k] = other.start as i32 - row.start as i32 + shift;
                }
                for e in 0..i32::from(row.len) {
                    let x = i32::from(row.x0) + e + [-1, 1, 0, 0, 0, 0][k];
                    let linked = (0..i32::from(other.len)).contains(&(x - i32::from(other.x0)));
                    self.links[(row.start as i32 + e) as usize] |= u8::from(linked) << k;
                }
            }
        }
    }

    fn add_room(&mut self) {
        self.room_um = vec![0; self.len()];
        for e in self.numbers() {
            let rest = self.rest_um(e);
            let to_wall = self.radius_um - square(rest).isqrt() as i32 - 1;
            self.room_um[e] = to_wall.min(self.front_um - rest[2]).clamp(0, u16::MAX.into()) as u16;
        }
    }

    /// The gel of each element; a link has the mean of the limits of its two elements (Schill et
    /// al. 1998 give limits to elements, not to links).
    fn add_gel(&mut self, vitreous: &VitreousScene) {
        self.density = vec![0; self.len()];
        self.modulus_pa = vec![0.0; self.len()];
        let mut half: [[Vec<u16>; 3]; 3] = Default::default();
        half.iter_mut().flatten().for_each(|h| *h = vec![0; self.len()]);
        self.limit = half.clone();
        for e in self.numbers() {
            let gel = self.gel_at(e, vitreous);
            (self.density[e], self.modulus_pa[e]) = (gel.density as u8, gel.modulus_pa as f32);
            for (axis, half) in half.iter_mut().enumerate() {
                let shares = [gel.compress[axis], gel.stretch[axis], gel.shear[axis]];
                for (half, share) in half.iter_mut().zip(shares) {
                    half[e] = (0.5 * share * f64::from(self.pitch_um)) as u16;
                }
            }
        }
        for e in self.numbers() {
            for (axis, (limit, half)) in self.limit.iter_mut().zip(&half).enumerate() {
                if self.links[e] & (2 << (2 * axis)) == 0 {
                    continue;
                }
                let row = &self.rows[self.row_of[e] as usize];
                let other = (e as i32 + row.steps[2 * axis + 1]) as usize;
                for kind in 0..3 {
                    // At least one µm, so that what relaxes always has room to move.
                    limit[kind][e] = (half[kind][e] + half[kind][other]).max(1);
                }
            }
        }
    }

    fn gel_at<'a>(&self, e: usize, vitreous: &'a VitreousScene) -> &'a GelScene {
        let at = self.rest_um(e).map(|c| f64::from(c) * 1e-3);
        let radius = f64::from(self.radius_um) * 1e-3;
        let norm = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        let holds = |zone: &&ZoneScene| {
            let c = zone.centre_in_eye_mm;
            let apart = norm([at[0] - c[0], at[1] - c[1], at[2] - c[2]]);
            let shell = zone.shell_mm > 0.0 && norm(at) >= radius - zone.shell_mm;
            at[2] >= zone.from_z_mm && (shell || (zone.radius_mm > 0.0 && apart <= zone.radius_mm))
        };
        vitreous.zones.iter().rev().find(holds).map_or(&vitreous.gel, |zone| &zone.gel)
    }

    /// Elements with a neighbour missing because the retina is there.
    fn add_walls(&mut self, scene: &SceneFile, vitreous: &VitreousScene) {
        let adhesion = &vitreous.adhesion;
        let nasal = if scene.eye.side == Side::Right { 1.0 } else { -1.0 };
        let disc = [nasal * libm::sin(DISC_RAD), 0.0, -libm::cos(DISC_RAD)];
        let within = |at: [f64; 3], towards: [f64; 3], angle: f64| {
            let dot: f64 = at.iter().zip(towards).map(|(a, t)| a * t).sum();
            let norm = at.iter().map(|c| c * c).sum::<f64>().sqrt();
            angle > 0.0 && dot >= norm * libm::cos(angle)
        };
        let at_retina = |e: &usize| {
            let at = self.rest_um(*e);
            (0..LINKS).any(|k| {
                let mut beyond = at;
                beyond[k / 2] += if k % 2 == 0 { -self.pitch_um } else { self.pitch_um };
                self.links[*e] >> k & 1 == 0 && square(beyond) > i64::from(self.radius_um).pow(2)
            })
        };
        let wall = |e: usize| {
            let at = self.rest_um(e).map(|c| f64::from(c) * 1e-3);
            let base = at[2] >= adhesion.base_from_z_mm;
            let pole = [0.0, 0.0, -1.0];
            let strong = within(at, disc, adhesion.strong_rad) || within(at, pole, adhesion.strong_rad);
            let release = if strong { adhesion.strong_release_pa } else { adhesion.release_pa };
            let release_pa = if base { f32::INFINITY } else { release as f32 };
            let detached = !base && within(at, pole, adhesion.detached_rad);
            Wall { element: e as u32, release_pa, base, detached }
        };
        self.walls = self.numbers().filter(at_retina).map(wall).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::lattice;
    use super::*;

    #[test]
    fn links_are_mutual_and_lead_to_the_next_cell() {
        for cells in [8, 13, 32] {
            let lattice = lattice(cells);
            for e in lattice.numbers() {
                for k in (0..LINKS).filter(|k| lattice.links[e] >> k & 1 == 1) {
                    let other = lattice.neighbour(e, k);
                    assert_eq!(lattice.links[other] >> (k ^ 1) & 1, 1);
                    assert_eq!(lattice.neighbour(other, k ^ 1), e);
                    let mut cell = lattice.cell(e);
                    cell[k / 2] += if k % 2 == 0 { -1 } else { 1 };
                    assert_eq!((lattice.cell(other), lattice.element(cell)), (cell, Some(other)));
                }
            }
        }
    }

    #[test]
    fn the_lattice_fills_the_eye_before_the_lens() {
        let lattice = lattice(64);
        let (r, front) = (11.5f64, f64::from(lattice.front_um) * 1e-3);
        // Ball less the cap beyond the lens.
        let height = r - front;
        let cap = std::f64::consts::PI * height * height * (3.0 * r - height) / 3.0;
        let volume = 4.0 / 3.0 * std::f64::consts::PI * r * r * r - cap;
        let found = lattice.elements() as f64 * lattice.cell_um3() as f64 * 1e-9;
        assert!((found / volume - 1.0).abs() < 0.01, "{found} mm³ of {volume}");
        assert_eq!(lattice.pitch_um, 360);
    }

    #[test]
    fn every_element_without_a_neighbour_is_at_the_wall_or_at_the_lens() {
        let lattice = lattice(24);
        for e in lattice.numbers().filter(|&e| lattice.links[e] != 63) {
            let at_wall = lattice.walls.iter().any(|w| w.element as usize == e);
            let at_lens = lattice.rest_um(e)[2] + lattice.pitch_um > lattice.front_um;
            assert!(at_wall || at_lens);
        }
        assert!(lattice.walls.iter().any(|w| w.base) && lattice.walls.iter().any(|w| !w.base));
    }

    #[test]
    fn who_has_room_is_inside() {
        let lattice = lattice(24);
        assert!(lattice.numbers().filter(|&e| lattice.room_um[e] > 2_000).count() > lattice.elements() / 2);
        for e in lattice.numbers() {
            let room = i32::from(lattice.room_um[e]);
            for way in
                [[room, 0, 0], [-room, 0, 0], [0, room, 0], [0, 0, room], [room / 2, 0, room - room / 2]]
            {
                assert!(
                    lattice.has_room(e, way) && !lattice.has_room(e, [way[0], way[1], way[2] + room + 1])
                );
                let rest = lattice.rest_um(e);
                assert!(lattice.is_inside(std::array::from_fn(|c| rest[c] + way[c])));
            }
        }
    }

    #[test]
    fn zones_have_their_own_gel() {
        let lattice = lattice(32);
        let (low, high) = (lattice.density[PAD..].iter(), lattice.density.iter().max().unwrap());
        assert!(low.filter(|&&d| d > 0).min().unwrap() < high);
        for e in lattice.numbers() {
            for axis in 0..3 {
                let [compress, _, shear] = lattice.limit[axis].each_ref().map(|l| i32::from(l[e]));
                assert!(lattice.pitch_um - compress > 2 * shear, "no cell can turn over");
            }
        }
    }
}
