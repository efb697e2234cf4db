//! Signed segments: what a change of any byte does to the signature.

use data_encoding::HEXLOWER;
use runtime::recording::{RecordingWriter, SegmentHeader, Views};
use segment_store::signature::{RobotKey, SIGNATURE, Statement};
use segment_store::{Finding, Signed, check_signature, verify};
use sha2::{Digest, Sha256};

use crate::common::{run_header, some_tick};

fn key() -> RobotKey {
    RobotKey::new(&[7; 32])
}

/// A segment that `key` signs as number `number` of its run. The digest is that of the bytes so far, as the recorder computes
/// it.
fn signed_by(key: &RobotKey, number: u32) -> Vec<u8> {
    let header = SegmentHeader::new(run_header(), number, 0, 0);
    let mut unsigned = RecordingWriter::begin(Vec::new(), header.clone()).unwrap();
    let mut writer = RecordingWriter::begin(Vec::new(), header).unwrap();
    for tick in 0..25 {
        unsigned.write(&some_tick(tick), &Views::default()).unwrap();
        writer.write(&some_tick(tick), &Views::default()).unwrap();
    }
    unsigned.flush().unwrap();
    writer.flush().unwrap();
    let statement = Statement {
        robot: key.public(),
        run: "00112233445566778899aabbccddeeff".to_owned(),
        segment: number,
        previous: String::new(),
        digest: HEXLOWER.encode(&Sha256::digest(unsigned.abandon())),
    };
    writer.write_metadata(SIGNATURE, key.sign(&statement)).unwrap();
    writer.finish().map_err(|(_, error)| error).unwrap()
}

fn check(bytes: &[u8]) -> Signed {
    check_signature(bytes).unwrap()
}

/// Offset of the signature's record: its name follows opcode, length and the name's length.
fn offset_of_signature(bytes: &[u8]) -> usize {
    let name = bytes.windows(SIGNATURE.len()).position(|window| window == SIGNATURE.as_bytes());
    name.unwrap() - 4 - 8 - 1
}

#[test]
fn a_signed_segment_says_who_recorded_it_and_is_a_whole_segment() {
    let bytes = signed_by(&key(), 3);
    let Signed::By(statement) = check(&bytes) else { panic!("{:?}", check(&bytes)) };
    assert_eq!((statement.robot, statement.segment), (key().public(), 3));
    let verified = verify(&bytes[..]).unwrap();
    assert_eq!((verified.finding, verified.ticks), (Finding::Whole, 25));
}

#[test]
fn a_segment_without_a_signature_is_not_signed() {
    assert_eq!(check(&crate::common::segment(0, 0, 25)), Signed::No);
    for length in [0, 5, 8, 20, 1000] {
        assert_eq!(check(&signed_by(&key(), 0)[..length]), Signed::No, "{length}");
    }
}

#[test]
fn no_bit_of_the_data_can_be_changed() {
    let bytes = signed_by(&key(), 0);
    let end = offset_of_signature(&bytes);
    for at in (0..end).step_by(97).chain(end - 20..end) {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        assert!(!matches!(check(&changed), Signed::By(_)), "byte {at}");
    }
}

#[test]
fn no_bit_of_the_signature_can_be_changed() {
    let bytes = signed_by(&key(), 0);
    let start = offset_of_signature(&bytes);
    let body = u64::from_le_bytes(bytes[start + 1..start + 9].try_into().unwrap()) as usize;
    for at in start..start + 9 + body {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        assert!(!matches!(check(&changed), Signed::By(_)), "byte {at}");
    }
}

#[test]
fn nothing_can_be_appended_behind_the_signature() {
    let bytes = signed_by(&key(), 0);
    let start = offset_of_signature(&bytes);
    let body = u64::from_le_bytes(bytes[start + 1..start + 9].try_into().unwrap()) as usize;
    let behind = start + 9 + body;
    let data_end = behind + 9 + 4;
    // Chunk, message, attachment, another metadata record; then a channel, which only the index may define.
    for opcode in [6, 5, 9, 12, 4] {
        let record = [&[opcode][..], &4_u64.to_le_bytes(), &[0; 4]].concat();
        let appended = [&bytes[..behind], &record, &bytes[behind..]].concat();
        assert_eq!(
            check(&appended),
            Signed::Wrong("there are data behind the signature"),
            "{opcode}"
        );
        if opcode != 4 {
            let in_index = [&bytes[..data_end], &record, &bytes[data_end..]].concat();
            assert_eq!(
                check(&in_index),
                Signed::Wrong("there are data behind the signature"),
                "{opcode}"
            );
        }
    }
}

/// Offset behind the record at `start`.
fn end_of(bytes: &[u8], start: usize) -> usize {
    start + 9 + u64::from_le_bytes(bytes[start + 1..start + 9].try_into().unwrap()) as usize
}

#[test]
fn fields_with_false_lengths_lead_no_reader_behind_the_signature() {
    let bytes = signed_by(&key(), 0);
    let data_end = end_of(&bytes, offset_of_signature(&bytes));
    // Every record of the index, and the end of the data: a byte more at its end, or fewer.
    let mut start = data_end;
    let mut records = 0;
    while start + 8 < bytes.len() {
        let end = end_of(&bytes, start);
        let body = (end - start - 9) as u64;
        let longer = [
            &bytes[..=start],
            &(body + 1).to_le_bytes(),
            &bytes[start + 9..end],
            &[0],
            &bytes[end..],
        ]
        .concat();
        let shorter = [
            &bytes[..=start],
            &(body - 1).to_le_bytes(),
            &bytes[start + 9..end - 1],
            &bytes[end..],
        ]
        .concat();
        for changed in [longer, shorter] {
            assert_eq!(
                check(&changed),
                Signed::Wrong("there are data behind the signature"),
                "{records}"
            );
        }
        records += 1;
        start = end;
    }
    assert!(records > 10, "{records}");
}

#[test]
fn a_file_that_ends_in_its_index_is_cut_and_not_signed() {
    let bytes = signed_by(&key(), 0);
    let data_end = end_of(&bytes, offset_of_signature(&bytes));
    for length in [data_end, data_end + 13, bytes.len() - 60, bytes.len() - 9] {
        assert_eq!(check(&bytes[..length]), Signed::No, "{length}");
    }
    for tail in [&bytes[..bytes.len() - 1], &[&bytes[..], &[0]].concat()] {
        assert!(!matches!(check(tail), Signed::By(_)));
    }
}

#[test]
fn a_signature_of_another_segment_does_not_fit() {
    let first = signed_by(&key(), 0);
    let second = signed_by(&key(), 1);
    let [from, to] = [&first, &second].map(|bytes| offset_of_signature(bytes));
    let swapped = [&first[..from], &second[to..]].concat();
    assert_eq!(check(&swapped), Signed::Wrong("the data were changed since they were signed"));
}

#[test]
fn a_printed_key_does_not_show_its_secret_half() {
    let key = key();
    assert!(!format!("{key:?}").contains(&key.secret()));
    assert_eq!(RobotKey::parse(&key.secret()), Some(key));
}
