//! How far a run has come: a bar on a terminal, a line every tenth elsewhere.

use std::{
    fmt,
    io::{IsTerminal as _, Write as _},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

/// What is worth knowing while a run lasts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Status<'a> {
    /// Share of the reachable floor that is mapped, where it is known.
    pub coverage: Option<f64>,
    /// What the robot is about, such as a goal's reason; may be empty.
    pub doing: &'a str,
}

impl Status<'_> {
    fn text(&self) -> String {
        let coverage = self.coverage.map(|share| format!("{:.0} % mapped", 100.0 * share));
        let doing = (!self.doing.is_empty()).then(|| self.doing.to_owned());
        [coverage, doing].into_iter().flatten().collect::<Vec<_>>().join(", ")
    }
}

/// Tells on stderr how far a run has come.
#[derive(Debug)]
pub struct Progress {
    total: u64,
    started: Instant,
    bar: Option<ProgressBar>,
    tenths_told: u64,
}

impl Progress {
    /// A run of `total` frames starts now.
    #[must_use]
    pub fn start(total: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| bar(total, ProgressDrawTarget::stderr()));
        Self { total, started: Instant::now(), bar, tenths_told: 0 }
    }

    /// `done` frames are done.
    pub fn frame(&mut self, done: u64, status: &Status<'_>) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            bar.set_message(status.text());
            return;
        }
        let tenths = tenths(done, self.total);
        if tenths > self.tenths_told {
            self.tenths_told = tenths;
            // Nobody may be reading; a run does not end for that.
            let _ = writeln!(
                std::io::stderr(),
                "{}",
                plain(done, self.total, self.started.elapsed(), status)
            );
        }
    }

    /// The run is over: takes the bar away.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

fn bar(total: u64, on: ProgressDrawTarget) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(total), on);
    let template = "{bar:20} {pos}/{len} frames, {rate}, {eta} left  {wide_msg}";
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    // indicatif's own `per_sec` has four decimals, whatever is asked for, and in the first second any number of digits.
    bar.with_style(style.with_key("rate", |state: &ProgressState, text: &mut dyn fmt::Write| {
        // Nothing can be done about a terminal that takes no text.
        let _ = write!(text, "{:.1} a second", rate(state.pos(), state.elapsed()));
    }))
}

/// Frames a second.
fn rate(done: u64, elapsed: Duration) -> f64 {
    done as f64 / elapsed.as_secs_f64().max(1e-9)
}

/// Whole tenths of the run.
fn tenths(done: u64, total: u64) -> u64 {
    (done * 10).checked_div(total).unwrap_or(10)
}

fn plain(done: u64, total: u64, elapsed: Duration, status: &Status<'_>) -> String {
    let rate = rate(done, elapsed);
    let left_s = total.saturating_sub(done) as f64 / rate.max(1e-9);
    let status = status.text();
    let separator = if status.is_empty() { "" } else { ", " };
    format!(
        "{:3.0} %  {done}/{total} frames, {rate:.1} a second, {left_s:.0} s left{separator}{status}",
        100.0 * done as f64 / total.max(1) as f64
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::TermLike;
    use std::io;

    #[test]
    fn a_line_says_how_far_how_fast_and_how_long() {
        let status = Status { coverage: Some(0.347), doing: "frontier" };
        let line = plain(1500, 3000, Duration::from_secs(50), &status);
        assert_eq!(
            line,
            " 50 %  1500/3000 frames, 30.0 a second, 50 s left, 35 % mapped, frontier"
        );
        let line = plain(3000, 3000, Duration::from_secs(100), &Status::default());
        assert_eq!(line, "100 %  3000/3000 frames, 30.0 a second, 0 s left");
    }

    /// A terminal of 78 columns that keeps what was drawn.
    #[derive(Debug, Clone, Default)]
    struct Paper(std::sync::Arc<std::sync::Mutex<String>>);

    impl TermLike for Paper {
        fn width(&self) -> u16 {
            78
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
            self.0.lock().unwrap().push_str(text);
            Ok(())
        }
        fn clear_line(&self) -> io::Result<()> {
            self.0.lock().unwrap().clear();
            Ok(())
        }
        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn the_bar_says_the_rate_with_one_decimal_within_the_terminals_width() {
        let paper = Paper::default();
        let bar = bar(3000, ProgressDrawTarget::term_like(Box::new(paper.clone())))
            .with_elapsed(Duration::from_secs(50));
        bar.set_message(
            Status { coverage: Some(0.347), doing: "going where two looks disagree" }.text(),
        );
        bar.set_position(1500);
        bar.force_draw();
        let line = paper.0.lock().unwrap().clone();
        let rate =
            line.split(", ").find_map(|part| part.strip_suffix(" a second")).unwrap_or_default();
        assert_eq!(rate.split_once('.').map(|(_, decimals)| decimals.len()), Some(1), "{line:?}");
        assert!(line.contains("1500/3000 frames") && line.contains("35 % mapped"), "{line:?}");
        assert!(line.trim_end().chars().count() <= 78 && !line.contains('\x1b'), "{line:?}");
    }

    #[test]
    fn a_run_of_any_length_tells_ten_times() {
        for total in [10, 37, 3000] {
            let mut told = Vec::new();
            for done in 1..=total {
                if told.last().copied().unwrap_or(0) < tenths(done, total) {
                    told.push(tenths(done, total));
                }
            }
            assert_eq!(told, (1..=10).collect::<Vec<_>>(), "{total}");
        }
    }

    #[test]
    fn a_run_without_frames_is_no_division_by_zero() {
        assert_eq!(tenths(0, 0), 10);
        assert!(plain(0, 0, Duration::ZERO, &Status::default()).contains("0/0 frames"));
    }
}
