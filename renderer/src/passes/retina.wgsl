// Retina that is off the choroid: an opaque sheet that carries its own piece of the photograph, and
// under it, where it lay at rest, the bare choroid.

struct Sheet {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    @location(2) uv: vec2f,
    // Height over the choroid (mm), vignette.
    @location(3) more: vec2f,
}

// Place on the unit sphere of coordinates in the map: the inverse of Lambert's projection.
fn from_map(uv: vec2f) -> vec3f {
    let flat = (uv - vec2f(0.5)) / frame.retina.y;
    let half_rho2 = min(dot(flat, flat) * 0.5, 2.0);
    // At the angle θ from the pole, |flat| is 2 sin(θ/2); z is -cos θ and 0.5 - 0.5 z the square of
    // cos(θ/2).
    let z = half_rho2 - 1.0;
    return vec3f(flat * sqrt(max(0.5 - 0.5 * z, 0.0)), z);
}

@vertex
fn vs_sheet(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(4) home: vec3f,
) -> Sheet {
    let clip = view.clip_from_eye * vec4f(position, 1.0);
    let more = vec2f(frame.retina.x - length(position), field_shade(clip));
    return Sheet(clip, position, normal, home.xy, more);
}

// Height over which lying retina, which is the fundus, becomes a sheet of its own, mm: about its
// thickness.
const COMES_OFF: f32 = 0.25;

@fragment
fn fs_sheet(in: Sheet) -> @location(0) vec4f {
    let photo = textureSampleLevel(fundus_map, fundus_sampler, in.uv, 0.0);
    let off = smoothstep(0.0, COMES_OFF, in.more.x);
    // Fresh detached retina is translucent: the choroid shines through, fainter and greyer the farther
    // behind it lies. The vessels stay.
    let veiled = smoothstep(0.05, 2.5, in.more.x);
    let pale = vec3f(0.40, 0.27, 0.19) * (0.15 + 1.7 * photo.g);
    let albedo = mix(photo.rgb * photo.rgb, pale, 0.18 * off + 0.42 * veiled);
    let v = normalize(view.camera.xyz - in.p);
    let folded = normalize(in.n);
    let lying = relief(normalize(in.p), in.uv, photo.a);
    let n = normalize(mix(lying, folded * sign(dot(folded, v) + 1e-6), off));
    let lamp = lamp_at(in.p);
    let strength = lamp.strength * past_casters(in.p);
    // Light also comes through from behind.
    let facing = dot(n, lamp.l);
    let diffuse = max(facing, 0.0) + 0.25 * off * max(-facing, 0.0);
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * (strength * diffuse);
    let lying_wet = film(-lying, lamp.l, -v) * wetness(photo);
    let wet = strength * mix(lying_wet, 2.0 * frame.retina.w * gloss(max(dot(n, normalize(lamp.l + v)), 0.0)), off);
    return vec4f(to_display(albedo * light + vec3f(wet)) * in.more.y, 1.0);
}

@vertex
fn vs_choroid(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(4) home: vec3f,
) -> Sheet {
    let q = from_map(home.xy);
    // Between the retina's depth and tissue that lies on. Where the sheet lies where it lay, both meet,
    // or the choroid would look out from under its edge.
    let moved = distance(position, q * frame.retina.x);
    let p = q * (frame.retina.x + min(0.05, 0.5 * moved));
    let clip = view.clip_from_eye * vec4f(p, 1.0);
    return Sheet(clip, p, -q, home.xy, vec2f(0.0, field_shade(clip)));
}

@fragment
fn fs_choroid(in: Sheet) -> @location(0) vec4f {
    // Orange-brown with coarse mottling and broad vessels, which no photograph of a healthy fundus
    // shows bare.
    let at = in.p.xy;
    let mottling = sin(at.x * 2.1 + 1.3 * sin(at.y * 1.7)) * sin(at.y * 2.6 + 1.1 * sin(at.x * 1.9));
    let albedo = vec3f(0.30, 0.085, 0.035) * (1.0 + 0.22 * mottling);
    let lamp = lamp_at(in.p);
    let strength = lamp.strength * past_casters(in.p) * max(dot(normalize(in.n), lamp.l), 0.0);
    return vec4f(to_display(albedo * (frame.ambient.rgb + frame.lamp_colour.rgb * strength)) * in.more.y, 1.0);
}
