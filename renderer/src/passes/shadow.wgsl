// What the lamp sees. Full tiers: depth, instruments into the left tile, the membrane into the
// right one. Lean tiers: a mask of light; nothing but the retina lies behind, so no depth is needed
// to shade it.

// Where the ray from the lamp through `p` meets the retina.
fn behind(p: vec3f) -> vec3f {
    let lamp = frame.lamp_position.xyz;
    let ray = normalize(p - lamp);
    let b = dot(lamp, ray);
    return lamp + (sqrt(max(b * b - dot(lamp, lamp) + frame.retina.x * frame.retina.x, 0.0)) - b) * ray;
}

// Half width of the soft edge that an instrument throws onto the retina from `p`, share of the map: as
// `soft_edge`, where nothing has to be looked for.
fn soft_on_retina(p: vec3f) -> f32 {
    let wide = frame.penumbra.x * (lamp_coordinates(behind(p)).z - lamp_coordinates(p).z);
    return clamp(wide, frame.shadow.y, frame.penumbra.y);
}

fn across_from_lamp(z: f32, which: u32) -> Across {
    return across(z, which, frame.lamp_position.xyz, frame.lamp_from_eye);
}

fn share_of_map(ndc: vec2f) -> f32 {
    return max(0.5 * length(ndc), 1e-6);
}

// Round parts are drawn into the mask as wide as they hold up all light; vs_edge draws the soft edge.
fn in_full_shadow(position: vec3f, which: u32) -> f32 {
    if !LEAN || !is_round(position.z, which) {
        return 1.0;
    }
    let at = across_from_lamp(position.z, which);
    let radius = length(position.xy) * share_of_map(at.ndc_per_mm);
    return max(1.0 - soft_on_retina(at.axis) / max(radius, 1e-6), 0.0);
}

@vertex
fn vs_instrument(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) part: f32,
    @location(3) material: f32,
    @builtin(instance_index) which: u32,
) -> Caster {
    let inside = in_full_shadow(position, which);
    return caster(place_instrument(vec3f(position.xy * inside, position.z), normal, part, which).p);
}

struct Edge {
    @builtin(position) clip: vec4f,
    @location(0) to_lamp: vec3f,
    // Way from the axis, radius, half width of the soft edge, shares of the map.
    @location(1) across: vec3f,
}

// A strip through the axis of a round part (`position.x` is its radius, with the side as its sign),
// as wide as its shadow with the soft edges.
@vertex
fn vs_edge(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) part: f32,
    @location(3) material: f32,
    @builtin(instance_index) which: u32,
) -> Edge {
    let at = across_from_lamp(position.z, which);
    let share_per_mm = share_of_map(at.ndc_per_mm);
    let radius = abs(position.x) * share_per_mm;
    let soft = soft_on_retina(at.axis);
    let from_axis = normal.x * (radius + soft);
    let edge = caster(at.axis + at.side * (from_axis / share_per_mm));
    return Edge(edge.clip, edge.to_lamp, vec3f(from_axis, radius, soft));
}

// Kept where less light passes. The lamp's disc is seen past an edge by a share that grows evenly; what
// is narrower than the disc hides a part of it at most.
@fragment
fn fs_edge(in: Edge) -> @location(0) vec4f {
    let hidden = 0.5 * (in.across.y + in.across.z - abs(in.across.x)) / in.across.z;
    let most = min(in.across.y / in.across.z, 1.0);
    return vec4f(1.0 - clamp(hidden, 0.0, most), length(in.to_lamp) / MASK_FAR, 1.0, 1.0);
}

struct Film {
    @builtin(position) clip: vec4f,
    // Where it lay at the start (mm), and how far from the edge of the mesh (mm).
    @location(0) home: vec3f,
    // Height over the choroid, mm.
    @location(1) height: f32,
}

@vertex
fn vs_membrane(@location(0) position: vec3f, @location(4) home: vec3f) -> Film {
    return Film(caster(position).clip, vec3f(rest_place(home.xy), home.z), frame.retina.x - length(position));
}

// Multiplied with what the mask has: a sheet takes its share of the light.
@fragment
fn fs_sheet(in: Film) -> @location(0) vec4f {
    return vec4f(1.0, 1.0, 1.0 - frame.ambient.w * grown(in.home.xy, in.home.z, in.height), 1.0);
}

// In the map of depths there is a sheet or none.
@fragment
fn fs_outline(in: Film) {
    if grown(in.home.xy, in.home.z, in.height) < 0.5 {
        discard;
    }
}
