//! Parsers of values on the command line, whose errors name the value and the range.

use std::ops::RangeInclusive;

/// A parser of whole numbers whose error names the range.
pub fn whole_number(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<u64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| match (range.start(), range.end()) {
            (least, &u64::MAX) => format!("it is not a whole number, {least} or more"),
            (least, most) => format!("it is not a whole number from {least} to {most}"),
        })
    }
}

/// Seconds, from 0 to an hour.
pub(super) fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.0..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("`{text}` is not a number of seconds from 0 to 3600"))
}

/// A factor above 0.
pub(super) fn parse_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse::<f64>().ok().filter(|scale| *scale > 0.0 && scale.is_finite());
    scale.ok_or_else(|| format!("`{text}` is not a number above 0"))
}

/// x and y, metres.
pub(super) fn parse_place(text: &str) -> Result<[f64; 2], String> {
    finite(text).ok_or_else(|| format!("`{text}` is not two numbers such as 1.5,-2"))
}

/// x and y in metres, and the heading in degrees.
pub(super) fn parse_start(text: &str) -> Result<[f64; 3], String> {
    finite(text).ok_or_else(|| format!("`{text}` is not three numbers such as 1.5,-2,90"))
}

/// Exactly `N` finite numbers with commas between them.
fn finite<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Vec<f64> =
        text.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    let numbers: [f64; N] = numbers.try_into().ok()?;
    numbers.iter().all(|number| number.is_finite()).then_some(numbers)
}
