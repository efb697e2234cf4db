//! The protocol of a unit in another program, at a Unix stream socket: a record of 56 bytes for each sample, little-endian.
//!
//! | bytes | content |
//! |---|---|
//! | 0 to 7 | time of the measurement on the monotonic clock, nanoseconds, unsigned |
//! | 8 to 31 | angular velocity about x, y and z, rad/s, 64-bit floating point |
//! | 32 to 55 | specific force along x, y and z, m/s2; NaN three times for a gyroscope alone |

use hal::ImuSample;

/// Number of bytes of a record.
pub const RECORD_BYTES: usize = 56;

/// Writes a sample.
#[must_use]
pub fn encode(sample: &ImuSample) -> [u8; RECORD_BYTES] {
    let mut record = [0; RECORD_BYTES];
    let force = sample.force_mps2.unwrap_or([f64::NAN; 3]);
    let numbers = sample.angular_radps.into_iter().chain(force).map(f64::to_le_bytes);
    let words = std::iter::once(sample.time_ns.to_le_bytes()).chain(numbers);
    for (place, word) in record.as_chunks_mut().0.iter_mut().zip(words) {
        *place = word;
    }
    record
}

/// Reads a sample. Its numbers may be anything.
#[must_use]
pub fn decode(record: &[u8; RECORD_BYTES]) -> ImuSample {
    let mut words = record.as_chunks().0.iter().copied();
    let time_ns = words.next().map_or(0, u64::from_le_bytes);
    let mut next = || words.next().map_or(f64::NAN, f64::from_le_bytes);
    let angular_radps = std::array::from_fn(|_| next());
    let force: [f64; 3] = std::array::from_fn(|_| next());
    let has_force = !force.iter().all(|value| value.is_nan());
    ImuSample { time_ns, angular_radps, force_mps2: has_force.then_some(force) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_read_as_it_was_written() {
        let unit = ImuSample {
            time_ns: u64::MAX - 1,
            angular_radps: [0.1, -0.2, 3e-9],
            force_mps2: Some([0.0, 9.8, -1.5]),
        };
        let gyroscope = ImuSample { force_mps2: None, ..unit };
        for sample in [unit, gyroscope] {
            assert_eq!(decode(&encode(&sample)), sample);
        }
    }

    #[test]
    fn the_bytes_are_those_of_the_table() {
        let sample =
            ImuSample { time_ns: 258, angular_radps: [0.0, 0.0, 1.0], force_mps2: Some([2.0; 3]) };
        let record = encode(&sample);
        assert_eq!(record[..8], [2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(record[24..32], [0, 0, 0, 0, 0, 0, 0xf0, 0x3f]);
        assert_eq!(record[48..], [0, 0, 0, 0, 0, 0, 0, 0x40]);
    }

    #[test]
    fn a_force_with_one_nan_is_a_force_that_is_not_finite() {
        let force_mps2 = Some([f64::NAN, 0.0, 9.8]);
        let sample = ImuSample { time_ns: 1, angular_radps: [0.0; 3], force_mps2 };
        assert!(!decode(&encode(&sample)).is_finite());
    }
}
