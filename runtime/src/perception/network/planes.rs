//! Converts images to the network's input planes, and its output to depth.

use hal::DepthMap;
use multiversion::multiversion;

use super::bound::Float;
use super::spec::{ModelSpec, OutputKind};
use crate::perception::DepthEstimate;

/// Tolerance for rounding at the ends of an output's range, relative to the range, with 32 bits.
const ROUNDING: f32 = 1e-4;
/// Tolerance for rounding with the 11 significant bits of a 16-bit float, relative to the range.
const ROUNDING_HALF: f32 = 1e-3;
/// Confidence of a network without an uncertainty output. The paper's robot maps every pixel alike.
const DEFAULT_CONFIDENCE: f32 = 1.0;
/// A depth within a factor of 1.25 of the truth counts as right, the field's delta1 (Eigen et al. 2014): its logarithm.
const LN_DELTA1: f32 = 0.223_143_55;

/// Converts interleaved RGB bytes to planes of red, green and blue in 0..1.
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn write_rgb(rgb: &[u8], planes: &mut [f32]) {
    let pixels = rgb.len() / 3;
    let (red, rest) = planes.split_at_mut(pixels);
    let (green, blue) = rest.split_at_mut(pixels);
    for (((pixel, red), green), blue) in rgb.chunks_exact(3).zip(red).zip(green).zip(blue) {
        *red = f32::from(pixel[0]) / 255.0;
        *green = f32::from(pixel[1]) / 255.0;
        *blue = f32::from(pixel[2]) / 255.0;
    }
}

/// Converts coarse depth to planes of disparity (0..1 over the model's depth range), validity (0 or 1) and confidence.
pub(super) fn write_coarse(
    coarse: Option<&DepthEstimate>,
    (min_m, max_m): (f32, f32),
    planes: &mut [f32],
) {
    let Some(coarse) = coarse else {
        planes.fill(0.0);
        return;
    };
    let far = 1.0 / max_m;
    let span = 1.0 / min_m - 1.0 / max_m;
    let pixels = planes.len() / 3;
    let (disparity, rest) = planes.split_at_mut(pixels);
    let (validity, confidence) = rest.split_at_mut(pixels);
    for ((disparity, validity), &depth) in
        disparity.iter_mut().zip(validity).zip(coarse.depth.values())
    {
        let valid = depth > 0.0;
        *disparity = if valid { ((1.0 / depth - far) / span).clamp(0.0, 1.0) } else { 0.0 };
        *validity = f32::from(u8::from(valid));
    }
    for (plane, &value) in confidence.iter_mut().zip(&coarse.confidence) {
        *plane = value;
    }
}

/// Converts the network's output to depth and confidence. `false` if it contains NaN or values out of the model's range; the
/// estimate is then invalid.
pub(super) fn read_output(output: &[f32], spec: &ModelSpec, estimate: &mut DepthEstimate) -> bool {
    let Some((depth, uncertainty)) = output.split_at_checked(spec.size.0 * spec.size.1) else {
        return false;
    };
    let sound = read_depth(depth, spec, &mut estimate.depth);
    if !spec.uncertainty {
        estimate.confidence.fill(DEFAULT_CONFIDENCE);
        return sound;
    }
    sound && read_confidence(uncertainty, &mut estimate.confidence)
}

/// `false` if a value is not finite.
#[multiversion(targets("x86_64+avx2"))]
fn read_confidence(uncertainty: &[f32], confidence: &mut [f32]) -> bool {
    let mut finite = true;
    for (confidence, &ln_scale) in confidence.iter_mut().zip(uncertainty) {
        finite &= ln_scale.is_finite();
        *confidence = probability_of_delta1(ln_scale);
    }
    finite
}

#[multiversion(targets("x86_64+avx2"))]
fn read_depth(output: &[f32], spec: &ModelSpec, depth: &mut DepthMap) -> bool {
    let (min_m, max_m) = spec.depth_range_m;
    let (low, high) = match spec.output {
        OutputKind::Depth => (min_m, max_m),
        OutputKind::Disparity => (0.0, 1.0),
    };
    let rounding =
        high * if spec.output_port.float == Float::Half { ROUNDING_HALF } else { ROUNDING };
    let allowed = low - rounding..=high + rounding;
    let far = 1.0 / max_m;
    let span = 1.0 / min_m - 1.0 / max_m;
    let mut sound = true;
    for (depth, &value) in depth.values_mut().iter_mut().zip(output) {
        // NaN and infinity are not in the range.
        sound &= allowed.contains(&value);
        let metres = match spec.output {
            OutputKind::Depth => value,
            OutputKind::Disparity => 1.0 / (far + span * value),
        };
        *depth = metres.clamp(min_m, max_m);
    }
    sound
}

/// Probability that the depth is within a factor of 1.25 of the truth when the error of ln depth is Laplacian with scale
/// b = e^`ln_scale`: 1 - e^(-ln 1.25 / b). Head and loss as in Poggi et al. 2020, "On the uncertainty of self-supervised
/// monocular depth estimation".
#[inline(always)]
fn probability_of_delta1(ln_scale: f32) -> f32 {
    1.0 - exp(-LN_DELTA1 * exp(-ln_scale))
}

/// e^x with a relative error below 3e-7 for x in -87 to 88; beyond, the value at that end. Unlike the C library's function,
/// it can be vectorised. Cody and Waite 1980: 2^n times e^r with |r| <= ln 2 / 2, the latter by its Taylor series.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = x.clamp(-87.0, 88.0);
    // Adding and subtracting 1.5 * 2^23 rounds to the nearest integer.
    const ROUND: f32 = 12_582_912.0;
    let n = (x * std::f32::consts::LOG2_E + ROUND) - ROUND;
    // ln 2 in two parts, the first with few enough bits that n times it is exact.
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let series = 1.0
        + r * (1.0
            + r * (1.0 / 2.0 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r / 720.0)))));
    f32::from_bits(((n as i32 + 127) << 23) as u32) * series
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::network::bound::Port;

    #[test]
    fn e_to_the_x_agrees_with_the_c_library() {
        for step in -8700..=8800 {
            let x = step as f32 * 0.01;
            let relative = (f64::from(exp(x)) / f64::from(x).exp() - 1.0).abs();
            assert!(relative < 3e-7, "e^{x} is off by {relative}");
        }
        assert!(exp(1e9).is_finite() && exp(-1e9) >= 0.0 && exp(0.0) == 1.0);
    }

    #[test]
    fn bytes_become_planes_of_red_green_blue() {
        let mut planes = [9.0; 6];
        write_rgb(&[0, 51, 102, 255, 204, 153], &mut planes);
        assert_eq!(planes, [0.0, 1.0, 0.2, 0.8, 0.4, 0.6]);
    }

    #[test]
    fn coarse_disparity_is_1_at_the_nearest_and_0_at_the_farthest_depth_and_where_there_is_none() {
        let depth = DepthMap::from_vec(4, 1, vec![0.0, 0.1, 20.0, 100.0]).unwrap();
        let coarse = DepthEstimate { depth, confidence: vec![0.0, 0.5, 1.0, 0.25] };
        let mut planes = [9.0; 12];
        write_coarse(Some(&coarse), (0.1, 20.0), &mut planes);
        assert_eq!(planes[..4], [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(planes[4..8], [0.0, 1.0, 1.0, 1.0]);
        assert_eq!(planes[8..], [0.0, 0.5, 1.0, 0.25]);
        write_coarse(None, (0.1, 20.0), &mut planes);
        assert_eq!(planes, [0.0; 12]);
    }

    fn port(name: &str, channels: usize) -> Port {
        Port { name: name.to_owned(), float: Float::Single, shape: [1, channels, 1, 2] }
    }

    #[test]
    fn an_uncertainty_that_is_nan_makes_the_whole_output_invalid() {
        let spec = ModelSpec {
            input: crate::perception::network::InputKind::Rgb,
            given: crate::perception::network::GivenDepth::Coarse,
            output: OutputKind::Depth,
            uncertainty: true,
            depth_range_m: (0.5, 5.0),
            size: (2, 1),
            version: None,
            input_ports: vec![port("rgb", 3)],
            output_port: port("depth", 2),
        };
        let mut estimate = DepthEstimate::none(2, 1);
        assert!(read_output(&[1.0, 2.0, 0.0, 0.0], &spec, &mut estimate));
        assert!(!read_output(&[1.0, 2.0, 0.0, f32::NAN], &spec, &mut estimate));
        assert!(!read_output(&[1.0, f32::NAN, 0.0, 0.0], &spec, &mut estimate));
        assert!(!read_output(&[1.0, 5.1, 0.0, 0.0], &spec, &mut estimate));
        assert!(!read_output(&[1.0], &spec, &mut estimate), "too short");
    }

    #[test]
    fn confidence_is_the_share_of_laplacian_errors_below_ln_1_25() {
        // b = ln 1.25 / ln 2 puts half of the probability inside.
        let half = (1.25_f32.ln() / 2.0_f32.ln()).ln();
        assert!((probability_of_delta1(half) - 0.5).abs() < 1e-6);
        assert!(probability_of_delta1(-10.0) > 0.999 && probability_of_delta1(10.0) < 1e-3);
    }
}
