//! What a measured number means: a distance, or one of the codes that hide below the shortest distance.

use hal::Range;

/// Limits and codes of one family of sensors (C-42-03320B, tables 3 and 4; `DMIN` and `DMAX` of the sensor's `PP` reply).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RangeCodes {
    /// Smaller numbers are codes, millimetres.
    pub dmin_mm: u32,
    /// Larger numbers mean that nothing came back, millimetres.
    pub dmax_mm: u32,
    /// The code for "no object in the range", where there is one.
    pub no_return: Option<u32>,
    /// The codes for "object too near".
    pub too_near: &'static [u32],
    /// Numbers above `dmax_mm` that are errors all the same.
    pub errors: &'static [u32],
}

impl RangeCodes {
    /// UTM-30LX: 1 no object, 2 and 4 too near, 3 interference, 5 other.
    pub const UTM_30LX: Self =
        Self { dmin_mm: 23, dmax_mm: 60_000, no_return: Some(1), too_near: &[2, 4], errors: &[] };
    /// URG-04LX: 0 possibly an object at 22 m; 1 to 19 are weak, strong or contradictory echoes.
    pub const URG_04LX: Self =
        Self { dmin_mm: 20, dmax_mm: 5_600, no_return: Some(0), too_near: &[], errors: &[] };
    /// UST-10LX. We have no table of its codes, so below the range everything is an error; above it no echo came, but for the
    /// two largest numbers of 16 bits, which are taken for errors to be careful.
    pub const UST_10LX: Self = Self {
        dmin_mm: 20,
        dmax_mm: 30_000,
        no_return: None,
        too_near: &[],
        errors: &[65_534, 65_535],
    };
    /// UST-20LX: as the UST-10LX, twice as far.
    pub const UST_20LX: Self = Self { dmax_mm: 60_000, ..Self::UST_10LX };

    /// The range of one beam. A code that is not known is an error, never "free".
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

    /// What a number that is no distance means.
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

/// A distance in metres, rounded once. Numbers have 18 bits at most, and vectors convert signed ones.
#[inline(always)]
pub(super) fn to_metres(value_mm: u32) -> f32 {
    value_mm as i32 as f32 / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_below_dmin_are_codes_and_only_one_of_them_means_no_return() {
        let range = |value| RangeCodes::UTM_30LX.range(value);
        assert_eq!(
            [range(1), range(2), range(4)],
            [Range::NoReturn, Range::TooNear, Range::TooNear]
        );
        for code in [0, 3].into_iter().chain(5..23) {
            assert_eq!(range(code), Range::Error, "{code}");
        }
        assert_eq!(RangeCodes::URG_04LX.range(0), Range::NoReturn);
        assert_eq!(RangeCodes::URG_04LX.range(19), Range::Error);
        assert!((0..20).all(|code| RangeCodes::UST_10LX.range(code) == Range::Error));
    }

    #[test]
    fn distances_are_metres_between_the_sensors_limits() {
        let range = |value| RangeCodes::UTM_30LX.range(value);
        assert_eq!([range(23), range(60_000)], [Range::Hit(0.023), Range::Hit(60.0)]);
        assert_eq!(range(65_533), Range::NoReturn);
    }

    #[test]
    fn the_largest_numbers_of_the_ust_models_are_errors_and_not_no_return() {
        let range = |value| RangeCodes::UST_10LX.range(value);
        assert_eq!([range(30_001), range(65_533)], [Range::NoReturn; 2]);
        assert_eq!([range(65_534), range(65_535)], [Range::Error; 2]);
    }
}
