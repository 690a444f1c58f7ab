// A rectangle that fills the caller's viewport. Put before the shaders that draw an image as it is.

struct Quad {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> Quad {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u));
    return Quad(vec4f(corner * 2.0 - 1.0, 0.0, 1.0), vec2f(corner.x, 1.0 - corner.y));
}

