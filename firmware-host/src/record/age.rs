//! Removes recordings that are older than the operator wants to have them.

use std::path::Path;
use std::time::{Duration, SystemTime};

use segment_store::Catalogue;

use super::disk::Disk;
use super::free_space::{Quota, Removed, is_simulated, remove_segment};

const DAY_S: u64 = 24 * 60 * 60;

/// Removes the segments that were written more than [`Quota::max_age_days`] before `now`: kept ones as well, and those that no
/// workstation has pulled, because the limit is a promise to the people of the home. Segments of simulated runs, and `next`,
/// which is about to be written, are not removed.
pub(super) fn remove_expired(
    disk: &mut dyn Disk,
    quota: &Quota,
    next: &Path,
    now: SystemTime,
) -> Removed {
    let mut removed = Removed::default();
    let Some(oldest_ns) = oldest_ns(quota.max_age_days, now) else { return removed };
    let Ok((_, catalogue)) = Catalogue::open(&quota.buffer)
        .inspect_err(|error| tracing::warn!("cannot remove old segments: {error}"))
    else {
        return removed;
    };
    for segment in catalogue.entries {
        let path = quota.buffer.join(segment.name.as_str());
        // A robot records into a folder per run, so segments outside of one are not the robot's.
        let is_expired = segment.modified_ns < oldest_ns && !segment.name.run().is_empty();
        if is_expired && path != next && !is_simulated(&path) {
            removed += remove_segment(disk, &segment, &path);
        }
    }
    if removed.not_pulled > 0 {
        tracing::warn!(
            "removed {} segments that no workstation had pulled: they were older than \
             recording.max_age_days = {}",
            removed.not_pulled,
            quota.max_age_days
        );
    }
    removed
}

/// Segments from before this time since 1970 are too old; `None` without a limit, or while the clock is not set.
fn oldest_ns(max_age_days: u64, now: SystemTime) -> Option<u64> {
    let age = Duration::from_secs(max_age_days.checked_mul(DAY_S)?);
    let since = now.duration_since(SystemTime::UNIX_EPOCH).ok()?.checked_sub(age)?;
    u64::try_from(since.as_nanos()).ok().filter(|_| max_age_days > 0)
}

#[cfg(test)]
mod tests {
    use segment_store::KEEP;

    use super::super::disk::FileSystem;
    use super::super::free_space::tests::{left, quota, recorded};
    use super::super::segment_name;
    use super::*;

    /// What is left of three segments when the first two are a day old.
    fn left_after(max_age_days: u64, prepare: impl FnOnce(&Path)) -> Vec<String> {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "a", 3, None);
        prepare(buffer.path());
        let third = buffer.path().join("a").join(segment_name(2));
        let now = third.metadata().unwrap().modified().unwrap() + Duration::from_secs(DAY_S);
        let quota = Quota { max_age_days, ..quota(buffer.path(), 0) };
        remove_expired(&mut FileSystem, &quota, Path::new(""), now);
        left(buffer.path())
    }

    #[test]
    fn segments_that_are_too_old_are_removed_and_no_others() {
        assert_eq!(left_after(1, |_| ()), ["a/recording_0002.mcap"]);
        assert_eq!(left_after(2, |_| ()).len(), 3);
    }

    #[test]
    fn without_a_limit_nothing_is_too_old() {
        assert_eq!(left_after(0, |_| ()).len(), 3);
    }

    #[test]
    fn a_segment_that_is_kept_is_removed_as_well_when_it_is_too_old() {
        let left = left_after(1, |buffer| {
            let mark = buffer.join("a").join(format!("{}{KEEP}", segment_name(0)));
            std::fs::write(mark, "").unwrap();
        });
        assert_eq!(left, ["a/recording_0002.mcap"]);
    }

    #[test]
    fn a_simulated_run_is_never_too_old() {
        let buffer = tempfile::tempdir().unwrap();
        recorded(buffer.path(), "simulated", 2, Some("builtin:house"));
        let quota = Quota { max_age_days: 1, ..quota(buffer.path(), 0) };
        let removed = remove_expired(&mut FileSystem, &quota, Path::new(""), SystemTime::now());
        assert_eq!(removed, Removed::default());
    }

    #[test]
    fn a_clock_that_is_not_set_makes_nothing_too_old() {
        assert_eq!(oldest_ns(1, SystemTime::UNIX_EPOCH), None);
    }
}
