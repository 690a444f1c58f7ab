// The retina: the inside of a sphere, with one fetch of the fundus photograph. Drawn as the square
// cells that cover the round field, their corners cast onto the sphere; nothing outside the field
// is shaded.
//
// Full tiers cast every pixel's ray onto the sphere and light it there. Lean tiers light the
// corners: light and film are smooth, so a pixel costs two fetches, one of which has shadows and the
// beam's edge, the vignette and the tone curve.

struct Disc {
    @builtin(position) clip: vec4f,
    @location(0) field_xy: vec2f,
    @location(1) p: vec3f,
}

struct LeanDisc {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
    @location(1) mask: vec3f,
    // Irradiance and film in the middle of the beam, without shadow; field coordinates.
    @location(2) light: vec4f,
}

// As in cells.rs: corners of a row of cells.
const ROW: u32 = 32u;
// As in fundus.rs.
const SEGMENTS: u32 = 48u;
// The disc's depth lies so far behind the retina (mm) that tissue on it is seen, and a tip a little
// inside it as well.
const BEHIND: f32 = 0.1;

fn on_circle(segment: u32, radius: f32) -> vec2f {
    let angle = f32(segment) * (6.2831853 / f32(SEGMENTS));
    return radius * vec2f(cos(angle), sin(angle));
}

// Field coordinates of a corner of the cells, which begin at the top left.
fn corner(index: u32) -> vec2f {
    let steps = vec2f(f32(index % ROW), f32(index / ROW));
    return (vec2f(-1.0, 1.0) + steps * vec2f(view.plane_x.w, -view.plane_y.w)) * view.field.xy;
}

// Where the ray through `at` from the objective leaves the eye.
fn to_retina(at: vec3f) -> vec3f {
    return on_retina(at, normalize(at - view.camera.xyz));
}

fn corner_on_retina(field_xy: vec2f) -> vec3f {
    let ndc = field_xy / view.field.xy;
    return to_retina(view.plane_origin.xyz + ndc.x * view.plane_x.xyz + ndc.y * view.plane_y.xyz);
}

// `clip` with the depth at which `p` lies.
fn at_depth_of(p: vec3f, clip: vec4f) -> vec4f {
    let there = view.clip_from_eye * vec4f(p, 1.0);
    return vec4f(clip.xy, there.z / there.w * clip.w, clip.w);
}

fn behind(p: vec3f, field_xy: vec2f) -> vec4f {
    let w = (view.clip_from_eye * vec4f(p, 1.0)).w;
    return at_depth_of(p * (1.0 + BEHIND / frame.retina.x), vec4f(field_xy / view.field.xy * w, 0.0, w));
}

// Lambert's azimuthal equal-area map about the pole at -z: (x, y) sqrt(2 / (1 - z)).
fn map_coordinates(q: vec3f) -> vec2f {
    return vec2f(0.5) + q.xy * (inverseSqrt(max(0.5 - 0.5 * q.z, 1e-4)) * frame.retina.y);
}

// The inner limiting membrane reflects like a wet film.
fn film(q: vec3f, l: vec3f, ray: vec3f) -> f32 {
    return frame.retina.w * gloss(max(-dot(q, normalize(l - ray)), 0.0));
}

// Vessels stand out of the retina and carry a reflex, too faint to hide their colour.
fn wetness(photo: vec4f) -> f32 {
    return 0.4 + photo.g * photo.g + 0.25 * photo.a;
}

// Normal towards the inside of the eye, tilted by the slope of the map's fourth channel, the height
// of vessels.
fn relief(q: vec3f, uv: vec2f, height: f32) -> vec3f {
    let step = 1.0 / f32(textureDimensions(fundus_map).x);
    let right = textureSampleLevel(fundus_map, fundus_sampler, uv + vec2f(step, 0.0), 0.0).a;
    let up = textureSampleLevel(fundus_map, fundus_sampler, uv + vec2f(0.0, step), 0.0).a;
    return normalize(vec3f(height - right, height - up, 0.0) * frame.shadow.z - q);
}

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> Disc {
    let field_xy = corner(index);
    let p = corner_on_retina(field_xy);
    return Disc(behind(p, field_xy), field_xy, p);
}

@fragment
fn fs_main(in: Disc) -> @location(0) vec4f {
    let p = to_retina(in.p);
    let q = p / frame.retina.x;
    let uv = map_coordinates(q);
    let photo = textureSampleLevel(fundus_map, fundus_sampler, uv, 0.0);
    let albedo = photo.rgb * photo.rgb;
    let inwards = relief(q, uv, photo.a);
    let lamp = lamp_at(p);
    let at = lamp_coordinates(p);
    let membrane = 1.0 - frame.ambient.w * (1.0 - lit_softly(at.xy, at.z, 1.0));
    let strength = lit_past_instruments(at.xy, at.z) * membrane * lamp.strength;
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * (strength * max(dot(inwards, lamp.l), 0.0));
    let wet = strength * film(-inwards, lamp.l, normalize(p - view.camera.xyz)) * wetness(photo);
    return vec4f(to_display(albedo * light + vec3f(wet)) * vignette(in.field_xy), 1.0);
}

@vertex
fn vs_lean(@builtin(vertex_index) index: u32) -> LeanDisc {
    let field_xy = corner(index);
    let p = corner_on_retina(field_xy);
    let q = p / frame.retina.x;
    let lamp = lamp_everywhere(p);
    let wet = film(q, lamp.l, normalize(p - view.camera.xyz));
    let light = vec4f(lamp.strength * max(-dot(q, lamp.l), 0.0), lamp.strength * wet, field_xy);
    return LeanDisc(behind(p, field_xy), map_coordinates(q), mask_coordinates(p), light);
}

@fragment
fn fs_lean(in: LeanDisc) -> @location(0) vec4f {
    let photo = textureSampleLevel(fundus_map, fundus_sampler, in.uv, 0.0);
    let albedo = photo.rgb * photo.rgb;
    let mask = lean_mask(in.mask);
    let past = mask.r * mask.b;
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * (past * in.light.x);
    let wet = past * in.light.y * wetness(photo);
    return vec4f(to_display(albedo * light + vec3f(wet)) * vignette(in.light.zw), 1.0);
}

// The black round the field: nearest depth, so that nothing is shaded there.
@vertex
fn vs_frame(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let field_xy = on_circle(index % SEGMENTS, select(1.0, 2.0, index >= SEGMENTS));
    return vec4f(field_xy / view.field.xy, 0.0, 1.0);
}

// An amber ring just inside the border says that tracking is lost.
@vertex
fn vs_ring(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let field_xy = on_circle(index % SEGMENTS, select(0.945, 0.985, index >= SEGMENTS));
    return vec4f(field_xy / view.field.xy, 0.0, 1.0);
}

@fragment
fn fs_ring() -> @location(0) vec4f {
    return vec4f(1.0, 0.62, 0.05, 0.75);
}
