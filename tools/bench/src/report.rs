//! The rows of the benchmark table: measurement, comparison with a peer, and printing.

use std::hint::black_box;
use std::time::Instant;

use comfy_table::{CellAlignment, Table, presets::ASCII_MARKDOWN};
use serde::Serialize;

/// Median and range of repeated measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Timing {
    /// The fastest run: the best estimate on a machine with other load.
    pub min: f64,
    pub median: f64,
    pub max: f64,
}

impl Timing {
    /// # Panics
    /// When `values` is empty.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        assert!(!values.is_empty(), "a timing needs at least one run");
        values.sort_by(f64::total_cmp);
        Self { min: values[0], median: values[values.len() / 2], max: values[values.len() - 1] }
    }
}

/// Measures the seconds that `work` takes, after one warm-up run.
pub fn time<T>(runs: usize, mut work: impl FnMut() -> T) -> Timing {
    seconds(&mut work);
    Timing::of((0..runs).map(|_| seconds(&mut work)).collect())
}

/// Measures the seconds of our implementation and of a peer's. Their runs alternate, so that load on the machine affects both
/// alike.
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

/// The unit of a number, which also tells whether more is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Duration of one operation: less is better.
    Seconds,
    /// Operations per second: more is better.
    PerSecond,
    /// Millions of bytes per second: more is better.
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

/// Another implementation of the same work, measured in the same run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Peer {
    /// The implementation and what it computes.
    pub name: String,
    /// The peer's median, in the row's unit.
    pub median: f64,
}

/// Required and desired value, in the row's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Goal {
    /// A worse value is a defect.
    pub floor: f64,
    /// The value that is desired.
    pub target: f64,
}

/// One row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Part of the workspace, such as `simulator` or `mapping`.
    pub area: &'static str,
    /// The measured operation, with the size of its input.
    pub name: String,
    pub unit: Unit,
    pub value: Timing,
    pub peer: Option<Peer>,
    pub goal: Option<Goal>,
    /// Conditions of the measurement.
    pub note: String,
}

impl Row {
    /// A row with the duration of one operation.
    #[must_use]
    pub fn seconds(area: &'static str, name: impl Into<String>, timing: Timing) -> Self {
        Self::new(area, name, Unit::Seconds, timing)
    }

    /// A row with a rate; each timed run did this number of operations.
    #[must_use]
    pub fn per_second(
        area: &'static str,
        name: impl Into<String>,
        operations: f64,
        timing: Timing,
    ) -> Self {
        let rate = Timing {
            min: operations / timing.max,
            median: operations / timing.median,
            max: operations / timing.min,
        };
        Self::new(area, name, Unit::PerSecond, rate)
    }

    /// A row with any other number.
    #[must_use]
    pub fn new(area: &'static str, name: impl Into<String>, unit: Unit, value: Timing) -> Self {
        Self { area, name: name.into(), unit, value, peer: None, goal: None, note: String::new() }
    }

    /// Adds a peer's median of the same run, in the row's unit.
    #[must_use]
    pub fn peer(self, name: impl Into<String>, median: f64) -> Self {
        Self { peer: Some(Peer { name: name.into(), median }), ..self }
    }

    /// Adds the required and the desired value.
    #[must_use]
    pub fn goal(self, floor: f64, target: f64) -> Self {
        Self { goal: Some(Goal { floor, target }), ..self }
    }

    /// Adds a note on the conditions of the measurement.
    #[must_use]
    pub fn note(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }

    /// The factor by which our value is better than the peer's; below 1 it is worse.
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
        let verdict = match (self.reaches(goal.target), self.reaches(goal.floor)) {
            (true, _) => "target reached",
            (_, true) => "floor reached",
            _ => "BELOW FLOOR",
        };
        format!("{} / {}: {verdict}", self.unit.text(goal.floor), self.unit.text(goal.target))
    }

    fn reaches(&self, goal: f64) -> bool {
        match self.unit.more_is_better() {
            true => self.value.median >= goal,
            false => self.value.median <= goal,
        }
    }

    fn cells(&self) -> [String; 8] {
        [
            self.area.to_owned(),
            self.name.clone(),
            self.unit.text(self.value.median),
            format!("{} .. {}", self.unit.text(self.value.min), self.unit.text(self.value.max)),
            self.peer.as_ref().map_or_else(String::new, |peer| {
                format!("{} {}", peer.name, self.unit.text(peer.median))
            }),
            self.ratio().map_or_else(String::new, |ratio| format!("{ratio:.2}x")),
            self.verdict(),
            self.note.clone(),
        ]
    }
}

/// The rows as a Markdown table.
#[must_use]
pub fn table(rows: &[Row]) -> Table {
    let mut table = Table::new();
    table.load_preset(ASCII_MARKDOWN);
    table.set_header([
        "area",
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
    fn the_warm_up_run_is_not_counted() {
        let mut runs = 0;
        time(3, || runs += 1);
        assert_eq!(runs, 4);
    }

    #[test]
    fn our_runs_and_the_peers_alternate() {
        let log = std::cell::RefCell::new(String::new());
        time_against(2, || log.borrow_mut().push('a'), || log.borrow_mut().push('b'));
        assert_eq!(log.into_inner(), "ababab");
    }

    #[test]
    fn the_slowest_run_of_a_rate_is_its_minimum() {
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
        for (floor, target, verdict) in
            [(0.9, 0.5, "BELOW FLOOR"), (1.0, 0.5, "floor reached"), (3.0, 1.0, "target reached")]
        {
            let row = Row::seconds("mapping", "update", TIMING).goal(floor, target);
            assert!(row.verdict().ends_with(verdict));
        }
    }

    #[test]
    fn numbers_are_printed_in_the_unit_that_fits() {
        assert_eq!(
            [2e-8, 2.5e-4, 0.0123, 3.0].map(|value| Unit::Seconds.text(value)),
            ["20 ns", "250.0 us", "12.30 ms", "3.00 s"]
        );
    }
}
