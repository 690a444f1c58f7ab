//! What the cameras of a rig see: boards drawn ray by ray, markers and streams of the virtual rig; and rigs that are off.

use blob_stream::write_line;
use bytemuck::Zeroable;
use calibration::board::Target;
use calibration::charuco::CharucoBoard;
use calibration::observations::collect;
use calibration::printed::Printed;
use calibration::self_calibration::{fitted, spread};
use calibration::target_problem::{camera_pose, set_camera_pose};
use fpga_model::colours::convert::rgb_of_ycc;
use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use protocol::blobs::BlobField;
use protocol::fields::FieldPicture;
use protocol::poses::EYE;
use recording::{PixelsHead, PixelsWriter};
use rig::Rig;
use rig::camera::Camera;
use rig::sensor::Scan;
use scene::{DEFAULT_SCENE, SceneFile};
use std::fs::File;
use std::path::Path;
use surgeon::motion::MotionSource;
use virtual_rig::cameras::{Cameras, Path as How};

/// Points of the board in a row, its rows, and their distance, mm.
pub const BOARD: (i32, i32, f64) = (9, 6, 2.5);
/// Subsamples along a side of a pixel.
const SUB: usize = 2;

/// Directions through the subsamples of all pixels, in the camera's frame.
pub struct Painter {
    camera: Camera,
    rays: Vec<Vector3<f32>>,
}

impl Painter {
    pub fn new(camera: &Camera) -> Self {
        let [width, height] = camera.size_px.map(|n| n as usize);
        let at = |i: usize| (i as f64 + 0.5) / SUB as f64 - 0.5;
        let mut rays = Vec::with_capacity(width * height * SUB * SUB);
        for (v, u) in (0..height * SUB).flat_map(|v| (0..width * SUB).map(move |u| (v, u))) {
            let n = camera.normalised_from_pixel(Vector2::new(at(u), at(v))).unwrap();
            rays.push(Vector3::new(n.x as f32, n.y as f32, 1.0));
        }
        Painter { camera: camera.clone(), rays }
    }

    /// The board at `world_from_board`, its middle at the origin of its frame; `print` gives the grey level at a place on
    /// it, mm from its middle.
    pub fn board(&self, world_from_board: &Isometry3<f64>, print: &Print<'_>) -> GrayImage {
        let [width, height] = self.camera.size_px;
        let turn = self.camera.camera_from_world * world_from_board.rotation.to_rotation_matrix().matrix();
        let origin = self.camera.in_camera(&world_from_board.translation.vector.into());
        // Of the board's plane, in the camera: a point on the ray at depth d is d·ray.
        let normal: Vector3<f64> = turn.column(2).into();
        let off = normal.dot(&origin);
        let shade = |ray: &Vector3<f32>| {
            let ray = ray.cast::<f64>();
            let p = turn.transpose() * (ray * (off / normal.dot(&ray)) - origin);
            print(p.x, p.y)
        };
        let stride = width as usize * SUB;
        GrayImage::from_fn(width, height, |x, y| {
            let at = |k: usize| (y as usize * SUB + k / SUB) * stride + x as usize * SUB + k % SUB;
            let sum: f64 = (0..SUB * SUB).map(|k| shade(&self.rays[at(k)])).sum();
            let grain = f64::from((x * 7919 + y * 104_729 + x * y) % 7) - 3.0;
            Luma([(sum / (SUB * SUB) as f64 + grain).round().clamp(0.0, 255.0) as u8])
        })
    }
}

/// Grey level at a place on a board, mm from its middle.
pub type Print<'a> = dyn Fn(f64, f64) -> f64 + 'a;

/// The chessboard [`BOARD`].
pub fn chessboard(x: f64, y: f64) -> f64 {
    let (columns, rows, pitch) = BOARD;
    let cell = |v: f64, n: i32| (v / pitch + f64::from(n + 1) / 2.0).floor() as i32;
    let (i, j) = (cell(x, columns), cell(y, rows));
    match (0..=columns).contains(&i) && (0..=rows).contains(&j) {
        true if (i + j) % 2 == 0 => 45.0,
        true => 205.0,
        false if (-1..=columns + 1).contains(&i) && (-1..=rows + 1).contains(&j) => 205.0,
        false => 110.0,
    }
}

/// A ChArUco board as `vitreo calibrate board` prints it.
pub struct CharucoPrint {
    paper: GrayImage,
    paper_mm: [f64; 2],
    /// Without the margin, mm.
    pub size_mm: [f64; 2],
}

impl CharucoPrint {
    /// Of a board as `--charuco` describes it.
    pub fn new(board: &str) -> Self {
        let printed = Printed::new(&Target::Charuco(CharucoBoard::parse(board).unwrap()), 3.0);
        let paper = image::load_from_memory(&printed.png(1200.0).unwrap()).unwrap().into_luma8();
        CharucoPrint { paper, paper_mm: printed.paper_mm(), size_mm: printed.size_mm }
    }

    /// Grey level at a place, mm from the middle.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let ([w, h], (width, height)) = (self.paper_mm, self.paper.dimensions());
        let [u, v] = [(x / w + 0.5) * f64::from(width), (y / h + 0.5) * f64::from(height)];
        let is_on = u >= 0.0 && v >= 0.0 && u < f64::from(width) && v < f64::from(height);
        if is_on {
            45.0 + f64::from(self.paper.get_pixel(u as u32, v as u32).0[0]) * 160.0 / 255.0
        } else {
            110.0
        }
    }
}

fn turn(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_euler_angles(x, y, z)
}

/// Pose `i` of a board before a camera: through its whole picture, tilted to all sides.
pub fn before(camera: &Camera, i: usize) -> Isometry3<f64> {
    let t = i as f64;
    let tilt = turn(0.5 * (1.9 * t).sin(), 0.5 * (2.6 * t).cos(), 0.25 * (0.8 * t).sin());
    let place = Vector3::new(
        3.6 * f64::from(i as i32 % 3 - 1),
        3.8 * f64::from(i as i32 / 3 % 3 - 1),
        78.0 + 5.0 * (1.3 * t).cos(),
    );
    let in_camera = Isometry3::from_parts(Translation3::from(place), tilt);
    let pose = Isometry3::from_parts(
        Translation3::from(camera.translation_mm),
        UnitQuaternion::from_matrix(&camera.camera_from_world),
    );
    pose.inverse() * in_camera
}

/// Pose `i` of a board where the eye will be, seen by all cameras.
pub fn together(i: usize) -> Isometry3<f64> {
    let t = i as f64;
    // The cameras are at −z: the board's z leads away from them.
    let tilt = turn(0.2 * (1.7 * t).sin(), 0.2 * (2.3 * t).cos(), 0.9 * t);
    let place = Vector3::new(3.0 * (1.1 * t).sin(), 2.5 * (1.9 * t).cos(), 2.0 * (0.7 * t).sin());
    Isometry3::from_parts(Translation3::from(place), tilt)
}

/// Writes pictures of a board into folders `cam0`, `cam1`, …
pub fn write_boards(
    cameras: &[Camera],
    folder: &Path,
    poses: &[(String, Vec<Isometry3<f64>>)],
    print: &Print<'_>,
) {
    for camera in cameras {
        let painter = Painter::new(camera);
        let own = folder.join(format!("cam{}", camera.id));
        std::fs::create_dir_all(&own).unwrap();
        for (view, poses) in poses {
            let pose = &poses[camera.id as usize % poses.len()];
            painter.board(pose, print).save(own.join(format!("{view}.png"))).unwrap();
        }
    }
}

/// A rig with camera poses that are off by up to so many mm and mrad, each in directions of its own.
pub fn displaced(rig: &Rig, mm: f64, mrad: f64) -> Rig {
    let mut rig = rig.clone();
    for (c, camera) in rig.cameras.iter_mut().enumerate() {
        let k = c as f64 + 1.0;
        let mut model = camera.model();
        let off = Isometry3::new(
            Vector3::new((1.7 * k).sin(), (2.9 * k).cos(), (0.6 * k).sin()) * mm,
            Vector3::new((2.3 * k).cos(), (1.9 * k).sin(), (0.4 * k).cos()) * mrad * 1e-3,
        );
        let pose = off * camera_pose(&model);
        set_camera_pose(&mut model, &pose);
        let r = model.camera_from_world;
        camera.rotation = std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)]));
        camera.t = model.translation_mm.into();
    }
    rig
}

/// The rig that a builder draws before anything is measured: lenses by 2 %, places by half a millimetre and some
/// milliradians, trocars by 0.3 mm.
pub fn drawn(truth: &Rig) -> Rig {
    let mut rig = displaced(truth, 0.5, 4.0);
    for camera in &mut rig.cameras {
        (camera.fx, camera.fy, camera.dist) = (1.02 * camera.fx, 0.98 * camera.fy, [0.0; 5]);
        (camera.cx, camera.cy) = (360.0, 288.0);
    }
    rig.trocars.iter_mut().for_each(|t| t.p_eye = t.p_eye.map(|v| v + 0.3));
    rig
}

/// By camera: how far its centre is off, mm, and how far it is turned, mrad, beside the truth.
pub fn places_off(rig: &Rig, truth: &Rig) -> Vec<[f64; 2]> {
    let off = |(a, b): (Camera, Camera)| {
        let beside = camera_pose(&a) * camera_pose(&b).inverse();
        [(a.centre_in_world() - b.centre_in_world()).norm(), 1e3 * beside.rotation.angle()]
    };
    rig.cameras().into_iter().zip(truth.cameras()).map(off).collect()
}

/// Root mean square error of the tips in the eye, of poses that are fitted with a rig, µm.
pub fn tips_um(rig: &Rig, seen: &Seen) -> f64 {
    let (instants, bundle) = fitted(rig, &spread(collect(rig, &seen.fields), 300)).unwrap();
    let (mut squares, mut n) = (0.0, 0);
    for (instant, poses) in instants.iter().zip(&bundle.poses) {
        let Some((_, tips)) = seen.tips.iter().find(|(t, _)| *t == instant.exposed_ns) else { continue };
        for (pose, tip) in poses.iter().zip(tips) {
            let Some((pose, eye)) = pose.as_ref().zip(poses[EYE].as_ref()) else { continue };
            let found = eye.inverse_transform_point(&pose.translation.vector.into());
            squares += (found - tip).norm_squared() * 1e6;
            n += 1;
        }
    }
    assert!(n > 100, "{n} tips only");
    (squares / f64::from(n)).sqrt()
}

/// Records what the cameras of a rig see of a surgeon, pixel by pixel.
pub fn record_pixels(path: &Path, rig: &Rig, seconds: f64) {
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, rig, None, 3);
    let mut cameras = Cameras::new(rig, How::Pixels, 3).unwrap();
    let head = PixelsHead {
        rig_json: rig.to_json(),
        cameras: rig.cameras.iter().map(|c| c.id).collect(),
        field_hz: rig.field_hz,
        realtime_offset_ns: 0,
        sources: Vec::new(),
    };
    let mut writer = PixelsWriter::on(File::create(path).unwrap(), path, &head).unwrap();
    for number in 1..(seconds * rig.field_hz) as u64 {
        for camera in 0..cameras.len() {
            let mut exposure = cameras.expose(camera, &mut surgeon, number);
            let header = exposure.header();
            let mut payload = vec![0; header.bytes()];
            exposure.paint(&mut payload);
            writer.write(&header, &payload).unwrap();
        }
    }
    writer.finish().unwrap();
}

/// Fields of the virtual rig's blobs, and the tips in the eye at their exposures.
pub struct Seen {
    pub fields: Vec<BlobField>,
    pub tips: Vec<(u64, [Point3<f64>; 2])>,
}

/// What the cameras of a rig see of a surgeon.
pub fn stream(rig: &Rig, seconds: f64) -> Seen {
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, rig, None, 3);
    let mut cameras = Cameras::new(rig, How::Direct, 3).unwrap();
    let mut seen = Seen { fields: Vec::new(), tips: Vec::new() };
    for number in 1..(seconds * rig.field_hz) as u64 {
        for camera in 0..cameras.len() {
            let mut field = BlobField::zeroed();
            cameras.expose(camera, &mut surgeon, number).blobs(&mut field);
            field.blobs_out_ns = field.read_out_ns;
            seen.fields.push(field);
        }
        let exposed_ns = seen.fields.last().unwrap().exposed_ns;
        let motion = surgeon.at(exposed_ns);
        let tip =
            |pose: &Isometry3<f64>| motion.world_from_eye.inverse() * Point3::from(pose.translation.vector);
        seen.tips.push((exposed_ns, [0, 1].map(|i| tip(&motion.world_from_instrument[i]))));
    }
    seen
}

/// Writes a stream as `blobs.jsonl`.
pub fn write_stream(fields: &[BlobField], file: &Path) {
    let text: String = fields.iter().map(|field| write_line(field) + "\n").collect();
    std::fs::write(file, text).unwrap();
}

/// Pictures of the markers, one a camera, as the virtual rig draws them; `changed` may change a pixel's Y, Cb, Cr.
pub fn write_markers(rig: &Rig, folder: &Path, number: u64, changed: impl Fn([u8; 3]) -> [u8; 3]) {
    let mut whole = rig.clone();
    (whole.scan, whole.line_ns) = (Scan::Progressive, 5_000);
    let scene = SceneFile::load(DEFAULT_SCENE).unwrap();
    let mut surgeon = MotionSource::new(&scene, &whole, None, 3);
    let mut cameras = Cameras::new(&whole, How::Pixels, 3).unwrap();
    for (i, camera) in whole.cameras.iter().enumerate() {
        let mut exposure = cameras.expose(i, &mut surgeon, number);
        let header = exposure.header();
        let mut payload = vec![0; header.bytes()];
        exposure.paint(&mut payload);
        let picture = FieldPicture::in_payload(&header, &payload).unwrap();
        let image = RgbImage::from_fn(camera.width, camera.height, |x, y| {
            if y >= header.lines {
                return Rgb(rgb_of_ycc([30, 128, 128]));
            }
            let (luma, blue, red) = picture.line(y as usize);
            let pair = x as usize / 2;
            Rgb(rgb_of_ycc(changed([luma[x as usize], blue[pair], red[pair]])))
        });
        image.save(folder.join(format!("cam{}-{number:04}.png", camera.id))).unwrap();
    }
}
