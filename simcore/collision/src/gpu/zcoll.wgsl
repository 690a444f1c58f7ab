// ZCOLL in whole numbers: the cull, the two passes that draw depth and triangle, the comparison
// with the instrument, and the reduction to triangles and nodes. Behind soft_float.wgsl and
// wide.wgsl.

// The parameters of a query. Mirrored by `QueryParams` in layout.rs.
struct QueryParams {
    // Rows of eye frame → instrument frame, bits of f32; w: the tip's x, y, z in the eye frame.
    turn: array<vec4<u32>, 3>,
    // Bits of f32: scale and offset of x and y, then of z.
    format: vec4<u32>,
    // Bits of f32: the limits of x and y, then of z; then 1/2; then 1 if nothing may be culled by
    // estimate.
    bound: vec4<u32>,
    // The same limits as whole numbers, the number of depth steps, and the resolution.
    limit: vec4<i32>,
    // First column and row of the instrument's rectangle, and one past the last.
    rect: vec4<i32>,
    // The box of the estimate, mm: lower corner, upper corner.
    low: vec4<f32>,
    high: vec4<f32>,
    // Triangles, vertices; where the nodes' list begins in `results`, and the pixels'.
    count: vec4<u32>,
}

@group(0) @binding(0) var<uniform> params: QueryParams;
// x of all vertices, then y, then z: bits of f32, eye frame, mm.
@group(0) @binding(1) var<storage, read> position: array<u32>;
@group(0) @binding(2) var<storage, read> corner: array<u32>;
// One bit a triangle.
@group(0) @binding(3) var<storage, read> alive: array<u32>;
// The instrument's depth image.
@group(0) @binding(4) var<storage, read> instrument: array<i32>;
@group(0) @binding(5) var<storage, read_write> survivor: array<u32>;
// Counters (see below), then an image each of: nearest depth, times seen, triangle.
@group(0) @binding(6) var<storage, read_write> work: array<atomic<u32>>;
// Longest vector of each triangle, then of each node; all 0 between queries.
@group(0) @binding(7) var<storage, read_write> longest: array<atomic<u32>>;
// Pairs (triangle, way), then pairs (node, way), then triples (pixel, triangle, way).
@group(0) @binding(8) var<storage, read_write> results: array<u32>;

const SURVIVORS: u32 = 0u;
const PIXELS: u32 = 1u;
const DEEPEST: u32 = 2u;
const FOLDED: u32 = 3u;
const REFUSED_TRIANGLES: u32 = 4u;
const FLAT: u32 = 5u;
const TRIANGLES: u32 = 6u;
const NODES: u32 = 7u;
const TOUCHED: u32 = 8u;
const IMAGES: u32 = 16u;

const PIXEL_BITS: u32 = 8u;
const SUBPIXELS: i32 = 256;
const NOTHING: i32 = 0x7fffffff;
const PLANES: u32 = 0x3fu;
const REFUSED: u32 = 0x40u;

// Threads of a workgroup, and triangles it takes at once.
const GROUP: u32 = 64u;

fn corners_of(triangle: u32) -> vec3<u32> {
    let first = 3u * triangle;
    return vec3<u32>(corner[first], corner[first + 1u], corner[first + 2u]);
}

fn vertex(number: u32) -> vec3<u32> {
    let n = params.count.y;
    return vec3<u32>(position[number], position[n + number], position[2u * n + number]);
}

// ---- The cull: an estimate, wide enough for any rounding, that may only drop what the whole
// numbers would drop.

// From here on (10⁶ mm) the estimate says nothing; infinity and what is not a number lie beyond.
const FAR: u32 = 0x49742400u;
// More than the rounding of the estimate, relative to the sum of distances: nine operations of 2⁻²³
// each, and as much again.
const SLACK: f32 = 4e-6;

fn planes_beyond(p: vec3<u32>) -> u32 {
    if any((p & vec3<u32>(~SIGN)) >= vec3<u32>(FAR)) {
        return 0u;
    }
    let tip = bitcast<vec3<f32>>(vec3<u32>(params.turn[0].w, params.turn[1].w, params.turn[2].w));
    let d = bitcast<vec3<f32>>(p) - tip;
    let slack = SLACK * (abs(d.x) + abs(d.y) + abs(d.z));
    var beyond = 0u;
    for (var axis = 0u; axis < 3u; axis += 1u) {
        let value = dot(bitcast<vec3<f32>>(params.turn[axis].xyz), d);
        beyond |= select(0u, 1u, value + slack < params.low[axis]) << (2u * axis);
        beyond |= select(0u, 2u, value - slack > params.high[axis]) << (2u * axis);
    }
    return beyond;
}

@compute @workgroup_size(64)
fn cull(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var t = id.x; t < params.count.x; t += GROUP * groups.x) {
        if ((alive[t >> 5u] >> (t & 31u)) & 1u) == 0u {
            continue;
        }
        let v = corners_of(t);
        if params.bound.w == 0u {
            let beyond = planes_beyond(vertex(v.x)) & planes_beyond(vertex(v.y)) & planes_beyond(vertex(v.z));
            if beyond != 0u {
                continue;
            }
        }
        survivor[atomicAdd(&work[SURVIVORS], 1u)] = t;
    }
}

// ---- Vertices into whole steps, exactly as placing.rs does it.

struct Placed {
    at: vec3<i32>,
    code: u32,
}

fn along(axis: u32, d: vec3<u32>) -> u32 {
    let row = params.turn[axis];
    return float_add(float_add(float_mul(row.x, d.x), float_mul(row.y, d.y)), float_mul(row.z, d.z));
}

fn to_fixed(value: u32, scale: u32, offset: u32, bound: u32, limit: i32) -> i32 {
    var step = float_add(float_mul(value, scale), offset);
    if !float_less(bound | SIGN, step) {
        step = bound | SIGN;
    }
    if !float_less(step, bound) {
        step = bound;
    }
    return float_floor(float_add(float_add(step, bound), params.bound.z)) - limit;
}

fn place(number: u32) -> Placed {
    let p = vertex(number);
    let d = vec3<u32>(
        float_sub(p.x, params.turn[0].w),
        float_sub(p.y, params.turn[1].w),
        float_sub(p.z, params.turn[2].w),
    );
    var placed = Placed(vec3<i32>(0), 0u);
    for (var axis = 0u; axis < 3u; axis += 1u) {
        let value = along(axis, d);
        let deep = axis == 2u;
        let scale = select(params.format.x, params.format.z, deep);
        let offset = select(params.format.y, params.format.w, deep);
        let limit = select(params.limit.x, params.limit.y, deep);
        let step = to_fixed(value, scale, offset, select(params.bound.x, params.bound.y, deep), limit);
        var low = 0;
        var high = params.limit.z;
        if axis == 0u {
            low = params.rect.x * SUBPIXELS;
            high = params.rect.z * SUBPIXELS;
        } else if axis == 1u {
            low = params.rect.y * SUBPIXELS;
            high = params.rect.w * SUBPIXELS;
        }
        if !is_nan(value) {
            placed.code |= select(0u, 1u, step < low) << (2u * axis);
            placed.code |= select(0u, 2u, step > high) << (2u * axis);
        }
        placed.code |= select(0u, REFUSED, step <= -limit || step >= limit);
        placed.at[axis] = step;
    }
    return placed;
}

// ---- Drawing. A workgroup places 64 triangles, one a thread, then all threads share their pixels
// evenly.

struct Ready {
    a: vec3<i32>,
    b: vec3<i32>,
    c: vec3<i32>,
    // First column and row.
    first: vec2<i32>,
    columns: u32,
    triangle: u32,
}

var<workgroup> ready: array<Ready, 64>;
// Pixels before those of each triangle, and of all.
var<workgroup> before: array<u32, 65>;
var<workgroup> survivors: u32;

// Twice the area on the left of the way from p to q, seen from r.
fn edge(p: vec2<i32>, q: vec2<i32>, r: vec2<i32>) -> vec2<u32> {
    let d = q - p;
    let e = r - p;
    return wide_sub(wide_product(d.x, e.y), wide_product(d.y, e.x));
}

// Pixels of an axis whose centres lie between the extremes, within first..end.
fn span(a: i32, b: i32, c: i32, first: i32, end: i32) -> vec2<i32> {
    let low = min(a, min(b, c));
    let high = max(a, max(b, c));
    let half = SUBPIXELS / 2;
    return vec2<i32>(max((low + half - 1) >> PIXEL_BITS, first), min(((high - half) >> PIXEL_BITS) + 1, end));
}

// Makes a triangle ready for its slot of the workgroup; how many pixels its box has. Counts what
// cannot be drawn if it should.
fn prepare(slot: u32, triangle: u32, counts: bool) -> u32 {
    let v = corners_of(triangle);
    let p = place(v.x);
    let q = place(v.y);
    let r = place(v.z);
    if (p.code & q.code & r.code & PLANES) != 0u {
        return 0u;
    }
    if ((p.code | q.code | r.code) & REFUSED) != 0u {
        if counts {
            atomicAdd(&work[REFUSED_TRIANGLES], 1u);
        }
        return 0u;
    }
    let area = edge(p.at.xy, q.at.xy, r.at.xy);
    if wide_zero(area) {
        if counts {
            atomicAdd(&work[FLAT], 1u);
        }
        return 0u;
    }
    let columns = span(p.at.x, q.at.x, r.at.x, params.rect.x, params.rect.z);
    let rows = span(p.at.y, q.at.y, r.at.y, params.rect.y, params.rect.w);
    if columns.x >= columns.y || rows.x >= rows.y {
        return 0u;
    }
    let turned = wide_negative(area);
    let b = select(q.at, r.at, turned);
    let c = select(r.at, q.at, turned);
    let across = u32(columns.y - columns.x);
    ready[slot] = Ready(p.at, b, c, vec2<i32>(columns.x, rows.x), across, triangle);
    return across * u32(rows.y - rows.x);
}

// True if a pixel centre with this edge function is on the inner side; on the edge only if it is a
// top or a left one.
fn inside(e: vec2<u32>, p: vec2<i32>, q: vec2<i32>) -> bool {
    let d = q - p;
    let owns = d.y < 0 || (d.y == 0 && d.x > 0);
    return !wide_negative(e) && (owns || !wide_zero(e));
}

// A pixel and the depth of a triangle there; depth −1 where it does not lie, or the instrument does
// not, or outside the volume.
struct Fragment {
    pixel: u32,
    depth: i32,
    triangle: u32,
}

fn fragment(number: u32) -> Fragment {
    var low = 0u;
    var high = GROUP;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if before[middle] <= number {
            low = middle;
        } else {
            high = middle;
        }
    }
    let t = ready[low];
    let rest = number - before[low];
    let at = t.first + vec2<i32>(i32(rest % t.columns), i32(rest / t.columns));
    let pixel = u32(at.y * params.limit.w + at.x);
    let none = Fragment(pixel, -1, t.triangle);
    if instrument[pixel] == NOTHING {
        return none;
    }
    let centre = at * SUBPIXELS + vec2<i32>(SUBPIXELS / 2);
    let opposite_a = edge(t.b.xy, t.c.xy, centre);
    let opposite_b = edge(t.c.xy, t.a.xy, centre);
    let opposite_c = edge(t.a.xy, t.b.xy, centre);
    let covered = inside(opposite_a, t.b.xy, t.c.xy)
        && inside(opposite_b, t.c.xy, t.a.xy)
        && inside(opposite_c, t.a.xy, t.b.xy);
    if !covered {
        return none;
    }
    // Over the nearest corner: all unsigned, and the three weights add up to the area.
    let z = vec3<i32>(t.a.z, t.b.z, t.c.z);
    let nearest = min(z.x, min(z.y, z.z));
    let over = vec3<u32>(z - vec3<i32>(nearest));
    let area = wide_add(wide_add(opposite_a, opposite_b), opposite_c);
    let numerator = wide_add(
        wide_add(wide_times(opposite_a, over.x), wide_times(opposite_b, over.y)),
        wide_times(opposite_c, over.z),
    );
    let depth = nearest + i32(wide_quotient(numerator, area, max(over.x, max(over.y, over.z))));
    if depth < 0 || depth > params.limit.z {
        return none;
    }
    return Fragment(pixel, depth, t.triangle);
}

fn pixels_of_image() -> u32 {
    return u32(params.limit.w * params.limit.w);
}

// Nearer is larger, 0 is nothing.
fn nearness(depth: i32) -> u32 {
    return u32(params.limit.z + 1 - depth);
}

fn draw(lane: u32, group: u32, groups: u32, names: bool) {
    if lane == 0u {
        survivors = atomicLoad(&work[SURVIVORS]);
    }
    let all = workgroupUniformLoad(&survivors);
    for (var first = group * GROUP; first < all; first += groups * GROUP) {
        var mine = 0u;
        if first + lane < all {
            mine = prepare(lane, survivor[first + lane], !names);
        }
        before[lane + 1u] = mine;
        workgroupBarrier();
        if lane == 0u {
            before[0] = 0u;
            for (var i = 1u; i <= GROUP; i += 1u) {
                before[i] += before[i - 1u];
            }
        }
        workgroupBarrier();
        for (var number = lane; number < before[GROUP]; number += GROUP) {
            let seen = fragment(number);
            if seen.depth < 0 {
                continue;
            }
            let at = IMAGES + seen.pixel;
            if names {
                // The first triangle of those that are nearest.
                if atomicLoad(&work[at]) == nearness(seen.depth) {
                    atomicMax(&work[at + 2u * pixels_of_image()], ~seen.triangle);
                }
            } else {
                atomicMax(&work[at], nearness(seen.depth));
                if atomicAdd(&work[at + pixels_of_image()], 1u) == 1u {
                    atomicAdd(&work[FOLDED], 1u);
                }
            }
        }
        workgroupBarrier();
    }
}

@compute @workgroup_size(64)
fn draw_depth(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    draw(lane, group.x, groups.x, false);
}

@compute @workgroup_size(64)
fn draw_name(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    draw(lane, group.x, groups.x, true);
}

// ---- Comparison and reduction: one workgroup, so that its barriers order everything.

// How far the instrument has passed the membrane in a pixel, steps; 0 where it has not.
fn way_in(pixel: u32) -> i32 {
    let near = atomicLoad(&work[IMAGES + pixel]);
    let z_i = instrument[pixel];
    if near == 0u || z_i == NOTHING {
        return 0;
    }
    return max(params.limit.z + 1 - i32(near) - z_i, 0);
}

fn pixel_of_rect(number: u32) -> u32 {
    let across = u32(params.rect.z - params.rect.x);
    return (u32(params.rect.y) + number / across) * u32(params.limit.w) + u32(params.rect.x) + number % across;
}

fn pixels_of_rect() -> u32 {
    return u32((params.rect.z - params.rect.x) * (params.rect.w - params.rect.y));
}

const WIDE_GROUP: u32 = 256u;

@compute @workgroup_size(256)
fn reduce(@builtin(local_invocation_index) lane: u32) {
    let nodes_at = params.count.z;
    let pixels_at = params.count.w;
    for (var i = lane; i < pixels_of_rect(); i += WIDE_GROUP) {
        let pixel = pixel_of_rect(i);
        let way = way_in(pixel);
        if way == 0 {
            continue;
        }
        let triangle = ~atomicLoad(&work[IMAGES + 2u * pixels_of_image() + pixel]);
        let hit = pixels_at + 3u * atomicAdd(&work[PIXELS], 1u);
        results[hit] = pixel;
        results[hit + 1u] = triangle;
        results[hit + 2u] = u32(way);
        atomicMax(&work[DEEPEST], u32(way));
        if atomicMax(&longest[triangle], u32(way)) == 0u {
            results[2u * atomicAdd(&work[TRIANGLES], 1u)] = triangle;
        }
    }
    storageBarrier();
    for (var i = lane; i < atomicLoad(&work[TRIANGLES]); i += WIDE_GROUP) {
        let triangle = results[2u * i];
        let way = atomicLoad(&longest[triangle]);
        results[2u * i + 1u] = way;
        let v = corners_of(triangle);
        for (var k = 0u; k < 3u; k += 1u) {
            if atomicMax(&longest[params.count.x + v[k]], way) == 0u {
                results[nodes_at + 2u * atomicAdd(&work[NODES], 1u)] = v[k];
            }
        }
    }
    storageBarrier();
    for (var i = lane; i < atomicLoad(&work[TRIANGLES]); i += WIDE_GROUP) {
        atomicStore(&longest[results[2u * i]], 0u);
    }
    for (var i = lane; i < atomicLoad(&work[NODES]); i += WIDE_GROUP) {
        let at = nodes_at + 2u * i;
        results[at + 1u] = atomicExchange(&longest[params.count.x + results[at]], 0u);
    }
}

@compute @workgroup_size(64)
fn touch(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < pixels_of_rect(); i += GROUP * groups.x) {
        if way_in(pixel_of_rect(i)) > 0 {
            atomicOr(&work[TOUCHED], 1u);
        }
    }
}

// Vertices as features, of the triangles that the last cull left; pairs (vertex, way) in place of
// the nodes.
@compute @workgroup_size(256)
fn vertices(@builtin(local_invocation_index) lane: u32) {
    let nodes_at = params.count.z;
    for (var i = lane; i < 3u * atomicLoad(&work[SURVIVORS]); i += WIDE_GROUP) {
        let number = corner[3u * survivor[i / 3u] + i % 3u];
        let placed = place(number);
        let at = placed.at.xy >> vec2<u32>(PIXEL_BITS);
        if placed.code != 0u || any(at < vec2<i32>(0)) || any(at >= vec2<i32>(params.limit.w)) {
            continue;
        }
        let way = placed.at.z - instrument[u32(at.y * params.limit.w + at.x)];
        if way > 0 && atomicMax(&longest[params.count.x + number], u32(way)) == 0u {
            results[nodes_at + 2u * atomicAdd(&work[NODES], 1u)] = number;
        }
    }
    storageBarrier();
    for (var i = lane; i < atomicLoad(&work[NODES]); i += WIDE_GROUP) {
        let at = nodes_at + 2u * i;
        results[at + 1u] = atomicExchange(&longest[params.count.x + results[at]], 0u);
    }
}
