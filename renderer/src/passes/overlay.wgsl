// Text on the picture: one quad, white letters with a dark ground.

@group(1) @binding(0) var text: texture_2d<f32>;
@group(1) @binding(1) var text_sampler: sampler;

@fragment
fn fs_main(in: Quad) -> @location(0) vec4f {
    let ink = textureSampleLevel(text, text_sampler, in.uv, 0.0).r;
    return vec4f(vec3f(1.0, 0.86, 0.45) * ink, 0.25 + 0.75 * ink);
}
