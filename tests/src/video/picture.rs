//! What a simulated camera sees.

/// Where pictures come from.
pub trait PictureSource: Send {
    /// The picture of this moment, as YUV 4:2:2 packed: `2 * width * height` bytes.
    fn picture(&mut self, time_ns: u64, width: usize, height: usize, yuyv: &mut [u8]);
}

/// Grey stripes that move to the left by a pixel every 10 ms, above a bar of 64 bits that tells the time: whoever has the
/// picture can say when it was taken, to the nanosecond.
#[derive(Debug, Clone, Copy, Default)]
pub struct MovingStripes;

impl PictureSource for MovingStripes {
    fn picture(&mut self, time_ns: u64, width: usize, height: usize, yuyv: &mut [u8]) {
        let shift = (time_ns / 10_000_000) as usize;
        for (y, row) in yuyv.chunks_exact_mut(2 * width).take(height).enumerate() {
            for (x, pixel) in row.chunks_exact_mut(2).enumerate() {
                let stripe = ((x + shift) / 16 + y / 16) % 8;
                pixel.copy_from_slice(&[16 + 28 * stripe as u8, 128]);
            }
        }
        for (bit, pixel) in yuyv.chunks_exact_mut(2).take(64).enumerate() {
            pixel[0] = if time_ns >> bit & 1 == 1 { 235 } else { 16 };
        }
    }
}

impl MovingStripes {
    /// The time that the bar in a picture tells.
    #[must_use]
    pub fn time_ns(yuyv: &[u8]) -> u64 {
        let bits = yuyv.chunks_exact(2).take(64).enumerate();
        bits.map(|(bit, pixel)| u64::from(pixel[0] > 128) << bit).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_tells_when_it_was_taken_and_the_next_one_differs() {
        let mut pictures = [vec![0; 2 * 64 * 48], vec![0; 2 * 64 * 48]];
        for (picture, time_ns) in pictures.iter_mut().zip([123_456_789_012, 123_466_789_012]) {
            MovingStripes.picture(time_ns, 64, 48, picture);
            assert_eq!(MovingStripes::time_ns(picture), time_ns);
        }
        assert_ne!(pictures[0][2 * 64..], pictures[1][2 * 64..]);
    }
}
