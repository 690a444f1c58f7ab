// Copies the finished picture into the window, the channels arranged as the display wants them.

struct Plan {
    // Arrangement, as in stereo.rs.
    arrangement: u32,
    // Channel that is shown now, where they alternate.
    channel: u32,
    padding: vec2u,
}

@group(0) @binding(0) var picture: texture_2d<f32>;
@group(0) @binding(1) var picture_sampler: sampler;
@group(0) @binding(2) var<uniform> plan: Plan;

const SIDE_BY_SIDE = 0u;
const ANAGLYPH = 1u;
const INTERLEAVED = 2u;
const SEQUENTIAL = 3u;
const RIGHT = 5u;

// A channel at uv; its neighbour does not bleed in over their border.
fn channel(which: u32, uv: vec2f) -> vec3f {
    let half_texel = 0.5 / f32(textureDimensions(picture).x);
    let x = clamp(0.5 * uv.x, half_texel, 0.5 - half_texel) + 0.5 * f32(which);
    return textureSampleLevel(picture, picture_sampler, vec2f(x, uv.y), 0.0).rgb;
}

// ITU-R BT.601, in the steps of stereo.rs.
fn luma(rgb: vec3f) -> f32 {
    return dot(rgb, vec3f(77.0, 150.0, 29.0) / 256.0);
}

fn arranged(in: Quad) -> vec3f {
    switch plan.arrangement {
        case SIDE_BY_SIDE: {
            return textureSampleLevel(picture, picture_sampler, in.uv, 0.0).rgb;
        }
        case ANAGLYPH: {
            return vec3f(luma(channel(0u, in.uv)), vec2f(luma(channel(1u, in.uv))));
        }
        case INTERLEAVED: {
            // Lines of the display, whatever the picture's own size: the shutter knows no other.
            return channel(u32(in.clip.y) & 1u, in.uv);
        }
        case SEQUENTIAL: {
            return channel(plan.channel, in.uv);
        }
        case RIGHT: {
            return channel(1u, in.uv);
        }
        default: {
            return channel(0u, in.uv);
        }
    }
}

@fragment
fn fs_main(in: Quad) -> @location(0) vec4f {
    return vec4f(arranged(in), 1.0);
}

// For windows whose format encodes sRGB by itself: hand it linear light.
@fragment
fn fs_linear(in: Quad) -> @location(0) vec4f {
    return vec4f(pow(arranged(in), vec3f(2.2)), 1.0);
}
