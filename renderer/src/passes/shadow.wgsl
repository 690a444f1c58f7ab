// Depth as the lamp sees it: instruments into the left tile, the membrane into the right one.

@vertex
fn vs_instrument(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) part: f32,
    @location(3) material: f32,
    @builtin(instance_index) which: u32,
) -> @builtin(position) vec4f {
    return frame.lamp_from_eye * vec4f(place_instrument(position, normal, part, which).p, 1.0);
}

@vertex
fn vs_membrane(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) edge: f32,
    @location(3) number: f32,
) -> @builtin(position) vec4f {
    return frame.lamp_from_eye * vec4f(position, 1.0);
}
