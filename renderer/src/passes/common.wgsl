// What every pass sees. Put before each shader's text. Everything is in the eye frame, mm.
// A test compares these structs with those of layout.rs.

struct Instrument {
    eye_from_instrument: mat4x4f,
    // half the jaw opening (rad), z of the jaws' pivot (mm), opacity, 1 if the lamp lights it
    shape: vec4f,
}

struct Frame {
    lamp_from_eye: mat4x4f,
    // position, then strength: irradiance at 1 mm
    lamp_position: vec4f,
    // direction of the beam, then cosine of the outer edge of the cone
    lamp_direction: vec4f,
    // linear RGB, then 1 / (cosine of the inner edge - cosine of the outer edge)
    lamp_colour: vec4f,
    // light scattered about in the eye, linear RGB, then the share of light that the membrane takes away
    ambient: vec4f,
    // radius (mm), map scale, mip level, strength of the specular film
    retina: vec4f,
    // bias, half width of the soft edge, strength of the tracking-lost ring, membrane detail
    shadow: vec4f,
    instruments: array<Instrument, 2>,
}

struct View {
    clip_from_eye: mat4x4f,
    camera: vec4f,
    // Plane through the target: its middle, and the way of one unit of NDC along x and y.
    plane_origin: vec4f,
    plane_x: vec4f,
    plane_y: vec4f,
    // (x, y) of the field's radius-1 coordinates per NDC, squared inner edge of the soft border, 0
    field: vec4f,
}

// Chosen when a pipeline is made: software drivers execute both sides of an `if`.
// Several taps on the edge of a shadow:
override SOFT_SHADOW: bool = true;
// The membrane's own shadow:
override MEMBRANE_SHADOW: bool = true;
// The retina's specular film and the membrane's wrinkles:
override DETAIL: bool = true;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> view: View;
@group(1) @binding(0) var fundus_map: texture_2d<f32>;
@group(1) @binding(1) var fundus_sampler: sampler;
@group(1) @binding(2) var shadow_map: texture_depth_2d;
@group(1) @binding(3) var shadow_sampler: sampler_comparison;

// Exposure is fixed, so highlights roll off; by the strongest colour, so that they keep their hue.
// The target holds square roots of linear light, a close and cheap stand-in for sRGB.
fn to_display(linear: vec3f) -> vec3f {
    let strongest = max(linear.r, max(linear.g, linear.b));
    return sqrt(linear * (1.35 / (0.6 + strongest)));
}

// 1 inside the round field, 0 outside, with a soft border and a slight fall-off before it.
fn vignette(field_xy: vec2f) -> f32 {
    let r2 = dot(field_xy, field_xy);
    let border = clamp((1.0 - r2) / (1.0 - view.field.z), 0.0, 1.0);
    return border * (1.0 - 0.3 * r2 * r2);
}

// Share of the lamp's beam that leaves in direction `away` (unit, from the lamp).
fn spot(away: vec3f) -> f32 {
    let s = clamp((dot(away, frame.lamp_direction.xyz) - frame.lamp_direction.w) * frame.lamp_colour.w, 0.0, 1.0);
    return s * s * (3.0 - 2.0 * s);
}

// Lit share at `p` by tile 0 (instruments) or 1 (membrane) of the shadow map.
fn lit_by_tile(uv: vec2f, depth: f32, tile: f32) -> f32 {
    return textureSampleCompareLevel(shadow_map, shadow_sampler, vec2f((uv.x + tile) * 0.5, uv.y), depth);
}

fn lamp_coordinates(p: vec3f) -> vec3f {
    let c = frame.lamp_from_eye * vec4f(p, 1.0);
    let ndc = c.xyz / c.w;
    return vec3f(0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y, ndc.z - frame.shadow.x);
}

fn lit_past_instruments(uv: vec2f, depth: f32) -> f32 {
    let soft = frame.shadow.y;
    if !SOFT_SHADOW {
        return lit_by_tile(uv, depth, 0.0);
    }
    let a = lit_by_tile(uv + vec2f(-soft, -0.4 * soft), depth, 0.0);
    let b = lit_by_tile(uv + vec2f(0.4 * soft, -soft), depth, 0.0);
    let c = lit_by_tile(uv + vec2f(soft, 0.4 * soft), depth, 0.0);
    let d = lit_by_tile(uv + vec2f(-0.4 * soft, soft), depth, 0.0);
    return 0.25 * (a + b + c + d);
}
