//! Reports on a run: `summary.json`, the table in the terminal, `map.png`, `depth.png` and
//! progress.

pub mod alignment;
pub mod animation;
pub mod another_run;
pub mod atomic;
pub mod canvas;
pub(crate) mod colors;
pub mod coverage;
pub mod depth_sample;
pub mod depth_scale;
pub mod depth_sheet;
pub mod events;
pub mod fit;
pub mod goal_log;
pub mod held;
pub mod known_cells;
pub mod latency;
pub mod map_image;
pub mod map_view;
pub mod pose_error;
pub mod progress;
pub mod stuck;
pub mod summary;
pub mod table;
pub mod top_view;

/// A share as a percentage with one decimal. It is rounded down, so that only all is 100 %.
#[must_use]
pub fn percent(share: f64) -> String {
    // A share such as 0.29 is slightly less than its decimal notation.
    let tenths = (1000.0 * share + 1e-9).floor();
    format!("{:.1} %", tenths / 10.0)
}

#[cfg(test)]
mod tests {
    use super::percent;

    #[test]
    fn only_all_is_a_hundred_percent() {
        let texts = [0.0, 0.29, 0.9999, 1.0].map(percent);
        assert_eq!(texts, ["0.0 %", "29.0 %", "99.9 %", "100.0 %"]);
    }
}
