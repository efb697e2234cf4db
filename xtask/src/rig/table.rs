//! What came of the scenarios, as text.

/// One check.
#[derive(Debug, Clone)]
pub struct Row {
    pub scenario: String,
    pub promise: String,
    pub figure: String,
    pub passed: bool,
    /// Wall time since the check before, seconds.
    pub seconds: f64,
}

/// Longer figures are cut in the table; they were printed whole when they came.
const FIGURE: usize = 60;

/// The table: scenario, promise, figure, outcome, wall time.
pub fn print(rows: &[Row]) {
    let width = |column: fn(&Row) -> &str, title: &str| {
        rows.iter().map(|row| column(row).chars().count()).chain([title.len()]).max().unwrap_or(0)
    };
    let (scenario, promise) =
        (width(|row| &row.scenario, "scenario"), width(|row| &row.promise, "promise"));
    let figure = width(|row| &row.figure, "figure").min(FIGURE);
    println!(
        "\n{:scenario$}  {:promise$}  {:figure$}  outcome  {:>6}",
        "scenario", "promise", "figure", "wall s"
    );
    for row in rows {
        let outcome = if row.passed { "pass" } else { "FAIL" };
        println!(
            "{:scenario$}  {:promise$}  {:figure$.figure$}  {outcome:7}  {:6.1}",
            row.scenario, row.promise, row.figure, row.seconds
        );
    }
}
