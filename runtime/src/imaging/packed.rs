//! Pixels in one machine word, so that the three colours are weighed together without SIMD of any machine.
//!
//! A *narrow* pixel is a `u32` with red, green and blue in its bytes from the lowest up. A *wide* pixel is a `u64` with red in
//! bits 0.., green in bits 21.., blue in bits 42.. of 21 bits each: room for a byte times 8192.

/// Bits from one colour of a wide pixel to the next.
const FIELD: u32 = 21;
/// A one in every field.
const ONES: u64 = 1 | 1 << FIELD | 1 << (2 * FIELD);
/// Weights of the bilinear filter run from 0 to 2^5, as in OpenCV.
pub(super) const WEIGHT_BITS: u32 = 5;

/// A narrow pixel.
#[inline(always)]
pub(super) fn narrow(red: u8, green: u8, blue: u8) -> u32 {
    u32::from(red) | u32::from(green) << 8 | u32::from(blue) << 16
}

/// Red, green, blue of a narrow pixel.
#[inline(always)]
pub(super) fn bytes(pixel: u32) -> [u8; 3] {
    [pixel as u8, (pixel >> 8) as u8, (pixel >> 16) as u8]
}

/// From narrow to wide.
#[inline(always)]
pub(super) fn widen(pixel: u32) -> u64 {
    let pixel = u64::from(pixel);
    (pixel & 0xff) | (pixel & 0xff00) << (FIELD - 8) | (pixel & 0x00ff_0000) << (2 * FIELD - 16)
}

/// From a sum of 2^`bits` wide pixels to their mean, rounded half up.
#[inline(always)]
pub(super) fn mean(sum: u64, bits: u32) -> u32 {
    let half = ONES << bits >> 1;
    let means = ((sum + half) >> bits) & (ONES * 0xff);
    ((means & 0xff) | (means >> (FIELD - 8) & 0xff00) | (means >> (2 * FIELD - 16) & 0x00ff_0000))
        as u32
}

/// The value between four wide pixels, times 2^(2 [`WEIGHT_BITS`]); `x` and `y` in 0..=32 tell how far to the right and to the
/// bottom.
#[inline(always)]
pub(super) fn bilinear(upper: [u64; 2], lower: [u64; 2], x: u64, y: u64) -> u64 {
    // The differences borrow from field to field, but the end result has no negative field, so modulo 2^64 it is right.
    let blend =
        |a: u64, b: u64, t: u64| (a << WEIGHT_BITS).wrapping_add(b.wrapping_sub(a).wrapping_mul(t));
    blend(blend(upper[0], upper[1], x), blend(lower[0], lower[1], x), y)
}

/// `byte / 255` to the last bit, without a division (a test looks at all 256).
#[inline(always)]
fn unit(byte: u8) -> f32 {
    let value = f32::from(byte);
    (value + value * (1.0 / 255.0)) * (1.0 / 256.0)
}

/// Mean and 1 / standard deviation of each colour: what the network's planes are shifted and scaled by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Normalisation {
    pub mean: [f32; 3],
    pub inverse_std: [f32; 3],
}

impl Normalisation {
    pub const NONE: Self = Self { mean: [0.0; 3], inverse_std: [1.0; 3] };

    /// Writes pixels into the three planes.
    #[inline(always)]
    pub fn write(&self, pixels: &[u32], [red, green, blue]: [&mut [f32]; 3]) {
        let place =
            |byte: u8, colour: usize| (unit(byte) - self.mean[colour]) * self.inverse_std[colour];
        for (((pixel, red), green), blue) in pixels.iter().zip(red).zip(green).zip(blue) {
            let [r, g, b] = bytes(*pixel);
            *red = place(r, 0);
            *green = place(g, 1);
            *blue = place(b, 2);
        }
    }

    /// The byte that a value of a plane stands for; the nearest one where it stands for none.
    pub fn byte(&self, value: f32, colour: usize) -> u8 {
        // A cast saturates and turns NaN into 0.
        ((value / self.inverse_std[colour] + self.mean[colour]) * 255.0).round() as u8
    }
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

    #[test]
    fn unit_is_division_by_255_to_the_last_bit() {
        for byte in 0..=255 {
            assert_eq!(unit(byte).to_bits(), (f32::from(byte) / 255.0).to_bits(), "{byte}");
        }
    }

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
