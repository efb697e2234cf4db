//! Prints the results of the scenarios.

/// One check of a scenario.
#[derive(Debug, Clone)]
pub struct Row {
    pub scenario: String,
    pub promise: String,
    pub figure: String,
    pub passed: bool,
    /// Wall time since the previous check, seconds.
    pub seconds: f64,
}

/// Longer figures are truncated in the table. They have been printed in full before.
const FIGURE: usize = 60;

/// The table with the columns scenario, promise, figure, outcome and wall time.
pub fn print(rows: &[Row]) {
    let scenario = width(rows, |row| &row.scenario, "scenario");
    let promise = width(rows, |row| &row.promise, "promise");
    let figure = width(rows, |row| &row.figure, "figure").min(FIGURE);
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

/// Width of a column: that of its longest cell or of its title.
fn width(rows: &[Row], column: fn(&Row) -> &str, title: &str) -> usize {
    let longest = rows.iter().map(|row| column(row).chars().count()).max();
    longest.unwrap_or(0).max(title.len())
}
