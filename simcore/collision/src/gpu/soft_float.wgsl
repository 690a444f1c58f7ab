// f32 arithmetic in whole numbers: IEEE 754 binary32, round to nearest even, with subnormal
// numbers, infinities and one "not a number". A shading language lets its compiler fuse a·b + c,
// flush subnormals, and forget about what is not a number; whole numbers leave it no choice. Values
// are the bits of an f32 in a u32.

const SIGN: u32 = 0x80000000u;
const INFINITE: u32 = 0x7f800000u;
const NOT_A_NUMBER: u32 = 0x7fc00000u;
const HIDDEN: u32 = 0x00800000u;

fn is_nan(a: u32) -> bool {
    return (a & ~SIGN) > INFINITE;
}

// The full product of two words: low, high.
fn product(a: u32, b: u32) -> vec2<u32> {
    let a0 = a & 0xffffu;
    let a1 = a >> 16u;
    let b0 = b & 0xffffu;
    let b1 = b >> 16u;
    let low = a0 * b0;
    // At most (2¹⁶ − 1)² + 2¹⁶ − 1 each time: no carry is lost.
    let middle = a1 * b0 + (low >> 16u);
    let other = a0 * b1 + (middle & 0xffffu);
    return vec2<u32>((other << 16u) | (low & 0xffffu), a1 * b1 + (middle >> 16u) + (other >> 16u));
}

// m / 2^by; the lowest bit also stands for everything that was lost.
fn shift_sticky(m: u32, by: u32) -> u32 {
    if by >= 32u {
        return select(0u, 1u, m != 0u);
    }
    return (m >> by) | select(0u, 1u, (m & ((1u << by) - 1u)) != 0u);
}

// The f32 nearest to m · 2^(exponent − 158), where the top bit of m is set.
fn pack(sign: u32, exponent: i32, m: u32) -> u32 {
    if exponent >= 255 {
        return sign | INFINITE;
    }
    var wide = m;
    if exponent <= 0 {
        wide = shift_sticky(m, u32(1 - exponent));
    }
    let rest = wide & 0xffu;
    var kept = wide >> 8u;
    if rest > 0x80u || (rest == 0x80u && (kept & 1u) == 1u) {
        kept += 1u;
    }
    // The hidden bit, or a carry into it, counts up the exponent.
    if exponent <= 0 {
        return sign | kept;
    }
    return sign | ((u32(exponent - 1) << 23u) + kept);
}

// Exponent and mantissa of what is finite and not zero, the mantissa's top bit at 23.
struct Parts {
    exponent: i32,
    mantissa: u32,
}

fn parts(magnitude: u32) -> Parts {
    let field = magnitude >> 23u;
    let fraction = magnitude & (HIDDEN - 1u);
    if field != 0u {
        return Parts(i32(field), fraction | HIDDEN);
    }
    let up = countLeadingZeros(fraction) - 8u;
    return Parts(1 - i32(up), fraction << up);
}

fn float_mul(a: u32, b: u32) -> u32 {
    let sign = (a ^ b) & SIGN;
    let x = a & ~SIGN;
    let y = b & ~SIGN;
    if x >= INFINITE || y >= INFINITE {
        if x > INFINITE || y > INFINITE || x == 0u || y == 0u {
            return NOT_A_NUMBER;
        }
        return sign | INFINITE;
    }
    if x == 0u || y == 0u {
        return sign;
    }
    let p = parts(x);
    let q = parts(y);
    // 46 or 47 bits behind the first.
    let whole = product(p.mantissa, q.mantissa);
    var m = (whole.y << 16u) | (whole.x >> 16u) | select(0u, 1u, (whole.x & 0xffffu) != 0u);
    var exponent = p.exponent + q.exponent - 126;
    if (m & SIGN) == 0u {
        m = m << 1u;
        exponent -= 1;
    }
    return pack(sign, exponent, m);
}

// Exponent and mantissa without normalising, six bits of room below.
fn addend(magnitude: u32) -> Parts {
    let field = magnitude >> 23u;
    let fraction = magnitude & (HIDDEN - 1u);
    if field == 0u {
        return Parts(1, fraction << 6u);
    }
    return Parts(i32(field), (fraction | HIDDEN) << 6u);
}

fn float_add(a: u32, b: u32) -> u32 {
    var x = a;
    var y = b;
    if (x & ~SIGN) < (y & ~SIGN) {
        x = b;
        y = a;
    }
    let large = x & ~SIGN;
    let small = y & ~SIGN;
    if large >= INFINITE {
        if large > INFINITE || (small == INFINITE && x != y) {
            return NOT_A_NUMBER;
        }
        return x;
    }
    if small == 0u {
        // Zeros: negative only if both are.
        return select(x, x & y, large == 0u);
    }
    let p = addend(large);
    let q = addend(small);
    let shifted = shift_sticky(q.mantissa, u32(p.exponent - q.exponent));
    var sum = p.mantissa + shifted;
    if ((x ^ y) & SIGN) != 0u {
        sum = p.mantissa - shifted;
    }
    if sum == 0u {
        return 0u;
    }
    let lead = countLeadingZeros(sum);
    return pack(x & SIGN, p.exponent + 2 - i32(lead), sum << lead);
}

fn float_sub(a: u32, b: u32) -> u32 {
    return float_add(a, b ^ SIGN);
}

// Whole numbers in the order of the values; both zeros are 0.
fn order(a: u32) -> i32 {
    let magnitude = i32(a & ~SIGN);
    return select(magnitude, -magnitude, (a & SIGN) != 0u);
}

// Of what is not a number every comparison is false.
fn float_less(a: u32, b: u32) -> bool {
    return !is_nan(a) && !is_nan(b) && order(a) < order(b);
}

// The integer part of what is at least 0 and below 2²³.
fn float_floor(a: u32) -> i32 {
    let exponent = a >> 23u;
    if exponent < 127u {
        return 0;
    }
    return i32(((a & (HIDDEN - 1u)) | HIDDEN) >> (150u - exponent));
}
