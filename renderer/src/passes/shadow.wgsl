// What the lamp sees. Full tiers: depth, instruments into the left tile, the membrane into the
// right one. Lean tiers: a mask of light; nothing but the retina lies behind, so no depth is needed
// to shade it.

@vertex
fn vs_instrument(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) part: f32,
    @location(3) material: f32,
    @builtin(instance_index) which: u32,
) -> Caster {
    return caster(place_instrument(position, normal, part, which).p);
}

struct Film {
    @builtin(position) clip: vec4f,
    // Where it lay at the start (mm), and how far from the edge of the mesh (mm).
    @location(0) home: vec3f,
}

@vertex
fn vs_membrane(@location(0) position: vec3f, @location(4) home: vec3f) -> Film {
    return Film(caster(position).clip, vec3f(rest_place(home.xy), home.z));
}

// Multiplied with what the mask has: a sheet takes its share of the light.
@fragment
fn fs_sheet(in: Film) -> @location(0) vec4f {
    return vec4f(1.0, 1.0, 1.0 - frame.ambient.w * grown(in.home.xy, in.home.z), 1.0);
}

// In the map of depths there is a sheet or none.
@fragment
fn fs_outline(in: Film) {
    if grown(in.home.xy, in.home.z) < 0.5 {
        discard;
    }
}
