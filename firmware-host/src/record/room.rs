//! Room on the disk: the oldest segments go first, so that the newest can be written.

use std::path::{Path, PathBuf};

use segment_store::{Catalogue, Entry, PULLED};

use super::disk::{Disk, Space};
use crate::replay::open_segment;

/// No more than one part in so many of a disk is kept free: what a small one cannot have would cost all that is on it.
const SMALL_DISK_SHARE: u64 = 10;

/// How much of the disk recordings may take.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quota {
    /// Holds the runs, each in a folder of its own.
    pub buffer: PathBuf,
    /// All segments of all runs together, bytes; `None`: as much as there is.
    pub bytes: Option<u64>,
    /// So much of the disk stays free, bytes; of a small disk a tenth.
    pub free_bytes: u64,
}

/// What had to go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Removed {
    /// Segments.
    pub segments: u64,
    /// Of these, how many were nowhere else.
    pub not_pulled: u64,
    /// Their size together.
    pub bytes: u64,
}

/// Removes segments until the quota is kept: first those that were pulled, then the others, the oldest first. What is marked
/// [`KEEP`](segment_store::KEEP) stays, and so do what a simulation recorded and `next`, which is about to be written.
pub(super) fn make_room(disk: &mut dyn Disk, quota: &Quota, next: &Path) -> Removed {
    let mut removed = Removed::default();
    let Ok((_, catalogue)) = Catalogue::open(&quota.buffer)
        .inspect_err(|error| tracing::warn!("no room is made: {error}"))
    else {
        return removed;
    };
    let mut segments = catalogue.entries;
    let mut total: u64 = segments.iter().map(|segment| segment.bytes).sum();
    // Only what lies in a run's folder is a robot's.
    segments.retain(|segment| !segment.keep && !segment.name.run().is_empty());
    age_by_number(&mut segments);
    segments.sort_by_key(|segment| {
        (segment.pulled_digest().is_none(), segment.modified_ns, segment.name.clone())
    });
    for segment in segments {
        // A disk that does not say how full it is counts as having room: the next write will tell.
        let has_room =
            disk.space(&quota.buffer).map_or(true, |Space { free_bytes, total_bytes }| {
                free_bytes >= quota.free_bytes.min(total_bytes / SMALL_DISK_SHARE)
            });
        if quota.bytes.is_none_or(|most| total <= most) && has_room {
            break;
        }
        let path = quota.buffer.join(segment.name.as_str());
        if path == next || is_simulated(&path) {
            continue;
        }
        if let Err(error) = disk.remove(&path) {
            tracing::warn!("cannot remove {} to make room: {error}", path.display());
            continue;
        }
        // Without its segment a mark says nothing.
        let _ = disk.remove(&PathBuf::from(format!("{}{PULLED}", path.display())));
        tracing::info!("removed {} to make room", path.display());
        total -= segment.bytes;
        removed.segments += 1;
        removed.not_pulled += u64::from(segment.pulled_digest().is_none());
        removed.bytes += segment.bytes;
    }
    removed
}

/// No segment is older than the one before it in its run, also when the clock was set back between them: else the newest would
/// go first.
fn age_by_number(segments: &mut [Entry]) {
    for index in 1..segments.len() {
        let Some([before, segment]) = segments.get_mut(index - 1..=index) else { return };
        if before.name.run() == segment.name.run() {
            segment.modified_ns = segment.modified_ns.max(before.modified_ns);
        }
    }
}

/// A simulation's recording lies where somebody put it, and is nobody's buffer.
fn is_simulated(segment: &Path) -> bool {
    open_segment(segment).is_ok_and(|reader| reader.header().run.scene.is_some())
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::time::SystemTime;

    use runtime::recording::Views;

    use super::super::disk::{FileSystem, SegmentFile};
    use super::super::tests::{run_header, some_tick};
    use super::super::{Recorder, RecorderOptions, segment_name};
    use super::*;

    /// Says that so many bytes are free, more with everything that is removed.
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

    /// A run of `segments` segments in `buffer`, older than what is recorded after it.
    fn recorded(buffer: &Path, run: &str, segments: u64, scene: Option<&str>) {
        let options =
            RecorderOptions { segment_ns: 1, ..RecorderOptions::simulation(buffer.join(run)) };
        let header =
            runtime::recording::RunHeader { scene: scene.map(str::to_owned), ..run_header() };
        let mut recorder = Recorder::start(options, header).unwrap();
        (0..segments).for_each(|tick| recorder.record(some_tick(tick), Views::default()).unwrap());
        recorder.finish().unwrap();
        // Files of one test are made faster than some file systems tell times apart.
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

    fn left(buffer: &Path) -> Vec<String> {
        catalogue(buffer).iter().map(|entry| entry.name.to_string()).collect()
    }

    fn bytes(buffer: &Path) -> u64 {
        catalogue(buffer).iter().map(|entry| entry.bytes).sum()
    }

    fn quota(buffer: &Path, free_bytes: u64) -> Quota {
        Quota { buffer: buffer.to_owned(), bytes: None, free_bytes }
    }

    #[test]
    fn the_oldest_segments_of_all_runs_go_first_and_no_more_than_needed() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "b", 2, None);
        recorded(buffer.path(), "a", 2, None);
        let removed = make_room(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), 25),
            Path::new(""),
        );
        assert_eq!((removed.segments, removed.not_pulled), (3, 3));
        assert_eq!(left(buffer.path()), ["b/recording_0001.mcap"]);
    }

    #[test]
    fn what_was_pulled_goes_before_what_is_nowhere_else_and_what_is_kept_stays() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        let path = |number, mark: &str| {
            buffer.path().join("a").join(format!("{}{mark}", segment_name(number)))
        };
        let pulled = |number, bytes| {
            let modified_ns = catalogue(buffer.path())[number as usize].modified_ns;
            let text =
                format!("{} {bytes} {modified_ns}\n", segment_store::Digest::of(b"as it was"));
            std::fs::write(path(number, PULLED), text).unwrap();
        };
        pulled(3, path(3, "").metadata().unwrap().len());
        // It has grown since.
        pulled(2, 1);
        std::fs::write(path(0, segment_store::KEEP), "").unwrap();
        let removed = make_room(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), 15),
            Path::new(""),
        );
        assert_eq!((removed.segments, removed.not_pulled), (2, 1));
        assert_eq!(left(buffer.path()), ["a/recording_0000.mcap", "a/recording_0002.mcap"]);
        make_room(
            &mut NearlyFull { free: 0, each: 10, total: u64::MAX },
            &quota(buffer.path(), u64::MAX),
            Path::new(""),
        );
        assert_eq!(left(buffer.path()), ["a/recording_0000.mcap"]);
        assert!(
            !buffer.path().join("a/recording_0003.mcap.pulled").exists(),
            "a mark goes with its segment"
        );
    }

    #[test]
    fn a_clock_that_was_set_back_does_not_make_the_newest_segments_go_first() {
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
        make_room(
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
        make_room(&mut FileSystem, &quota, Path::new(""));
        let left = bytes(buffer.path());
        assert!(left <= all / 2 && left >= all / 5, "{left} of {all}");
    }

    #[test]
    fn a_small_disk_is_not_emptied_for_room_that_it_cannot_have() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 4, None);
        // A tenth of 300 is enough.
        let mut disk = NearlyFull { free: 15, each: 10, total: 300 };
        let removed = make_room(&mut disk, &quota(buffer.path(), 2 << 30), Path::new(""));
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
        let removed = make_room(
            &mut NearlyFull { free: 0, each: 0, total: u64::MAX },
            &quota(buffer.path(), u64::MAX),
            Path::new(""),
        );
        assert_eq!(removed, Removed::default());
        assert!(others.iter().all(|other| buffer.path().join(other).exists()));
        assert_eq!(left(elsewhere.path()).len(), 1);
    }

    #[test]
    fn a_robot_that_records_on_a_full_disk_makes_room_before_every_segment() {
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
            "also the first, which is made before"
        );
        assert_eq!(left.len(), 4);
    }
}
