//! One line of the benchmark table: how it is measured, what it is compared with, how it is printed.

use std::hint::black_box;
use std::time::Instant;

use comfy_table::{CellAlignment, Table, presets::ASCII_MARKDOWN};
use serde::Serialize;

/// The middle and the ends of repeated measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Timing {
    /// The fastest run: the best guess on a machine that others use too.
    pub min: f64,
    /// The middle run.
    pub median: f64,
    /// The slowest run.
    pub max: f64,
}

impl Timing {
    /// Of any measurements, in any order.
    ///
    /// # Panics
    /// When there are none.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        assert!(!values.is_empty(), "a timing needs at least one run");
        values.sort_by(f64::total_cmp);
        Self { min: values[0], median: values[values.len() / 2], max: values[values.len() - 1] }
    }
}

/// Seconds that `work` takes, after one run that does not count.
pub fn time<T>(runs: usize, mut work: impl FnMut() -> T) -> Timing {
    seconds(&mut work);
    Timing::of((0..runs).map(|_| seconds(&mut work)).collect())
}

/// Seconds of ours and of a peer's way to do the same, turn by turn, so that a busy machine slows both down alike.
pub fn time_against<A, B>(
    runs: usize,
    mut ours: impl FnMut() -> A,
    mut peer: impl FnMut() -> B,
) -> (Timing, Timing) {
    seconds(&mut ours);
    seconds(&mut peer);
    let (a, b) = (0..runs).map(|_| (seconds(&mut ours), seconds(&mut peer))).unzip();
    (Timing::of(a), Timing::of(b))
}

fn seconds<T>(work: &mut impl FnMut() -> T) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64()
}

/// What a number counts, and with it whether more is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Seconds for one piece of work: less is better.
    Seconds,
    /// Pieces of work in a second: more is better.
    PerSecond,
    /// Millions of bytes in a second: more is better.
    MegabytesPerSecond,
    /// Memory in MiB: less is better.
    Mebibytes,
    /// A share of one: more is better.
    Share,
}

impl Unit {
    fn more_is_better(self) -> bool {
        matches!(self, Self::PerSecond | Self::MegabytesPerSecond | Self::Share)
    }

    fn text(self, value: f64) -> String {
        match self {
            Self::Seconds if value < 1e-6 => format!("{:.0} ns", value * 1e9),
            Self::Seconds if value < 1e-3 => format!("{:.1} us", value * 1e6),
            Self::Seconds if value < 1.0 => format!("{:.2} ms", value * 1e3),
            Self::Seconds => format!("{value:.2} s"),
            Self::PerSecond => format!("{value:.1} /s"),
            Self::MegabytesPerSecond => format!("{value:.0} MB/s"),
            Self::Mebibytes => format!("{value:.0} MiB"),
            Self::Share => format!("{value:.3}"),
        }
    }
}

/// What another way of doing the same reaches in the same run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Peer {
    /// Who or what.
    pub name: String,
    /// Its median, in the row's unit.
    pub median: f64,
}

/// What must be reached and what is aimed at, in the row's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Goal {
    /// Worse than this is a defect.
    pub floor: f64,
    /// This is aimed at.
    pub target: f64,
}

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The room of the house: `simulator`, `mapping`, ...
    pub room: &'static str,
    /// What is measured, with the size of the work.
    pub name: String,
    /// What the numbers count.
    pub unit: Unit,
    /// Median and spread.
    pub value: Timing,
    /// The peer, if there is one.
    pub peer: Option<Peer>,
    /// Floor and target, if there are any.
    pub goal: Option<Goal>,
    /// What else one must know to judge the number.
    pub note: String,
}

impl Row {
    /// Time for one piece of work.
    #[must_use]
    pub fn seconds(room: &'static str, name: impl Into<String>, timing: Timing) -> Self {
        Self::new(room, name, Unit::Seconds, timing)
    }

    /// The same as a rate; `pieces` of work were done in each timed run.
    #[must_use]
    pub fn per_second(
        room: &'static str,
        name: impl Into<String>,
        pieces: f64,
        timing: Timing,
    ) -> Self {
        let rate = Timing {
            min: pieces / timing.max,
            median: pieces / timing.median,
            max: pieces / timing.min,
        };
        Self::new(room, name, Unit::PerSecond, rate)
    }

    /// Any other number.
    #[must_use]
    pub fn new(room: &'static str, name: impl Into<String>, unit: Unit, value: Timing) -> Self {
        Self { room, name: name.into(), unit, value, peer: None, goal: None, note: String::new() }
    }

    /// Beside a peer whose median was taken in the same run, in the row's unit.
    #[must_use]
    pub fn peer(self, name: impl Into<String>, median: f64) -> Self {
        Self { peer: Some(Peer { name: name.into(), median }), ..self }
    }

    /// With what must be reached and what is aimed at.
    #[must_use]
    pub fn goal(self, floor: f64, target: f64) -> Self {
        Self { goal: Some(Goal { floor, target }), ..self }
    }

    /// With a remark.
    #[must_use]
    pub fn note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    /// How many times better than the peer we are; below 1 we are worse.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        let peer = self.peer.as_ref()?.median;
        Some(if self.unit.more_is_better() {
            self.value.median / peer
        } else {
            peer / self.value.median
        })
    }

    fn verdict(&self) -> String {
        let Some(goal) = self.goal else { return String::new() };
        let reached = |wanted: f64| match self.unit.more_is_better() {
            true => self.value.median >= wanted,
            false => self.value.median <= wanted,
        };
        let word = match (reached(goal.target), reached(goal.floor)) {
            (true, _) => "target reached",
            (_, true) => "floor reached",
            _ => "BELOW FLOOR",
        };
        format!("{} / {}: {word}", self.unit.text(goal.floor), self.unit.text(goal.target))
    }

    fn cells(&self) -> [String; 8] {
        let text = |value| self.unit.text(value);
        [
            self.room.to_owned(),
            self.name.clone(),
            text(self.value.median),
            format!("{} .. {}", text(self.value.min), text(self.value.max)),
            self.peer
                .as_ref()
                .map_or_else(String::new, |peer| format!("{} {}", peer.name, text(peer.median))),
            self.ratio().map_or_else(String::new, |ratio| format!("{ratio:.2}x")),
            self.verdict(),
            self.note.clone(),
        ]
    }
}

/// The table for people.
#[must_use]
pub fn table(rows: &[Row]) -> Table {
    let mut table = Table::new();
    table.load_preset(ASCII_MARKDOWN);
    table.set_header([
        "room",
        "what",
        "median",
        "spread",
        "peer",
        "ratio",
        "floor / target",
        "note",
    ]);
    table.add_rows(rows.iter().map(Row::cells));
    for column in [2, 3, 5] {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMING: Timing = Timing { min: 0.5, median: 1.0, max: 2.0 };

    #[test]
    fn the_median_is_the_middle_of_the_sorted_runs() {
        assert_eq!(Timing::of(vec![2.0, 0.5, 1.0]), TIMING);
    }

    #[test]
    fn the_first_run_does_not_count() {
        let mut runs = 0;
        time(3, || runs += 1);
        assert_eq!(runs, 4);
    }

    #[test]
    fn ours_and_the_peer_take_turns() {
        let log = std::cell::RefCell::new(String::new());
        time_against(2, || log.borrow_mut().push('a'), || log.borrow_mut().push('b'));
        assert_eq!(log.into_inner(), "ababab");
    }

    #[test]
    fn a_rate_turns_the_spread_round() {
        let row = Row::per_second("simulator", "frames", 10.0, TIMING);
        assert_eq!(row.value, Timing { min: 5.0, median: 10.0, max: 20.0 });
    }

    #[test]
    fn a_ratio_above_one_is_better_for_times_and_for_rates() {
        let time = Row::seconds("planning", "a_star", TIMING).peer("pathfinding", 3.0);
        let rate = Row::per_second("simulator", "frames", 30.0, TIMING).peer("other", 10.0);
        assert_eq!((time.ratio(), rate.ratio()), (Some(3.0), Some(3.0)));
    }

    #[test]
    fn a_time_above_its_floor_is_called_out() {
        let verdict =
            |floor, target| Row::seconds("mapping", "update", TIMING).goal(floor, target).verdict();
        assert!(verdict(0.9, 0.5).ends_with("BELOW FLOOR"));
        assert!(verdict(1.0, 0.5).ends_with("floor reached"));
        assert!(verdict(3.0, 1.0).ends_with("target reached"));
    }

    #[test]
    fn numbers_are_printed_in_the_unit_that_fits() {
        let text = |value| Unit::Seconds.text(value);
        assert_eq!(
            [text(2e-8), text(2.5e-4), text(0.0123), text(3.0)],
            ["20 ns", "250.0 us", "12.30 ms", "3.00 s"]
        );
    }
}
