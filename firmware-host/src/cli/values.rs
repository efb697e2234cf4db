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

pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.0..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("`{text}` is not a number of seconds from 0 to 3600"))
}

pub fn parse_scale(text: &str) -> Result<f64, String> {
    let scale = text.parse::<f64>().ok().filter(|scale| *scale > 0.0 && scale.is_finite());
    scale.ok_or_else(|| format!("`{text}` is not a number above 0"))
}

pub fn parse_place(text: &str) -> Result<[f64; 2], String> {
    let numbers: Result<Vec<f64>, _> =
        text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok([x_m, y_m]) if x_m.is_finite() && y_m.is_finite() => Ok([*x_m, *y_m]),
        _ => Err(format!("`{text}` is not two numbers such as 1.5,-2")),
    }
}

pub fn parse_start(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> =
        text.split(',').map(|part| part.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok([x, y, yaw]) if [x, y, yaw].iter().all(|value| value.is_finite()) => Ok([*x, *y, *yaw]),
        _ => Err(format!("`{text}` is not three numbers such as 1.5,-2,90")),
    }
}
