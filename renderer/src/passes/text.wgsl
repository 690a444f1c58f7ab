// Text on the picture: a small quad for each character, its letter taken from the font's strip, on
// a dark ground.

struct Letter {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
}

@group(1) @binding(0) var font: texture_2d<f32>;
@group(1) @binding(1) var font_sampler: sampler;

// As in font.rs.
const LETTERS: f32 = 96.0;

@vertex
fn vs_main(
    @builtin(vertex_index) index: u32,
    // Left, top, width and height in the block's viewport, 0 to 1.
    @location(0) place: vec4f,
    // Number of the letter in the strip.
    @location(1) letter: f32,
) -> Letter {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u));
    let at = place.xy + corner * place.zw;
    let clip = vec4f(at.x * 2.0 - 1.0, 1.0 - at.y * 2.0, 0.0, 1.0);
    return Letter(clip, vec2f((letter + corner.x) / LETTERS, corner.y));
}

@fragment
fn fs_main(in: Letter) -> @location(0) vec4f {
    let ink = textureSampleLevel(font, font_sampler, in.uv, 0.0).r;
    return vec4f(vec3f(1.0, 0.86, 0.45) * ink, 0.25 + 0.75 * ink);
}
