// What every pass sees. Put before each shader's text. Everything is in the eye frame, mm.
// A test compares these structs with those of layout.rs.

struct Instrument {
    eye_from_instrument: mat4x4f,
    // half the jaw opening (rad), z of the jaws' pivot (mm), opacity, 1 if the lamp lights it
    shape: vec4f,
    // radius and length of the shaft (mm), 1 if it is drawn, height over the tip from which it is
    // round (mm)
    shaft: vec4f,
}

struct Frame {
    lamp_from_eye: mat4x4f,
    // position, then strength: irradiance at 1 mm
    lamp_position: vec4f,
    // direction of the beam, then cosine of the outer edge of the cone
    lamp_direction: vec4f,
    // linear RGB, then 1 / (cosine of the inner edge - cosine of the outer edge)
    lamp_colour: vec4f,
    // light scattered about in the eye, linear RGB, then the share of light that the membrane takes
    // away
    ambient: vec4f,
    // radius (mm), map scale, 0, strength of the specular film
    retina: vec4f,
    // bias, half width of the soft edge, relief of the vessels, membrane detail
    shadow: vec4f,
    // growth of a shadow's soft edge with the difference of depths in the map, widest half width
    // that is looked for (shares of a tile), 1 / radius of the retina (1/mm), 0
    penumbra: vec4f,
    // Corner of the vitreous' densities with the smallest coordinates, then extinction at full
    // density (1/mm)
    haze_corner: vec4f,
    // Edges of their box, 0
    haze_size: vec4f,
    instruments: array<Instrument, 2>,
}

struct View {
    clip_from_eye: mat4x4f,
    // Position of the objective, height of a pixel in NDC.
    camera: vec4f,
    // Plane through the target: its middle, and the way of one unit of NDC along x and y; then
    // width and height of a cell in NDC.
    plane_origin: vec4f,
    plane_x: vec4f,
    plane_y: vec4f,
    // (x, y) of the field's radius-1 coordinates per NDC, squared inner edge of the soft border, 1
    // / (1 - that)
    field: vec4f,
}

// Chosen when a pipeline is made, since software drivers execute both sides of an `if`.
override LEAN: bool = false;

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> view: View;
// The one level of the map whose texels are about as large as a pixel: if a level is selected by number,
// software drivers compute its address again for every four pixels.
@group(1) @binding(0) var fundus_map: texture_2d<f32>;
@group(1) @binding(1) var fundus_sampler: sampler;
@group(1) @binding(2) var shadow_map: texture_depth_2d;
@group(1) @binding(3) var shadow_sampler: sampler_comparison;
// Of the lean tiers: r light past the instruments, g distance of what holds it up (share of
// MASK_FAR), b light past the membrane.
@group(1) @binding(4) var shadow_mask: texture_2d<f32>;
// The shadow map's depths as they are: OpenGL reads none from a texture that compares.
@group(1) @binding(5) var shadow_depths: texture_2d<f32>;

// Distance from the lamp at which the mask's second channel is 1, mm.
const MASK_FAR: f32 = 26.0;

// Exposure is fixed, so highlights roll off; by the strongest colour, so that they keep their hue.
// The target holds square roots of linear light, a close and cheap stand-in for sRGB.
fn to_display(linear: vec3f) -> vec3f {
    let strongest = max(linear.r, max(linear.g, linear.b));
    return sqrt(linear * (1.35 / (0.6 + strongest)));
}

// 1 inside the round field, 0 outside, with a soft border and a slight fall-off before it.
fn vignette(field_xy: vec2f) -> f32 {
    let r2 = dot(field_xy, field_xy);
    let border = clamp((1.0 - r2) * view.field.w, 0.0, 1.0);
    return border * (1.0 - 0.3 * r2 * r2);
}

// Share of the lamp's light that leaves in the direction `away` (unit, from the lamp).
fn beam(away: vec3f) -> f32 {
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

// Taps that look for what holds the light up, and that measure how much of it.
const LOOKS: u32 = 14u;
const TAPS: u32 = 16u;

// A step on a spiral whose steps spread evenly over all directions.
fn on_spiral(i: u32, radius: f32) -> vec2f {
    let angle = 2.3999632 * f32(i);
    return radius * vec2f(cos(angle), sin(angle));
}

// Half width of the soft edge at `uv`, share of a tile; 0 where nothing holds the light up. The
// lamp is a disc: behind an edge at the distance c from it, a surface at the distance d sees it
// appear over (1/c - 1/d) times its radius, in units of the map. In the map's depth that difference
// is linear.
fn soft_edge(uv: vec2f, depth: f32, tile: f32) -> f32 {
    let size = f32(textureDimensions(shadow_depths).y);
    var sum = 0.0;
    var found = 0.0;
    for (var i = 0u; i < LOOKS; i++) {
        let look = uv + on_spiral(i, frame.penumbra.y * (f32(i) + 0.5) / f32(LOOKS));
        let inside = clamp(look, vec2f(0.0), vec2f(0.9999)) + vec2f(tile, 0.0);
        let nearest = textureLoad(shadow_depths, vec2i(inside * size), 0).r;
        let holds = select(0.0, 1.0, nearest < depth);
        sum += holds * nearest;
        found += holds;
    }
    let wide = frame.penumbra.x * (depth - sum / max(found, 1.0));
    return select(0.0, clamp(wide, frame.shadow.y, frame.penumbra.y), found > 0.0);
}

// Share of the lamp's disc that is seen from `uv` past what the tile shows.
fn lit_softly(uv: vec2f, depth: f32, tile: f32) -> f32 {
    let soft = soft_edge(uv, depth, tile);
    if soft == 0.0 {
        return 1.0;
    }
    var lit = 0.0;
    for (var i = 0u; i < TAPS; i++) {
        let at = uv + on_spiral(i, soft * sqrt((f32(i) + 0.5) / f32(TAPS)));
        lit += lit_by_tile(clamp(at, vec2f(0.0), vec2f(1.0)), depth, tile);
    }
    return lit / f32(TAPS);
}

fn lit_past_instruments(uv: vec2f, depth: f32) -> f32 {
    return lit_softly(uv, depth, 0.0);
}

// Where the ray from `p` along `ray` (unit) leaves the eye: |p + t ray| = radius, the farther root.
fn on_retina(p: vec3f, ray: vec3f) -> vec3f {
    let b = dot(p, ray);
    let root = b * b - dot(p, p) + frame.retina.x * frame.retina.x;
    return p + (sqrt(max(root, 0.0)) - b) * ray;
}

struct Lamp {
    // Unit, towards the lamp.
    l: vec3f,
    // Irradiance of a surface that faces it, without shadow.
    strength: f32,
}

// As if it shone to all sides as in the middle of its beam.
fn lamp_everywhere(p: vec3f) -> Lamp {
    let to_lamp = frame.lamp_position.xyz - p;
    let inverse_square = 1.0 / max(dot(to_lamp, to_lamp), 0.25);
    return Lamp(to_lamp * sqrt(inverse_square), frame.lamp_position.w * inverse_square);
}

fn lamp_at(p: vec3f) -> Lamp {
    let lamp = lamp_everywhere(p);
    return Lamp(lamp.l, lamp.strength * beam(-lamp.l));
}

// (n·h)^32 by five products.
fn gloss(cosine: f32) -> f32 {
    return gloss_of_square(cosine * cosine);
}

// The same of the square of n·h, which spares a root.
fn gloss_of_square(h2: f32) -> f32 {
    let h4 = h2 * h2;
    let h8 = h4 * h4;
    let h16 = h8 * h8;
    return h16 * h16;
}

// For lean_mask: coordinates in the mask times w, and w. Linear in p, so exact when interpolated
// over a triangle.
fn mask_coordinates(p: vec3f) -> vec3f {
    let c = frame.lamp_from_eye * vec4f(p, 1.0);
    return vec3f(0.5 * (c.w + c.x), 0.5 * (c.w - c.y), c.w);
}

// One fetch; its filter softens the edge.
fn lean_mask(coordinates: vec3f) -> vec3f {
    let uv = coordinates.xy * (1.0 / max(coordinates.z, 0.01));
    return textureSampleLevel(shadow_mask, fundus_sampler, uv, 0.0).rgb;
}

// Share of the lamp's light that instruments and bodies let through to `p`, for things that lie
// anywhere in the eye.
fn past_casters(p: vec3f) -> f32 {
    if LEAN {
        // What holds the light up shades only what lies beyond it, by more than a step of the
        // mask's 8 bits.
        let mask = lean_mask(mask_coordinates(p));
        return select(1.0, mask.r, distance(p, frame.lamp_position.xyz) / MASK_FAR > mask.g + 0.006);
    }
    let at = lamp_coordinates(p);
    return lit_past_instruments(at.xy, at.z);
}

fn field_shade(clip: vec4f) -> f32 {
    return vignette(clip.xy / clip.w * view.field.xy);
}
