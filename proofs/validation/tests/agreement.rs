//! ZCOLL against exact rays on random scenes. The example `collision_agreement` does the same for
//! 10,000 and more.

use collision::instrument_image::InstrumentImage;
use collision::instrument_image::Volume;
use collision::surface::CollisionError;
use collision::surface::Surface;
use collision::zcoll::{Contacts, Zcoll};
use proptest::prelude::*;
use protocol::handles::Tool;
use protocol::random::Random;
use std::collections::{BTreeMap, BTreeSet};
use validation::rays::{Collisions, RADIUS_MM, Scene, collisions, collisions_back, truth};

/// Scenes of the quick test.
const SCENES: usize = 250;

struct Looked {
    found: Contacts,
    hits: Collisions,
    triangles: BTreeMap<usize, i32>,
    nodes: BTreeMap<usize, i32>,
    touches: bool,
}

fn look(scene: &Scene, simd: bool) -> Looked {
    let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
    image.prepare(scene.jaw_rad, &scene.volume);
    let mut zcoll = Zcoll::new(scene.volume, &scene.triangles, scene.position_mm[0].len()).unwrap();
    if !simd {
        zcoll = zcoll.without_simd();
    }
    let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
    let surface = Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive };
    let touches = zcoll.touches(&image, &scene.instrument_from_eye, &surface);
    let found = zcoll.query(&image, &scene.instrument_from_eye, &surface);
    Looked {
        found,
        hits: zcoll.hits().iter().map(|h| (h.pixel, (h.triangle, h.depth))).collect(),
        triangles: zcoll.triangles().collect(),
        nodes: zcoll.displaced().collect(),
        touches,
    }
}

/// Colliding pixels, their triangles and vectors to the bit; from them the triangles, and by Eq. 1
/// the nodes.
#[test]
fn collisions_are_those_of_exact_rays() {
    let mut random = Random::from_seed(1);
    let (mut colliding, mut pixels) = (0, 0);
    for number in 0..SCENES {
        let scene = Scene::random(&mut random, &[8, 16, 32, 32, 32, 64]);
        let expected = collisions(&scene);
        let looked = look(&scene, true);
        assert_eq!(looked.hits, expected, "scene {number}");
        assert_eq!(looked.found.pixels as usize, expected.len(), "scene {number}");
        assert_eq!(looked.touches, !expected.is_empty(), "scene {number}");
        let (mut triangles, mut nodes) = (BTreeMap::new(), BTreeMap::new());
        for &(t, way) in expected.values() {
            let deepest = triangles.entry(t as usize).or_insert(0);
            *deepest = way.max(*deepest);
        }
        for (t, way) in &triangles {
            for &node in &scene.triangles[*t] {
                let deepest = nodes.entry(node as usize).or_insert(0);
                *deepest = *way.max(deepest);
            }
        }
        assert_eq!((looked.triangles, looked.nodes), (triangles, nodes), "scene {number}");
        assert_eq!(looked.found.folded, 0, "scene {number} is π-convex");
        colliding += usize::from(looked.touches);
        pixels += expected.len();
    }
    assert!(colliding > SCENES / 2 && pixels > 20 * SCENES, "{colliding} scenes collide, {pixels} pixels");
}

/// The reversed camera of an instrument under the membrane, against rays of its own; and every
/// colliding vector leads from the membrane to the top of what lifts it.
#[test]
fn the_reversed_camera_sees_what_exact_rays_see() {
    let mut random = Random::from_seed(4);
    let (mut colliding, mut pixels) = (0, 0);
    for number in 0..SCENES {
        let mut scene = Scene::random(&mut random, &[8, 16, 32, 32, 32, 64]);
        scene.tool = if number % 3 == 0 { Tool::Forceps } else { Tool::Pick };
        let expected = collisions_back(&scene);
        let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
        image.prepare(scene.jaw_rad, &scene.volume);
        let nodes = scene.position_mm[0].len();
        let mut zcoll = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap();
        let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
        let surface = Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive };
        let look = |zcoll: &mut Zcoll| -> (Contacts, Collisions) {
            let found = zcoll.query_reversed(&image, &scene.instrument_from_eye, &surface);
            (found, zcoll.hits().iter().map(|h| (h.pixel, (h.triangle, h.depth))).collect())
        };
        let (found, hits) = look(&mut zcoll);
        assert_eq!(hits, expected, "scene {number}");
        assert_eq!((found.pixels as usize, found.folded), (expected.len(), 0), "scene {number}");
        let mut plain = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap().without_simd();
        assert_eq!(look(&mut plain), (found, hits), "scene {number}, base instruction set");
        colliding += usize::from(!expected.is_empty());
        pixels += expected.len();
    }
    assert!(colliding > SCENES / 3 && pixels > 5 * SCENES, "{colliding} scenes collide, {pixels} pixels");
}

#[test]
fn the_base_instruction_set_gives_the_same_bits() {
    let mut random = Random::from_seed(2);
    for _ in 0..60 {
        let scene = Scene::random(&mut random, &[32, 128, 256]);
        let (fast, plain) = (look(&scene, true), look(&scene, false));
        assert_eq!((fast.found, fast.hits, fast.nodes), (plain.found, plain.hits, plain.nodes));
    }
}

/// A vertex is reported if and only if the instrument is nearer in its pixel; compared with the
/// pixels of the images.
#[test]
fn vertices_are_reported_with_their_own_depth() {
    let mut random = Random::from_seed(3);
    let mut reported = 0;
    for _ in 0..90 {
        let scene = Scene::random(&mut random, &[16, 32, 64]);
        let mut image = InstrumentImage::new(scene.tool, RADIUS_MM, &scene.volume);
        image.prepare(scene.jaw_rad, &scene.volume);
        let nodes = scene.position_mm[0].len();
        let mut zcoll = Zcoll::new(scene.volume, &scene.triangles, nodes).unwrap();
        let position_mm = scene.position_mm.each_ref().map(Vec::as_slice);
        let surface = Surface { position_mm, triangles: &scene.triangles, alive: &scene.alive };
        zcoll.query(&image, &scene.instrument_from_eye, &surface);
        let found: BTreeMap<u32, i32> = zcoll.vertices(&image, &surface).iter().copied().collect();
        reported += found.len();
        let living: BTreeSet<u32> = (0..scene.triangles.len())
            .filter(|t| scene.alive[*t] != 0)
            .flat_map(|t| scene.triangles[t])
            .collect();
        let v = &scene.volume;
        for node in 0..nodes as u32 {
            let p = scene.instrument_from_eye
                * nalgebra::Point3::from(scene.position_mm.each_ref().map(|a| f64::from(a[node as usize])));
            let pixel = [p.x, p.y].map(|c| (c + v.half_mm) / (2.0 * v.half_mm) * v.resolution as f64);
            let z = (p.z - v.near_mm) / v.depth_mm * 65536.0;
            // Vertices within a step of a border may fall on either side of it.
            let sure = pixel.iter().all(|c| (c - c.round()).abs() > 0.01) && (0.0..65536.0).contains(&z);
            let inside = pixel.iter().all(|c| (0.0..v.resolution as f64).contains(c));
            if !sure || !inside {
                continue;
            }
            let z_i = image.depth[pixel[1] as usize * v.resolution + pixel[0] as usize];
            let way = z - f64::from(z_i);
            if living.contains(&node) && way > 3.0 {
                let reported = found.get(&node).copied();
                assert!(reported.is_some_and(|t| (f64::from(t) - way).abs() < 3.0), "{reported:?} {way}");
            } else if way < -3.0 || !living.contains(&node) {
                assert!(!found.contains_key(&node));
            }
        }
    }
    assert!(reported > 500, "the test must see something: {reported}");
}

fn check_against_rays(scene: &Scene) -> Result<(), TestCaseError> {
    let expected = truth(scene);
    for simd in [true, false] {
        let looked = look(scene, simd);
        prop_assert_eq!(&looked.hits, &expected.collisions);
        let Contacts { pixels, folded, refused, flat, .. } = looked.found;
        prop_assert_eq!(pixels as usize, expected.collisions.len());
        prop_assert_eq!([folded, refused, flat], [expected.folded, expected.refused, expected.flat]);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    /// Corners that are no numbers, infinite, too far away, on top of each other: what can be drawn
    /// is drawn as if the rest were not there, and the rest is counted, one by one.
    #[test]
    fn spoilt_corners_are_counted_and_the_rest_is_seen(seed in any::<u64>(), pose in 0usize..20) {
        let mut random = Random::from_seed(seed);
        let mut scene = Scene::random(&mut random, &[8, 16, 32]);
        scene.spoil(&mut random);
        if let Some(x) = [f64::NAN, f64::INFINITY, 1e300, 1e9].get(pose) {
            scene.instrument_from_eye.translation.vector.x = *x;
        }
        check_against_rays(&scene)?;
    }

    /// Triangles from one limit of the format to the other, to the bit: nothing overflows.
    #[test]
    fn extremes_of_the_format_are_exact(seed in any::<u64>(), resolution in prop::sample::select(vec![8usize, 32, 256])) {
        check_against_rays(&Scene::extreme(&mut Random::from_seed(seed), resolution))?;
    }

    /// A volume is refused if and only if it has no extent or its image no size, with the figures
    /// that it was given.
    #[test]
    fn volumes_without_extent_are_refused(
        half_mm in prop_oneof![Just(0.0), Just(f64::NAN), Just(f64::INFINITY), -1.0f64..1.0],
        depth_mm in prop_oneof![Just(0.0), Just(f64::NAN), Just(f64::INFINITY), -1.0f64..1.0],
        resolution in 0usize..300,
    ) {
        let volume = Volume { half_mm, near_mm: -depth_mm / 6.0, depth_mm, resolution };
        let extent = half_mm > 0.0 && depth_mm > 0.0 && half_mm.is_finite() && depth_mm.is_finite();
        match Zcoll::new(volume, &[[0, 1, 2]], 3) {
            Ok(_) => prop_assert!(extent && (8..=256).contains(&resolution)),
            Err(CollisionError::NoVolume { .. }) => prop_assert!(!extent),
            Err(refused) => {
                prop_assert_eq!(refused, CollisionError::Resolution { resolution });
                prop_assert!(extent && !(8..=256).contains(&resolution));
            }
        }
    }

    /// A mesh is refused if and only if it is empty or names a vertex that is not there; a look at
    /// any other does no harm.
    #[test]
    fn meshes_are_refused_by_what_is_wrong_with_them(
        triangles in prop::collection::vec(prop::array::uniform3(0u32..12), 0..40), nodes in 0usize..14,
    ) {
        let volume = Volume { half_mm: 0.75, near_mm: -0.25, depth_mm: 1.5, resolution: 8 };
        let stray = triangles.as_flattened().iter().position(|&v| v as usize >= nodes);
        match Zcoll::new(volume, &triangles, nodes) {
            Err(refused) if triangles.is_empty() => prop_assert_eq!(refused, CollisionError::Empty),
            Err(refused) => {
                let at = stray.unwrap();
                let vertex = triangles.as_flattened()[at];
                prop_assert_eq!(refused, CollisionError::NoSuchVertex { triangle: at / 3, vertex, vertices: nodes });
            }
            Ok(mut zcoll) => {
                prop_assert!(stray.is_none() && !triangles.is_empty());
                let mut image = InstrumentImage::new(Tool::Forceps, RADIUS_MM, &volume);
                image.prepare(0.2, &volume);
                // All vertices on one place: no triangle has an area.
                let (axis, alive) = (vec![0.1f32; nodes], vec![1; triangles.len()]);
                let surface = Surface { position_mm: [&axis; 3], triangles: &triangles, alive: &alive };
                let found = zcoll.query(&image, &nalgebra::Isometry3::identity(), &surface);
                prop_assert_eq!((found.pixels, found.flat as usize), (0, triangles.len()));
            }
        }
    }
}
