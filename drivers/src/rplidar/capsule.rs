//! Capsules of an express scan: legacy ones of 32 measurements (kind 0x82) and dense ones of 40 (kind
//! 0x85). Both have 84 bytes.
//!
//! ```text
//! byte  0     0xA in the upper half, lower half of the checksum
//! byte  1     0x5 in the upper half, upper half of the checksum
//! bytes 2, 3  angle of the first measurement, 1/64 degree, clockwise; highest bit: a new scan begins
//! bytes 4..84 legacy: 16 cabins of two measurements; dense: 40 distances in millimetres
//! ```
//!
//! The checksum is the exclusive or of bytes 2 to 83. A cabin has five bytes: two words with a
//! distance in millimetres in the upper 14 bits and the upper two bits of an angle correction below,
//! then a byte with the lower four bits of both corrections. Corrections count 1/8 degree and are
//! subtracted. The maker's notes call their top bit a sign; the maker's software takes all six bits
//! for a number from 0 to 7.9 degrees, which is what the optics of a triangulating scanner need, and
//! so does this one.
//!
//! The directions of a capsule's measurements are spread evenly up to the first of the next capsule.

use super::AnswerError;
use super::measurement::FULL_CIRCLE_Q6;

/// Length of a capsule, bytes.
pub const CAPSULE_BYTES: usize = 84;

const HEAD: usize = 4;
const CABIN_BYTES: usize = 5;
const NEW_SCAN: u16 = 0x8000;

/// The two layouts of a capsule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Layout {
    #[default]
    Legacy,
    Dense,
}

impl Layout {
    /// Measurements of one capsule.
    #[must_use]
    pub fn measurements(self) -> usize {
        match self {
            Self::Legacy => 32,
            Self::Dense => 40,
        }
    }
}

/// A measurement of a capsule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cell {
    /// Distance, millimetres; 0 if nothing was measured.
    pub distance_mm: u16,
    /// Correction that is subtracted from the angle, 1/8 degree, 0 to 63.
    pub correction_q3: u8,
}

/// A capsule that passed its checks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Capsule {
    bytes: [u8; CAPSULE_BYTES],
    layout: Layout,
}

/// Whether these bytes may be the beginning of a capsule.
#[must_use]
pub fn may_begin(bytes: &[u8]) -> bool {
    let first = bytes.first().is_some_and(|byte| byte >> 4 == 0xa);
    first && bytes.get(1).is_none_or(|byte| byte >> 4 == 0x5)
}

impl Capsule {
    /// Checks a capsule.
    ///
    /// # Errors
    /// A wrong checksum, or an angle beyond a full revolution.
    pub fn read(bytes: &[u8; CAPSULE_BYTES], layout: Layout) -> Result<Self, AnswerError> {
        let found = (bytes[0] & 0xf) | (bytes[1] << 4);
        let computed = checksum(bytes);
        if found != computed || !may_begin(bytes) {
            return Err(AnswerError::Checksum { found, computed });
        }
        let capsule = Self { bytes: *bytes, layout };
        let q6 = capsule.start_angle_q6();
        if q6 > FULL_CIRCLE_Q6 { Err(AnswerError::Angle { q6 }) } else { Ok(capsule) }
    }

    /// Makes a capsule from up to 32 or 40 measurements; the others have no distance. Legacy
    /// distances have 14 bits, and dense measurements no correction.
    #[must_use]
    pub fn from_cells(
        layout: Layout,
        start_angle_q6: u16,
        is_new_scan: bool,
        cells: &[Cell],
    ) -> Self {
        let mut bytes = [0; CAPSULE_BYTES];
        let word = start_angle_q6 & !NEW_SCAN | if is_new_scan { NEW_SCAN } else { 0 };
        bytes[2..4].copy_from_slice(&word.to_le_bytes());
        let body = &mut bytes[HEAD..];
        match layout {
            Layout::Legacy => {
                let cabins = body.chunks_exact_mut(CABIN_BYTES);
                cells.chunks(2).zip(cabins).for_each(|(pair, cabin)| write_cabin(pair, cabin));
            }
            Layout::Dense => {
                for (cell, out) in cells.iter().zip(body.chunks_exact_mut(2)) {
                    out.copy_from_slice(&cell.distance_mm.to_le_bytes());
                }
            }
        }
        let sum = checksum(&bytes);
        bytes[0] = 0xa0 | (sum & 0xf);
        bytes[1] = 0x50 | (sum >> 4);
        Self { bytes, layout }
    }

    /// The capsule as the scanner sends it.
    #[must_use]
    pub fn bytes(&self) -> &[u8; CAPSULE_BYTES] {
        &self.bytes
    }

    #[must_use]
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Clockwise angle of the first measurement, 1/64 degree.
    #[must_use]
    pub fn start_angle_q6(&self) -> u16 {
        self.start_word() & !NEW_SCAN
    }

    /// Whether the scanner has started a new measurement: this capsule does not continue the one before it.
    #[must_use]
    pub fn is_new_scan(&self) -> bool {
        self.start_word() & NEW_SCAN != 0
    }

    /// A measurement of the capsule; without distance beyond the last one.
    #[must_use]
    pub fn cell(&self, index: usize) -> Cell {
        match self.layout {
            Layout::Legacy => self.legacy_cell(index),
            Layout::Dense => Cell { distance_mm: self.word(HEAD + 2 * index), correction_q3: 0 },
        }
    }

    fn legacy_cell(&self, index: usize) -> Cell {
        let cabin = HEAD + index / 2 * CABIN_BYTES;
        let word = self.word(cabin + index % 2 * 2);
        let corrections = self.bytes.get(cabin + 4).copied().unwrap_or_default();
        let low = if index.is_multiple_of(2) { corrections & 0xf } else { corrections >> 4 };
        Cell { distance_mm: word >> 2, correction_q3: low | ((word & 3) << 4) as u8 }
    }

    fn start_word(&self) -> u16 {
        self.word(2)
    }

    fn word(&self, at: usize) -> u16 {
        match self.bytes.get(at..at + 2) {
            Some([low, high]) => u16::from_le_bytes([*low, *high]),
            _ => 0,
        }
    }
}

fn write_cabin(pair: &[Cell], cabin: &mut [u8]) {
    for (index, cell) in pair.iter().enumerate() {
        let word = (cell.distance_mm << 2) | u16::from((cell.correction_q3 >> 4) & 3);
        cabin[2 * index..2 * index + 2].copy_from_slice(&word.to_le_bytes());
        cabin[4] |= (cell.correction_q3 & 0xf) << (4 * index);
    }
}

fn checksum(bytes: &[u8; CAPSULE_BYTES]) -> u8 {
    bytes[2..].iter().fold(0, |sum, byte| sum ^ byte)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_fields_of_a_cabin_are_where_the_makers_notes_place_them() {
        let cells = [
            Cell { distance_mm: 0x0123, correction_q3: 0x2a },
            Cell { distance_mm: 0x3fff, correction_q3: 0x15 },
        ];
        let capsule = Capsule::from_cells(Layout::Legacy, 90 * 64, true, &cells);
        // 0x0123 << 2 | 0x2a >> 4, 0x3fff << 2 | 0x15 >> 4, then 0x5 and 0xa.
        assert_eq!(capsule.bytes()[4..9], [0x8e, 0x04, 0xfd, 0xff, 0x5a]);
        assert_eq!(capsule.bytes()[2..4], [0x80, 0x96], "90 degrees with the bit of a new scan");
        assert_eq!((capsule.bytes()[0] >> 4, capsule.bytes()[1] >> 4), (0xa, 0x5));
        assert_eq!((capsule.cell(0), capsule.cell(1)), (cells[0], cells[1]));
        assert_eq!(capsule.cell(2), Cell::default());
    }

    #[test]
    fn an_angle_beyond_a_revolution_is_refused() {
        let capsule = Capsule::from_cells(Layout::Legacy, 23_041, false, &[]);
        let read = Capsule::read(capsule.bytes(), Layout::Legacy);
        assert_eq!(read, Err(AnswerError::Angle { q6: 23_041 }));
    }

    fn any_capsule() -> impl Strategy<Value = (Capsule, Vec<Cell>)> {
        let legacy = (0..0x4000_u16, 0..64_u8)
            .prop_map(|(distance_mm, correction_q3)| Cell { distance_mm, correction_q3 });
        let dense = any::<u16>().prop_map(|distance_mm| Cell { distance_mm, correction_q3: 0 });
        let cells = prop_oneof![
            proptest::collection::vec(legacy, 32).prop_map(|cells| (Layout::Legacy, cells)),
            proptest::collection::vec(dense, 40).prop_map(|cells| (Layout::Dense, cells)),
        ];
        (cells, 0..=FULL_CIRCLE_Q6, any::<bool>()).prop_map(|((layout, cells), start, is_new)| {
            (Capsule::from_cells(layout, start, is_new, &cells), cells)
        })
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again((capsule, cells) in any_capsule()) {
            prop_assert_eq!(Capsule::read(capsule.bytes(), capsule.layout()), Ok(capsule));
            prop_assert_eq!(cells.len(), capsule.layout().measurements());
            for (index, cell) in cells.iter().enumerate() {
                prop_assert_eq!(capsule.cell(index), *cell);
            }
        }

        #[test]
        fn a_flipped_bit_is_always_refused(
            (capsule, _) in any_capsule(),
            bit in 0..CAPSULE_BYTES * 8,
        ) {
            let mut flipped = *capsule.bytes();
            flipped[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(Capsule::read(&flipped, capsule.layout()).is_err());
        }
    }
}
