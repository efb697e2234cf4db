//! Colour maps of the report images.

/// Red, green and blue in sRGB.
pub type Rgb = [u8; 3];

/// Google's Turbo colour map (Mikhailov 2019) as its published polynomial fit of degree five: blue
/// at 0, red at 1.
#[must_use]
pub fn turbo(share: f64) -> Rgb {
    const RED: [f64; 6] = [
        0.135_721_38,
        4.615_392_60,
        -42.660_322_58,
        132.131_082_34,
        -152.942_393_96,
        59.286_379_43,
    ];
    const GREEN: [f64; 6] =
        [0.091_402_61, 2.194_188_39, 4.842_966_58, -14.185_033_33, 4.277_298_57, 2.829_566_04];
    const BLUE: [f64; 6] = [
        0.106_673_30,
        12.641_946_08,
        -60.582_048_36,
        110.362_767_71,
        -89.903_109_12,
        27.348_249_73,
    ];
    [RED, GREEN, BLUE].map(|coefficients| polynomial(&coefficients, share))
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

fn polynomial(coefficients: &[f64], x: f64) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let value = coefficients.iter().rev().fold(0.0, |sum, coefficient| sum * x + coefficient);
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
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
    fn turbo_goes_from_blue_over_green_to_red() {
        let [low, middle, high] = [0.1, 0.5, 0.9].map(turbo);
        assert!(low[2] > low[0] && low[2] > low[1], "{low:?}");
        assert!(middle[1] > middle[0] && middle[1] > middle[2], "{middle:?}");
        assert!(high[0] > high[1] && high[0] > high[2], "{high:?}");
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
        fn a_path_is_always_readable_on_white(share in 0.0..1.0f64) {
            prop_assert!(luma(time(share)) < 140.0);
        }
    }
}
