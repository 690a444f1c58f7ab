//! The only light inside the eye: the light pipe's beam.

use crate::latch::Latched;
use crate::layout::FrameUniform;
use crate::tools::FIBRE_FACE_MM;
use glam::dcamera::rh::proj::directx::perspective;
use glam::dcamera::rh::view::look_at_mat4;
use glam::{DMat4, DVec3};
use protocol::dose::{BEAM_INNER_RAD, BEAM_OUTER_RAD};
use protocol::handles::Tool;
use protocol::limits::INSTRUMENTS;
use protocol::optics::Filter;

/// The shadow map reaches a little beyond the cone, rad.
pub const MAP_RAD: f64 = 0.86;
/// What lies nearer to the lamp casts no shadow, mm.
const NEAR_MM: f64 = 0.3;
/// Far end of the shadow map: across the eye, mm.
const FAR_MM: f64 = 26.0;
/// Irradiance at 1 mm, so that a retina 6 mm away is well exposed.
const STRENGTH: f32 = 46.0;
/// Xenon through a fibre: slightly warm white, linear.
const COLOUR: [f32; 3] = [1.0, 0.95, 0.86];
/// Light scattered back from the retina onto everything, linear.
const SCATTERED: [f32; 3] = [0.045, 0.032, 0.026];
/// Radius of the fibre's bright face, mm: half the outer radius of a 25 gauge pipe, as its mesh has
/// it. It makes shadows soft.
pub const FIBRE_RADIUS_MM: f64 = 0.125;
/// Stands in for the light pipe where there is none: a chandelier light at the pars plana,
/// position in the eye, mm.
const CHANDELIER_IN_EYE: DVec3 = DVec3::new(0.0, -7.5, 7.0);
/// Its strength: it is farther away.
const CHANDELIER_STRENGTH: f32 = 330.0;

/// A lamp in the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lamp {
    /// mm, eye frame.
    pub position: DVec3,
    /// Unit, eye frame.
    pub direction: DVec3,
    /// Keeps the map from turning needlessly.
    up: DVec3,
    /// Irradiance at 1 mm.
    strength: f32,
}

impl Lamp {
    /// The first light pipe, or a chandelier light where no instrument is one.
    pub fn find(tools: &[Option<Tool>; INSTRUMENTS], latched: &Latched) -> Self {
        let Some(which) = lamp_index(tools) else {
            let direction = (DVec3::new(0.0, 0.0, -11.5) - CHANDELIER_IN_EYE).normalize();
            return Self {
                position: CHANDELIER_IN_EYE,
                direction,
                up: DVec3::X,
                strength: CHANDELIER_STRENGTH,
            };
        };
        let m = latched.eye_from_instrument()[which];
        Self {
            position: m.transform_point3(DVec3::Z * f64::from(FIBRE_FACE_MM)),
            direction: -m.transform_vector3(DVec3::Z).normalize(),
            up: m.transform_vector3(DVec3::X).normalize(),
            strength: STRENGTH,
        }
    }

    /// Projection of the shadow map.
    pub fn lamp_from_eye(&self) -> DMat4 {
        let clip = perspective(2.0 * MAP_RAD, 1.0, NEAR_MM, FAR_MM);
        clip * look_at_mat4(self.position, self.position + self.direction, self.up)
    }

    /// Fills in the lamp's part of the uniform, its light seen through `filter`. What is scattered
    /// about passed the filter too.
    pub fn write(&self, uniform: &mut FrameUniform, filter: Filter) {
        let vec4 = |v: DVec3, w: f32| [v.x as f32, v.y as f32, v.z as f32, w];
        let (outer, inner) = (BEAM_OUTER_RAD.cos(), BEAM_INNER_RAD.cos());
        uniform.lamp_from_eye = self.lamp_from_eye().as_mat4().to_cols_array_2d();
        uniform.lamp_position = vec4(self.position, self.strength);
        uniform.lamp_direction = vec4(self.direction, outer as f32);
        let through = |light: [f32; 3]| std::array::from_fn(|i| light[i] * filter.passes()[i]);
        let [red, green, blue]: [f32; 3] = through(COLOUR);
        uniform.lamp_colour = [red, green, blue, (1.0 / (inner - outer)) as f32];
        uniform.ambient[..3].copy_from_slice(&through(SCATTERED));
    }
}

/// Half width of a shadow's soft edge, share of the map, for a difference of 1 between the depths
/// of surface and caster. The edge of a caster at the distance c hides the lamp's disc over a half
/// width of r (d − c) / c on a surface at the distance d; the map is 2 d tan(half angle) wide
/// there. Depth is (1 − near / d) far / (far − near), so 1/c − 1/d is the difference of depths by
/// near far / (far − near).
pub fn soft_edge_per_depth() -> f64 {
    FIBRE_RADIUS_MM / (2.0 * MAP_RAD.tan()) * (FAR_MM - NEAR_MM) / (NEAR_MM * FAR_MM)
}

/// Which instrument is the lamp.
pub fn lamp_index(tools: &[Option<Tool>; INSTRUMENTS]) -> Option<usize> {
    tools.iter().position(|&t| t == Some(Tool::LightPipe))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latch::matrix;
    use protocol::geometry::Pose;
    use protocol::time::Instants;

    fn latched(tip: [f64; 3]) -> Latched {
        let pose = Pose { position_mm: tip, ..Pose::IDENTITY };
        Latched {
            field: 0,
            instants: bytemuck::Zeroable::zeroed(),
            predicted_to: 0,
            world_from_eye: DMat4::IDENTITY,
            world_from_instrument: [DMat4::IDENTITY, matrix(&pose)],
            tracked: [true; 2],
            eye_tracked: true,
        }
    }

    #[test]
    fn beam_leaves_the_tip_away_from_the_handle() {
        let _: Instants = latched([0.0; 3]).instants;
        let lamp = Lamp::find(&[Some(Tool::Forceps), Some(Tool::LightPipe)], &latched([1.0, 2.0, -5.0]));
        assert!((lamp.position - DVec3::new(1.0, 2.0, -5.0)).length() < 0.05);
        assert_eq!(lamp.direction, DVec3::NEG_Z);
        let p = lamp.lamp_from_eye().project_point3(DVec3::new(1.0, 2.0, -11.5));
        assert!(p.truncate().length() < 1e-9 && (0.0..1.0).contains(&p.z), "{p}");
        let rim = DVec3::new(1.0 + 6.5 * BEAM_OUTER_RAD.tan(), 2.0, -11.5);
        assert!(lamp.lamp_from_eye().project_point3(rim).x.abs() < 1.0, "the cone fits the map");
    }

    #[test]
    fn soft_edges_are_those_of_similar_triangles() {
        let lamp = Lamp::find(&[None, Some(Tool::LightPipe)], &latched([0.0, 0.0, -5.0]));
        let depth = |d: f64| lamp.lamp_from_eye().project_point3(lamp.position + lamp.direction * d).z;
        for (caster, surface) in [(5.5, 6.0), (3.0, 6.0), (1.6, 9.0)] {
            let half_mm = FIBRE_RADIUS_MM * (surface - caster) / caster;
            let share = half_mm / (2.0 * surface * MAP_RAD.tan());
            let found = soft_edge_per_depth() * (depth(surface) - depth(caster));
            assert!((found / share - 1.0).abs() < 1e-9, "{caster}, {surface}: {found}, expected {share}");
        }
    }

    #[test]
    fn a_filter_takes_its_colours_from_all_light() {
        let lamp = Lamp::find(&[None, Some(Tool::LightPipe)], &latched([0.0, 0.0, -5.0]));
        let written = |filter| {
            let mut uniform: FrameUniform = bytemuck::Zeroable::zeroed();
            lamp.write(&mut uniform, filter);
            (uniform.lamp_colour, uniform.ambient)
        };
        let ((clear, scattered), (amber, dim)) = (written(Filter::Clear), written(Filter::Amber));
        assert_eq!((clear[..3].to_vec(), clear[3]), (COLOUR.to_vec(), amber[3]));
        for i in 0..3 {
            let share = Filter::Amber.passes()[i];
            assert!(
                (amber[i] - clear[i] * share).abs() < 1e-6 && (dim[i] - scattered[i] * share).abs() < 1e-6
            );
        }
        assert!(amber[2] < 0.1 * clear[2], "little blue is left");
    }

    #[test]
    fn without_a_light_pipe_a_chandelier_shines_at_the_pole() {
        let lamp = Lamp::find(&[None, Some(Tool::Forceps)], &latched([0.0; 3]));
        let pole = lamp.position + lamp.direction * lamp.position.distance(DVec3::new(0.0, 0.0, -11.5));
        assert!((pole - DVec3::new(0.0, 0.0, -11.5)).length() < 1e-9);
    }
}
