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

@vertex
fn vs_membrane(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) edge: f32,
    @location(3) number: f32,
) -> Caster {
    return caster(position);
}

// Multiplied with what the mask has: a sheet takes its share of the light.
@fragment
fn fs_sheet(in: Caster) -> @location(0) vec4f {
    return vec4f(1.0, 1.0, 1.0 - frame.ambient.w, 1.0);
}
