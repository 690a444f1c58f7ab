// Instruments as lit metal.

struct Metal {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    // field coordinates times w, and w: divided in the fragment, since they bend over long triangles
    @location(2) field_xyw: vec3f,
    // material (0 metal, 1 glowing fibre, 2 dark port), opacity, lit by the lamp
    @location(3) surface: vec3f,
}

@vertex
fn vs_main(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) part: f32,
    @location(3) material: f32,
    @builtin(instance_index) which: u32,
) -> Metal {
    let placed = place_instrument(position, normal, part, which);
    var out: Metal;
    out.p = placed.p;
    out.n = placed.n;
    out.clip = view.clip_from_eye * vec4f(out.p, 1.0);
    out.field_xyw = vec3f(out.clip.xy * view.field.xy, out.clip.w);
    let shape = frame.instruments[which].shape;
    out.surface = vec3f(material, shape.z, shape.w);
    return out;
}

@fragment
fn fs_main(in: Metal) -> @location(0) vec4f {
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    let n = normalize(in.n);
    let v = normalize(view.camera.xyz - in.p);
    let r = reflect(-v, n);
    // The lit retina below is a large warm lamp; above is the dark of the vitreous.
    let from_retina = clamp(0.5 - 0.5 * n.z, 0.0, 1.0);
    let mirrored = clamp(-r.z * 1.4 + 0.1, 0.0, 1.0);
    // The microscope's own rim of light keeps the shaft readable against the dark.
    let towards_viewer = clamp(dot(n, v), 0.0, 1.0);
    var light = frame.ambient.rgb * (0.08 + 2.2 * from_retina * from_retina + 6.0 * mirrored * mirrored);
    let glint = towards_viewer * towards_viewer * towards_viewer;
    light += vec3f(0.020, 0.022, 0.025) * (0.12 + 2.6 * glint * glint * glint * glint);
    if in.surface.z > 0.0 {
        let lamp = lamp_at(in.p);
        let h = max(dot(n, normalize(lamp.l + v)), 0.0);
        light += frame.lamp_colour.rgb * (lamp.strength * (0.30 * max(dot(n, lamp.l), 0.0) + 1.6 * gloss(h)));
    }
    var colour = vec3f(0.72, 0.74, 0.78) * light;
    if in.surface.x > 1.5 {
        colour = colour * 0.08;
    } else if in.surface.x > 0.5 {
        colour = frame.lamp_colour.rgb * 2.5;
    }
    return vec4f(to_display(colour) * shade, in.surface.y);
}
