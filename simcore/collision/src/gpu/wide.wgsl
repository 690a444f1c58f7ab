// Whole numbers of 64 bits as two words, low and high; two's complement where signed.

fn wide_add(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    let low = a.x + b.x;
    return vec2<u32>(low, a.y + b.y + select(0u, 1u, low < a.x));
}

fn wide_sub(a: vec2<u32>, b: vec2<u32>) -> vec2<u32> {
    return vec2<u32>(a.x - b.x, a.y - b.y - select(0u, 1u, a.x < b.x));
}

fn wide_negative(a: vec2<u32>) -> bool {
    return (a.y & 0x80000000u) != 0u;
}

fn wide_zero(a: vec2<u32>) -> bool {
    return (a.x | a.y) == 0u;
}

// The product of two signed words.
fn wide_product(a: i32, b: i32) -> vec2<u32> {
    let size = product(u32(abs(a)), u32(abs(b)));
    if (a < 0) != (b < 0) {
        return wide_sub(vec2<u32>(0u, 0u), size);
    }
    return size;
}

// a · b for unsigned a and b whose product fits.
fn wide_times(a: vec2<u32>, b: u32) -> vec2<u32> {
    let low = product(a.x, b);
    return vec2<u32>(low.x, low.y + a.y * b);
}

fn wide_shift(a: vec2<u32>, by: u32) -> vec2<u32> {
    if by == 0u {
        return a;
    }
    return vec2<u32>(a.x << by, (a.y << by) | (a.x >> (32u - by)));
}

fn wide_less(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.y < b.y || (a.y == b.y && a.x < b.x);
}

// The integer part of numerator / divisor, known to be at most `most`, which is below 2²¹;
// unsigned, divisor below 2⁴¹.
fn wide_quotient(numerator: vec2<u32>, divisor: vec2<u32>, most: u32) -> u32 {
    var rest = numerator;
    var quotient = 0u;
    for (var bit = 32u - countLeadingZeros(most); bit > 0u; bit -= 1u) {
        let part = wide_shift(divisor, bit - 1u);
        if !wide_less(rest, part) {
            rest = wide_sub(rest, part);
            quotient |= 1u << (bit - 1u);
        }
    }
    return quotient;
}
