//! Follows a small patch from one image to another to a fraction of a pixel (Lucas and Kanade 1981, in the inverse form of Baker
//! and Matthews 2004).

/// Half the side of a patch, pixels.
const HALF: i32 = 5;
const ITERATIONS: usize = 10;
/// A step this small ends the iterations, pixels.
const AT_REST_PX: f32 = 0.01;
/// A patch that moves further than this from where it was predicted has been lost, pixels.
const FARTHEST_PX: f32 = 6.0;
/// Mean difference of brightness between both patches that noise and light explain, of 255.
const LARGEST_DIFFERENCE: f32 = 12.0;
/// Texture in the weaker direction: the smaller eigenvalue of the structure tensor per pixel, of 255 squared per pixel squared.
/// Noise of 1.5 gives 1.
const LEAST_TEXTURE: f32 = 12.0;

/// An image of brightness.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gray {
    pub width: usize,
    pub height: usize,
    pixels: Vec<f32>,
}

impl Gray {
    /// The mean of the three channels.
    pub fn of_rgb(width: usize, height: usize, rgb: &[u8]) -> Self {
        Self { width, height, pixels: rgb.chunks_exact(3).map(mean).collect() }
    }

    fn get(&self, x: i32, y: i32) -> f32 {
        self.pixels[y as usize * self.width + x as usize]
    }

    /// Whether a patch around the point, with its gradients, lies in the image.
    fn holds(&self, x: f32, y: f32) -> bool {
        let margin = (HALF + 2) as f32;
        x >= margin
            && y >= margin
            && x < self.width as f32 - margin - 1.0
            && y < self.height as f32 - margin - 1.0
    }

    fn interpolated(&self, x: f32, y: f32) -> f32 {
        let (column, row) = (x.floor(), y.floor());
        let (right, down) = (x - column, y - row);
        let (column, row) = (column as i32, row as i32);
        let upper = self.get(column, row) * (1.0 - right) + self.get(column + 1, row) * right;
        let lower =
            self.get(column, row + 1) * (1.0 - right) + self.get(column + 1, row + 1) * right;
        upper * (1.0 - down) + lower * down
    }

    fn gradient(&self, x: i32, y: i32) -> [f32; 2] {
        [
            0.5 * (self.get(x + 1, y) - self.get(x - 1, y)),
            0.5 * (self.get(x, y + 1) - self.get(x, y - 1)),
        ]
    }
}

fn mean(pixel: &[u8]) -> f32 {
    pixel.iter().map(|byte| f32::from(*byte)).sum::<f32>() / 3.0
}

/// The sums of products of gradients over a patch.
#[derive(Debug, Clone, Copy, Default)]
struct Texture {
    xx: f32,
    xy: f32,
    yy: f32,
}

impl Texture {
    fn around(image: &Gray, x: i32, y: i32) -> Self {
        let mut texture = Self::default();
        for row in y - HALF..=y + HALF {
            for column in x - HALF..=x + HALF {
                let [gx, gy] = image.gradient(column, row);
                texture.xx += gx * gx;
                texture.xy += gx * gy;
                texture.yy += gy * gy;
            }
        }
        texture
    }

    /// The smaller eigenvalue per pixel (Shi and Tomasi 1994).
    fn strength(&self) -> f32 {
        let mean = 0.5 * (self.xx + self.yy);
        let half = 0.5 * (self.xx - self.yy);
        let side = (2 * HALF + 1) as f32;
        (mean - half.hypot(self.xy)) / (side * side)
    }

    fn solve(&self, right: [f32; 2]) -> [f32; 2] {
        let determinant = self.xx * self.yy - self.xy * self.xy;
        [
            (self.yy * right[0] - self.xy * right[1]) / determinant,
            (self.xx * right[1] - self.xy * right[0]) / determinant,
        ]
    }
}

/// The corners of an image: the best-textured point of every square of `cell` pixels that has one.
pub(super) fn corners(image: &Gray, cell: usize) -> Vec<[i32; 2]> {
    let mut corners = Vec::new();
    for top in (0..image.height).step_by(cell) {
        for left in (0..image.width).step_by(cell) {
            corners.extend(best_in_cell(image, left, top, cell));
        }
    }
    corners
}

fn best_in_cell(image: &Gray, left: usize, top: usize, cell: usize) -> Option<[i32; 2]> {
    /// Distance between the points that are tried, pixels.
    const STRIDE: usize = 3;
    let mut best = None;
    let mut strength = LEAST_TEXTURE;
    for y in (top..top + cell).step_by(STRIDE) {
        for x in (left..left + cell).step_by(STRIDE) {
            let (x, y) = (x as i32, y as i32);
            if !image.holds(x as f32, y as f32) {
                continue;
            }
            let there = Texture::around(image, x, y).strength();
            if there > strength {
                strength = there;
                best = Some([x, y]);
            }
        }
    }
    best
}

/// Follows the patch of `from` at whole pixels `at` into `to`, beginning at `guess`. `None` if it is not found there.
pub(super) fn follow(from: &Gray, to: &Gray, at: [i32; 2], guess: [f32; 2]) -> Option<[f32; 2]> {
    let [x, y] = at;
    if !from.holds(x as f32, y as f32) {
        return None;
    }
    let texture = Texture::around(from, x, y);
    if texture.strength() < 0.5 * LEAST_TEXTURE {
        return None;
    }
    let mut found = guess;
    for _ in 0..ITERATIONS {
        if !to.holds(found[0], found[1]) {
            return None;
        }
        let (right, difference) = difference(from, to, at, found);
        let step = texture.solve(right);
        found = [found[0] - step[0], found[1] - step[1]];
        let is_far = (found[0] - guess[0]).hypot(found[1] - guess[1]) > FARTHEST_PX;
        if is_far || !found[0].is_finite() || !found[1].is_finite() {
            return None;
        }
        if step[0].hypot(step[1]) < AT_REST_PX {
            return (difference < LARGEST_DIFFERENCE).then_some(found);
        }
    }
    None
}

/// Sums of gradient times difference of both patches, and their mean difference. A change of the light is taken out.
fn difference(from: &Gray, to: &Gray, at: [i32; 2], there: [f32; 2]) -> ([f32; 2], f32) {
    let [x, y] = at;
    let mut differences = [0.0; ((2 * HALF + 1) * (2 * HALF + 1)) as usize];
    let mut sum = 0.0;
    let mut index = 0;
    for row in -HALF..=HALF {
        for column in -HALF..=HALF {
            let seen = to.interpolated(there[0] + column as f32, there[1] + row as f32);
            differences[index] = seen - from.get(x + column, y + row);
            sum += differences[index];
            index += 1;
        }
    }
    let mean = sum / differences.len() as f32;
    let mut right = [0.0; 2];
    let mut absolute = 0.0;
    index = 0;
    for row in -HALF..=HALF {
        for column in -HALF..=HALF {
            let [gx, gy] = from.gradient(x + column, y + row);
            let difference = differences[index] - mean;
            right[0] += gx * difference;
            right[1] += gy * difference;
            absolute += difference.abs();
            index += 1;
        }
    }
    (right, absolute / differences.len() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A texture without repetition, moved by `shift` pixels.
    fn image(shift: [f32; 2]) -> Gray {
        let (width, height) = (64, 48);
        let mut rgb = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let (x, y) = (x as f32 - shift[0], y as f32 - shift[1]);
                let tone = (0.61 * x + 0.2 * y).sin() + (0.47 * y - 0.13 * x).sin();
                rgb.extend([(128.0 + 50.0 * tone).round() as u8; 3]);
            }
        }
        Gray::of_rgb(width, height, &rgb)
    }

    proptest! {
        #[test]
        fn a_shift_is_found_to_a_twentieth_of_a_pixel(dx in -2.0f32..2.0, dy in -2.0f32..2.0) {
            let found = follow(&image([0.0; 2]), &image([dx, dy]), [30, 24], [30.0, 24.0]);
            let [x, y] = found.unwrap();
            prop_assert!((x - 30.0 - dx).abs() < 0.05 && (y - 24.0 - dy).abs() < 0.05);
        }
    }

    #[test]
    fn a_plain_image_has_no_corners_and_follows_nothing() {
        let plain = Gray::of_rgb(64, 48, &[100; 64 * 48 * 3]);
        assert!(corners(&plain, 16).is_empty());
        assert_eq!(follow(&plain, &plain, [30, 24], [30.0, 24.0]), None);
    }

    #[test]
    fn every_cell_of_a_textured_image_has_at_most_one_corner() {
        let corners = corners(&image([0.0; 2]), 16);
        assert!((4..=12).contains(&corners.len()), "{corners:?}");
    }

    #[test]
    fn a_patch_that_leaves_the_image_is_not_followed() {
        assert_eq!(follow(&image([0.0; 2]), &image([0.0; 2]), [30, 24], [2.0, 24.0]), None);
    }
}
