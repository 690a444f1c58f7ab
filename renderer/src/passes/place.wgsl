// Where a vertex of an instrument lies in the eye: jaws turn about y at their pivot, by part = ±1.

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
