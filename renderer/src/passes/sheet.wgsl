// Where a membrane's tissue lay at the start, and how it grew there. Put before the shaders that draw
// membranes or their shadows.

// Way to the edge of the mesh within which the tissue thins out, mm: on average, and how far that
// wanders by waves of two lengths.
const FRINGE: f32 = 0.40;
const LONG_WAVE: f32 = 0.26;
const SHORT_WAVE: f32 = 0.08;
// Width over which it thins out, mm.
const THINNING: f32 = 0.24;
// What of the tissue is left beyond, by which an instrument takes hold of it.
const LEFT_AT_EDGE: f32 = 0.15;
// That film ends before the straight edge of the mesh, in a line that wanders as far; and width over
// which it fades, mm.
const FILM_WAVE: f32 = 0.05;
const FADING: f32 = 0.12;
// The same where it is lifted: seen from the side and drawn together, the film shows. Heights over the
// choroid between which it comes into view, mm.
const LEFT_WHEN_LIFTED: f32 = 0.8;
const LIFTED: vec2f = vec2f(0.3, 1.0);

// Place at which a point of the tissue lay, mm in the map's plane, from its place in the map.
fn rest_place(in_map: vec2f) -> vec2f {
    return (in_map - vec2f(0.5)) * (frame.retina.x / frame.retina.y);
}

// Share of the tissue that grew at a place, `from_edge` mm from the edge of the mesh and now `height` mm
// over the choroid: scar tissue ends in an irregular line. What is cut or torn later ends where it is
// cut.
fn grown(rest: vec2f, from_edge: f32, height: f32) -> f32 {
    let long = sin(1.7 * rest.x + 1.5 * sin(1.3 * rest.y + 0.6)) * sin(1.9 * rest.y - 0.8 * rest.x + 0.4);
    let short = sin(6.1 * rest.x - 4.3 * rest.y + 1.4 * sin(3.7 * rest.x));
    let within = from_edge - FRINGE - LONG_WAVE * long - SHORT_WAVE * short;
    let film = smoothstep(0.0, FADING, from_edge - FILM_WAVE * (1.0 + sin(9.0 * rest.y + 2.0 * short) * sin(8.0 * rest.x - 1.1)));
    let left = film * mix(LEFT_AT_EDGE, LEFT_WHEN_LIFTED, smoothstep(LIFTED.x, LIFTED.y, height));
    return mix(left, 1.0, smoothstep(-0.5 * THINNING, 0.5 * THINNING, within));
}
