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

fn seen_across(z: f32, which: u32) -> Across {
    return across(z, which, view.camera.xyz, view.clip_from_eye);
}

fn pixels(ndc: vec2f) -> f32 {
    return max(length(ndc * view.field.xy) / (view.field.y * view.camera.w), 1e-3);
}

// Where a pixel has one sample, round parts are drawn half a pixel thinner: so wide are they to where
// a pixel is covered to the full. The rest of the edge is drawn by fs_edge. Jaws end as wide as the
// shaft begins.
fn inside_edge(position: vec3f, which: u32) -> f32 {
    if !LEAN || position.z < frame.instruments[which].shaft.w - 0.01 {
        return 1.0;
    }
    let radius_px = length(position.xy) * pixels(seen_across(position.z, which).ndc_per_mm);
    return max(1.0 - 0.5 / max(radius_px, 1e-3), 0.0);
}

// The normal of a part that is drawn with the share `inside` of its width, as it is where the whole
// part is seen so far from its axis.
fn normal_inside(n: vec3f, p: vec3f, axis: vec3f, inside: f32) -> vec3f {
    let v = normalize(view.camera.xyz - p);
    let side = normalize(cross(axis, v) + vec3f(1e-6, 0.0, 0.0));
    let up = cross(side, axis);
    let sideways = dot(n, side);
    let towards = dot(n, up);
    let turned = sqrt(max(towards * towards + sideways * sideways * (1.0 - inside * inside), 0.0));
    return n - side * (sideways * (1.0 - inside)) + up * (turned - towards);
}

@vertex
fn vs_main(in: MetalVertex) -> Metal {
    let inside = inside_edge(in.position, in.which);
    let placed = place_instrument(vec3f(in.position.xy * inside, in.position.z), in.normal, in.part, in.which);
    let clip = view.clip_from_eye * vec4f(placed.p, 1.0);
    let field_xyw = vec3f(clip.xy * view.field.xy, clip.w);
    let surface = vec3f(in.material, frame.instruments[in.which].shape.zw);
    let axis = frame.instruments[in.which].eye_from_instrument[2].xyz;
    let n = select(placed.n, normal_inside(placed.n, placed.p, axis, inside), LEAN);
    return Metal(clip, placed.p, n, field_xyw, surface, axis);
}

// Mean colour of the fundus, linear: what a mirror in the eye shows of it.
const FUNDUS: vec3f = vec3f(0.38, 0.20, 0.145);
// Share of the light that bare steel mirrors.
const STEEL: vec3f = vec3f(0.66, 0.67, 0.69);

// What a mirrored ray from `p` meets: the lit retina, the dark before it, where the ray leaves
// through the pupil.
fn mirrored(p: vec3f, ray: vec3f) -> vec3f {
    let per_radius = frame.penumbra.z;
    let hit = on_retina(p, ray);
    let lamp = lamp_at(hit);
    let lit = lamp.strength * max(-dot(hit, lamp.l) * per_radius, 0.0);
    let behind = 1.0 - smoothstep(-0.2, 0.5, hit.z * per_radius);
    return FUNDUS * behind * (2.0 * frame.ambient.rgb + frame.lamp_colour.rgb * min(lit, 3.0));
}

// Light that metal, fibre or port (`surface`, as in Metal) at `p` with the normal `n` sends to the
// viewer, linear; `axis` of the shaft.
fn sent(p: vec3f, n: vec3f, axis: vec3f, surface: vec3f) -> vec3f {
    let v = normalize(view.camera.xyz - p);
    // Steel turned on a lathe: grooves run round the shaft and draw every light out along it.
    let grooves = cross(axis, n) + vec3f(1e-5, 0.0, 0.0);
    let facing = max(dot(n, v), 0.0);
    // The microscope's own light, from where one looks, keeps the shaft readable against the dark.
    let coaxial = vec3f(0.078, 0.082, 0.088) * (facing * facing * facing * facing);
    var light = STEEL * (0.55 * mirrored(p, reflect(-v, n)) + 0.3 * frame.ambient.rgb + coaxial);
    if surface.z > 0.0 {
        let lamp = lamp_at(p);
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
    if surface.x > 1.5 {
        light = light * 0.12;
    } else if surface.x > 0.5 {
        // The face sends out the beam; the sides glow.
        let face = max(-dot(n, axis), 0.0);
        light = frame.lamp_colour.rgb * (0.8 + 3.2 * face * face);
    }
    return light;
}

@fragment
fn fs_main(in: Metal) -> @location(0) vec4f {
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    let light = sent(in.p, normalize(in.n), in.axis, in.surface);
    return vec4f(to_display(light) * shade, in.surface.y);
}

struct Edge {
    @builtin(position) clip: vec4f,
    // As it is shown without vignette, and opacity.
    @location(0) shown: vec4f,
    // field coordinates times w, and w
    @location(1) field_xyw: vec3f,
    // Way from the axis, half the width of the strip (px), share of a pixel that the part covers at
    // most.
    @location(2) across: vec3f,
}

// A strip through the axis of a round part (`position.x` is its radius, with the side as its sign),
// wider by half a pixel on both sides. The part itself hides all of it but the pixels on its edge.
// They are few, lie in a row and are lit alike, so light is computed at the strip's corners.
@vertex
fn vs_edge(in: MetalVertex) -> Edge {
    let at = seen_across(in.position.z, in.which);
    let px_per_mm = pixels(at.ndc_per_mm);
    let radius_px = abs(in.position.x) * px_per_mm;
    let half_px = radius_px + 0.5;
    let p = at.axis + at.side * (in.normal.x * half_px / px_per_mm);
    // Of what is seen of the part in the pixels on its edge.
    let sine = clamp(1.0 - 0.75 / max(radius_px, 1e-3), 0.0, 1.0);
    let n = at.side * (in.normal.x * sine) + at.up * sqrt(1.0 - sine * sine);
    let surface = vec3f(in.material, frame.instruments[in.which].shape.zw);
    let axis = frame.instruments[in.which].eye_from_instrument[2].xyz;
    let light = sent(at.axis + n * abs(in.position.x), n, axis, surface);
    let clip = view.clip_from_eye * vec4f(p, 1.0);
    let wide = vec3f(in.normal.x * half_px, half_px, min(2.0 * radius_px, 1.0));
    return Edge(clip, vec4f(to_display(light), surface.y), vec3f(clip.xy * view.field.xy, clip.w), wide);
}

@fragment
fn fs_edge(in: Edge) -> @location(0) vec4f {
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    let covered = clamp(in.across.y - abs(in.across.x), 0.0, in.across.z);
    return vec4f(in.shown.rgb * shade, in.shown.a * covered);
}
