// Copies the finished picture into the window.

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var picture_sampler: sampler;

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
