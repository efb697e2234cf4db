//! Encoding of ranges as the numbers of a `foxglove.LaserScan`.

use hal::Range;

/// Viewers show a distance that is not finite as an error, but a replay needs its bits. They are stored in the payload of
/// a quiet NaN with this prefix.
const NOT_FINITE_HIT: u64 = 0x7ff8_0001_0000_0000;

/// REP-117: too near is -inf, no return is +inf, an error is NaN.
pub(super) fn encode(range: Range) -> f64 {
    match range {
        Range::Hit(distance_m) if distance_m.is_finite() => f64::from(distance_m),
        Range::Hit(distance_m) => f64::from_bits(NOT_FINITE_HIT | u64::from(distance_m.to_bits())),
        Range::NoReturn => f64::INFINITY,
        Range::TooNear => f64::NEG_INFINITY,
        Range::Error => f64::NAN,
    }
}

/// The inverse of [`encode`]; `None` for a number that it cannot have written.
pub(super) fn decode(number: f64) -> Option<Range> {
    if number == f64::INFINITY {
        return Some(Range::NoReturn);
    }
    if number == f64::NEG_INFINITY {
        return Some(Range::TooNear);
    }
    if number.is_nan() {
        let bits = number.to_bits();
        let is_hit = bits & !0xffff_ffff == NOT_FINITE_HIT;
        return Some(if is_hit { Range::Hit(f32::from_bits(bits as u32)) } else { Range::Error });
    }
    let distance_m = number as f32;
    (f64::from(distance_m).to_bits() == number.to_bits()).then_some(Range::Hit(distance_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_hit_comes_back_bit_for_bit(bits in any::<u32>()) {
            match decode(encode(Range::Hit(f32::from_bits(bits)))) {
                Some(Range::Hit(back)) => prop_assert_eq!(back.to_bits(), bits),
                other => prop_assert!(false, "{:?}", other),
            }
        }
    }

    #[test]
    fn what_is_not_a_hit_comes_back_and_follows_rep_117() {
        for range in [Range::NoReturn, Range::TooNear, Range::Error] {
            assert_eq!(decode(encode(range)), Some(range));
        }
        assert_eq!(encode(Range::NoReturn), f64::INFINITY);
        assert_eq!(encode(Range::TooNear), f64::NEG_INFINITY);
        assert!(encode(Range::Error).is_nan());
    }

    #[test]
    fn hits_that_are_not_finite_come_back_as_such() {
        for bad in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            let number = encode(Range::Hit(bad));
            assert!(number.is_nan());
            assert!(
                matches!(decode(number), Some(Range::Hit(back)) if back.to_bits() == bad.to_bits())
            );
        }
    }

    #[test]
    fn a_distance_that_no_f32_holds_is_refused() {
        assert_eq!(decode(0.1), None);
    }
}
