//! Decoding of a scan's data lines: checksums, characters, numbers and ranges, in plain loops that
//! the compiler vectorizes.

use hal::Range;
use multiversion::multiversion;

use super::codes::to_metres;
use super::line::{checked, is_data, value};
use super::{RangeCodes, ScipError};

/// The largest number of data characters in one line.
pub(super) const LINE: usize = 64;
/// Number of bytes after the data: the checksum and LF.
const LINE_END: usize = 2;
/// Lines that are decoded together. Three lines hold a whole number of ranges in every encoding,
/// while 64 is not a multiple of three.
const BLOCK_LINES: usize = 3;
const BLOCK: usize = BLOCK_LINES * LINE;

/// The buffers into which a scan is decoded.
pub(super) struct Beams<'a> {
    pub(super) codes: &'a RangeCodes,
    pub(super) ranges: &'a mut [Range],
    /// One per beam if the data contains intensities, otherwise empty.
    pub(super) intensities: &'a mut [u32],
}

/// The number of bytes of this many data characters, including the ends of their lines.
pub(super) fn encoded_length(characters: usize) -> usize {
    characters + characters.div_ceil(LINE) * LINE_END
}

/// Decodes the data lines. `first_line` is the number of the first one in its message, for errors.
/// A number has `WIDTH` characters. A beam has one number, or two with intensities.
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn read<const WIDTH: usize>(
    lines: &[u8],
    first_line: usize,
    beams: &mut Beams<'_>,
) -> Result<(), ScipError> {
    let with_intensities = !beams.intensities.is_empty();
    let needed = encoded_length(beams.ranges.len() * WIDTH * if with_intensities { 2 } else { 1 });
    if lines.len() != needed {
        return Err(ScipError::Length { found: lines.len(), needed });
    }
    let mut characters = [0_u8; BLOCK];
    let mut numbers = [0_u32; BLOCK / 2];
    let mut beam = 0;
    for (index, block) in lines.chunks(BLOCK_LINES * (LINE + LINE_END)).enumerate() {
        let found = strip(block, first_line + index * BLOCK_LINES, &mut characters)?;
        let numbers = unpack::<WIDTH>(&characters, found, &mut numbers);
        beam += if with_intensities {
            beams.put_pairs(beam, numbers)
        } else {
            beams.put(beam, numbers)
        };
    }
    Ok(())
}

/// Checks up to three lines, and writes their data characters minus `0`. Returns the number of
/// characters.
#[inline(always)]
fn strip(
    block: &[u8],
    first_line: usize,
    characters: &mut [u8; BLOCK],
) -> Result<usize, ScipError> {
    let mut found = 0;
    let lines = block.chunks(LINE + LINE_END);
    for (index, (line, into)) in lines.zip(characters.chunks_exact_mut(LINE)).enumerate() {
        let full: Result<&[u8; LINE + LINE_END], _> = line.try_into();
        let (sound, length) = match full {
            // With a constant length, this compiles to a few vector instructions.
            Ok(line) => (strip_line(line, into), LINE),
            Err(_) => (strip_line(line, into), line.len().saturating_sub(LINE_END)),
        };
        if !sound {
            return Err(line_error(line, first_line + index));
        }
        found += length;
    }
    Ok(found)
}

/// Writes a line's data characters minus `0`, and returns whether the line, its checksum and its LF
/// are valid.
#[inline(always)]
fn strip_line(line: &[u8], into: &mut [u8]) -> bool {
    let Some((content, &[sum, b'\n'])) = line.split_last_chunk::<LINE_END>() else { return false };
    let mut total = 0_u8;
    let mut all_data = is_data(sum);
    for (&byte, place) in content.iter().zip(into) {
        let character = byte.wrapping_sub(0x30);
        total = total.wrapping_add(byte);
        all_data &= character < 0x40;
        *place = character;
    }
    all_data && sum == (total & 0x3f) + 0x30
}

/// The error of an invalid line.
#[cold]
fn line_error(line: &[u8], number: usize) -> ScipError {
    let Some(content) = line.strip_suffix(b"\n") else {
        return ScipError::Shape { missing: "line of 64 characters" };
    };
    match checked(content, number) {
        Err(error) => error,
        Ok(_) => ScipError::Shape { missing: "line of 64 characters" },
    }
}

/// Decodes the numbers in the first `found` characters, most significant character first.
#[inline(always)]
fn unpack<'a, const WIDTH: usize>(
    characters: &[u8; BLOCK],
    found: usize,
    numbers: &'a mut [u32; BLOCK / 2],
) -> &'a [u32] {
    let (groups, _) = characters.as_chunks::<WIDTH>();
    for (group, number) in groups.iter().zip(numbers.iter_mut()) {
        *number = value(group);
    }
    numbers.get(..found / WIDTH).unwrap_or_default()
}

impl Beams<'_> {
    #[inline(always)]
    fn put(&mut self, first: usize, numbers: &[u32]) -> usize {
        let ranges = self.ranges.get_mut(first..).unwrap_or_default();
        let mut metres = [0.0; BLOCK / 2];
        for (metres, &number) in metres.iter_mut().zip(numbers) {
            *metres = to_metres(number);
        }
        // Sixteen beams at a time. If all numbers are distances, which is nearly always so, the
        // loop has no branch.
        for ((ranges, numbers), metres) in
            ranges.chunks_mut(16).zip(numbers.chunks(16)).zip(metres.chunks(16))
        {
            for (range, &metres) in ranges.iter_mut().zip(metres) {
                *range = Range::Hit(metres);
            }
            if !numbers.iter().fold(true, |all, &number| all & self.codes.is_distance(number)) {
                put_codes(self.codes, ranges, numbers);
            }
        }
        numbers.len()
    }

    #[inline(always)]
    fn put_pairs(&mut self, first: usize, numbers: &[u32]) -> usize {
        let (pairs, _) = numbers.as_chunks::<2>();
        let places = self.ranges.iter_mut().zip(self.intensities.iter_mut()).skip(first);
        for ((range, intensity), &[number, strength]) in places.zip(pairs) {
            *range = self.codes.range(number);
            *intensity = strength;
        }
        pairs.len()
    }
}

/// Corrects the beams whose numbers are not distances.
#[inline(never)]
fn put_codes(codes: &RangeCodes, ranges: &mut [Range], numbers: &[u32]) {
    for (range, &number) in ranges.iter_mut().zip(numbers) {
        if !codes.is_distance(number) {
            *range = codes.code(number);
        }
    }
}
