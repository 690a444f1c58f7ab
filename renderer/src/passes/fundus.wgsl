// The retina: the inside of a sphere, found by ray, with one fetch of the fundus photograph.
// Drawn as a disc that covers the round field, so that nothing outside it is shaded.

struct Disc {
    @builtin(position) clip: vec4f,
    @location(0) field_xy: vec2f,
    @location(1) plane_point: vec3f,
}

const SEGMENTS: f32 = 48.0;

@vertex
fn vs_main(@builtin(vertex_index) index: u32) -> Disc {
    // A fan of triangles; the rim is pushed out so that its chords clear the unit circle.
    let corner = index % 3u;
    let step = f32(index / 3u + select(0u, 1u, corner == 2u));
    let angle = step * (6.2831853 / SEGMENTS);
    let radius = select(1.0022, 0.0, corner == 0u);
    var out: Disc;
    out.field_xy = radius * vec2f(cos(angle), sin(angle));
    let ndc = out.field_xy / view.field.xy;
    out.plane_point = view.plane_origin.xyz + ndc.x * view.plane_x.xyz + ndc.y * view.plane_y.xyz;
    out.clip = vec4f(ndc, 1.0, 1.0);
    return out;
}

@fragment
fn fs_main(in: Disc) -> @location(0) vec4f {
    let shade = vignette(in.field_xy);
    // |plane_point + t ray| = radius, the farther root: the far side of the eye.
    let ray = normalize(in.plane_point - view.camera.xyz);
    let radius = frame.retina.x;
    let b = dot(in.plane_point, ray);
    let root = b * b - dot(in.plane_point, in.plane_point) + radius * radius;
    let p = in.plane_point + (sqrt(max(root, 0.0)) - b) * ray;
    let q = p / radius;

    // Lambert's azimuthal equal-area map about the pole at -z: (x, y) sqrt(2 / (1 - z)).
    let uv = vec2f(0.5) + q.xy * (inverseSqrt(max(0.5 - 0.5 * q.z, 1e-4)) * frame.retina.y);
    let photo = textureSampleLevel(fundus_map, fundus_sampler, uv, frame.retina.z).rgb;
    let albedo = photo * photo;

    let to_lamp = frame.lamp_position.xyz - p;
    let inverse_square = 1.0 / dot(to_lamp, to_lamp);
    let l = to_lamp * sqrt(inverse_square);
    let beam = spot(-l);
    let at = lamp_coordinates(p);
    var strength = lit_past_instruments(at.xy, at.z) * beam * frame.lamp_position.w * inverse_square;
    if MEMBRANE_SHADOW {
        strength *= 1.0 - frame.ambient.w * (1.0 - lit_by_tile(at.xy, at.z, 1.0));
    }
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * (strength * max(-dot(q, l), 0.0));
    var film = 0.0;
    if DETAIL {
        // The inner limiting membrane reflects like a wet film: (n·h)^32, brighter off the vessels.
        let h = max(-dot(q, normalize(l - ray)), 0.0);
        let h2 = h * h;
        let h4 = h2 * h2;
        let h8 = h4 * h4;
        let h16 = h8 * h8;
        film = frame.retina.w * strength * h16 * h16 * (0.4 + albedo.g);
    }
    var colour = to_display(albedo * light + vec3f(film)) * select(0.0, shade, root > 0.0);
    // An amber ring says that tracking is lost.
    let ring = clamp(1.0 - abs(dot(in.field_xy, in.field_xy) - 0.93) * 22.0, 0.0, 1.0) * frame.shadow.z;
    colour = mix(colour, vec3f(1.0, 0.62, 0.05), ring);
    return vec4f(colour, 1.0);
}
