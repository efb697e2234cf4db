//! Which minutes a robot keeps: those around an event that a person will ask about.

use std::path::{Path, PathBuf};

use runtime::event::{SafetyEvent, TripCause};
use runtime::recording::fault_reason;
use segment_store::{Name, Root};

use super::segments::segment_name;

/// Marks the segment in which such an event happened, the one before and the one after, so that the quota keeps them.
pub(super) struct EventKeeper {
    folder: PathBuf,
    /// The event of the previous segment, for the segment that begins next.
    before: Option<&'static str>,
}

impl EventKeeper {
    /// For the run in `folder`.
    pub(super) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), before: None }
    }

    /// A segment has begun.
    pub(super) fn began(&mut self, segment: u32) {
        if let Some(why) = self.before.take() {
            self.mark(segment, why);
        }
    }

    /// A tick with these events was written into the segment.
    pub(super) fn wrote(&mut self, segment: u32, events: &[SafetyEvent]) {
        let Some(why) = events.iter().find_map(why_kept) else { return };
        if let Some(before) = segment.checked_sub(1) {
            self.mark(before, why);
        }
        self.mark(segment, why);
        self.before = Some(why);
    }

    fn mark(&self, segment: u32, why: &str) {
        let path = self.folder.join(segment_name(segment));
        // A number is left out when the disk failed, and the oldest segments may have been removed.
        if !path.exists() {
            return;
        }
        if let Err(error) = keep(&self.folder, segment, why) {
            tracing::warn!("{} is not protected from the quota: {error}", path.display());
        }
    }
}

fn keep(folder: &Path, segment: u32, why: &str) -> anyhow::Result<()> {
    let root = Root::open(folder)?;
    let name = Name::parse(&segment_name(segment))?;
    Ok(segment_store::keep_for_event(&root, &name, why)?)
}

/// Why the minutes around an event are kept; `None` for the stops that a home causes all day long, such as a chair in the way.
fn why_kept(event: &SafetyEvent) -> Option<&'static str> {
    match event {
        SafetyEvent::Tripped { by: TripCause::Contact, .. } => Some("contact"),
        SafetyEvent::Tripped { by: TripCause::Cliff, .. } => Some("cliff"),
        SafetyEvent::Faulted { why } if why.needs_person() => Some(fault_reason(*why)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use runtime::event::FaultReason;
    use runtime::recording::Views;
    use segment_store::KEEP;

    use super::super::free_space::Quota;
    use super::super::tests::{run_header, some_tick};
    use super::super::{Recorder, RecorderOptions};
    use super::*;

    const TICKS_OF_A_SEGMENT: u64 = 10;

    fn contact() -> SafetyEvent {
        SafetyEvent::Tripped { by: TripCause::Contact, x_m: 0.2, y_m: 0.0 }
    }

    /// Records a run of five segments with an event in the middle of some of them.
    fn record(options: RecorderOptions, events: &[(u64, SafetyEvent)]) {
        let options = RecorderOptions { segment_ns: 1_000_000_000, queue_ticks: 100, ..options };
        let mut recorder = Recorder::start(options, run_header()).unwrap();
        for number in 0..5 * TICKS_OF_A_SEGMENT {
            let mut tick = some_tick(number);
            let happened = events.iter().filter(|(segment, _)| {
                number == segment * TICKS_OF_A_SEGMENT + TICKS_OF_A_SEGMENT / 2
            });
            tick.safety.events.extend(happened.map(|(_, event)| *event));
            recorder.record(tick, Views::default()).unwrap();
        }
        recorder.finish().unwrap();
    }

    fn robot(run: &Path) -> RecorderOptions {
        let buffer = run.parent().unwrap().to_owned();
        let quota = Quota { buffer, bytes: None, free_bytes: 0, kept_percent: 50, max_age_days: 0 };
        RecorderOptions { quota: Some(quota), ..RecorderOptions::robot(run) }
    }

    fn kept(run: &Path) -> Vec<u32> {
        (0..6)
            .filter(|number| run.join(format!("{}{KEEP}", segment_name(*number))).exists())
            .collect()
    }

    /// The segments that a robot keeps when these events happen.
    fn kept_after(events: &[(u64, SafetyEvent)]) -> Vec<u32> {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        record(robot(&run), events);
        kept(&run)
    }

    #[test]
    fn the_segment_of_a_contact_is_kept_with_the_one_before_and_the_one_after() {
        assert_eq!(kept_after(&[(2, contact())]), [1, 2, 3]);
        assert_eq!(kept_after(&[(0, contact())]), [0, 1]);
        assert_eq!(kept_after(&[(4, contact())]), [3, 4], "no mark without its segment");
        assert_eq!(kept_after(&[(1, contact()), (3, contact())]), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn an_emergency_stop_and_every_stop_that_needs_a_person_is_kept() {
        for why in [FaultReason::EmergencyStop, FaultReason::RepeatedContact] {
            assert_eq!(kept_after(&[(2, SafetyEvent::Faulted { why })]), [1, 2, 3], "{why:?}");
        }
    }

    #[test]
    fn a_stop_before_an_obstacle_and_one_that_ends_by_itself_are_not_kept() {
        let obstacle = SafetyEvent::Tripped { by: TripCause::LidarHit, x_m: 0.4, y_m: 0.0 };
        let dirty = SafetyEvent::Faulted { why: FaultReason::LidarBad };
        assert_eq!(kept_after(&[(1, obstacle), (3, dirty)]), [0; 0]);
    }

    #[test]
    fn a_simulation_keeps_nothing_because_no_quota_deletes_it() {
        let dir = tempfile::tempdir().unwrap();
        record(RecorderOptions::simulation(dir.path()), &[(2, contact())]);
        assert_eq!(kept(dir.path()), [0; 0]);
    }

    #[test]
    fn the_mark_says_what_happened() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        record(robot(&run), &[(2, contact())]);
        let mark = std::fs::read_to_string(run.join("recording_0001.mcap.keep")).unwrap();
        assert_eq!(mark, "event: contact\n");
    }
}
