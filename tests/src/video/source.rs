//! Image sources of simulated cameras.

/// Renders the frames of a simulated camera.
pub trait ImageSource: Send {
    /// Renders the image at `time_ns` as YUV 4:2:2 packed: `2 * width * height` bytes.
    fn render(&mut self, time_ns: u64, width: usize, height: usize, yuyv: &mut [u8]);
}

/// Grey stripes that move to the left by a pixel every 10 ms, above a bar of 64 pixels that encodes
/// the time in binary, so that the exposure time can be read from the image to the nanosecond.
#[derive(Debug, Clone, Copy, Default)]
pub struct MovingStripes;

impl ImageSource for MovingStripes {
    fn render(&mut self, time_ns: u64, width: usize, height: usize, yuyv: &mut [u8]) {
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
    /// The time that the bar in an image encodes.
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
    fn an_image_encodes_its_time_and_the_next_one_differs() {
        let mut images = [vec![0; 2 * 64 * 48], vec![0; 2 * 64 * 48]];
        for (image, time_ns) in images.iter_mut().zip([123_456_789_012, 123_466_789_012]) {
            MovingStripes.render(time_ns, 64, 48, image);
            assert_eq!(MovingStripes::time_ns(image), time_ns);
        }
        assert_ne!(images[0][2 * 64..], images[1][2 * 64..]);
    }
}
