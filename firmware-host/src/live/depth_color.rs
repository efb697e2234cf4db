//! Depth as a colour: yellow near, blue-violet far. Lightness falls with distance, so that it can be read without seeing hues.

use hal::DepthMap;

use crate::report::colors;

/// The nearest and the farthest depth that differ in colour, metres.
const NEAR_M: f32 = 0.3;
const FAR_M: f32 = 10.0;
/// Where there is no depth.
const NONE: [u8; 3] = [110, 110, 110];

/// The image in RGB8, row-major.
pub fn image(depth: &DepthMap) -> Vec<u8> {
    depth.values().iter().flat_map(|depth_m| color(*depth_m)).collect()
}

/// The colour of a depth on a logarithmic scale, as near things matter more.
fn color(depth_m: f32) -> [u8; 3] {
    if !(depth_m > 0.0 && depth_m.is_finite()) {
        return NONE;
    }
    let share = (depth_m / NEAR_M).ln() / (FAR_M / NEAR_M).ln();
    colors::depth(f64::from(share))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn farther_is_darker_and_no_depth_is_grey() {
        let depths = [0.3, 0.5, 0.8, 1.3, 2.0, 3.0, 5.0, 8.0, 10.0];
        assert!(depths.windows(2).all(|pair| luma(pair[0]) > luma(pair[1])));
        for none in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert_eq!(color(none), NONE);
        }
        assert_eq!([color(0.01), color(90.0)], [colors::depth(0.0), colors::depth(1.0)]);
    }

    fn luma(depth_m: f32) -> f32 {
        let [red, green, blue] = color(depth_m).map(f32::from);
        0.2126 * red + 0.7152 * green + 0.0722 * blue
    }
}
