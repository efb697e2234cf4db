//! Colour maps of the report images.

/// Red, green and blue in sRGB.
pub type Rgb = [u8; 3];

/// Colour of a depth, 0 (near) to 1 (far) of its scale: viridis from yellow to dark violet. Equal steps look equal, also in
/// grey and to eyes that do not tell red from green.
#[must_use]
pub fn depth(share: f64) -> Rgb {
    colorous::VIRIDIS.eval_continuous(1.0 - share.clamp(0.0, 1.0)).as_array()
}

/// Colour of a probability, 0 to 1: from nearly white to dark blue.
#[must_use]
pub fn probability(share: f64) -> Rgb {
    colorous::BLUES.eval_continuous(share.clamp(0.0, 1.0)).as_array()
}

/// Colour of the time along a path, 0 to 1: dark blue, violet, red, orange. All colours are dark
/// enough for lines on white.
#[must_use]
pub fn time(share: f64) -> Rgb {
    gradient(&[[26, 35, 126], [106, 27, 154], [198, 40, 90], [239, 108, 0]], share)
}

/// Colour of an error, 0 to 1 of its scale: white is no error, dark red the largest. The colours
/// also differ in lightness alone.
#[must_use]
pub fn error(share: f64) -> Rgb {
    gradient(&[[255, 255, 250], [253, 212, 158], [252, 141, 89], [200, 40, 30], [70, 0, 20]], share)
}

fn gradient(stops: &[Rgb], share: f64) -> Rgb {
    let at = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
    let index = (at as usize).min(stops.len() - 2);
    mix(stops[index], stops[index + 1], at - index as f64)
}

/// A linear mix of two colours: `under` at `share` 0, `over` at 1.
#[must_use]
pub fn mix(under: Rgb, over: Rgb, share: f64) -> Rgb {
    let mut mixed = under;
    for (channel, over) in mixed.iter_mut().zip(over) {
        let under = f64::from(*channel);
        *channel = (under + (f64::from(over) - under) * share).round() as u8;
    }
    mixed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn luma([red, green, blue]: Rgb) -> f64 {
        0.2126 * f64::from(red) + 0.7152 * f64::from(green) + 0.0722 * f64::from(blue)
    }

    #[test]
    fn near_is_yellow_and_far_is_violet() {
        assert_eq!([depth(0.0), depth(1.0)], [[253, 231, 37], [68, 1, 84]]);
    }

    #[test]
    fn a_gradient_begins_and_ends_with_its_first_and_last_colour() {
        assert_eq!(time(0.0), [26, 35, 126]);
        assert_eq!(time(1.0), [239, 108, 0]);
        assert_eq!(time(7.0), time(1.0));
    }

    proptest! {
        #[test]
        fn a_larger_error_is_always_darker(a in 0.0..1.0f64, b in 0.0..1.0f64) {
            prop_assume!(b - a > 0.01);
            prop_assert!(luma(error(b)) < luma(error(a)));
        }

        #[test]
        fn depth_and_probability_are_also_read_in_grey(a in 0.0..1.0f64, b in 0.0..1.0f64) {
            prop_assume!(b - a > 0.01);
            prop_assert!(luma(depth(b)) < luma(depth(a)));
            prop_assert!(luma(probability(b)) < luma(probability(a)));
        }

        #[test]
        fn a_path_is_always_readable_on_white(share in 0.0..1.0f64) {
            prop_assert!(luma(time(share)) < 140.0);
        }
    }
}
