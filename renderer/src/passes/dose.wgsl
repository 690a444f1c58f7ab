// The dose of light on the retina, drawn over it on request. Put after fundus.wgsl, whose cells it
// is drawn on.

// Light that was counted, on the scale of dose.rs: 0 none, 1 far too much.
@group(2) @binding(0) var doses: texture_2d<f32>;
@group(2) @binding(1) var doses_sampler: sampler;

struct Dose {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) field_xy: vec2f,
}

// Radius of the grid in the equal-area map of the unit sphere, as in protocol::dose.
const GRID_REACH: f32 = 1.68294197;

@vertex
fn vs_dose(@builtin(vertex_index) index: u32) -> Dose {
    let field_xy = corner(index);
    let p = corner_on_retina(field_xy);
    // A little before the retina, whose depth it shares otherwise; behind all that lies on it.
    let clip = at_depth_of(p * (1.0 + 0.5 * BEHIND / frame.retina.x), behind(p, field_xy));
    return Dose(clip, p, field_xy);
}

// Green where little light fell, yellow where the score begins to fall, red where it has none left.
fn colour_of(share: f32) -> vec3f {
    let low = mix(vec3f(0.05, 0.75, 0.35), vec3f(1.0, 0.85, 0.1), smoothstep(0.1, 0.64, share));
    return mix(low, vec3f(1.0, 0.05, 0.25), smoothstep(0.64, 1.0, share));
}

@fragment
fn fs_dose(in: Dose) -> @location(0) vec4f {
    let q = normalize(in.p);
    let flat = q.xy * inverseSqrt(max(0.5 - 0.5 * q.z, 1e-4));
    let uv = vec2f(0.5) + flat * (0.5 / GRID_REACH);
    let share = textureSampleLevel(doses, doses_sampler, uv, 0.0).r;
    let shade = vignette(in.field_xy);
    return vec4f(colour_of(share) * shade, 0.65 * smoothstep(0.0, 0.25, share));
}
