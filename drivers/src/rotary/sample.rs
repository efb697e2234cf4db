//! What the codec of a rotating scanner makes of its bytes.

use hal::Range;

/// One distance that the scanner measured, with its direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Direction clockwise, seen from above an upright scanner, from the scanner's zero, radians from 0 to 2 pi.
    pub clockwise_rad: f64,
    pub range: Range,
}

/// What a codec found in the bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event<E> {
    Sample(Sample),
    /// Measurements are missing before the next one. Their directions stay errors.
    Missing,
    /// Bytes failed their checks and were dropped.
    Refused(E),
}

impl<E> Event<E> {
    /// The event with another type of errors.
    pub(crate) fn map_error<F>(self, convert: impl FnOnce(E) -> F) -> Event<F> {
        match self {
            Self::Sample(sample) => Event::Sample(sample),
            Self::Missing => Event::Missing,
            Self::Refused(error) => Event::Refused(convert(error)),
        }
    }
}
