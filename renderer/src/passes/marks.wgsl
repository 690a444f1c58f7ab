// Marks on retina and tissue (bleeding, burns): round spots that lie flat on the inside of the eye.

struct Mark {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) at: vec2f,
    @location(2) rgba: vec4f,
}

// Marks lie so far (mm) before what they mark that they are not lost in it.
const BEFORE: f32 = 0.06;

@vertex
fn vs_main(
    @builtin(vertex_index) index: u32,
    @location(0) centre: vec3f,
    @location(1) radius: f32,
    @location(2) rgba: vec4f,
) -> Mark {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u)) * 2.0 - 1.0;
    let inwards = -normalize(centre + vec3f(0.0, 0.0, -1e-6));
    let side = normalize(cross(inwards, select(vec3f(0.0, 1.0, 0.0), vec3f(1.0, 0.0, 0.0), abs(inwards.y) > 0.9)));
    let p = centre + inwards * BEFORE + (side * corner.x + cross(inwards, side) * corner.y) * radius;
    return Mark(view.clip_from_eye * vec4f(p, 1.0), p, corner, rgba);
}

@fragment
fn fs_main(in: Mark) -> @location(0) vec4f {
    // A drop spreads unevenly.
    let bearing = atan2(in.at.y, in.at.x);
    let rim = 0.88 + 0.07 * sin(3.0 * bearing + in.p.x * 9.0) + 0.05 * sin(5.0 * bearing - in.p.y * 11.0);
    let cover = 1.0 - smoothstep(rim - 0.22, rim, length(in.at));
    let lamp = lamp_at(in.p);
    let n = -normalize(in.p);
    let strength = lamp.strength * past_casters(in.p) * max(dot(n, lamp.l), 0.0);
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * strength;
    let shade = field_shade(view.clip_from_eye * vec4f(in.p, 1.0));
    return vec4f(to_display(in.rgba.rgb * light) * shade, in.rgba.a * cover);
}
