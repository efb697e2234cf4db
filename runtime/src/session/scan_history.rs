//! The recent scans. A frame is processed some milliseconds after it was taken, and it must be
//! combined with the scan of that time, not with the newest one.
//!
//! The safety thread fills scans, and exploration returns them for reuse. So neither thread waits
//! or allocates.

use std::collections::VecDeque;

use hal::{LaserScan, ScanGeometry};

/// Number of scans that are kept: 0.6 s of a fast scanner (40 Hz). The latency of cameras is lower.
const REMEMBERED: usize = 24;
/// Number of scans in circulation: those that are kept, and as many again that may be queued while
/// exploration is busy.
const SCANS: usize = 2 * REMEMBERED;

/// Both ends of a circulation of scans that are known `late_ns` later than their time stamps say.
#[must_use]
pub fn scan_history(geometry: ScanGeometry, late_ns: u64) -> (ScanWriter, ScanHistory) {
    let (full, filled) = rtrb::RingBuffer::new(SCANS);
    let (mut spent, empty) = rtrb::RingBuffer::new(SCANS);
    for _ in 0..SCANS {
        let _ = spent.push(LaserScan::empty(geometry));
    }
    (
        ScanWriter { empty, full },
        ScanHistory { filled, spent, past: VecDeque::with_capacity(SCANS), late_ns, told_ns: None },
    )
}

/// The safety thread's end of the circulation.
pub struct ScanWriter {
    empty: rtrb::Consumer<LaserScan>,
    full: rtrb::Producer<LaserScan>,
}

impl ScanWriter {
    /// Queues a copy of a scan. The scan is dropped if exploration has not fetched the earlier
    /// ones.
    pub fn push(&mut self, scan: &LaserScan) {
        if let Ok(mut copy) = self.empty.pop() {
            copy.clone_from(scan);
            let _ = self.full.push(copy);
        }
    }
}

/// The exploration thread's end of the circulation.
pub struct ScanHistory {
    filled: rtrb::Consumer<LaserScan>,
    spent: rtrb::Producer<LaserScan>,
    /// The scans that are kept, oldest first.
    past: VecDeque<LaserScan>,
    /// The scanner's latency: the newest scan may be older than a frame that was taken after it.
    late_ns: u64,
    told_ns: Option<u64>,
}

impl ScanHistory {
    /// Fetches the scans that were queued since the last call.
    pub fn update(&mut self) {
        while let Ok(scan) = self.filled.pop() {
            self.past.push_back(scan);
        }
        while self.past.len() > REMEMBERED {
            if let Some(scan) = self.past.pop_front() {
                let _ = self.spent.push(scan);
            }
        }
    }

    /// The scan whose middle is nearest to `time_ns`. `None` if it is two periods and the scanner's
    /// latency away or more, or if this scan or a newer one was returned before: no scan is used twice.
    pub fn nearest(&mut self, time_ns: u64) -> Option<&LaserScan> {
        let apart_ns =
            |scan: &LaserScan| (scan.time_ns + scan.geometry.period_ns / 2).abs_diff(time_ns);
        let scan = self.past.iter().min_by_key(|scan| apart_ns(scan))?;
        let is_news = self.told_ns.is_none_or(|told_ns| scan.time_ns > told_ns);
        if !is_news || apart_ns(scan) >= 2 * scan.geometry.period_ns + self.late_ns {
            return None;
        }
        self.told_ns = Some(scan.time_ns);
        Some(scan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Range;

    const GEOMETRY: ScanGeometry = ScanGeometry::UTM_30LX;
    const PERIOD_NS: u64 = GEOMETRY.period_ns;

    /// The scan that begins `number` periods after time 0.
    fn scan(number: u64) -> LaserScan {
        LaserScan {
            time_ns: number * PERIOD_NS,
            geometry: GEOMETRY,
            ranges: vec![Range::Hit(number as f32); GEOMETRY.beams],
        }
    }

    fn with(numbers: std::ops::Range<u64>) -> (ScanWriter, ScanHistory) {
        let (mut writer, mut history) = scan_history(GEOMETRY, 0);
        numbers.for_each(|number| writer.push(&scan(number)));
        history.update();
        (writer, history)
    }

    #[test]
    fn beside_a_picture_lies_the_scan_that_was_half_way_round_when_it_was_taken() {
        let (_, mut history) = with(0..10);
        assert_eq!(history.nearest(6 * PERIOD_NS + PERIOD_NS / 2).unwrap(), &scan(6));
        assert_eq!(history.nearest(8 * PERIOD_NS - 1).unwrap(), &scan(7));
        assert_eq!(history.nearest(8 * PERIOD_NS + 1).unwrap(), &scan(8));
    }

    #[test]
    fn no_scan_is_news_twice_and_none_is_from_before_what_was_told() {
        let (_, mut history) = with(0..10);
        assert!(history.nearest(9 * PERIOD_NS).is_some());
        assert!(history.nearest(9 * PERIOD_NS).is_none());
        assert!(history.nearest(3 * PERIOD_NS).is_none());
    }

    #[test]
    fn a_scan_two_periods_away_is_of_another_moment() {
        let middle_ns = PERIOD_NS / 2;
        let (_, mut history) = with(10..11);
        assert!(history.nearest(12 * PERIOD_NS + middle_ns).is_none());
        assert!(history.nearest(8 * PERIOD_NS + middle_ns).is_none());
        assert!(history.nearest(12 * PERIOD_NS + middle_ns - 1).is_some());
        assert!(scan_history(GEOMETRY, 0).1.nearest(0).is_none());
    }

    #[test]
    fn the_newest_scan_of_a_late_scanner_is_used_though_it_is_old() {
        let late_ns = 100_000_000;
        let (mut writer, mut history) = scan_history(GEOMETRY, late_ns);
        writer.push(&scan(10));
        history.update();
        let known_ns = scan(10).middle_ns() + late_ns + PERIOD_NS;
        assert_eq!(history.nearest(known_ns), Some(&scan(10)));
        writer.push(&scan(11));
        history.update();
        let silent_ns = scan(11).middle_ns() + late_ns + 2 * PERIOD_NS;
        assert!(history.nearest(silent_ns).is_none());
    }

    #[test]
    fn after_exploration_was_busy_for_long_the_scans_of_now_come_again() {
        let (mut writer, mut history) = with(0..3);
        (3..1000).for_each(|number| writer.push(&scan(number)));
        history.update();
        assert!(history.nearest(1000 * PERIOD_NS).is_none(), "those that were kept are old");
        (1000..1004).for_each(|number| writer.push(&scan(number)));
        history.update();
        assert_eq!(history.nearest(1003 * PERIOD_NS).unwrap(), &scan(1002));
    }

    #[test]
    fn handing_scans_on_allocates_nothing() {
        let (mut writer, mut history) = scan_history(GEOMETRY, 0);
        let scans: Vec<_> = (0..200).map(scan).collect();
        let counted = allocation_counter::measure(|| {
            for scan in &scans {
                writer.push(scan);
                if scan.time_ns % (4 * PERIOD_NS) == 0 {
                    history.update();
                }
            }
        });
        assert_eq!(counted.count_total, 0);
    }
}
