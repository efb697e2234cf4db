//! The meaning of a measured number: a distance, or one of the codes below the shortest distance.

use hal::Range;

/// The limits and codes of one family of sensors (C-42-03320B, tables 3 and 4; `DMIN` and `DMAX` of
/// the sensor's `PP` reply).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RangeCodes {
    /// Smaller numbers are codes.
    pub dmin_mm: u32,
    /// Larger numbers mean that there was no echo.
    pub dmax_mm: u32,
    /// The code for "no object in the range", if the family has one.
    pub no_return: Option<u32>,
    /// The codes for "object too near".
    pub too_near: &'static [u32],
    /// Numbers above `dmax_mm` that are errors nevertheless.
    pub errors: &'static [u32],
}

impl RangeCodes {
    /// UTM-30LX: 1 no object, 2 and 4 too near, 3 interference, 5 other.
    pub const UTM_30LX: Self =
        Self { dmin_mm: 23, dmax_mm: 60_000, no_return: Some(1), too_near: &[2, 4], errors: &[] };
    /// URG-04LX: 0 may be an object at 22 m; 1 to 19 are weak, strong or contradictory echoes.
    pub const URG_04LX: Self =
        Self { dmin_mm: 20, dmax_mm: 5_600, no_return: Some(0), too_near: &[], errors: &[] };
    /// UST-10LX. No table of its codes is available, so every number below the range is an error.
    /// Numbers above the range mean that there was no echo, except for the two largest numbers of
    /// 16 bits, which are treated as errors to be safe.
    pub const UST_10LX: Self = Self {
        dmin_mm: 20,
        dmax_mm: 30_000,
        no_return: None,
        too_near: &[],
        errors: &[65_534, 65_535],
    };
    /// UST-20LX: as the UST-10LX with twice the range.
    pub const UST_20LX: Self = Self { dmax_mm: 60_000, ..Self::UST_10LX };

    /// Decodes the number of one beam. An unknown code is an error and never means free space.
    #[must_use]
    pub fn range(&self, value_mm: u32) -> Range {
        if self.is_distance(value_mm) {
            Range::Hit(to_metres(value_mm))
        } else {
            self.code(value_mm)
        }
    }

    /// Whether a number is a distance.
    #[inline(always)]
    pub(super) fn is_distance(&self, value_mm: u32) -> bool {
        (self.dmin_mm..=self.dmax_mm).contains(&value_mm)
    }

    /// Decodes a number that is not a distance.
    #[inline(never)]
    pub(super) fn code(&self, value: u32) -> Range {
        if value > self.dmax_mm {
            return if self.errors.contains(&value) { Range::Error } else { Range::NoReturn };
        }
        match value {
            code if Some(code) == self.no_return => Range::NoReturn,
            code if self.too_near.contains(&code) => Range::TooNear,
            _ => Range::Error,
        }
    }
}

/// Converts a distance to metres with a single rounding. The numbers have at most 18 bits, and the
/// vector instructions convert signed integers.
#[inline(always)]
pub(super) fn to_metres(value_mm: u32) -> f32 {
    value_mm as i32 as f32 / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_below_dmin_are_codes_and_only_one_of_them_means_no_return() {
        let codes = RangeCodes::UTM_30LX;
        assert_eq!(
            [1, 2, 4].map(|code| codes.range(code)),
            [Range::NoReturn, Range::TooNear, Range::TooNear]
        );
        for code in [0, 3].into_iter().chain(5..23) {
            assert_eq!(codes.range(code), Range::Error, "{code}");
        }
        assert_eq!(RangeCodes::URG_04LX.range(0), Range::NoReturn);
        assert_eq!(RangeCodes::URG_04LX.range(19), Range::Error);
        assert!((0..20).all(|code| RangeCodes::UST_10LX.range(code) == Range::Error));
    }

    #[test]
    fn numbers_between_the_sensors_limits_are_distances() {
        let codes = RangeCodes::UTM_30LX;
        assert_eq!(codes.range(23), Range::Hit(0.023));
        assert_eq!(codes.range(60_000), Range::Hit(60.0));
        assert_eq!(codes.range(65_533), Range::NoReturn);
    }

    #[test]
    fn the_two_largest_numbers_of_the_ust_models_are_errors() {
        let codes = RangeCodes::UST_10LX;
        assert_eq!([30_001, 65_533].map(|value| codes.range(value)), [Range::NoReturn; 2]);
        assert_eq!([65_534, 65_535].map(|value| codes.range(value)), [Range::Error; 2]);
    }
}
