//! Pixels in one machine word, so that the three colours are weighted together without SIMD instructions.
//!
//! A *narrow* pixel is a `u32` with red, green and blue in its bytes from the lowest up. A *wide* pixel is a `u64` with red in
//! bits 0.., green in bits 21.., blue in bits 42.. of 21 bits each, enough for a byte times 8192.

/// Bits from one colour of a wide pixel to the next.
const FIELD: u32 = 21;
/// A one in every field.
const ONES: u64 = 1 | 1 << FIELD | 1 << (2 * FIELD);
/// Weights of the bilinear filter run from 0 to 2^5, as in OpenCV.
pub(super) const WEIGHT_BITS: u32 = 5;

#[inline(always)]
pub(super) fn narrow(red: u8, green: u8, blue: u8) -> u32 {
    u32::from(red) | u32::from(green) << 8 | u32::from(blue) << 16
}

/// Red, green, blue of a narrow pixel.
#[inline(always)]
pub(super) fn bytes(pixel: u32) -> [u8; 3] {
    [pixel as u8, (pixel >> 8) as u8, (pixel >> 16) as u8]
}

/// Converts a narrow pixel to a wide one.
#[inline(always)]
pub(super) fn widen(pixel: u32) -> u64 {
    let pixel = u64::from(pixel);
    (pixel & 0xff) | (pixel & 0xff00) << (FIELD - 8) | (pixel & 0x00ff_0000) << (2 * FIELD - 16)
}

/// The mean of 2^`bits` wide pixels from their sum, as a narrow pixel, rounded half up.
#[inline(always)]
pub(super) fn mean(sum: u64, bits: u32) -> u32 {
    let half = ONES << bits >> 1;
    let means = ((sum + half) >> bits) & (ONES * 0xff);
    ((means & 0xff) | (means >> (FIELD - 8) & 0xff00) | (means >> (2 * FIELD - 16) & 0x00ff_0000))
        as u32
}

/// The bilinear value between four wide pixels, times 2^(2 [`WEIGHT_BITS`]); `x` and `y` in 0..=32 are the fractions to the
/// right and down.
#[inline(always)]
pub(super) fn bilinear(upper: [u64; 2], lower: [u64; 2], x: u64, y: u64) -> u64 {
    blend(blend(upper[0], upper[1], x), blend(lower[0], lower[1], x), y)
}

/// `a` at t = 0 to `b` at t = 32, times 2^[`WEIGHT_BITS`]. The differences borrow between the fields, but the result has no
/// negative field, so it is correct modulo 2^64.
#[inline(always)]
fn blend(a: u64, b: u64, t: u64) -> u64 {
    (a << WEIGHT_BITS).wrapping_add(b.wrapping_sub(a).wrapping_mul(t))
}

/// Writes pixels as bytes of red, green, blue.
#[inline(always)]
pub(super) fn write_rgb(pixels: &[u32], out: &mut [u8]) {
    for (pixel, out) in pixels.iter().zip(out.chunks_exact_mut(3)) {
        out.copy_from_slice(&bytes(*pixel));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bilinear_is_the_rounded_weighted_mean_of_each_colour(
            p in proptest::array::uniform4(proptest::array::uniform3(0_u8..)), x in 0_u64..=32, y in 0_u64..=32,
        ) {
            let [a, b, c, d] = p.map(|[r, g, b]| widen(narrow(r, g, b)));
            let got = bytes(mean(bilinear([a, b], [c, d], x, y), 2 * WEIGHT_BITS));
            for colour in 0..3 {
                let [a, b, c, d] = p.map(|pixel| u64::from(pixel[colour]));
                let sum = (a * (32 - x) + b * x) * (32 - y) + (c * (32 - x) + d * x) * y;
                prop_assert_eq!(u64::from(got[colour]), (sum + 512) / 1024);
            }
        }

        #[test]
        fn the_mean_of_equal_pixels_is_that_pixel(r: u8, g: u8, b: u8, bits in 0_u32..=12) {
            prop_assert_eq!(bytes(mean(widen(narrow(r, g, b)) << bits, bits)), [r, g, b]);
        }
    }
}
