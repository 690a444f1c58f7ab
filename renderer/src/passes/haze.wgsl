// The vitreous as a haze: light that its elements scatter towards the viewer, summed along each ray
// from the retina up. Put after fundus.wgsl, whose cells it is drawn on.
//
// Full tiers march every pixel's ray and stop at the shafts, so that instruments sink into the
// haze. Lean tiers march the rays of the cells' corners, and instruments lie before it.

@group(2) @binding(0) var densities: texture_3d<f32>;
@group(2) @binding(1) var densities_sampler: sampler;

// The haze is looked at up to so far over the retina, mm; beyond lies the lens.
const REACH: f32 = 16.0;
const STEPS: u32 = 32u;
const LEAN_STEPS: u32 = 12u;
// Brightness of scattered light, against a white surface that faces the lamp.
const WHITENESS: f32 = 0.8;

fn density(p: vec3f) -> f32 {
    let uvw = (p - frame.haze_corner.xyz) / frame.haze_size.xyz;
    let inside = all(uvw >= vec3f(0.0)) && all(uvw <= vec3f(1.0));
    return select(0.0, textureSampleLevel(densities, densities_sampler, uvw, 0.0).r, inside);
}

// Colour (display) and opacity of the haze over `from`, the last step towards the viewer first.
fn march(ground: vec3f, ray: vec3f, begin: f32, steps: u32) -> vec4f {
    let step = (REACH - begin) / f32(steps);
    var light = vec3f(0.0);
    var passes = 1.0;
    // From the viewer down to the retina: what is nearer veils what is farther.
    for (var i = 0u; i < steps; i++) {
        let p = ground - ray * (begin + (f32(steps - i) - 0.5) * step);
        let held = 1.0 - exp(-density(p) * frame.haze_corner.w * step);
        let lamp = lamp_at(p);
        light += passes * held * (frame.ambient.rgb + frame.lamp_colour.rgb * (WHITENESS * min(lamp.strength, 6.0)));
        passes *= 1.0 - held;
    }
    let opacity = 1.0 - passes;
    return vec4f(to_display(light / max(opacity, 1e-4)), opacity);
}

// How far over the retina the ray leaves the nearest shaft that it meets, mm; 0 if none.
fn over_shafts(ground: vec3f, ray: vec3f) -> f32 {
    var over = 0.0;
    for (var i = 0u; i < 2u; i++) {
        let m = frame.instruments[i].eye_from_instrument;
        let axis = m[2].xyz;
        let shaft = frame.instruments[i].shaft;
        // Closest approach of the ray up from the retina to the axis.
        let from_tip = ground - m[3].xyz;
        let cosine = -dot(ray, axis);
        let up = (cosine * dot(axis, from_tip) + dot(ray, from_tip)) / max(1.0 - cosine * cosine, 1e-4);
        let along = dot(axis, from_tip) + cosine * up;
        let apart = length(from_tip - ray * up - axis * along);
        let meets = shaft.z > 0.0 && apart < shaft.x && along > 0.0 && along < shaft.y;
        over = select(over, max(over, up), meets);
    }
    return min(over, REACH - 0.1);
}

struct LeanHaze {
    @builtin(position) clip: vec4f,
    @location(0) rgba: vec4f,
}

@vertex
fn vs_haze_lean(@builtin(vertex_index) index: u32) -> LeanHaze {
    let field_xy = corner(index);
    let p = corner_on_retina(field_xy);
    let veil = march(p, normalize(p - view.camera.xyz), 0.0, LEAN_STEPS);
    // Before all tissue near the retina, behind every instrument over it.
    let clip = at_depth_of(p * 0.97, behind(p, field_xy));
    return LeanHaze(clip, vec4f(veil.rgb * vignette(field_xy), veil.a));
}

@fragment
fn fs_haze_lean(in: LeanHaze) -> @location(0) vec4f {
    return in.rgba;
}

@fragment
fn fs_haze(in: Disc) -> @location(0) vec4f {
    let ground = to_retina(in.p);
    let ray = normalize(ground - view.camera.xyz);
    let veil = march(ground, ray, over_shafts(ground, ray), STEPS);
    return vec4f(veil.rgb * vignette(in.field_xy), veil.a);
}
