//! Where each channel is in a record.

use super::ElementType;

/// A channel that is part of the records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Element {
    /// Its name, such as `in_anglvel_x`.
    pub name: String,
    /// Its position among the channels. The timestamp has the highest one.
    pub index: u32,
    pub kind: ElementType,
}

/// Where a channel is in a record, and of which type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    offset: usize,
    kind: ElementType,
}

impl Place {
    /// The value of the channel in a record; `None` if the record is too short.
    #[must_use]
    pub fn value(&self, record: &[u8]) -> Option<i64> {
        self.kind.value(record.get(self.offset..)?)
    }
}

/// The layout of the records of a buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout {
    places: Vec<(String, Place)>,
    record_bytes: usize,
}

impl Layout {
    /// The layout of these channels. The rule is the kernel's (`iio_compute_scan_bytes`): in the order of their indices, each
    /// is aligned to its own size, and the record is padded to a multiple of the largest.
    #[must_use]
    pub fn new(mut elements: Vec<Element>) -> Self {
        elements.sort_by_key(|element| element.index);
        let mut places = Vec::new();
        let mut end = 0_usize;
        let mut largest = 1;
        for Element { name, kind, .. } in elements {
            let bytes = kind.bytes();
            let offset = end.next_multiple_of(bytes);
            places.push((name, Place { offset, kind }));
            end = offset + bytes;
            largest = largest.max(bytes);
        }
        Self { places, record_bytes: end.next_multiple_of(largest) }
    }

    /// Where the channel of this name is, if it is part of the records.
    #[must_use]
    pub fn place(&self, name: &str) -> Option<Place> {
        self.places.iter().find(|(known, _)| known == name).map(|(_, place)| *place)
    }

    /// Number of bytes of a record.
    #[must_use]
    pub fn record_bytes(&self) -> usize {
        self.record_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn elements(kinds: &[&str]) -> Vec<Element> {
        let element = |(index, kind): (u32, &&str)| Element {
            name: index.to_string(),
            index,
            kind: kind.parse().unwrap(),
        };
        (0..).zip(kinds).map(element).collect()
    }

    fn offsets(kinds: &[&str]) -> (Vec<usize>, usize) {
        let layout = Layout::new(elements(kinds));
        let offsets = layout.places.iter().map(|(_, place)| place.offset).collect();
        (offsets, layout.record_bytes())
    }

    #[test]
    fn channels_are_aligned_to_their_size_and_records_to_the_largest() {
        let half = "le:s16/16>>0";
        let stamp = "le:s64/64>>0";
        // A BMI160 with both sensors, and a gyroscope whose three axes leave two bytes before the timestamp.
        assert_eq!(offsets(&[half; 6]), (vec![0, 2, 4, 6, 8, 10], 12));
        assert_eq!(offsets(&[half, half, half, stamp]), (vec![0, 2, 4, 8], 16));
        assert_eq!(offsets(&["le:s8/8>>0", "le:s32/32>>0", half]), (vec![0, 4, 8], 12));
        assert_eq!(offsets(&["le:s32/32X2>>0", stamp]), (vec![0, 8], 16));
        assert_eq!(offsets(&[]), (vec![], 0));
    }

    #[test]
    fn channels_are_in_the_order_of_their_indices() {
        let mut reversed = elements(&["le:s8/8>>0", "le:s32/32>>0"]);
        reversed.reverse();
        assert_eq!(Layout::new(reversed), Layout::new(elements(&["le:s8/8>>0", "le:s32/32>>0"])));
    }

    /// A type with a value that it can hold.
    #[derive(Debug, Clone)]
    struct Written {
        text: String,
        is_big_endian: bool,
        storage_bytes: u32,
        shift: u32,
        value: i64,
    }

    fn written() -> impl Strategy<Value = Written> {
        let sizes = (0_u32..4).prop_flat_map(|power| {
            let storage = 8_u32 << power;
            (Just(storage), 1..=storage)
        });
        let rest =
            sizes.prop_flat_map(|(storage, bits)| (Just(storage), Just(bits), 0..=storage - bits));
        (rest, any::<bool>(), any::<bool>(), any::<i64>()).prop_map(
            |((storage, bits, shift), is_big_endian, is_signed, any)| {
                let value = match is_signed {
                    true => any >> (64 - bits),
                    // The highest bit of 64 would be beyond the range of the result.
                    false => (any.cast_unsigned() >> (64 - bits.min(63))).cast_signed(),
                };
                let order = if is_big_endian { "be" } else { "le" };
                let sign = if is_signed { "s" } else { "u" };
                let text = format!("{order}:{sign}{bits}/{storage}>>{shift}");
                Written { text, is_big_endian, storage_bytes: storage / 8, shift, value }
            },
        )
    }

    /// Appends the value as the kernel stores it, one byte after the other.
    fn append(record: &mut Vec<u8>, written: &Written) {
        while !record.len().is_multiple_of(written.storage_bytes as usize) {
            record.push(0xa5);
        }
        let stored = (written.value << written.shift).to_le_bytes();
        let mut bytes = stored[..written.storage_bytes as usize].to_vec();
        if written.is_big_endian {
            bytes.reverse();
        }
        record.extend(bytes);
    }

    proptest! {
        #[test]
        fn a_record_of_any_channels_is_read_as_it_was_written(
            channels in proptest::collection::vec(written(), 1..9),
        ) {
            let mut record = Vec::new();
            channels.iter().for_each(|channel| append(&mut record, channel));
            let texts: Vec<_> = channels.iter().map(|channel| channel.text.as_str()).collect();
            let layout = Layout::new(elements(&texts));
            for (index, channel) in channels.iter().enumerate() {
                let place = layout.place(&index.to_string()).unwrap();
                prop_assert_eq!(place.value(&record), Some(channel.value), "{}", channel.text);
            }
            let largest = channels.iter().map(|channel| channel.storage_bytes as usize).max();
            prop_assert_eq!(layout.record_bytes(), record.len().next_multiple_of(largest.unwrap()));
        }

        #[test]
        fn a_type_is_written_as_it_was_read(channel in written()) {
            prop_assert_eq!(channel.text.parse::<ElementType>().unwrap().to_string(), channel.text);
        }

        #[test]
        fn any_text_is_a_type_or_is_refused(text in "[bl]e:[su][0-9]{0,3}/[0-9]{0,3}(X[0-9]{0,3})?(>>[0-9]{0,3})?") {
            if let Ok(kind) = text.parse::<ElementType>() {
                prop_assert!(kind.bytes() >= 1);
                prop_assert!(kind.value(&[0xff; 8]).is_some());
            }
        }
    }
}
