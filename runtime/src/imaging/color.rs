//! Converts the camera's bytes to narrow pixels, a part of a row at a time.

use hal::{ImageView, PixelFormat};

use super::packed::narrow;

/// Range of the luma and chroma samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum YuvRange {
    /// Y from 16 to 235, U and V from 16 to 240: cameras and video.
    Limited,
    /// Everything from 0 to 255: JPEG files (JFIF).
    Full,
}

/// Fraction bits of the coefficients: coefficients and samples fit 16 bits, their products 32.
const BITS: u32 = 13;

/// YUV to RGB conversion in fixed point, ITU-R BT.601.
#[derive(Debug, Clone, Copy)]
pub(super) struct YuvMatrix {
    black: i16,
    y: i16,
    red_v: i16,
    green_u: i16,
    green_v: i16,
    blue_u: i16,
}

fn fixed_point(value: f64) -> i16 {
    (value * f64::from(1 << BITS)).round() as i16
}

#[inline(always)]
fn times(coefficient: i16, sample: i32) -> i32 {
    i32::from(coefficient) * sample
}

/// The integer part of a fixed-point number, as a byte.
#[inline(always)]
fn to_byte(sum: i32) -> u32 {
    (sum >> BITS).clamp(0, 255) as u32
}

impl YuvMatrix {
    /// Coefficients from the weights of red and blue in luma (BT.601, 2.5.1) and the sample ranges (2.5.3).
    pub fn bt601(range: YuvRange) -> Self {
        let red = 0.299;
        let blue = 0.114;
        let green = 1.0 - red - blue;
        let (black, luma, chroma) = match range {
            YuvRange::Limited => (16, 255.0 / 219.0, 255.0 / 224.0),
            YuvRange::Full => (0, 1.0, 1.0),
        };
        let v = 2.0 * (1.0 - red) * chroma;
        let u = 2.0 * (1.0 - blue) * chroma;
        Self {
            black,
            y: fixed_point(luma),
            red_v: fixed_point(v),
            green_u: fixed_point(-u * blue / green),
            green_v: fixed_point(-v * red / green),
            blue_u: fixed_point(u),
        }
    }

    /// Converts two neighbours that share their colour. All arithmetic has 32-bit lanes, so that compilers convert eight
    /// pairs at a time.
    #[inline(always)]
    fn pair(&self, y: [u32; 2], u: u32, v: u32) -> [u32; 2] {
        let u = u as i32 - 128;
        let v = v as i32 - 128;
        let half = 1 << (BITS - 1);
        let red = times(self.red_v, v) + half;
        let green = times(self.green_u, u) + times(self.green_v, v) + half;
        let blue = times(self.blue_u, u) + half;
        y.map(|y| {
            let y = times(self.y, y as i32 - i32::from(self.black));
            to_byte(y + red) | to_byte(y + green) << 8 | to_byte(y + blue) << 16
        })
    }
}

/// Converts the pixels of `frame` from (`column`, `row`) on to the right until `out` is full. Chroma that two pixels share is
/// used for both without interpolation. For formats with shared chroma, `column` and the length of `out` are even. JPEG
/// frames are decoded before.
#[inline(always)]
pub(super) fn convert(
    matrix: &YuvMatrix,
    frame: ImageView<'_>,
    column: usize,
    row: usize,
    out: &mut [u32],
) {
    let width = frame.width();
    let data = frame.data();
    let at = row * width + column;
    match frame.format() {
        PixelFormat::Rgb8 => {
            for (out, pixel) in out.iter_mut().zip(data[3 * at..].chunks_exact(3)) {
                *out = narrow(pixel[0], pixel[1], pixel[2]);
            }
        }
        PixelFormat::Gray8 => {
            for (out, &grey) in out.iter_mut().zip(&data[at..]) {
                *out = u32::from(grey) * 0x01_0101;
            }
        }
        PixelFormat::Yuyv => {
            for (out, yuyv) in out.chunks_exact_mut(2).zip(data[2 * at..].chunks_exact(4)) {
                let yuyv = u32::from_le_bytes([yuyv[0], yuyv[1], yuyv[2], yuyv[3]]);
                let pair =
                    matrix.pair([yuyv & 0xff, yuyv >> 16 & 0xff], yuyv >> 8 & 0xff, yuyv >> 24);
                out[0] = pair[0];
                out[1] = pair[1];
            }
        }
        PixelFormat::Nv12 => {
            let luma = data[at..].chunks_exact(2);
            let chroma = data[width * frame.height() + row / 2 * width + column..].chunks_exact(2);
            for ((out, y), uv) in out.chunks_exact_mut(2).zip(luma).zip(chroma) {
                let pair = matrix.pair([y[0].into(), y[1].into()], uv[0].into(), uv[1].into());
                out[0] = pair[0];
                out[1] = pair[1];
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::packed::bytes;

    /// BT.601 in floating point.
    fn exact(range: YuvRange, [y, u, v]: [u8; 3]) -> [f64; 3] {
        let [y, u, v] = [y, u, v].map(f64::from);
        let (y, u, v) = match range {
            YuvRange::Limited => ((y - 16.0) / 219.0, (u - 128.0) / 224.0, (v - 128.0) / 224.0),
            YuvRange::Full => (y / 255.0, (u - 128.0) / 255.0, (v - 128.0) / 255.0),
        };
        [y + 1.402 * v, y - 0.344136 * u - 0.714136 * v, y + 1.772 * u]
            .map(|c| (c * 255.0).clamp(0.0, 255.0))
    }

    #[test]
    fn every_colour_is_within_rounding_of_the_formula() {
        for range in [YuvRange::Limited, YuvRange::Full] {
            let matrix = YuvMatrix::bt601(range);
            for y in (0..=255).step_by(5) {
                for u in (0..=255).step_by(3) {
                    for v in 0..=255 {
                        let got = bytes(matrix.pair([y.into(); 2], u.into(), v.into())[1]);
                        let want = exact(range, [y, u, v]);
                        for (got, want) in got.into_iter().zip(want) {
                            assert!(
                                (f64::from(got) - want).abs() < 0.56,
                                "{range:?} {y} {u} {v}: {got}, {want}"
                            );
                        }
                    }
                }
            }
        }
    }

    fn grey(range: YuvRange, y: u32) -> [u8; 3] {
        bytes(YuvMatrix::bt601(range).pair([y; 2], 128, 128)[0])
    }

    #[test]
    fn black_and_white_are_black_and_white() {
        assert_eq!([grey(YuvRange::Limited, 16), grey(YuvRange::Limited, 235)], [[0; 3], [255; 3]]);
        assert_eq!([grey(YuvRange::Full, 0), grey(YuvRange::Full, 255)], [[0; 3], [255; 3]]);
        assert_eq!(
            [grey(YuvRange::Limited, 0), grey(YuvRange::Limited, 255)],
            [[0; 3], [255; 3]],
            "clamped"
        );
    }
}
