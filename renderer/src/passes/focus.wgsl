// Depth of field: light of points out of focus is spread over the patch that the microscope's
// formula gives. Points nearer than the plane of focus are spread over what lies behind them; where
// none is near, a pixel stays as it is.

struct Focus {
    // A and B of distance = B / (A - depth), distance of the plane in focus (mm), half the aperture
    // in pixels of that plane.
    optics: vec4f,
}

@group(0) @binding(0) var<uniform> focus: Focus;
// The drawn picture, and the depths of its samples.
@group(0) @binding(1) var drawn: texture_2d<f32>;
@group(0) @binding(2) var depths: texture_multisampled_2d<f32>;
// Widest patch in each tile, as a share of MOST; then of its neighbours too.
@group(0) @binding(3) var tiles: texture_2d<f32>;
// Radius of each pixel's patch, px.
@group(0) @binding(4) var radii: texture_2d<f32>;

// As in focus.rs: pixels of a tile, and the largest radius of a patch, px, no more than two tiles.
const TILE: i32 = 16;
const MOST: f32 = 32.0;
// A patch of a smaller radius is a point, px.
const SHARP: f32 = 0.5;
const TAPS: u32 = 56u;
const SAMPLES: i32 = 4;

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32((index >> 1u) & 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// Radius of a pixel's patch with its sign: negative for a point nearer than the plane of focus. The
// nearest sample counts, or the rim of what is in focus would be spread like what lies behind it.
// Outside the field, which is closed by the nearest depth, nothing is spread.
@fragment
fn fs_radius(@builtin(position) clip: vec4f) -> @location(0) vec4f {
    var depth = 1.0;
    for (var i = 0; i < SAMPLES; i++) {
        depth = min(depth, textureLoad(depths, vec2i(clip.xy), i).r);
    }
    let distance = focus.optics.y / (focus.optics.x - depth);
    let radius = focus.optics.w * (distance - focus.optics.z) / distance;
    return vec4f(select(clamp(radius, -MOST, MOST), 0.0, depth <= 0.0), 0.0, 0.0, 1.0);
}

fn patch_radius(at: vec2i) -> f32 {
    return textureLoad(radii, at, 0).r;
}

@fragment
fn fs_tile(@builtin(position) clip: vec4f) -> @location(0) vec4f {
    let corner = vec2i(clip.xy) * TILE;
    let last = vec2i(textureDimensions(radii)) - 1;
    var widest = 0.0;
    for (var y = 0; y < TILE; y++) {
        for (var x = 0; x < TILE; x++) {
            widest = max(widest, abs(patch_radius(min(corner + vec2i(x, y), last))));
        }
    }
    return vec4f(widest / MOST, 0.0, 0.0, 1.0);
}

// A patch reaches no farther than two tiles.
@fragment
fn fs_reach(@builtin(position) clip: vec4f) -> @location(0) vec4f {
    let at = vec2i(clip.xy);
    let last = vec2i(textureDimensions(tiles)) - 1;
    var widest = 0.0;
    for (var y = -2; y <= 2; y++) {
        for (var x = -2; x <= 2; x++) {
            widest = max(widest, textureLoad(tiles, clamp(at + vec2i(x, y), vec2i(0), last), 0).r);
        }
    }
    return vec4f(widest, 0.0, 0.0, 1.0);
}

// Light of a pixel: the picture holds square roots of it. Without a filter, which would take some
// of its neighbour's.
fn light_of(at: vec2i) -> vec3f {
    let root = textureLoad(drawn, at, 0).rgb;
    return root * root;
}

// Share of a point's light that each pixel of its patch has.
fn share(radius: f32) -> f32 {
    let wide = max(abs(radius), SHARP);
    return 1.0 / (3.1415927 * wide * wide);
}

@fragment
fn fs_main(@builtin(position) clip: vec4f) -> @location(0) vec4f {
    let at = vec2i(clip.xy);
    let last = vec2i(textureDimensions(drawn)) - 1;
    let own_root = textureLoad(drawn, at, 0).rgb;
    let reach = textureLoad(tiles, at / TILE, 0).r * MOST;
    if reach < SHARP {
        return vec4f(own_root, 1.0);
    }
    let own = patch_radius(at);
    let own_light = own_root * own_root;
    // Light of the layers in front of the plane of focus, how much of the pixel it covers, and of
    // what lies behind them.
    var before = vec4f(0.0);
    var behind = vec4f(0.0);
    let own_share = share(own);
    if own < -SHARP {
        before = vec4f(own_light, 1.0) * own_share;
    } else {
        behind = vec4f(own_light, 1.0) * own_share;
    }
    // A spiral that is denser inside, so that narrow patches among wide ones are met too.
    for (var i = 0u; i < TAPS; i++) {
        let along = (f32(i) + 0.5) / f32(TAPS);
        let away = reach * along;
        let angle = 2.3999632 * f32(i);
        let place = clip.xy + away * vec2f(cos(angle), sin(angle));
        let q = clamp(vec2i(place), vec2i(0), last);
        let radius = patch_radius(q);
        // Pixels that this tap stands for.
        let area = 6.2831853 * away * reach / f32(TAPS);
        let light = vec4f(light_of(q), 1.0);
        if radius < -SHARP {
            let covers = clamp(-radius - away + 0.5, 0.0, 1.0);
            before += light * (covers * area * share(radius));
        } else {
            // What lies farther is hidden by the pixel's own point and spreads no wider than that;
            // what is seen past a patch in front is taken from all round.
            let hidden = select(abs(radius), min(abs(radius), abs(own)), radius > own);
            let spread = select(hidden, abs(own), own < -SHARP);
            let covers = clamp(spread - away + 0.5, 0.0, 1.0);
            behind += light * (covers * area * share(spread));
        }
    }
    let cover = select(clamp(before.a, 0.0, 1.0), 1.0, behind.a <= 1e-4);
    let mixed = mix(behind.rgb / max(behind.a, 1e-4), before.rgb / max(before.a, 1e-4), cover);
    return vec4f(sqrt(mixed), 1.0);
}
