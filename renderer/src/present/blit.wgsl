// Copies the finished picture into the window.

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var picture_sampler: sampler;

struct Quad {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> Quad {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u));
    var out: Quad;
    out.clip = vec4f(corner * 2.0 - 1.0, 0.0, 1.0);
    out.uv = vec2f(corner.x, 1.0 - corner.y);
    return out;
}

@fragment
fn fs_main(in: Quad) -> @location(0) vec4f {
    return textureSampleLevel(picture, picture_sampler, in.uv, 0.0);
}

// For windows whose format encodes sRGB by itself: hand it linear light.
@fragment
fn fs_linear(in: Quad) -> @location(0) vec4f {
    let c = textureSampleLevel(picture, picture_sampler, in.uv, 0.0).rgb;
    return vec4f(pow(c, vec3f(2.2)), 1.0);
}
