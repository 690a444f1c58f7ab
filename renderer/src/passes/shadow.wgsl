// What the lamp sees. Full tiers: depth, instruments into the left tile, the membrane into the
// right one. Lean tiers: a mask of light; nothing but the retina lies behind, so no depth is needed
// to shade it.

// Half width of the soft edge that an instrument throws onto the retina from `p`, share of the map: as
// `soft_edge`, where nothing has to be looked for.
fn soft_on_retina(p: vec3f) -> f32 {
    let behind = on_retina(frame.lamp_position.xyz, normalize(p - frame.lamp_position.xyz));
    let wide = frame.penumbra.x * (lamp_coordinates(behind).z - lamp_coordinates(p).z);
    return clamp(wide, frame.shadow.y, frame.penumbra.y);
}

@vertex
fn vs_instrument(in: MetalVertex) -> Caster {
    return caster(place_instrument(in.position, in.normal, in.part, in.which).p);
}

struct Round {
    @builtin(position) clip: vec4f,
    // Way from the axis, radius, half width of the soft edge (shares of the map); distance from the
    // lamp (share of MASK_FAR).
    @location(0) across: vec4f,
}

// A strip through the axis of a round part (`position.x` is its radius, with the side as its sign),
// as wide as its shadow with the soft edges.
@vertex
fn vs_round(in: MetalVertex) -> Round {
    let at = across(in.position.z, in.which, frame.lamp_position.xyz, frame.lamp_from_eye);
    let share_per_mm = max(0.5 * length(at.ndc_per_mm), 1e-6);
    let radius = abs(in.position.x) * share_per_mm;
    let soft = soft_on_retina(at.axis);
    let from_axis = in.normal.x * (radius + soft);
    let edge = caster(at.axis + at.side * (from_axis / share_per_mm));
    return Round(edge.clip, vec4f(from_axis, radius, soft, length(edge.to_lamp) / MASK_FAR));
}

// Kept where less light passes. The lamp's disc is seen past an edge by a share that grows evenly; what
// is narrower than the disc hides a part of it at most.
@fragment
fn fs_round(in: Round) -> @location(0) vec4f {
    let per_soft = 1.0 / in.across.z;
    let hidden = 0.5 + 0.5 * (in.across.y - abs(in.across.x)) * per_soft;
    return vec4f(1.0 - clamp(hidden, 0.0, min(in.across.y * per_soft, 1.0)), in.across.w, 1.0, 1.0);
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

struct Sheet {
    @builtin(position) clip: vec4f,
    // Share of the light that passes.
    @location(0) past: f32,
}

@vertex
fn vs_sheet(@location(0) position: vec3f, @location(4) home: vec3f) -> Sheet {
    let share = grown(rest_place(home.xy), home.z, frame.retina.x - length(position));
    return Sheet(caster(position).clip, 1.0 - frame.ambient.w * share);
}

// Multiplied with what the mask has: a sheet takes its share of the light.
@fragment
fn fs_sheet(in: Sheet) -> @location(0) vec4f {
    return vec4f(1.0, 1.0, in.past, 1.0);
}

// In the map of depths there is a sheet or none.
@fragment
fn fs_outline(in: Film) {
    if grown(in.home.xy, in.home.z, in.height) < 0.5 {
        discard;
    }
}
