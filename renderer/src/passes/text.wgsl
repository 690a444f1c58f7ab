// Text over the picture: a quad for each block of lines, its pixels those of a layer as large as the
// channel. Colours are multiplied by their opacity.

struct Block {
    @builtin(position) clip: vec4f,
    @location(0) at_px: vec2f,
}

@group(0) @binding(0) var layer: texture_2d<f32>;

@vertex
fn vs_main(
    @builtin(vertex_index) index: u32,
    // Left, top, right and bottom, shares of the channel.
    @location(0) block: vec4f,
) -> Block {
    let corner = vec2f(f32(index & 1u), f32((index >> 1u) & 1u));
    let at = mix(block.xy, block.zw, corner);
    let clip = vec4f(at.x * 2.0 - 1.0, 1.0 - at.y * 2.0, 0.0, 1.0);
    return Block(clip, at * vec2f(textureDimensions(layer)));
}

@fragment
fn fs_main(in: Block) -> @location(0) vec4f {
    return textureLoad(layer, vec2i(in.at_px), 0);
}

// For windows whose format encodes sRGB by itself: hand it linear light.
@fragment
fn fs_linear(in: Block) -> @location(0) vec4f {
    let texel = textureLoad(layer, vec2i(in.at_px), 0);
    let colour = texel.rgb / max(texel.a, 1.0 / 255.0);
    return vec4f(pow(colour, vec3f(2.2)) * texel.a, texel.a);
}
