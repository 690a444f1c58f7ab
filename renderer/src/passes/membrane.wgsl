// The membrane: a thin translucent sheet, seen and lit from both sides, with a sheen like cellophane.

struct Sheet {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    // field coordinates times w, and w: divided in the fragment, since they bend over long triangles
    @location(2) field_xyw: vec3f,
    @location(3) edge: f32,
    @location(4) rest: vec2f,
}

@vertex
fn vs_main(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) edge: f32,
    @location(3) number: f32,
) -> Sheet {
    var out: Sheet;
    out.p = position;
    out.n = normal;
    out.clip = view.clip_from_eye * vec4f(position, 1.0);
    out.field_xyw = vec3f(out.clip.xy * view.field.xy, out.clip.w);
    out.edge = edge;
    // Grain of the sheet: a smooth pattern of the place, and a faint one of the node's number.
    out.rest = position.xy * 2.1 + vec2f(0.13 * sin(number * 2.399), 0.13 * cos(number * 2.399));
    return out;
}

@fragment
fn fs_main(in: Sheet) -> @location(0) vec4f {
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    let v = normalize(view.camera.xyz - in.p);
    var n = normalize(in.n);
    if DETAIL {
        // Fine wrinkles of two sizes that run in different directions.
        let fine = sin(in.rest.x * 7.0 + in.rest.y * 3.0 + 1.5 * sin(in.rest.y * 2.0));
        let coarse = sin(in.rest.y * 3.7 - in.rest.x * 1.9 + 2.0 * sin(in.rest.x * 1.3));
        n = normalize(n + vec3f(fine + 0.5 * coarse, 0.6 * coarse - 0.4 * fine, 0.0) * frame.shadow.w);
    }
    let facing = abs(dot(n, v));
    n = n * sign(dot(n, v) + 1e-6);
    let to_lamp = frame.lamp_position.xyz - in.p;
    let inverse_square = 1.0 / max(dot(to_lamp, to_lamp), 0.25);
    let l = to_lamp * sqrt(inverse_square);
    let at = lamp_coordinates(in.p);
    let strength = spot(-l) * lit_by_tile(at.xy, at.z, 0.0) * frame.lamp_position.w * inverse_square;
    let rim = (1.0 - facing) * (1.0 - facing);
    let h = max(dot(n, normalize(l + v)), 0.0);
    let h2 = h * h;
    let h4 = h2 * h2;
    let h8 = h4 * h4;
    let sheen = strength * h8 * h8 * h8 * (0.5 + rim);
    let light = frame.ambient.rgb + frame.lamp_colour.rgb * strength * (0.25 + 0.6 * abs(dot(n, l)));
    let colour = vec3f(0.66, 0.74, 0.70) * light + frame.lamp_colour.rgb * sheen;
    let opacity = clamp(0.15 + 0.6 * rim + 0.25 * in.edge * in.edge + 0.4 * sheen, 0.0, 0.92);
    return vec4f(to_display(colour) * shade, opacity * select(0.0, 1.0, shade > 0.0));
}
