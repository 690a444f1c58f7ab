// Text on the picture: one quad, white letters with a dark ground.

@group(1) @binding(0) var text: texture_2d<f32>;
@group(1) @binding(1) var text_sampler: sampler;

struct Quad {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> Quad {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u));
    // The caller's viewport is the text's rectangle.
    var out: Quad;
    out.clip = vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
    out.uv = vec2f(corner.x, 1.0 - corner.y);
    return out;
}

@fragment
fn fs_main(in: Quad) -> @location(0) vec4f {
    let ink = textureSampleLevel(text, text_sampler, in.uv, 0.0).r;
    return vec4f(vec3f(1.0, 0.86, 0.45) * ink, 0.25 + 0.75 * ink);
}
