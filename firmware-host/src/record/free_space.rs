//! Frees space on the disk for the next segment: removes the oldest ones.

use std::cmp::Reverse;
use std::ops::AddAssign;
use std::path::{Path, PathBuf};

use segment_store::{Catalogue, Entry, KEEP, Name, PULLED, Root, is_kept_for_event};

use super::disk::{Disk, Space};
use crate::replay::open_segment;

/// At most one tenth of the disk is kept free. Without this limit, all recordings on a disk smaller than
/// [`Quota::free_bytes`] would be removed.
const SMALL_DISK_SHARE: u64 = 10;

/// How much of the disk recordings may use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quota {
    /// Folder of the runs, each in a folder of its own.
    pub buffer: PathBuf,
    /// Maximum size of all segments of all runs, bytes; `None` for no limit.
    pub bytes: Option<u64>,
    /// Space that stays free, bytes, but at most a tenth of the disk.
    pub free_bytes: u64,
    /// Share of `bytes`, or of a smaller disk, that segments may use which are kept because of an event, percent.
    pub kept_percent: u64,
    /// Segments that are older are removed, days; 0 for no limit.
    pub max_age_days: u64,
}

impl Quota {
    /// How many bytes of segments are kept because of events.
    fn kept_bytes(&self, disk: &dyn Disk) -> u64 {
        let disk_bytes = disk.space(&self.buffer).map_or(u64::MAX, |space| space.total_bytes);
        self.bytes.unwrap_or(u64::MAX).min(disk_bytes) / 100 * self.kept_percent
    }
}

/// Segments that were removed to free space.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Removed {
    /// Number of segments.
    pub segments: u64,
    /// How many of these no workstation had pulled.
    pub not_pulled: u64,
    /// Their total size.
    pub bytes: u64,
}

impl AddAssign for Removed {
    fn add_assign(&mut self, more: Self) {
        self.segments += more.segments;
        self.not_pulled += more.not_pulled;
        self.bytes += more.bytes;
    }
}

/// Removes segments until the quota is met: first those that a workstation has pulled, then the others, the oldest first.
/// Segments that are [`protected`], segments of simulated runs, and `next`, which is about to be written, are not
/// removed.
pub(super) fn free_space(disk: &mut dyn Disk, quota: &Quota, next: &Path) -> Removed {
    let mut removed = Removed::default();
    let Ok((root, catalogue)) = Catalogue::open(&quota.buffer)
        .inspect_err(|error| tracing::warn!("cannot remove old segments: {error}"))
    else {
        return removed;
    };
    let mut segments = catalogue.entries;
    let mut total: u64 = segments.iter().map(|segment| segment.bytes).sum();
    age_by_number(&mut segments);
    let protected = protected(&root, &segments, quota.kept_bytes(disk));
    // A robot records into a folder per run, so segments outside of one are not the robot's.
    segments.retain(|segment| !protected.contains(&segment.name) && !segment.name.run().is_empty());
    segments.sort_by_key(|segment| {
        (segment.pulled_digest().is_none(), segment.modified_ns, segment.name.clone())
    });
    for segment in segments {
        // If the free space is unknown, nothing is removed for it. A full disk is reported by the next write.
        let enough_free =
            disk.space(&quota.buffer).map_or(true, |Space { free_bytes, total_bytes }| {
                free_bytes >= quota.free_bytes.min(total_bytes / SMALL_DISK_SHARE)
            });
        if quota.bytes.is_none_or(|most| total <= most) && enough_free {
            break;
        }
        let path = quota.buffer.join(segment.name.as_str());
        if path == next || is_simulated(&path) {
            continue;
        }
        let this = remove_segment(disk, &segment, &path);
        total -= this.bytes;
        removed += this;
    }
    removed
}

/// Removes a segment with its marks. Returns what was removed: nothing when the disk refuses.
pub(super) fn remove_segment(disk: &mut dyn Disk, segment: &Entry, path: &Path) -> Removed {
    if let Err(error) = disk.remove(path) {
        tracing::warn!("cannot remove the old segment {}: {error}", path.display());
        return Removed::default();
    }
    remove_marks(disk, path);
    tracing::info!("removed the old segment {}", path.display());
    let not_pulled = u64::from(segment.pulled_digest().is_none());
    Removed { segments: 1, not_pulled, bytes: segment.bytes }
}

/// The segments that an operator keeps, and the newest of those that are kept because of an event, up to `most_bytes` of
/// these.
fn protected(root: &Root, segments: &[Entry], most_bytes: u64) -> Vec<Name> {
    let mut kept: Vec<&Entry> = segments.iter().filter(|segment| segment.keep).collect();
    kept.sort_by_key(|segment| Reverse((segment.modified_ns, segment.name.clone())));
    let mut bytes: u64 = 0;
    kept.retain(|segment| {
        if !is_kept_for_event(root, &segment.name) {
            return true;
        }
        bytes = bytes.saturating_add(segment.bytes);
        bytes <= most_bytes
    });
    kept.into_iter().map(|segment| segment.name.clone()).collect()
}

/// The marks are about this segment only. Most segments have none.
fn remove_marks(disk: &mut dyn Disk, segment: &Path) {
    for mark in [PULLED, KEEP] {
        let _ = disk.remove(&PathBuf::from(format!("{}{mark}", segment.display())));
    }
}

/// Makes every segment at least as new as the one before it in its run. Without this, the newest segments would be removed
/// first after the clock was set back.
fn age_by_number(segments: &mut [Entry]) {
    for index in 1..segments.len() {
        let Some([before, segment]) = segments.get_mut(index - 1..=index) else { return };
        if before.name.run() == segment.name.run() {
            segment.modified_ns = segment.modified_ns.max(before.modified_ns);
        }
    }
}

/// A simulated run is in a folder that the user chose, not in the robot's buffer.
pub(super) fn is_simulated(segment: &Path) -> bool {
    open_segment(segment).is_ok_and(|reader| reader.header().run.scene.is_some())
}

#[cfg(test)]
pub(super) mod tests {
    use std::io;
    use std::time::SystemTime;

    use runtime::recording::Views;

    use super::super::disk::{FileSystem, SegmentFile};
    use super::super::tests::{run_header, some_tick};
    use super::super::{Recorder, RecorderOptions, segment_name};
    use super::*;

    /// Reports `free` bytes, and `each` more for every segment that is removed.
    struct NearlyFull {
        free: u64,
        each: u64,
        total: u64,
    }

    impl Disk for NearlyFull {
        fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
            FileSystem.create(path)
        }

        fn remove(&mut self, path: &Path) -> io::Result<()> {
            FileSystem.remove(path)?;
            self.free +=
                if path.extension().is_some_and(|end| end == "mcap") { self.each } else { 0 };
            Ok(())
        }

        fn space(&self, _path: &Path) -> io::Result<Space> {
            Ok(Space { free_bytes: self.free, total_bytes: self.total })
        }
    }

    /// Records a run of `segments` segments into `buffer`, with older times than later recordings.
    pub(in crate::record) fn recorded(
        buffer: &Path,
        run: &str,
        segments: u64,
        scene: Option<&str>,
    ) {
        let options =
            RecorderOptions { segment_ns: 1, ..RecorderOptions::simulation(buffer.join(run)) };
        let header =
            runtime::recording::RunHeader { scene: scene.map(str::to_owned), ..run_header() };
        let mut recorder = Recorder::start(options, header).unwrap();
        (0..segments).for_each(|tick| recorder.record(some_tick(tick), Views::default()).unwrap());
        recorder.finish().unwrap();
        // The test creates files faster than the resolution of some file systems' times.
        for segment in 0..segments {
            let file = std::fs::File::options()
                .append(true)
                .open(buffer.join(run).join(segment_name(segment as u32)))
                .unwrap();
            let number = run.bytes().map(u64::from).sum::<u64>() * 100 + segment;
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(number))
                .unwrap();
        }
    }

    fn catalogue(buffer: &Path) -> Vec<segment_store::Entry> {
        Catalogue::open(buffer).unwrap().1.entries
    }

    pub(in crate::record) fn left(buffer: &Path) -> Vec<String> {
        catalogue(buffer).iter().map(|entry| entry.name.to_string()).collect()
    }

    fn bytes(buffer: &Path) -> u64 {
        catalogue(buffer).iter().map(|entry| entry.bytes).sum()
    }

    pub(in crate::record) fn quota(buffer: &Path, free_bytes: u64) -> Quota {
        Quota {
            buffer: buffer.to_owned(),
            bytes: None,
            free_bytes,
            kept_percent: 50,
            max_age_days: 0,
        }
    }

    #[test]
    fn the_oldest_segments_of_all_runs_are_removed_first_and_no_more_than_needed() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "b", 2, None);
        recorded(buffer.path(), "a", 2, None);
        let removed = free_space(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), 25),
            Path::new(""),
        );
        assert_eq!((removed.segments, removed.not_pulled), (3, 3));
        assert_eq!(left(buffer.path()), ["b/recording_0001.mcap"]);
    }

    #[test]
    fn pulled_segments_are_removed_before_others_and_kept_segments_never() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        let whole = segment_path(buffer.path(), 3, "").metadata().unwrap().len();
        mark_pulled(buffer.path(), 3, whole);
        // It has grown since.
        mark_pulled(buffer.path(), 2, 1);
        std::fs::write(segment_path(buffer.path(), 0, KEEP), "").unwrap();
        let removed = free_space(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), 15),
            Path::new(""),
        );
        assert_eq!((removed.segments, removed.not_pulled), (2, 1));
        assert_eq!(left(buffer.path()), ["a/recording_0000.mcap", "a/recording_0002.mcap"]);
        free_space(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), u64::MAX),
            Path::new(""),
        );
        assert_eq!(left(buffer.path()), ["a/recording_0000.mcap"]);
        assert!(
            !buffer.path().join("a/recording_0003.mcap.pulled").exists(),
            "the mark is removed with its segment"
        );
    }

    fn segment_path(buffer: &Path, number: u32, mark: &str) -> PathBuf {
        buffer.join("a").join(format!("{}{mark}", segment_name(number)))
    }

    fn mark_pulled(buffer: &Path, number: u32, bytes: u64) {
        let modified_ns = catalogue(buffer)[number as usize].modified_ns;
        let text = format!("{} {bytes} {modified_ns}\n", segment_store::Digest::of(b"as it was"));
        std::fs::write(segment_path(buffer, number, PULLED), text).unwrap();
    }

    #[test]
    fn the_oldest_segments_are_removed_first_after_the_clock_was_set_back() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        for (number, seconds) in [(0, 5000), (1, 5001), (2, 100), (3, 101)] {
            let file = std::fs::File::options()
                .append(true)
                .open(buffer.path().join("a").join(segment_name(number)));
            file.unwrap()
                .set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(seconds))
                .unwrap();
        }
        free_space(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), 15),
            Path::new(""),
        );
        assert_eq!(left(buffer.path()), ["a/recording_0002.mcap", "a/recording_0003.mcap"]);
    }

    #[test]
    fn all_segments_together_stay_below_the_quota() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 5, None);
        let all = bytes(buffer.path());
        let quota = Quota { bytes: Some(all / 2), ..quota(buffer.path(), 0) };
        free_space(&mut FileSystem, &quota, Path::new(""));
        let left = bytes(buffer.path());
        assert!(left <= all / 2 && left >= all / 5, "{left} of {all}");
    }

    /// Marks segments of the run `a` as the recorder does after a contact.
    fn keep_for_contact(buffer: &Path, segments: std::ops::Range<u32>) {
        let root = Root::open(buffer).unwrap();
        for segment in segments {
            let name = Name::parse(&format!("a/{}", segment_name(segment))).unwrap();
            segment_store::keep_for_event(&root, &name, "contact").unwrap();
        }
    }

    #[test]
    fn segments_around_an_event_are_kept_and_later_ones_are_removed_for_them() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 6, None);
        keep_for_contact(buffer.path(), 0..2);
        let quota = Quota { bytes: Some(bytes(buffer.path()) * 7 / 10), ..quota(buffer.path(), 0) };
        free_space(&mut FileSystem, &quota, Path::new(""));
        assert_eq!(
            left(buffer.path()),
            [0, 1, 4, 5].map(|number| format!("a/{}", segment_name(number)))
        );
    }

    #[test]
    fn the_oldest_kept_segments_go_first_beyond_their_share_of_the_quota() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 6, None);
        keep_for_contact(buffer.path(), 0..4);
        // Half of it are two segments and a bit: the kept segments 2 and 3.
        let quota = Quota { bytes: Some(bytes(buffer.path()) * 3 / 4), ..quota(buffer.path(), 0) };
        free_space(&mut FileSystem, &quota, Path::new(""));
        assert_eq!(
            left(buffer.path()),
            [2, 3, 4, 5].map(|number| format!("a/{}", segment_name(number)))
        );
        assert!(
            !buffer.path().join("a/recording_0000.mcap.keep").exists(),
            "the mark is removed with its segment"
        );
    }

    #[test]
    fn what_an_operator_keeps_does_not_count_and_is_never_removed() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        for number in 0..4 {
            let mark = buffer.path().join("a").join(format!("{}{KEEP}", segment_name(number)));
            std::fs::write(mark, "").unwrap();
        }
        let quota = Quota { bytes: Some(1), ..quota(buffer.path(), 0) };
        assert_eq!(free_space(&mut FileSystem, &quota, Path::new("")), Removed::default());
    }

    #[test]
    fn a_share_of_nothing_keeps_nothing() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        keep_for_contact(buffer.path(), 0..4);
        let quota = Quota { bytes: Some(1), kept_percent: 0, ..quota(buffer.path(), 0) };
        free_space(&mut FileSystem, &quota, Path::new(""));
        assert!(left(buffer.path()).is_empty());
    }

    #[test]
    fn a_small_disk_is_not_emptied_for_space_that_it_does_not_have() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        // A tenth of 300 is enough.
        let mut disk = NearlyFull { free: 15, each: 10, total: 300 };
        let removed = free_space(&mut disk, &quota(buffer.path(), 2 << 30), Path::new(""));
        assert_eq!(removed.segments, 2);
    }

    #[test]
    fn nothing_else_is_ever_removed() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "simulated", 2, Some("builtin:house"));
        let others = [
            "notes.txt",
            "a/map.png",
            "a/recording_0000.mcap.part",
            "a/sub/recording_0000.mcap",
            "recording_0000.mcap",
        ];
        for other in others {
            let path = buffer.path().join(other);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "mine").unwrap();
        }
        let elsewhere = tempfile::tempdir().unwrap();
        recorded(elsewhere.path(), "a", 1, None);
        let linked = buffer.path().join("linked");
        std::os::unix::fs::symlink(elsewhere.path().join("a"), &linked).unwrap();
        let removed = free_space(
            &mut NearlyFull { free: 0, each: 0, total: u64::MAX },
            &quota(buffer.path(), u64::MAX),
            Path::new(""),
        );
        assert_eq!(removed, Removed::default());
        assert!(others.iter().all(|other| buffer.path().join(other).exists()));
        assert_eq!(left(elsewhere.path()).len(), 1);
    }

    #[test]
    fn a_robot_that_records_on_a_full_disk_frees_space_before_every_segment() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 3, None);
        let options = RecorderOptions {
            segment_ns: 1_000_000_000,
            quota: Some(quota(buffer.path(), 15)),
            queue_ticks: 100,
            ..RecorderOptions::robot(buffer.path().join("new"))
        };
        let disk = NearlyFull { free: 0, each: 10, total: u64::MAX };
        let mut recorder = Recorder::start_on(Box::new(disk), options, run_header()).unwrap();
        (0..30).for_each(|tick| recorder.record(some_tick(tick), Views::default()).unwrap());
        let summary = recorder.finish().unwrap();
        assert_eq!((summary.removed.segments, summary.ticks), (2, 30));
        let left = left(buffer.path());
        assert_eq!(
            left[..2],
            ["a/recording_0002.mcap", "new/recording_0000.mcap"],
            "space is freed before the first segment as well"
        );
        assert_eq!(left.len(), 4);
    }
}
