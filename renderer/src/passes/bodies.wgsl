// Rigid bodies of abstract tasks: unit shapes, scaled, turned and placed by each body.

// A corner of a unit shape, and the body of which it is one.
struct Corner {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    // ±1 on the halves of a capsule (along z, with its caps inside the half extents), 0 elsewhere.
    @location(2) cap: f32,
    @location(3) unused: f32,
    @location(4) at: vec3f,
    @location(5) rotation: vec4f,
    @location(6) half: vec3f,
    @location(7) rgba: vec4f,
}

struct Body {
    @builtin(position) clip: vec4f,
    @location(0) p: vec3f,
    @location(1) n: vec3f,
    @location(2) rgba: vec4f,
}

fn turned(q: vec4f, v: vec3f) -> vec3f {
    return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
}

fn place_body(in: Corner) -> Placed {
    let straight = vec3f(0.0, 0.0, in.cap * max(in.half.z - in.half.x, 0.0));
    let extents = select(max(in.half, vec3f(1e-4)), vec3f(max(in.half.x, 1e-4)), in.cap != 0.0);
    let p = turned(in.rotation, in.position * extents + straight) + in.at;
    return Placed(p, turned(in.rotation, normalize(in.normal / extents)));
}

@vertex
fn vs_main(in: Corner) -> Body {
    let placed = place_body(in);
    return Body(view.clip_from_eye * vec4f(placed.p, 1.0), placed.p, placed.n, in.rgba);
}

@fragment
fn fs_main(in: Body) -> @location(0) vec4f {
    let n = normalize(in.n);
    let v = normalize(view.camera.xyz - in.p);
    let lamp = lamp_at(in.p);
    let strength = lamp.strength * past_casters(in.p + 0.06 * lamp.l);
    let diffuse = max(dot(n, lamp.l), 0.0);
    // A body of a task must be seen outside the beam too.
    let scattered = frame.ambient.rgb * 2.0 + vec3f(0.05 * (0.4 + 0.6 * max(dot(n, v), 0.0)));
    let glint = 0.25 * strength * gloss(max(dot(n, normalize(lamp.l + v)), 0.0));
    let colour = in.rgba.rgb * (scattered + frame.lamp_colour.rgb * (strength * diffuse)) + frame.lamp_colour.rgb * glint;
    return vec4f(to_display(colour) * field_shade(view.clip_from_eye * vec4f(in.p, 1.0)), in.rgba.a);
}

@vertex
fn vs_shadow(in: Corner) -> Caster {
    return caster(place_body(in).p);
}
