//! From the camera's bytes to narrow pixels, a piece of a row at a time.

use hal::{ImageView, PixelFormat};

use super::packed::narrow;

/// Which bytes mean black and white, and how strong colour can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum YuvRange {
    /// Y from 16 to 235, U and V from 16 to 240: what cameras and video send.
    Limited,
    /// Everything from 0 to 255: JPEG files (JFIF).
    Full,
}

/// Fraction bits of the coefficients: they and the samples fit 16 bits, their products 32.
const BITS: u32 = 13;

/// YUV to RGB in fixed point, ITU-R BT.601.
#[derive(Debug, Clone, Copy)]
pub(super) struct YuvMatrix {
    black: i16,
    y: i16,
    red_v: i16,
    green_u: i16,
    green_v: i16,
    blue_u: i16,
}

impl YuvMatrix {
    /// From the shares of red and blue in luma (BT.601, 2.5.1) and the steps between black and white (2.5.3).
    pub fn bt601(range: YuvRange) -> Self {
        let (red, blue) = (0.299, 0.114);
        let green = 1.0 - red - blue;
        let (black, luma, chroma) = match range {
            YuvRange::Limited => (16, 255.0 / 219.0, 255.0 / 224.0),
            YuvRange::Full => (0, 1.0, 1.0),
        };
        let fixed = |value: f64| (value * f64::from(1 << BITS)).round() as i16;
        let (v, u) = (2.0 * (1.0 - red) * chroma, 2.0 * (1.0 - blue) * chroma);
        Self {
            black,
            y: fixed(luma),
            red_v: fixed(v),
            green_u: fixed(-u * blue / green),
            green_v: fixed(-v * red / green),
            blue_u: fixed(u),
        }
    }

    /// Two neighbours that share their colour. 32-bit lanes all the way, so that compilers take eight pairs at a time.
    #[inline(always)]
    fn pair(&self, y: [u32; 2], u: u32, v: u32) -> [u32; 2] {
        let times = |coefficient: i16, sample: i32| i32::from(coefficient) * sample;
        let (u, v) = (u as i32 - 128, v as i32 - 128);
        let half = 1 << (BITS - 1);
        let red = times(self.red_v, v) + half;
        let green = times(self.green_u, u) + times(self.green_v, v) + half;
        let blue = times(self.blue_u, u) + half;
        y.map(|y| {
            let y = times(self.y, y as i32 - i32::from(self.black));
            let byte = |sum: i32| (sum >> BITS).clamp(0, 255) as u32;
            byte(y + red) | byte(y + green) << 8 | byte(y + blue) << 16
        })
    }
}

/// Converts the pixels of `frame` from (`column`, `row`) on to the right until `out` is full. Colour that two pixels share is
/// given to both as it is. For formats with shared colour, `column` and the length of `out` are even. A JPEG has no rows: it
/// is decoded before.
#[inline(always)]
pub(super) fn convert(
    matrix: &YuvMatrix,
    frame: ImageView<'_>,
    column: usize,
    row: usize,
    out: &mut [u32],
) {
    let (width, data) = (frame.width(), frame.data());
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
                (out[0], out[1]) = (pair[0], pair[1]);
            }
        }
        PixelFormat::Nv12 => {
            let luma = data[at..].chunks_exact(2);
            let chroma = data[width * frame.height() + row / 2 * width + column..].chunks_exact(2);
            for ((out, y), uv) in out.chunks_exact_mut(2).zip(luma).zip(chroma) {
                let pair = matrix.pair([y[0].into(), y[1].into()], uv[0].into(), uv[1].into());
                (out[0], out[1]) = (pair[0], pair[1]);
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
    fn every_colour_is_within_a_hair_of_the_formula() {
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

    #[test]
    fn black_and_white_are_black_and_white() {
        let grey = |range, y| bytes(YuvMatrix::bt601(range).pair([y; 2], 128, 128)[0]);
        assert_eq!([grey(YuvRange::Limited, 16), grey(YuvRange::Limited, 235)], [[0; 3], [255; 3]]);
        assert_eq!([grey(YuvRange::Full, 0), grey(YuvRange::Full, 255)], [[0; 3], [255; 3]]);
        assert_eq!(
            [grey(YuvRange::Limited, 0), grey(YuvRange::Limited, 255)],
            [[0; 3], [255; 3]],
            "clamped"
        );
    }
}
