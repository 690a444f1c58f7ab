// Where a vertex of an instrument lies in the eye: jaws turn about y at their pivot, by part = ±1.

// A vertex of an instrument's mesh, as in layout.rs.
struct MetalVertex {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    // 1 or -1 on a jaw.
    @location(2) part: f32,
    @location(3) material: f32,
    // Which instrument.
    @builtin(instance_index) which: u32,
}

struct Placed {
    p: vec3f,
    n: vec3f,
}

fn turn_about_y(v: vec3f, angle: f32) -> vec3f {
    let s = sin(angle);
    let c = cos(angle);
    return vec3f(c * v.x + s * v.z, v.y, c * v.z - s * v.x);
}

fn place_instrument(position: vec3f, normal: vec3f, part: f32, which: u32) -> Placed {
    let shape = frame.instruments[which].shape;
    // The jaw lies at z below its pivot: to open towards +x it turns by a negative angle.
    let angle = -part * shape.x;
    let pivot = vec3f(0.0, 0.0, shape.y);
    let p = turn_about_y(position - pivot, angle) + pivot;
    let m = frame.instruments[which].eye_from_instrument;
    return Placed((m * vec4f(p, 1.0)).xyz, (m * vec4f(turn_about_y(normal, angle), 0.0)).xyz);
}

// Across the shaft of instrument `which`, `z` mm over its tip, as it is seen from `eye`.
struct Across {
    axis: vec3f,
    // Unit, at right angles to the shaft, on the side of `eye`.
    up: vec3f,
    // Unit, at right angles to the shaft and to the line of sight.
    side: vec3f,
    // The way of a millimetre along `side` in NDC.
    ndc_per_mm: vec2f,
}

fn across(z: f32, which: u32, eye: vec3f, clip_from_eye: mat4x4f) -> Across {
    let m = frame.instruments[which].eye_from_instrument;
    let axis = (m * vec4f(0.0, 0.0, z, 1.0)).xyz;
    let v = normalize(eye - axis);
    let side = normalize(cross(m[2].xyz, v) + vec3f(1e-6, 0.0, 0.0));
    let clip = clip_from_eye * vec4f(axis, 1.0);
    let step = clip_from_eye * vec4f(side, 0.0);
    return Across(axis, cross(side, m[2].xyz), side, (step.xy * clip.w - clip.xy * step.w) / (clip.w * clip.w));
}
