// What the lamp sees of a point that throws a shadow. Put before the shaders that draw into the
// shadow map.

struct Caster {
    @builtin(position) clip: vec4f,
    @location(0) to_lamp: vec3f,
}

fn caster(p: vec3f) -> Caster {
    return Caster(frame.lamp_from_eye * vec4f(p, 1.0), frame.lamp_position.xyz - p);
}

// No light passes, and this is how far away it ends.
@fragment
fn fs_solid(in: Caster) -> @location(0) vec4f {
    return vec4f(0.0, length(in.to_lamp) / MASK_FAR, 1.0, 1.0);
}
