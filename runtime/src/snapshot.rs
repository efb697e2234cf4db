//! Everything that a robot remembers between two ticks, as bytes. A new robot that restores a snapshot decides bit for bit as
//! the robot that wrote it, so that a replay may begin at any snapshot of a recording.
//!
//! Configuration, models, and buffers that every tick overwrites are not in a snapshot: it is restored into a robot that was
//! built with the same configuration and models.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Increased whenever the layout of anything remembered changes. Snapshots of other layouts than the four here are refused;
/// recordings stay readable.
pub const SNAPSHOT_VERSION: u32 = 14;
/// The layout before, which lacks the maps of a robot that has several, at its end. It is read as that of a robot with one map.
pub const SNAPSHOT_WITHOUT_SEPARATE_MAPS: u32 = 13;
/// The layout before that, which also lacks what the robot knows of the scanner's latency and of the camera before it was turned, at its
/// end. It is read as that of a robot that knows nothing of them, which finds a change of them later than the robot that wrote it.
pub const SNAPSHOT_WITHOUT_SCANNER_TIME: u32 = 12;
/// The layout before that, which also lacks the memory of the inertial unit. It is read as that of a robot without a unit.
pub const SNAPSHOT_WITHOUT_IMU: u32 = 11;

/// Why a snapshot cannot be restored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// Another version of this program wrote it.
    #[error(
        "the snapshot has layout {found}, this program knows {SNAPSHOT_VERSION}: replay with the version that recorded it, or from \
         the run's first tick"
    )]
    Version {
        /// Layout of the snapshot.
        found: u32,
    },
    /// The bytes are not those of a snapshot.
    #[error("the snapshot is damaged: {0}; replay from another one, or from the run's first tick")]
    Damaged(String),
    /// The snapshot belongs to a robot with another configuration or model.
    #[error(
        "the snapshot is of another robot: {what} is {found} there and {here} here; build the robot from the recording's header"
    )]
    OtherRobot {
        /// Name of what differs.
        what: &'static str,
        /// Its value in the snapshot.
        found: String,
        /// Its value in this robot.
        here: String,
    },
}

/// A part of the robot with memory. A value that serde can serialize is memory as a whole; [`remembers`] lists the fields of
/// a larger type that are memory.
pub(crate) trait State {
    /// Appends the memory to `to`.
    fn write(&self, to: &mut Vec<u8>);

    /// Restores what [`write`](Self::write) wrote, and moves `from` behind it.
    ///
    /// # Errors
    /// When the bytes are not those of this part. It may then be restored in part, and its robot must not be used.
    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError>;
}

impl<T: Serialize + DeserializeOwned> State for T {
    fn write(&self, to: &mut Vec<u8>) {
        // Serialization into memory fails only for sequences of unknown length, and no part has one.
        if let Ok(bytes) = postcard::to_stdvec(self) {
            to.extend_from_slice(&bytes);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let (value, rest) = postcard::take_from_bytes(from)
            .map_err(|error| SnapshotError::Damaged(error.to_string()))?;
        *self = value;
        *from = rest;
        Ok(())
    }
}

/// Writes numbers as they are in memory, which is faster than serde for a map of a million cells.
pub(crate) fn write_bulk<T: bytemuck::NoUninit>(values: &[T], to: &mut Vec<u8>) {
    to.extend_from_slice(&(values.len() as u64).to_le_bytes());
    to.extend_from_slice(bytemuck::cast_slice(values));
}

/// The inverse of [`write_bulk`] for at most `most` values.
pub(crate) fn read_bulk<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
    values: &mut Vec<T>,
    most: usize,
    from: &mut &[u8],
) -> Result<(), SnapshotError> {
    let (length, rest) = from.split_first_chunk().ok_or_else(|| damaged("it is truncated"))?;
    let count = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|count| *count <= most);
    let count = count.ok_or_else(|| damaged("it has more values than this robot can hold"))?;
    let (bytes, rest) =
        rest.split_at_checked(count * size_of::<T>()).ok_or_else(|| damaged("it is truncated"))?;
    values.clear();
    values.resize(count, T::zeroed());
    bytemuck::cast_slice_mut::<T, u8>(values).copy_from_slice(bytes);
    *from = rest;
    Ok(())
}

fn damaged(what: &str) -> SnapshotError {
    SnapshotError::Damaged(what.to_owned())
}

/// `remembers!(Type: field, field)`: these fields are memory, written in this order. All other fields follow from the
/// configuration, or every tick overwrites them.
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
    fn bulk_is_read_back_bit_for_bit_and_is_refused_when_truncated_or_too_long() {
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
    fn a_length_that_no_memory_holds_is_refused_before_allocation() {
        let bytes = u64::MAX.to_le_bytes();
        assert!(read_bulk::<u16>(&mut Vec::new(), 1000, &mut bytes.as_slice()).is_err());
    }
}
