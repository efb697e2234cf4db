//! The type of one channel in a record, as the kernel describes it in `scan_elements/*_type`.

use std::fmt;
use std::str::FromStr;

/// The text is not of the form `[be|le]:[s|u]BITS/STORAGE[Xn]>>SHIFT`, or its numbers do not fit together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not a type such as le:s16/16>>0")]
pub struct TypeError;

/// How the bytes of a channel become a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ElementType {
    is_big_endian: bool,
    is_signed: bool,
    bits: u32,
    storage_bits: u32,
    /// How often the value is repeated. Channels with several values, such as quaternions, are no channels of an axis; their
    /// size still matters to those that follow.
    repeat: u32,
    shift: u32,
}

/// The kernel's field for it is 8 bits wide.
const MOST_REPEATS: u32 = 255;

impl ElementType {
    /// Number of bytes in a record.
    #[must_use]
    pub fn bytes(&self) -> usize {
        (self.value_bytes() as u32 * self.repeat) as usize
    }

    fn value_bytes(&self) -> usize {
        self.storage_bits as usize / 8
    }

    /// The first value in these bytes; `None` if there are too few of them.
    #[must_use]
    pub fn value(&self, bytes: &[u8]) -> Option<i64> {
        let bytes = bytes.get(..self.value_bytes())?;
        let push = |stored: u64, byte: &u8| (stored << 8) | u64::from(*byte);
        let stored = if self.is_big_endian {
            bytes.iter().fold(0, push)
        } else {
            bytes.iter().rev().fold(0, push)
        };
        // The value is moved to the upper end of a word and back, which drops other bits and repeats the sign.
        let above = 64 - self.bits;
        let value = (stored >> self.shift) << above;
        if self.is_signed {
            return Some(value.cast_signed() >> above);
        }
        Some(i64::try_from(value >> above).unwrap_or(i64::MAX))
    }

    fn is_consistent(&self) -> bool {
        matches!(self.storage_bits, 8 | 16 | 32 | 64)
            && self.bits >= 1
            && self.bits.checked_add(self.shift).is_some_and(|bits| bits <= self.storage_bits)
            && (1..=MOST_REPEATS).contains(&self.repeat)
    }
}

impl FromStr for ElementType {
    type Err = TypeError;

    fn from_str(text: &str) -> Result<Self, TypeError> {
        let parsed = parse(text).filter(Self::is_consistent).ok_or(TypeError)?;
        Ok(parsed)
    }
}

fn parse(text: &str) -> Option<ElementType> {
    let (order, rest) = text.split_once(':')?;
    let is_big_endian = match order {
        "be" => true,
        "le" => false,
        _ => return None,
    };
    let is_signed = rest.starts_with('s');
    let rest = rest.strip_prefix(['s', 'u'])?;
    let (bits, rest) = rest.split_once('/')?;
    let (storage, shift) = rest.split_once(">>")?;
    let (storage_bits, repeat) = storage.split_once('X').unwrap_or((storage, "1"));
    Some(ElementType {
        is_big_endian,
        is_signed,
        bits: number(bits)?,
        storage_bits: number(storage_bits)?,
        repeat: number(repeat)?,
        shift: number(shift)?,
    })
}

/// A number in digits alone.
fn number(digits: &str) -> Option<u32> {
    digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())?
}

impl fmt::Display for ElementType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let order = if self.is_big_endian { "be" } else { "le" };
        let sign = if self.is_signed { 's' } else { 'u' };
        write!(f, "{order}:{sign}{}/{}", self.bits, self.storage_bits)?;
        if self.repeat != 1 {
            write!(f, "X{}", self.repeat)?;
        }
        write!(f, ">>{}", self.shift)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(kind: &str, bytes: &[u8]) -> Option<i64> {
        kind.parse::<ElementType>().unwrap().value(bytes)
    }

    #[test]
    fn values_are_read_in_their_order_with_their_sign_and_shift() {
        assert_eq!(value("le:s16/16>>0", &[0xfe, 0xff]), Some(-2));
        assert_eq!(value("be:s16/16>>0", &[0xff, 0xfe]), Some(-2));
        assert_eq!(
            value("be:s12/16>>4", &[0x80, 0x0f]),
            Some(-2048),
            "the lower bits are not its own"
        );
        assert_eq!(value("le:u12/16>>4", &[0x0f, 0x80]), Some(0x800));
        assert_eq!(value("le:s24/32>>8", &[0x55, 0xff, 0xff, 0xff]), Some(-1));
        assert_eq!(value("le:u8/8>>0", &[0xff]), Some(255));
        assert_eq!(value("le:s64/64>>0", &i64::MIN.to_le_bytes()), Some(i64::MIN));
        assert_eq!(value("le:s32/32X2>>0", &[1, 0, 0, 0, 2, 0, 0, 0]), Some(1), "the first of two");
    }

    #[test]
    fn too_few_bytes_are_no_value_and_an_unsigned_value_never_becomes_negative() {
        assert_eq!(value("le:s16/16>>0", &[1]), None);
        assert_eq!(value("le:u64/64>>0", &u64::MAX.to_le_bytes()), Some(i64::MAX));
    }

    #[test]
    fn a_text_that_is_no_type_is_refused() {
        for text in [
            "",
            "le",
            "le:s16",
            "xe:s16/16>>0",
            "le:f32/32>>0",
            "le:s16/16",
            "le:s0/16>>0",
            "le:s17/16>>0",
            "le:s16/16>>4",
            "le:s16/24>>0",
            "le:s16/16X0>>0",
            "le:s16/16X256>>0",
            "le:s+16/16>>0",
            "le:s16/16>>4294967295",
        ] {
            assert_eq!(text.parse::<ElementType>(), Err(TypeError), "{text}");
        }
    }
}
