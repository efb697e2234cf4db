//! All that a robot remembers between two turns, as bytes: a fresh robot that takes them up goes on to the last bit as the one
//! that wrote them down. So a replay may begin anywhere that a snapshot was recorded.
//!
//! What shapes decisions but is no memory (configuration, models, buffers that every turn fills anew) is not in it: whoever takes
//! up a snapshot has built the same robot first.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Goes up whenever the layout of anything remembered changes: old snapshots are then refused, recordings stay readable.
pub const SNAPSHOT_VERSION: u32 = 2;

/// Why a snapshot cannot be taken up.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// Another version of this program wrote it.
    #[error(
        "the snapshot has layout {found}, this program knows {SNAPSHOT_VERSION}: replay with the version that recorded it, or from \
         the run's first turn"
    )]
    Version {
        /// Its layout.
        found: u32,
    },
    /// The bytes are not those of a snapshot.
    #[error("the snapshot is damaged: {0}; replay from another one, or from the run's first turn")]
    Damaged(String),
    /// The robot is another one.
    #[error(
        "the snapshot is of another robot: {what} is {found} there and {here} here; build the robot from the recording's header"
    )]
    OtherRobot {
        /// What differs.
        what: &'static str,
        /// In the snapshot.
        found: String,
        /// In this robot.
        here: String,
    },
}

/// A part of the robot that remembers something. Values remember themselves whole; [`remembers`] says of larger things which of
/// their fields are memory.
pub(crate) trait State {
    /// Writes down what is remembered.
    fn write(&self, to: &mut Vec<u8>);

    /// Takes up what [`write`](Self::write) wrote, and moves `from` behind it.
    ///
    /// # Errors
    /// Bytes that cannot be; the part is then half old, half new, and its robot must not be used.
    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError>;
}

impl<T: Serialize + DeserializeOwned> State for T {
    fn write(&self, to: &mut Vec<u8>) {
        // Writing into memory fails for no type that has a length.
        if let Ok(bytes) = postcard::to_stdvec(self) {
            to.extend_from_slice(&bytes);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let (value, rest) = postcard::take_from_bytes(from)
            .map_err(|error| SnapshotError::Damaged(error.to_string()))?;
        (*self, *from) = (value, rest);
        Ok(())
    }
}

/// Numbers in bulk, as they lie in memory: a map has a million.
pub(crate) fn write_bulk<T: bytemuck::NoUninit>(values: &[T], to: &mut Vec<u8>) {
    to.extend_from_slice(&(values.len() as u64).to_le_bytes());
    to.extend_from_slice(bytemuck::cast_slice(values));
}

/// The inverse of [`write_bulk`]; `most` values at most.
pub(crate) fn read_bulk<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
    values: &mut Vec<T>,
    most: usize,
    from: &mut &[u8],
) -> Result<(), SnapshotError> {
    let damaged = |what: &str| SnapshotError::Damaged(what.to_owned());
    let (length, rest) = from.split_first_chunk().ok_or_else(|| damaged("it ends too early"))?;
    let count = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|count| *count <= most);
    let count = count.ok_or_else(|| damaged("more values than there can be"))?;
    let (bytes, rest) = rest
        .split_at_checked(count * size_of::<T>())
        .ok_or_else(|| damaged("it ends too early"))?;
    values.clear();
    values.resize(count, T::zeroed());
    bytemuck::cast_slice_mut::<T, u8>(values).copy_from_slice(bytes);
    *from = rest;
    Ok(())
}

/// `remembers!(Type: field, field)`: these fields are what it remembers, in this order; all others follow from the
/// configuration or are made anew each turn.
macro_rules! remembers {
    ($type:ty: $($field:ident),+ $(,)?) => {
        impl $crate::snapshot::State for $type {
            fn write(&self, to: &mut Vec<u8>) {
                $($crate::snapshot::State::write(&self.$field, to);)+
            }

            fn read(&mut self, from: &mut &[u8]) -> Result<(), $crate::snapshot::SnapshotError> {
                $($crate::snapshot::State::read(&mut self.$field, from)?;)+
                Ok(())
            }
        }
    };
}
pub(crate) use remembers;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bulk_comes_back_to_the_bit_and_what_is_cut_or_too_long_is_refused() {
        let values = [0.0_f32, -0.0, 1.5, f32::NAN, f32::MIN_POSITIVE / 2.0];
        let mut bytes = Vec::new();
        write_bulk(&values, &mut bytes);
        let mut back = vec![7.0_f32; 9];
        read_bulk(&mut back, 5, &mut bytes.as_slice()).unwrap();
        assert_eq!(
            back.iter().map(|value| value.to_bits()).collect::<Vec<_>>(),
            values.map(f32::to_bits)
        );
        assert!(read_bulk(&mut back, 4, &mut bytes.as_slice()).is_err());
        for len in 0..bytes.len() {
            assert!(read_bulk(&mut back, 5, &mut &bytes[..len]).is_err());
        }
    }

    #[test]
    fn a_length_that_no_memory_holds_is_refused_before_it_is_asked_for() {
        let bytes = u64::MAX.to_le_bytes();
        assert!(read_bulk::<u16>(&mut Vec::new(), 1000, &mut bytes.as_slice()).is_err());
    }
}
