//! Segments that were cut off or damaged: every complete chunk is kept.

use std::fs;

use crate::common::{CHUNK_TICKS, Noise, pull_into, segment, some_tick};
use runtime::recording::RecordingReader;
use segment_store::pull::Options;
use segment_store::source::Directory;
use segment_store::{Catalogue, Finding, Root, State, recover, verify};

/// The offsets of the chunks, from the sequence of records: opcode, length, body (MCAP specification, "Records").
fn chunk_starts(file: &[u8]) -> Vec<usize> {
    let mut at = 8;
    let mut starts = Vec::new();
    while at + 9 <= file.len() {
        if file[at] == 6 {
            starts.push(at);
        }
        at = record_end(file, at);
    }
    starts
}

/// The offset behind the record that begins at `at`.
fn record_end(file: &[u8], at: usize) -> usize {
    let length = u64::from_le_bytes(file[at + 1..at + 9].try_into().unwrap()) as usize;
    at + 9 + length
}

/// The offsets at which the chunks end.
fn chunk_ends(file: &[u8]) -> Vec<usize> {
    chunk_starts(file).into_iter().map(|at| record_end(file, at)).collect()
}

/// The number of ticks in the complete chunks of the first `cut` bytes. The first chunk contains only the header.
fn complete_ticks(ends: &[usize], cut: usize, total: u64) -> u64 {
    let chunks = ends.iter().filter(|end| **end <= cut).count() as u64;
    (chunks.saturating_sub(1) * CHUNK_TICKS).min(total)
}

fn assert_recovered(cut: &[u8], ticks: u64) {
    let mut whole = Vec::new();
    let done = recover(cut, &mut whole).unwrap();
    assert_eq!((done.ticks, done.bad_chunks), (ticks, 0));
    assert_eq!(verify(&whole[..]).unwrap().finding, Finding::Whole);
    assert!(mcap::Summary::read(&whole).unwrap().is_some(), "it has an index");
    if done.messages > 0 {
        let recovered = RecordingReader::open(&whole[..]).unwrap().map(Result::unwrap);
        assert!(recovered.eq((0..ticks).map(some_tick)));
    }
}

const TICKS: u64 = 40;

#[test]
fn a_segment_cut_at_every_byte_of_its_last_two_chunks_is_recovered_with_every_complete_message() {
    let file = segment(0, 0, TICKS);
    let starts = chunk_starts(&file);
    let ends = chunk_ends(&file);
    let from = starts[starts.len() - 2];
    assert!(ends[ends.len() - 1] - from > 5000, "the two chunks are long enough");
    for cut in from..file.len() {
        let ticks = complete_ticks(&ends, cut, TICKS);
        let mut whole = Vec::new();
        let done = recover(&file[..cut], &mut whole).unwrap();
        assert_eq!((done.ticks, done.bad_chunks), (ticks, 0), "cut at {cut}");
        // Decoding images is slow, so the contents are compared only at every 31st offset.
        if cut % 31 == 0 {
            assert_recovered(&file[..cut], ticks);
        }
    }
}

#[test]
fn a_segment_cut_at_a_thousand_random_bytes_is_recovered_with_every_complete_message_and_the_reader_reports_where_it_ends()
 {
    let file = segment(0, 0, TICKS);
    let ends = chunk_ends(&file);
    let mut noise = Noise(6);
    for _ in 0..1000 {
        let cut = noise.below(file.len() as u64) as usize;
        let ticks = complete_ticks(&ends, cut, TICKS);
        assert_recovered(&file[..cut], ticks);
        let found = verify(&file[..cut]).unwrap();
        let is_cut = matches!(found.finding, Finding::Cut { at } if at <= cut as u64);
        assert!(is_cut && found.ticks == ticks, "cut at {cut}: {found:?}");
        match RecordingReader::open(&file[..cut]) {
            Ok(reader) => {
                let read: Vec<_> = reader.collect();
                let good = read.iter().filter(|tick| tick.is_ok()).count() as u64;
                assert_eq!(good, ticks, "cut at {cut}");
                let error = read.last().unwrap().as_ref().unwrap_err();
                assert!(error.is_truncation(), "{error}");
                if let Some(last) = ticks.checked_sub(1) {
                    assert!(error.to_string().contains(&format!(" {last}")), "{last}: {error}");
                }
            }
            Err(error) => {
                assert!(error.is_truncation() && cut < ends[0], "cut at {cut}: {error}");
            }
        }
    }
}

fn first_segment(run: usize) -> String {
    format!("run{run}/recording_0000.mcap")
}

#[test]
fn cut_segments_are_pulled_as_they_are() {
    let robot = tempfile::tempdir().unwrap();
    let here = tempfile::tempdir().unwrap();
    let file = segment(0, 0, TICKS);
    let mut noise = Noise(9);
    let cuts: Vec<usize> =
        (0..60).map(|_| 1 + noise.below(file.len() as u64 - 1) as usize).collect();
    for (run, cut) in cuts.iter().enumerate() {
        fs::create_dir(robot.path().join(format!("run{run}"))).unwrap();
        let path = robot.path().join(first_segment(run));
        fs::write(&path, &file[..*cut]).unwrap();
        // RefuseAll has written to it for a while.
        fs::File::open(&path).unwrap().set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
    }
    let report =
        pull_into(&mut Directory::open(robot.path()).unwrap(), here.path(), Options::default())
            .unwrap();
    assert_eq!((report.files, report.cut), (60, 60));
    for (run, cut) in cuts.iter().enumerate() {
        assert!(
            fs::read(here.path().join(first_segment(run))).unwrap() == file[..*cut],
            "cut at {cut}"
        );
    }
}

/// Recovers `bad`, a segment with one flipped bit in byte `at`, and checks that every tick that can be read afterwards is the
/// recorded one. Returns the number of ticks in the recovered file.
fn recovered_ticks(bad: &[u8], at: usize, header_end: usize) -> u64 {
    let mut whole = Vec::new();
    let done = recover(bad, &mut whole).unwrap_or_else(|error| panic!("byte {at}: {error}"));
    assert_eq!(verify(&whole[..]).unwrap().finding, Finding::Whole, "byte {at}");
    let reader = match RecordingReader::open(&whole[..]) {
        Ok(reader) => reader,
        // The first chunk contains the header without which a recording cannot be read.
        Err(error) => {
            assert!(at < header_end, "byte {at}: {error}");
            return done.ticks;
        }
    };
    let read: Vec<_> = reader.map(Result::unwrap).collect();
    assert_eq!(read.len() as u64, done.ticks, "byte {at}");
    for tick in read {
        assert_eq!(tick, some_tick(tick.tick), "byte {at}");
    }
    done.ticks
}

#[test]
fn one_flipped_bit_anywhere_is_found_and_costs_at_most_the_chunk_that_it_is_in() {
    let file = segment(0, 0, TICKS);
    let starts = chunk_starts(&file);
    let ends = chunk_ends(&file);
    let chunks: Vec<_> = starts.iter().zip(&ends).map(|(start, end)| start + 9..*end).collect();
    let mut noise = Noise(12);
    let mut without_loss = 0;
    // Every seventh byte, so that each kind of record is hit, with a random bit.
    for at in (0..file.len()).step_by(7) {
        let mut bad = file.clone();
        bad[at] ^= 1 << noise.below(8);
        let verified = verify(&bad[..]).unwrap();
        let passed = matches!(verified.finding, Finding::Whole | Finding::Unindexed);
        assert!(!passed, "byte {at}: {verified:?}");
        let ticks = recovered_ticks(&bad, at, ends[0]);
        // The first chunk contains the header only. The bytes between two chunks can be replaced by the index.
        let in_tick_chunk = chunks.iter().skip(1).any(|chunk| chunk.contains(&at));
        let least = if in_tick_chunk { TICKS - CHUNK_TICKS } else { TICKS };
        assert!(ticks >= least, "byte {at}: {ticks} of {TICKS} ticks");
        without_loss += usize::from(ticks == TICKS);
    }
    let all = file.len().div_ceil(7);
    assert!(without_loss > 0 && without_loss < all, "{without_loss} of {all} flips cost nothing");
}

#[test]
fn the_index_defines_the_channels_of_a_damaged_chunk_and_without_it_their_messages_are_counted() {
    let file = segment(0, 0, TICKS);
    let defining = chunk_starts(&file)[1] + 200;
    let mut bad = file.clone();
    bad[defining] ^= 1;
    let done = recover(&bad[..], &mut Vec::new()).unwrap();
    assert_eq!((done.ticks, done.bad_chunks), (TICKS - CHUNK_TICKS, 1));
    assert_eq!(done.unknown_messages, 0);
    // Cut in the last chunk, so that there is no index.
    let cut = chunk_ends(&file).last().unwrap() - 1;
    let done = recover(&bad[..cut], &mut Vec::new()).unwrap();
    assert_eq!((done.ticks, done.bad_chunks), (0, 1));
    assert!(done.unknown_messages > 0);
}

#[test]
fn a_corrupt_chunk_in_the_middle_does_not_affect_the_others() {
    let file = segment(0, 0, TICKS);
    let mut bad = file.clone();
    bad[chunk_starts(&file)[2] + 200] ^= 1;
    let done = recover(&bad[..], &mut Vec::new()).unwrap();
    assert_eq!((done.ticks, done.bad_chunks), (TICKS - CHUNK_TICKS, 1));
}

#[test]
fn arbitrary_bytes_are_not_a_whole_segment_and_never_panic() {
    let mut noise = Noise(1);
    for length in (0..400).chain([4096, 70_000]) {
        let mut bytes: Vec<u8> = (0..length).map(|_| noise.next() as u8).collect();
        for magic in [false, true] {
            if magic && bytes.len() >= 8 {
                bytes[..8].copy_from_slice(mcap::MAGIC);
            }
            assert!(!matches!(verify(&bytes[..]).unwrap().finding, Finding::Whole));
            let _ = recover(&bytes[..], &mut Vec::new());
        }
    }
}

fn states(catalogue: &Catalogue) -> Vec<State> {
    catalogue.entries.iter().map(|entry| entry.state).collect()
}

#[test]
fn only_the_last_segment_of_a_run_counts_as_open_and_only_shortly_after_a_write() {
    let dir = tempfile::tempdir().unwrap();
    let file = segment(0, 0, TICKS);
    for (name, length) in [
        ("recording_0000.mcap", file.len()),
        ("recording_0001.mcap", 5000),
        ("recording_0002.mcap", 5000),
    ] {
        fs::write(dir.path().join(name), &file[..length]).unwrap();
    }
    let root = Root::open(dir.path()).unwrap();
    let catalogue = Catalogue::read(&root).unwrap();
    assert_eq!(catalogue.entries[0].ticks, Some(TICKS));
    let times = catalogue.entries[0].times.unwrap();
    assert_eq!((times.first_ns, times.last_ns), (0, 3_900_000_000));
    let written_ns = catalogue.entries[2].modified_ns;
    assert_eq!(states(&catalogue), [State::Closed, State::Cut, State::Open]);
    let later = Catalogue::read_at(&root, written_ns + 31_000_000_000).unwrap();
    assert_eq!(states(&later), [State::Closed, State::Cut, State::Cut]);
}

#[test]
fn a_cut_segment_is_not_open_for_ever_after_the_clock_was_set_back() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("recording_0000.mcap");
    fs::write(&path, &segment(0, 0, TICKS)[..5000]).unwrap();
    let root = Root::open(dir.path()).unwrap();
    let written_ns = Catalogue::read(&root).unwrap().entries[0].modified_ns;
    for (set_back_s, state) in
        [(1, State::Open), (29, State::Open), (31, State::Cut), (3600 * 24 * 365, State::Cut)]
    {
        let entry =
            &Catalogue::read_at(&root, written_ns - set_back_s * 1_000_000_000).unwrap().entries[0];
        assert_eq!(entry.state, state, "{set_back_s} s");
    }
}
