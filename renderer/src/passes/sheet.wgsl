// Where a membrane's tissue lay at the start, and how it grew there. Put before the shaders that draw
// membranes or their shadows.

// Way to the edge of the mesh within which the tissue thins out, mm: on average, and how far that
// wanders by waves of two lengths.
const FRINGE: f32 = 0.40;
const LONG_WAVE: f32 = 0.26;
const SHORT_WAVE: f32 = 0.08;
// Width over which it thins out, mm.
const THINNING: f32 = 0.24;
// What of the tissue is left at the edge of the mesh, by which an instrument takes hold of it.
const LEFT_AT_EDGE: f32 = 0.15;

// Place at which a point of the tissue lay, mm in the map's plane, from its place in the map.
fn rest_place(in_map: vec2f) -> vec2f {
    return (in_map - vec2f(0.5)) * (frame.retina.x / frame.retina.y);
}

// Share of the tissue that grew at a place, `from_edge` mm from the edge of the mesh: scar tissue ends
// in an irregular line. What is cut or torn later ends where it is cut.
fn grown(rest: vec2f, from_edge: f32) -> f32 {
    let long = sin(1.7 * rest.x + 1.5 * sin(1.3 * rest.y + 0.6)) * sin(1.9 * rest.y - 0.8 * rest.x + 0.4);
    let short = sin(6.1 * rest.x - 4.3 * rest.y + 1.4 * sin(3.7 * rest.x));
    let within = from_edge - FRINGE - LONG_WAVE * long - SHORT_WAVE * short;
    return mix(LEFT_AT_EDGE, 1.0, smoothstep(-0.5 * THINNING, 0.5 * THINNING, within));
}
