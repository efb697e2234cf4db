//! Progress of a run: a bar on a terminal, otherwise one line for each tenth of the run.

use std::{
    fmt,
    io::{IsTerminal as _, Write as _},
    time::{Duration, Instant},
};

use super::fit;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

/// On a terminal with fewer columns, the bar is short and leaves out the rate.
const NARROW: usize = 70;

/// The state of a run that is shown beside the progress.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Status<'a> {
    /// Share of the reachable floor that is mapped, 0 to 1, if it is known.
    pub coverage: Option<f64>,
    /// Current activity, such as the reason of the goal; may be empty.
    pub doing: &'a str,
}

impl Status<'_> {
    fn text(&self) -> String {
        // Rounded down, so that only all is 100 %.
        let coverage =
            self.coverage.map(|share| format!("{:.0} % mapped", (100.0 * share).floor()));
        let doing = (!self.doing.is_empty()).then(|| self.doing.to_owned());
        [coverage, doing].into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// Shows the progress of a run on standard error.
#[derive(Debug)]
pub struct Progress {
    total: u64,
    started: Instant,
    bar: Option<ProgressBar>,
    tenths_shown: u64,
}

impl Progress {
    /// Starts the progress of a run of `total` frames.
    #[must_use]
    pub fn start(total: u64) -> Self {
        let columns = fit::columns_of(std::io::stderr());
        let bar = std::io::stderr()
            .is_terminal()
            .then(|| bar(total, ProgressDrawTarget::stderr(), columns));
        Self { total, started: Instant::now(), bar, tenths_shown: 0 }
    }

    /// A progress that shows nothing, for `--quiet`.
    #[must_use]
    pub fn hidden() -> Self {
        // All tenths count as shown.
        Self { total: 0, started: Instant::now(), bar: None, tenths_shown: u64::MAX }
    }

    /// Prints a line above the bar. Without a terminal there is no bar, and no line either.
    pub fn say(&self, line: &str) {
        if let Some(bar) = &self.bar {
            bar.println(fit::text(line, fit::columns_of(std::io::stderr())));
        }
    }

    /// Shows that `done` frames are done.
    pub fn frame(&mut self, done: u64, status: &Status<'_>) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.set_message(status.text());
            return;
        }
        let tenths = tenths(done, self.total);
        if tenths > self.tenths_shown {
            self.tenths_shown = tenths;
            // Standard error may be closed; the run continues without it.
            let _ = writeln!(
                std::io::stderr(),
                "{}",
                plain(done, self.total, self.started.elapsed(), status)
            );
        }
    }

    /// Ends the progress and removes the bar.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// A bar for a terminal of this width. The message takes what is left of the line.
fn bar(total: u64, on: ProgressDrawTarget, columns: Option<usize>) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total), on);
    let template = if columns.is_some_and(|columns| columns < NARROW) {
        "{bar:4} {pos}/{len} {eta} {wide_msg}"
    } else {
        "{bar:20} {pos}/{len} frames, {rate}, {eta} left  {wide_msg}"
    };
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    // indicatif's own `per_sec` always has four decimals, and any number of digits in the first
    // second.
    bar.with_style(style.with_key("rate", |state: &ProgressState, text: &mut dyn fmt::Write| {
        // Writing into a string cannot fail.
        let _ = write!(text, "{:.1} frames/s", rate(state.pos(), state.elapsed()));
    }))
}

/// Frames per second.
fn rate(done: u64, elapsed: Duration) -> f64 {
    done as f64 / elapsed.as_secs_f64().max(1e-9)
}

/// Number of completed tenths of the run.
fn tenths(done: u64, total: u64) -> u64 {
    (done * 10).checked_div(total).unwrap_or(10)
}

/// One line of progress for output that is not a terminal.
fn plain(done: u64, total: u64, elapsed: Duration, status: &Status<'_>) -> String {
    let rate = rate(done, elapsed);
    let left_s = total.saturating_sub(done) as f64 / rate.max(1e-9);
    let status = status.text();
    let separator = if status.is_empty() { "" } else { ", " };
    format!(
        "{:3.0} %  {done}/{total} frames, {rate:.1} frames/s, {left_s:.0} s left{separator}{status}",
        100.0 * done as f64 / total.max(1) as f64
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::TermLike;
    use std::io;

    #[test]
    fn a_line_shows_progress_rate_and_remaining_time() {
        let status = Status { coverage: Some(0.347), doing: "frontier" };
        let line = plain(1500, 3000, Duration::from_secs(50), &status);
        assert_eq!(
            line,
            " 50 %  1500/3000 frames, 30.0 frames/s, 50 s left, 34 % mapped, frontier"
        );
        let line = plain(3000, 3000, Duration::from_secs(100), &Status::default());
        assert_eq!(line, "100 %  3000/3000 frames, 30.0 frames/s, 0 s left");
    }

    /// A terminal that stores the drawn text.
    #[derive(Debug, Clone)]
    struct FakeTerminal {
        columns: u16,
        text: std::sync::Arc<std::sync::Mutex<String>>,
    }

    impl TermLike for FakeTerminal {
        fn width(&self) -> u16 {
            self.columns
        }
        fn move_cursor_up(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_down(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_right(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_left(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn write_line(&self, text: &str) -> io::Result<()> {
            self.write_str(text)
        }
        fn write_str(&self, text: &str) -> io::Result<()> {
            self.text.lock().unwrap().push_str(text);
            Ok(())
        }
        fn clear_line(&self) -> io::Result<()> {
            self.text.lock().unwrap().clear();
            Ok(())
        }
        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    /// The bar in the middle of a run on a terminal of this width.
    fn drawn(columns: u16) -> String {
        let terminal = FakeTerminal { columns, text: std::sync::Arc::default() };
        let target = ProgressDrawTarget::term_like(Box::new(terminal.clone()));
        let bar = bar(3000, target, Some(columns.into())).with_elapsed(Duration::from_secs(50));
        bar.set_message(Status { coverage: Some(0.347), doing: "towards an inconsistency" }.text());
        bar.set_position(1500);
        bar.force_draw();
        terminal.text.lock().unwrap().clone()
    }

    #[test]
    fn the_bar_fits_40_columns_and_still_shows_progress_time_and_coverage() {
        let line = drawn(40);
        assert!(line.contains("1500/3000") && line.contains("34 % mapped"), "{line:?}");
        assert!(line.trim_end().chars().count() <= 40, "{line:?}");
    }

    #[test]
    fn the_bar_shows_the_rate_with_one_decimal_and_fits_the_terminal() {
        let line = drawn(78);
        let rate =
            line.split(", ").find_map(|part| part.strip_suffix(" frames/s")).unwrap_or_default();
        assert_eq!(rate.split_once('.').map(|(_, decimals)| decimals.len()), Some(1), "{line:?}");
        assert!(line.contains("1500/3000 frames") && line.contains("34 % mapped"), "{line:?}");
        assert!(line.trim_end().chars().count() <= 78 && !line.contains('\x1b'), "{line:?}");
    }

    #[test]
    fn a_run_of_any_length_shows_ten_lines() {
        for total in [10, 37, 3000] {
            let mut shown = Vec::new();
            for done in 1..=total {
                if shown.last().copied().unwrap_or(0) < tenths(done, total) {
                    shown.push(tenths(done, total));
                }
            }
            assert_eq!(shown, (1..=10).collect::<Vec<_>>(), "{total}");
        }
    }

    #[test]
    fn a_run_without_frames_does_not_divide_by_zero() {
        assert_eq!(tenths(0, 0), 10);
        assert!(plain(0, 0, Duration::ZERO, &Status::default()).contains("0/0 frames"));
    }
}
