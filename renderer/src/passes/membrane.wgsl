// The membrane: a thin translucent sheet, seen and lit from both sides, with a sheen like
// cellophane.

struct Sheet {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    // field coordinates times w, and w: divided in the fragment, since they bend over long
    // triangles
    @location(2) field_xyw: vec3f,
    // 1 on an edge of the sheet; share of the dye that it can take.
    @location(3) edge_dye: vec2f,
    // Where it lay at the start (mm), and how far from the edge of the mesh (mm).
    @location(4) home: vec3f,
}

@vertex
fn vs_main(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) edge: f32,
    @location(3) dye: f32,
    @location(4) home: vec3f,
) -> Sheet {
    let clip = view.clip_from_eye * vec4f(position, 1.0);
    let field_xyw = vec3f(clip.xy * view.field.xy, clip.w);
    return Sheet(clip, position, normal, field_xyw, vec2f(edge, dye), vec3f(rest_place(home.xy), home.z));
}

struct Shaded {
    // Light of the lamp that the sheet sends to the viewer, linear.
    lit: vec3f,
    opacity: f32,
}

// Opacity from which the sheet itself, not what lies behind it, is in or out of focus.
const SEEN: f32 = 0.4;
const TINT: vec3f = vec3f(0.66, 0.74, 0.70);
// Brilliant blue G, with which surgeons stain it.
const DYE: vec3f = vec3f(0.04, 0.16, 0.62);

fn tint(dye: f32) -> vec3f {
    return mix(TINT, DYE, dye);
}

// Patterns of the tissue a millimetre.
const GRAIN: f32 = 2.1;

// Scar tissue grows in patches and strands: 0 where it is a mere film, 1 where it is white.
fn thickness(at: vec2f) -> f32 {
    let rest = at * GRAIN;
    let bent = rest + 0.7 * vec2f(sin(rest.y * 0.9 + 0.4), sin(rest.x * 0.7 - 1.1));
    let patches = sin(bent.x * 0.8 + 0.6 * sin(bent.y * 0.5)) * sin(bent.y * 0.9 - 0.3 * bent.x + 1.7);
    let strands = sin(bent.x * 2.1 + 3.3 * bent.y + 1.6 * sin(bent.x * 0.6));
    return smoothstep(-0.7, 1.1, patches + 0.45 * strands * strands * strands);
}

// Without shadow; the scattered light comes on top.
fn shaded(p: vec3f, normal: vec3f, edge_dye: vec2f, past: f32, home: vec3f) -> Shaded {
    let v = normalize(view.camera.xyz - p);
    let facing = abs(dot(normal, v));
    let n = normal * sign(dot(normal, v) + 1e-6);
    let lamp = lamp_at(p);
    let strength = lamp.strength * past;
    let rim = (1.0 - facing) * (1.0 - facing);
    let sheen = strength * gloss(max(dot(n, normalize(lamp.l + v)), 0.0)) * (0.5 + rim);
    let lit = tint(edge_dye.y) * (strength * (0.25 + 0.6 * abs(dot(n, lamp.l)))) + vec3f(sheen);
    // Where it was cut or torn the edge curls in and is white.
    let cut = edge_dye.x * edge_dye.x * smoothstep(0.0, 0.2, home.z);
    let body = 0.07 + 0.19 * thickness(home.xy) + 0.25 * cut + 0.32 * edge_dye.y;
    let opacity = clamp((body + 0.6 * rim + 0.4 * sheen) * grown(home.xy, home.z, frame.retina.x - length(p)), 0.0, 0.92);
    return Shaded(frame.lamp_colour.rgb * lit, opacity);
}

// Tilt of fine wrinkles of two sizes that run in different directions, bend, and are drawn in some
// places and smooth in others.
fn wrinkled(at: vec2f) -> vec3f {
    let rest = at * GRAIN;
    let bent = rest + vec2f(0.5 * sin(1.1 * rest.y + 0.9 * sin(0.7 * rest.x)), 0.6 * sin(0.8 * rest.x - 0.5 * rest.y));
    let drawn = smoothstep(-0.5, 0.9, sin(0.9 * bent.x + 0.4) * sin(1.3 * bent.y - 0.9));
    let fine = (0.2 + 0.8 * drawn) * sin(6.0 * bent.x + 3.0 * bent.y + 1.5 * sin(2.0 * bent.y));
    let coarse = (1.0 - 0.7 * drawn) * sin(3.7 * bent.y - 1.9 * bent.x + 2.0 * sin(1.3 * bent.x));
    return vec3f(fine + 0.5 * coarse, 0.6 * coarse - 0.4 * fine, 0.0);
}

@fragment
fn fs_main(in: Sheet) -> @location(0) vec4f {
    let wrinkles = wrinkled(in.home.xy) * frame.shadow.w;
    let at = lamp_coordinates(in.p);
    let sheet = shaded(in.p, normalize(normalize(in.n) + wrinkles), in.edge_dye, lit_past_instruments(at.xy, at.z), in.home);
    let shade = vignette(in.field_xyw.xy / in.field_xyw.z);
    return vec4f(to_display(tint(in.edge_dye.y) * frame.ambient.rgb + sheet.lit) * shade, sheet.opacity);
}

// Depth of what is seen rather than seen through: folds, edges, sheen.
@fragment
fn fs_depth(in: Sheet) -> @location(0) vec4f {
    if shaded(in.p, normalize(in.n), in.edge_dye, 1.0, in.home).opacity < SEEN {
        discard;
    }
    return vec4f(0.0);
}

// The sheet's triangles are a few pixels large, so a pixel is shaded several times: everything is done
// at the nodes.
struct LeanSheet {
    @builtin(position) clip: vec4f,
    // As it is shown, and opacity.
    @location(0) shown: vec4f,
}

@vertex
fn vs_lean(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) edge: f32,
    @location(3) dye: f32,
    @location(4) home: vec3f,
) -> LeanSheet {
    let past = past_casters(position);
    let sheet = shaded(position, normal, vec2f(edge, dye), past, vec3f(rest_place(home.xy), home.z));
    let clip = view.clip_from_eye * vec4f(position, 1.0);
    let light = tint(dye) * frame.ambient.rgb + sheet.lit;
    return LeanSheet(clip, vec4f(to_display(light) * field_shade(clip), sheet.opacity));
}

@fragment
fn fs_lean(in: LeanSheet) -> @location(0) vec4f {
    return in.shown;
}
