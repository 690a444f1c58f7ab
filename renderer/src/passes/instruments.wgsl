// Instruments as lit metal.

struct Metal {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    // field coordinates times w, and w: divided in the fragment, since they bend over long
    // triangles
    @location(2) field_xyw: vec3f,
    // material (0 metal, 1 glowing fibre, 2 dark port), opacity, lit by the lamp
    @location(3) surface: vec3f,
    // of the shaft, towards the handle
    @location(4) @interpolate(flat) axis: vec3f,
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
    let clip = view.clip_from_eye * vec4f(placed.p, 1.0);
    let field_xyw = vec3f(clip.xy * view.field.xy, clip.w);
    let surface = vec3f(material, frame.instruments[which].shape.zw);
    let axis = frame.instruments[which].eye_from_instrument[2].xyz;
    return Metal(clip, placed.p, placed.n, field_xyw, surface, axis);
}

// Mean colour of the fundus, linear: what a mirror in the eye shows of it.
const FUNDUS: vec3f = vec3f(0.38, 0.20, 0.145);
// Share of the light that bare steel mirrors.
const STEEL: vec3f = vec3f(0.66, 0.67, 0.69);

// What a mirrored ray from `p` meets: the lit retina, the dark before it, where the ray leaves
// through the pupil.
fn mirrored(p: vec3f, ray: vec3f) -> vec3f {
    let radius = frame.retina.x;
    let per_radius = frame.penumbra.z;
    let b = dot(p, ray);
    let hit = p + (sqrt(max(b * b - dot(p, p) + radius * radius, 0.0)) - b) * ray;
    let lamp = lamp_at(hit);
    let lit = lamp.strength * max(-dot(hit, lamp.l) * per_radius, 0.0);
    let behind = 1.0 - smoothstep(-0.2, 0.5, hit.z * per_radius);
    return FUNDUS * behind * (2.0 * frame.ambient.rgb + frame.lamp_colour.rgb * min(lit, 3.0));
}

@fragment
fn fs_main(in: Metal) -> @location(0) vec4f {
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    let n = normalize(in.n);
    let v = normalize(view.camera.xyz - in.p);
    // Steel turned on a lathe: grooves run round the shaft and draw every light out along it.
    let grooves = cross(in.axis, n) + vec3f(1e-5, 0.0, 0.0);
    let facing = max(dot(n, v), 0.0);
    // The microscope's own light, from where one looks, keeps the shaft readable against the dark.
    let coaxial = vec3f(0.078, 0.082, 0.088) * (facing * facing * facing * facing);
    var light = STEEL * (0.55 * mirrored(in.p, reflect(-v, n)) + 0.3 * frame.ambient.rgb + coaxial);
    if in.surface.z > 0.0 {
        let lamp = lamp_at(in.p);
        // Half way between lamp and viewer, of any length: only squares of cosines are needed.
        let half_way = lamp.l + v;
        let per_square = 1.0 / max(dot(half_way, half_way), 1e-6);
        let across = dot(grooves, half_way);
        let along = 1.0 - across * across * per_square / dot(grooves, grooves);
        let streak = gloss_of_square(max(along, 0.0)) * smoothstep(-0.1, 0.3, dot(n, lamp.l));
        let towards = max(dot(n, half_way), 0.0);
        let direct = 0.14 * max(dot(n, lamp.l), 0.0) + 0.35 * streak + 0.9 * gloss_of_square(towards * towards * per_square);
        light += STEEL * frame.lamp_colour.rgb * (min(lamp.strength, 4.0) * direct);
    }
    if in.surface.x > 1.5 {
        light = light * 0.12;
    } else if in.surface.x > 0.5 {
        // The face sends out the beam; the sides glow.
        let face = max(-dot(n, in.axis), 0.0);
        light = frame.lamp_colour.rgb * (0.8 + 3.2 * face * face);
    }
    return vec4f(to_display(light) * shade, in.surface.y);
}
