//! Which of the rates that a device has is the nearest.

/// The text to write for a rate. `available` is the text of the attribute `sampling_frequency_available`: rates, or
/// `[MIN STEP MAX]`. Without it, any rate may be written and the device takes the nearest.
pub(super) fn nearest(rate_hz: f64, available: Option<&str>) -> String {
    let Some(available) = available else { return rate_hz.to_string() };
    if let Some(range) = available.trim().strip_prefix('[') {
        return within(rate_hz, range.trim_end_matches(']'));
    }
    // The distance is a ratio: 200 Hz is as far from 100 Hz as 50 Hz is.
    let listed = available.split_whitespace().filter_map(|text| {
        let hz = text.parse::<f64>().ok().filter(|hz| *hz > 0.0)?;
        Some(((hz / rate_hz).ln().abs(), text))
    });
    let best = listed.min_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| rate_hz.to_string(), |(_, text)| text.to_owned())
}

fn within(rate_hz: f64, range: &str) -> String {
    let mut numbers = range.split_whitespace().map(str::parse::<f64>);
    match [numbers.next(), numbers.next(), numbers.next()] {
        [Some(Ok(min)), Some(Ok(_)), Some(Ok(max))] => rate_hz.min(max).max(min).to_string(),
        _ => rate_hz.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_listed_rate_is_written_as_it_is_listed() {
        // The lists of a BMI160 and of an LSM6DSOX.
        let bmi160 = "25 50 100 200 400 800 1600 3200";
        assert_eq!(nearest(100.0, Some(bmi160)), "100");
        assert_eq!(nearest(130.0, Some(bmi160)), "100");
        assert_eq!(nearest(150.0, Some(bmi160)), "200");
        let lsm6dsox = "12.500000 26.000000 52.000000 104.000000";
        assert_eq!(nearest(100.0, Some(lsm6dsox)), "104.000000");
    }

    #[test]
    fn a_rate_within_a_range_is_written_as_it_is_and_one_outside_becomes_its_end() {
        assert_eq!(nearest(100.0, Some("[4 1 1000]")), "100");
        assert_eq!(nearest(100.0, Some("[4 1 50]")), "50");
        assert_eq!(nearest(12.5, None), "12.5");
    }

    #[test]
    fn a_list_without_a_rate_is_as_no_list() {
        assert_eq!(nearest(100.0, Some("")), "100");
        assert_eq!(nearest(100.0, Some("fast slow 0")), "100");
        assert_eq!(nearest(100.0, Some("[4 1]")), "100");
    }
}
